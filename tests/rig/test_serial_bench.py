from __future__ import annotations

from pathlib import Path

import pytest

from rig.cli import entry as cli
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.serial_bus import UNWATCHED_SHARE, SerialBus
from rig.runs.run import read_record
from rig.wiring.connect import connect

SEQUENCE = """
sequence: 1
name: short
stages:
  - {name: swing, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 1}], duration_s: 1,
     ramp_in_s: 0.3,
     ramp_out_s: 0.3}
"""
BUS = "bus: {interface: epos_serial, port: mock, baud: 1000000, round_trip_ms: 0}"
ENCODER = "encoder: {kind: amt21, port: mock, baud: 2000000, address: 84, sign: 1, offset_deg: 0}"


def variant(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = resolve("practical_serial", "benches").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "bench.yaml"
    path.write_text(text)
    return path


def test_the_packaged_bench_is_simulated_and_unwatched() -> None:
    bench = load_bench("practical_serial").value
    assert isinstance(bench.bus, SerialBus)
    assert bench.simulated
    assert not bench.watched
    assert load_bench("practical").value.watched


def test_limits_are_cut_where_the_drive_has_no_watchdog(tmp_path: Path) -> None:
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
        ([("baud: 1000000", "baud: 115200")], r"13.72 ms, 686% .* cycle_Hz to 55.5556"),
        ([("round_trip_ms: 0", "round_trip_ms: 16")], r"81.58 ms, .* cycle_Hz to 9.80392"),
        ([(BUS, "bus: {interface: epos_serial}")], r":13:6: bus.port: missing"),
        (
            [(BUS, "bus: {interface: epos_serial, port: mock, bitrate: 1}")],
            r":13:43: bus.bitrate: unknown key; (?!did you mean 'bitrate')",
        ),
        ([(ENCODER, "encoder: {kind: cia406}")], "an encoder of kind cia406 needs a CAN bus"),
        ([(ENCODER, "encoder: {kind: sincos}")], "known are cia406 .* and amt21"),
        (
            [("kind: amt21, port: mock", "kind: amt21, port: /dev/ttyUSB1")],
            r"must both be simulated \(mock\) or both real",
        ),
        ([("address: 84", "address: 85")], r"encoder.address: .*multiple of 4"),
    ],
    ids=[
        "cycle",
        "baud",
        "round trip",
        "no port",
        "CAN key",
        "CAN encoder",
        "kind",
        "mixed",
        "address",
    ],
)
def test_a_bench_that_cannot_work_is_refused(
    tmp_path: Path, changes: list[tuple[str, str]], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        load_bench(variant(tmp_path, *changes))


def test_an_encoder_line_beside_a_can_servo(tmp_path: Path) -> None:
    path = variant(tmp_path, (BUS, "bus: {interface: mock}"), ("node: 1", "node: 2"))
    with connect(load_bench(path), 0, False) as devices:
        assert devices.link.has_watchdog
        devices.servo.prepare(0.002)
        devices.encoder.prepare(0.002)
        devices.link.exchange()
        assert devices.servo.sample().fresh
        assert devices.encoder.sample().fresh
        assert devices.encoder.identity().name == "AMT21 at 54h"


def test_a_real_port_needs_the_makers_eds(tmp_path: Path) -> None:
    path = variant(tmp_path, ("port: mock", "port: /dev/no_such_port"))
    with (
        pytest.raises(InputError, match=r"servo\.eds: missing"),
        connect(load_bench(path), 0, False),
    ):
        pass


def test_a_run_over_serial_tells_the_operator(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sequence = tmp_path / "short.yaml"
    sequence.write_text(SEQUENCE)
    out = tmp_path / "run"
    assert (
        cli.status(
            ["run", str(sequence), "--bench", "practical_serial", "--yes", "--out", str(out)]
        )
        == 0
    )
    # It is said at the start, and not again between the result and what to do next.
    said = capsys.readouterr().err
    assert said.count("this drive has no watchdog") == 1
    record = read_record(out)
    assert record.state == "done"
    assert record.stale == 0
    assert record.de_energised
