from pathlib import Path

import pytest

from drivers.clock import NS
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.serial_bus import NO_WATCHDOG, UNWATCHED_SHARE
from rig.control.remote import RunProgress
from rig.runs.run import read_record
from rig.wiring.connect import connect

from .benches import stages, swing, variant

BUS = "bus: {interface: epos_serial, port: mock, baud: 1000000, round_trip_ms: 0}"
ENCODER = "encoder: {kind: amt21, port: mock, baud: 2000000, address: 84, sign: 1, offset_deg: 0}"


def test_limits_are_cut_where_the_drive_has_no_watchdog() -> None:
    limits, watched = (
        load_bench("practical_serial").value.limits,
        load_bench("practical").value.limits,
    )
    assert limits.torque_N_m == UNWATCHED_SHARE * watched.torque_N_m == 45
    assert limits.current_A == UNWATCHED_SHARE * watched.current_A == 15
    assert limits.speed_deg_s == UNWATCHED_SHARE * watched.speed_deg_s == 72
    assert limits.following_error_deg == watched.following_error_deg


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            [("cycle_Hz: 500", "cycle_Hz: 1000")],
            r":13:49: bus.baud: too slow: 5 objects per cycle take up to 1580 bits and 1.58 ms, "
            r"158% of a cycle of 1 "
            r"ms, limit 80%; .* cycle_Hz to 500 \(got 1000000\)",
        ),
        ([("round_trip_ms: 0", "round_trip_ms: 16")], r"81.58 ms, .* cycle_Hz to 9.80392"),
        ([(BUS, "bus: {interface: epos_serial}")], r":13:6: bus.port: missing"),
        ([(BUS, "bus: {interface: epos_seral}")], r":13:18: bus.interface: .*'epos_serial'"),
        ([("kind: amt21, port: mock", "kind: amt21, port: mok")], r":15:30: .*port: .*'mock'"),
        ([(BUS, "bus: {interface: mok}")], r":13:18: bus.interface: .*'mock'"),
        ([(ENCODER, "encoder: {kind: cia406}")], "an encoder of kind cia406 needs a CAN bus"),
        (
            [("kind: amt21, port: mock", "kind: amt21, port: /dev/ttyUSB1")],
            r"must both be simulated \(mock\) or both real",
        ),
        ([("address: 84", "address: 85")], r"encoder.address: .*multiple of 4"),
    ],
    ids=[
        "cycle",
        "round trip",
        "no port",
        "near serial",
        "near port",
        "near mock",
        "CAN encoder",
        "mixed",
        "address",
    ],
)
def test_a_bench_that_cannot_work_is_refused(tmp_path, changes, words):
    with pytest.raises(InputError, match=words):
        load_bench(variant(tmp_path, *changes, source="practical_serial"))


def test_an_encoder_line_beside_a_can_servo(tmp_path: Path) -> None:
    path = variant(
        tmp_path, (BUS, "bus: {interface: mock}"), ("node: 1", "node: 2"), source="practical_serial"
    )
    with connect(load_bench(path), 0, False) as devices:
        assert devices.link.has_watchdog
        devices.servo.prepare(0.002)
        devices.encoder.prepare(0.002)
        devices.link.exchange()
        assert devices.servo.sample().fresh
        assert devices.encoder.sample().fresh
        assert devices.encoder.identity().name == "AMT21 at 54h"


def test_after_a_pause_the_motor_shows_the_turn_of_the_joint() -> None:
    """In the pause the joint could have made half a turn, which its encoder does not count."""
    document = load_bench("practical_serial")
    with connect(document, 0, realtime=False) as devices:
        devices.prepare(document.value.cycle_s)
        devices.link.exchange()
        before, clock = devices.encoder.sample(), devices.link.clock
        assert before.fresh
        for pause_ns in (3 * NS, document.value.cycle_ns):
            clock.sleep_until_ns(clock.now_ns() + pause_ns)
            devices.link.exchange()
        after = devices.encoder.sample()
    assert after.fresh
    assert after.angle_rad == pytest.approx(before.angle_rad, abs=0.01)


def test_a_run_over_serial_says_once_what_nothing_protects(elsewhere, monkeypatch, capsys):
    """It is said at the start, and not again between the result and how to go on."""

    def press(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(RunProgress, "__call__", press)
    Path("s.yaml").write_text(stages(swing(amplitude_deg=3)))
    assert status(["run", "s.yaml", "--bench", "practical_serial", "--yes", "--out", "out"]) == 3
    told = capsys.readouterr()
    assert "go on with: rig resume out" in told.out + told.err
    assert (told.out.count(NO_WATCHDOG), told.err.count(NO_WATCHDOG)) == (0, 1)
    record = read_record(Path("out"))
    assert NO_WATCHDOG in record.warnings
    assert (record.state, record.stale, record.de_energised) == ("stopped", 0, True)
