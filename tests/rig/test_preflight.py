"""What a run refuses, `rig check` and `rig run --dry-run` report in the same words."""

import dataclasses
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import rig.wiring.connect
from drivers.interfaces import RawFrame, ServoLimits
from drivers.mock.bench import SimulatedBench, simulated_bench
from drivers.mock.canopen.dictionary import key
from rig.cli.entry import BAD_INPUT, status
from rig.common.errors import Cause, InputError
from rig.common.provenance import utc_now
from rig.config.bench import load_bench
from rig.config.configuration import names
from rig.config.sequence import load_sequence
from rig.config.serial_bus import GUARDED, NO_WATCHDOG, sleep_words
from rig.control import attendance
from rig.control.attendance import connected, kept_awake, require_attendance
from rig.control.operator import AutomaticOperator, StopButton
from rig.control.session import execute
from rig.planning.plan import Plan, make_plan
from rig.runs.run_record import Ending
from rig.wiring.connect import DRIVE_EDS, ENCODER_EDS, connect
from rig.wiring.devices import unprotected
from rig.wiring.preflight import bench_findings, device_findings

from .benches import sine, stages, swing, variant

SEQUENCE = stages(swing())
TODAY = utc_now().date()


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("one.yaml").write_text(SEQUENCE)


@pytest.fixture
def outcomes(capsys: pytest.CaptureFixture[str]) -> Callable[[Path], dict[str, tuple[int, str]]]:
    """Return exit status and words of run, check and --dry-run on a bench file."""

    def each(bench: Path) -> dict[str, tuple[int, str]]:
        found = {}
        for name, arguments in (
            ("dry", ["run", "one.yaml", "--dry-run", "--bench", str(bench)]),
            ("check", ["check", str(bench)]),
            ("run", ["run", "one.yaml", "--yes", "--out", "out", "--bench", str(bench)]),
        ):
            code = status(arguments)
            captured = capsys.readouterr()
            assert "Traceback" not in captured.err
            found[name] = code, captured.out + captured.err
        return found

    return each


def problems(text: str) -> list[str]:
    return [
        line.removeprefix("problem: ") for line in text.splitlines() if line.startswith("problem: ")
    ]


@pytest.mark.parametrize("name", [name for name in names("benches") if name != "literal"])
def test_nothing_is_wrong_with_the_packaged_benches(name: str) -> None:
    assert bench_findings(load_bench(name), TODAY) == []


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            [("encoder: {node: 2", "encoder: {node: 1")],
            "encoder.node: 1 is also the node identifier of the servo",
        ),
        (
            [("servo: {node: 1", "servo: {node: 127")],
            "servo.node: 127 is also the node identifier of this program's own",
        ),
        ([("servo: {", "servo: {eds: none.eds, ")], "servo.eds: EDS file "),
        (
            [("servo: {", "servo: {eds: poor.eds, ")],
            "servo.eds: object 6061h:00h is not in the device's EDS; every run needs this object, "
            "because it shows",
        ),
    ],
    ids=["same node", "master is servo", "no EDS", "object missing"],
)
def test_a_bench_that_cannot_be_connected_to_is_bad_input(tmp_path, outcomes, changes, words):
    shutil.copy(ENCODER_EDS, "encoder.eds")
    Path("poor.eds").write_text(DRIVE_EDS.read_text().replace("[6061]", "[5061]"))
    bench = variant(tmp_path, *changes)
    found = outcomes(bench)
    for code, text in found.values():
        assert code == 2
        (line,) = [line for line in text.splitlines() if words in line]
        assert line.startswith(f"{bench}:")
    assert not Path("out").exists()


def test_a_pressure_transmitter_has_a_node_of_its_own(tmp_path: Path) -> None:
    bench = variant(
        tmp_path, ("kind: cia404, node: 4", "kind: cia404, node: 2"), source="practical_hot"
    )
    (finding,) = bench_findings(load_bench(bench), TODAY)
    assert "pressure.node: 2 is also the node identifier of the encoder" in finding.text
    assert (finding.cause, finding.connectable) == (Cause.NODES, False)


@pytest.mark.parametrize(("node", "count"), [(2, 0), (0x10, 2)])
def test_frames_of_a_drive_must_not_be_those_of_the_encoder(tmp_path, node, count):
    bench = variant(
        tmp_path, ("encoder: {node: 2", f"encoder: {{node: {node}"), source="practical_dbc"
    )
    found = bench_findings(load_bench(bench), TODAY)
    assert len(found) == count
    for finding in found:
        assert "and CANopen node 16 both use the CAN identifier" in finding.text
        assert not finding.connectable


def test_a_real_device_without_its_file_and_others_are_found_at_once(tmp_path: Path) -> None:
    bench = variant(tmp_path, ("interface: mock", "interface: virtual, channel: nobody"))
    found = bench_findings(load_bench(bench), TODAY)
    assert [finding.text.split(": ")[1] for finding in found] == ["servo.eds", "encoder.eds"]


def test_an_overdue_calibration_is_named_and_not_the_drive(tmp_path: Path, outcomes: Any) -> None:
    bench = variant(tmp_path)
    overdue = 'calibrations: [{device: lever, id: L-2, due: "2001-01-31"}]'
    bench.write_text(f"{bench.read_text()}{overdue}\noverdue_calibration: refuse\n")
    found = outcomes(bench)
    assert [found[name][0] for name in ("dry", "check", "run")] == [2, 1, 2]
    shown = found["check"][1]
    (problem,) = problems(shown)
    assert problem in found["run"][1]
    assert problem in found["dry"][1]
    assert shown.splitlines()[-1] == "verdict: NOT good: a run would refuse, because of calibration"


Tamper = Callable[[SimulatedBench], None]


def tampered(monkeypatch: pytest.MonkeyPatch, tamper: Tamper) -> None:
    def made(*arguments: Any) -> SimulatedBench:
        bench = simulated_bench(*arguments)
        tamper(bench)
        return bench

    monkeypatch.setattr(rig.wiring.connect, "simulated_bench", made)


def rates(bench: SimulatedBench, index: int, value: int) -> None:
    """Have the drive hold another rated value, mA or mN m, than the bench file says."""
    bench.drive.objects.values[key(index)] = value


def looser_than_own(bench: SimulatedBench) -> None:
    bench.drive.objects.values[key(0x6072)] = 1000
    bench.drive.objects.values[key(0x6073)] = 1000


def alarmed(bench: SimulatedBench) -> None:
    bench.encoder.objects.values[key(0x6503)] = 1


@pytest.mark.parametrize(
    ("changes", "tamper", "cause"),
    [
        ([], lambda bench: rates(bench, 0x6075, 10_000), Cause.DRIVE),
        (
            [("node: 2, counts_per_turn: 262144", "node: 2, counts_per_turn: 4096")],
            None,
            Cause.ENCODER,
        ),
        ([("servo: {", "servo: {temperature_object: [0x2555, 0], ")], None, None),
        ([], alarmed, Cause.ENCODER),
        ([], looser_than_own, Cause.LIMITS),
        ([], lambda bench: bench.drive.fail(0x3220), Cause.STATE),
        ([("servo: {", "servo: {velocity_unit_rad_s: 1.0e-12, ")], None, Cause.LIMITS),
    ],
)
def test_what_devices_refuse_is_reported_once_in_the_words_of_the_run(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    outcomes: Any,
    changes: list[tuple[str, str]],
    tamper: Tamper | None,
    cause: Cause | None,
) -> None:
    if tamper is not None:
        tampered(monkeypatch, tamper)
    found = outcomes(variant(tmp_path, *changes))
    if cause is None:  # said by the EDS, before anything is connected to
        assert [found[name][0] for name in ("dry", "check", "run")] == [2, 2, 2]
        return
    assert [found[name][0] for name in ("dry", "check", "run")] == [0, 1, 4]
    shown = found["check"][1]
    assert (
        shown.splitlines()[-1] == f"verdict: NOT good: a run would refuse, because of {cause.value}"
    )
    reported = problems(shown)
    assert len(reported) == len(set(reported))
    assert reported[0] in found["run"][1]


def test_a_drive_under_power_is_refused_in_the_words_of_the_run() -> None:
    with connect(load_bench("practical"), 0, realtime=False) as devices:
        bench = load_bench("practical").value
        devices.prepare(bench.cycle_s)
        devices.servo.enable()
        wanted = devices.servo.read_limits()
        (finding,) = device_findings(devices, wanted, bench.cycle_s)
        devices.servo.disable()
        assert list(device_findings(devices, wanted, bench.cycle_s)) == []
    assert (
        finding.text
        == "before the weight prompt: the drive is in 'operation enabled'; it must be de-energised"
    )
    assert finding.cause is Cause.STATE


@pytest.mark.parametrize("name", ["practical", "practical_serial", "practical_dbc"])
def test_check_writes_nothing(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    frames: list[RawFrame] = []
    powered: list[bool] = []

    def watched(document: Any, *arguments: Any, **options: Any) -> Any:
        context = connect(document, *arguments, **options)
        devices = context.__enter__()

        class Context:
            def __enter__(self) -> Any:
                return devices

            def __exit__(self, *exception: object) -> None:
                frames.extend(frame for frame in devices.link.take_frames() if frame.sent)
                powered.append(devices.servo.state().energised)
                context.__exit__(None, None, None)
                frames.extend(frame for frame in devices.link.take_frames() if frame.sent)

        return Context()

    monkeypatch.setattr("rig.cli.commands.bench.connect", watched)
    assert status(["check", name]) == 0
    assert powered == [False]
    can = [frame for frame in frames if frame.identifier < 0x800]
    assert {frame.identifier for frame in can} <= {0x601, 0x602, 0x604}
    assert not [
        frame for frame in can if frame.data[0] >> 5 in (0, 1)
    ]  # requests that write (CiA 301, 7.2.4.3)
    if name == "practical_dbc":
        assert {frame.identifier for frame in can} == {0x602}


OWN = ServoLimits(-1.0, 1.0, 3.0, 80.0, 30.0, None, 2, 10.0)


@pytest.mark.parametrize(("torque", "asked"), [(80.0, 2), (50.0, 0)])
@pytest.mark.parametrize("real", [True, False])
def test_a_real_bench_is_refused_before_a_weight_is_asked_for(
    runner: Any, fake_bench: Any, torque: float, asked: int, real: bool
) -> None:
    prompts = []

    class Asked(AutomaticOperator):
        def confirm_weight(self, stage: str, weight_kg: float) -> float:
            prompts.append(stage)
            return weight_kg

    bench = fake_bench(limits=dataclasses.replace(OWN, torque_N_m=torque))
    devices = bench.devices()
    if real:
        devices = dataclasses.replace(devices, hang=None)
    runner.folder.mkdir()
    folder, outcome = execute(
        runner.inputs, runner.plan, devices, runner.folder, Asked(), StopButton(), lambda *_: None
    )
    assert (outcome.ending is Ending.DONE) is (asked == 2)
    # On a simulated bench nobody hangs a weight; it is refused right after.
    assert len(prompts) == (asked or (0 if real else 1))
    if not asked:
        assert outcome.ending is Ending.FAILED
        assert "joint torque (6072h): bench file 75 N m, drive 50 N m" in outcome.message
        assert folder.record.de_energised is True
        assert bench.calls["enable"] == 0


def test_jog_refuses_what_a_run_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench = variant(tmp_path, ("encoder: {node: 2", "encoder: {node: 1"))
    assert status(["jog", str(bench), "--to", "1"]) == 2
    assert "encoder.node: 1 is also the node identifier of the servo" in capsys.readouterr().err


EMPTY = stages(sine(duration_s=3))
HEAVY = stages(sine(duration_s=3), sine("heavy", duration_s=3, weight_kg=5))
REAL = ("interface: mock", "interface: virtual")


def planned(folder: Path, text: str) -> Plan:
    path = folder / "sequence.yaml"
    path.write_text(text)
    return make_plan(load_sequence(path), load_bench("practical"))


@pytest.mark.parametrize(("yes", "terminal"), [(True, True), (False, False)])
def test_weights_and_nobody_to_ask_on_a_real_bench_are_refused(tmp_path, yes, terminal):
    bench = load_bench(variant(tmp_path, REAL))
    reason = "--yes would answer" if yes else "no terminal for the prompts"
    with pytest.raises(InputError, match=rf"{reason}.* stages heavy have weights.*without --yes"):
        require_attendance(planned(tmp_path, HEAVY), bench, yes, terminal)


def test_who_can_be_asked_or_needs_no_asking_may_run(tmp_path: Path) -> None:
    heavy, empty = planned(tmp_path, HEAVY), planned(tmp_path, EMPTY)
    real = load_bench(variant(tmp_path, REAL))
    require_attendance(heavy, real, yes=False, terminal=True)
    require_attendance(empty, real, yes=True, terminal=False)
    require_attendance(heavy, load_bench("practical"), yes=True, terminal=False)
    hoist = variant(tmp_path, REAL, ("\nbus:", "\nweights_hung_by: hoist\nbus:"))
    require_attendance(heavy, load_bench(hoist), yes=True, terminal=False)


def test_weights_and_yes_on_a_real_bench_are_refused(tmp_path, capsys):
    planned(tmp_path, HEAVY)
    servo = ("\nservo: {", f"\nservo: {{eds: {DRIVE_EDS}, ")
    encoder = ("\nencoder: {", f"\nencoder: {{eds: {ENCODER_EDS}, ")
    bench, out = variant(tmp_path, REAL, servo, encoder), tmp_path / "run"
    sequence = str(tmp_path / "sequence.yaml")
    arguments = ["run", sequence, "--bench", str(bench), "--yes", "--out", str(out)]
    assert status(arguments) == BAD_INPUT
    assert "--yes would answer the weight prompts" in capsys.readouterr().err
    assert not out.exists()


INHIBIT = """#!/bin/sh
[ -z "$REFUSED" ] || exit 1
while [ "${1#--}" != "$1" ]; do shift; done
exec "$@"
"""


@pytest.mark.parametrize(
    ("installed", "refused", "why"),
    [
        (True, "", ""),
        (True, "1", "systemd-inhibit is refused"),
        (False, "", "systemd-inhibit is not installed"),
    ],
)
def test_the_computer_is_kept_awake_where_the_system_permits_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, installed: bool, refused: str, why: str
) -> None:
    if installed:
        tool = tmp_path / "systemd-inhibit"
        tool.write_text(INHIBIT)
        tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/bin" if installed else str(tmp_path))
    monkeypatch.setenv("REFUSED", refused)
    with kept_awake("rig run") as reason:
        assert reason == why


def test_what_keeps_no_computer_awake_is_named_on_a_real_bench(tmp_path, monkeypatch):
    asked: list[list[str]] = []

    def missing(command: list[str], **_options: Any) -> None:
        asked.append(command)
        raise FileNotFoundError

    simulated = load_bench("practical_serial")
    monkeypatch.setattr(attendance.subprocess, "Popen", missing)
    monkeypatch.setattr(attendance, "connect", lambda *_: connect(simulated, 0, realtime=False))
    real = variant(tmp_path, ("port: mock", "port: /dev/some"), source="practical_serial")
    with connected(StopButton(), load_bench(real), 0, realtime=True) as devices:
        assert unprotected(devices) == [NO_WATCHDOG, sleep_words(devices.awake)]
    ((tool, what, *_),) = asked
    assert tool in devices.awake
    assert set(what.removeprefix("--what=").split(":")) == {"sleep", "idle", "handle-lid-switch"}
    guarded: Any = dataclasses.replace(devices, guard=object(), awake="")
    assert unprotected(guarded) == [GUARDED]
    with connected(StopButton(), simulated, 0, realtime=True) as devices:
        assert (len(asked), devices.awake) == (1, "")
