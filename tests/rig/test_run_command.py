"""``rig run``, ``check``, ``export`` and ``recover`` as a user runs them, on the simulated bus."""

from __future__ import annotations

import io
import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from scipy.io import loadmat

from drivers.clock import SimulatedClock
from drivers.interfaces import RawFrame, ServoState
from drivers.mock.wires.bus import SimulatedBus
from rig.cli.entry import COMMANDS, status
from rig.config.configuration import resolve
from rig.control.operator import AutomaticOperator
from rig.control.remote import RunProgress
from rig.control.session import execute
from rig.runs.mcap.layout import decode_frames
from rig.runs.mcap.reader import read_run
from rig.runs.run import load_run, read_record
from rig.sources import load_source
from rig.terminal.stop_button import StopButton
from rig.wiring.connect import DRIVE_EDS, ENCODER_EDS, connect


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of the short sequence, not to be changed."""
    folder = tmp_path_factory.mktemp("finished")
    sequence = folder / "short.yaml"
    sequence.write_text(ONE_STAGE)
    assert status(["run", str(sequence), "--yes", "--out", str(folder / "run")]) == 0
    return folder / "run"


ONE_STAGE = """\
sequence: 1
name: one
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 2}], duration_s: 1,
     ramp_in_s: 0.2, ramp_out_s: 0.2, settle_s: 0.05}
"""


def run(*arguments: str) -> int:
    return status(["run", *arguments])


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status([name, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"rig {name}" in text.split("Example", 1)[1]


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, rig.cli.entry; rig.cli.entry.status(['--help']); "
        "print(sorted(sys.modules), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for heavy in ("numpy", "numba", "canopen", "can", "pydantic", "yaml"):
        assert f"'{heavy}'" not in done.stderr


def test_an_unknown_command_is_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["fly"]) == 2
    assert "fly" in capsys.readouterr().err


def test_a_run(short_sequence: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(str(short_sequence), "--yes", "--out", "out", "--json", "copy.json") == 0
    text = capsys.readouterr().out
    assert "done: all 2 stages done; the drive is de-energised" in text
    assert "\nin simulated time: lateness of cycles p99 0 us" in text
    record = read_record(Path("out"))
    assert (record.state, record.de_energised, record.overruns, record.stale) == (
        "done",
        True,
        0,
        0,
    )
    assert json.loads(Path("copy.json").read_text()) == json.loads(Path("out/run.json").read_text())
    log = read_run(Path("out/recording.mcap"))
    assert log.damage is None
    assert log.attachments["sequence.yaml"] == short_sequence.read_bytes()
    identifiers = {
        frame.identifier
        for message in log.messages["/frames"][100:110]
        for frame in decode_frames(message.data)
    }
    assert {0x080, 0x181, 0x201} <= identifiers
    *_, heavy = load_run(Path("out")).recordings
    np.testing.assert_allclose(
        heavy.channels["angle"], heavy.channels["command"], atol=np.radians(0.5)
    )
    # Moving under 1 kN takes clearly more than the friction of the empty joint, 6.8 N m over 3 N
    # m/A.
    assert np.median(np.abs(heavy.channels["current"])) > 2.5
    assert heavy.period == pytest.approx(0.001, rel=1e-3)


def test_equal_seeds_give_equal_bytes(short_sequence: Path) -> None:
    messages = []
    for number, seed in enumerate(("3", "3", "4")):
        assert run(str(short_sequence), "--yes", "--out", f"out{number}", "--seed", seed) == 0
        messages.append(read_run(Path(f"out{number}/recording.mcap")).messages)
    assert messages[0] == messages[1]
    assert messages[0]["/sample"] != messages[2]["/sample"]


def test_dry_run_prints_the_plan_and_touches_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert run("figure10", "--dry-run") == 0
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if line.startswith("case-2")).split()
    assert row == ["case-2", "loaded", "1", "20", "30.6", "3000.8", "32.91", "+20.00"]
    assert any("joint speed" in line and "120" in line for line in lines)
    assert list(tmp_path.iterdir()) == []


def test_bad_input_names_file_line_and_column(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(
        ONE_STAGE.replace("amplitude_deg: 5", "amplitude_deg: 50").replace(
            "duration_s: 1", "duration_s: no"
        )
    )
    assert run(str(path), "--yes") == 2
    captured = capsys.readouterr()
    assert captured.err.startswith(f"{path}:4:")
    assert "Traceback" not in captured.err
    path.write_text(ONE_STAGE.replace("amplitude_deg: 5", "amplitude_deg: 50"))
    assert run(str(path), "--yes") == 2
    assert "outside -30 to 30 deg" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_a_folder_in_use_is_refused(
    short_sequence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "notes.txt").write_text("mine")
    assert run(str(short_sequence), "--yes", "--out", "used") == 2
    assert "notes.txt" in capsys.readouterr().err


def test_the_prompt_insists_on_the_planned_mass(
    short_sequence: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("0\n20\nten\n10\n"))
    assert run(str(short_sequence), "--out", "out") == 0
    text = capsys.readouterr().err
    assert "Take every weight off the lever" in text
    assert "20 kg is not the planned 10 kg" in text
    events = [(e["event"], e.get("weight_kg")) for e in read_run(Path("out/recording.mcap")).events]
    assert ("answer", 10.0) in events


def test_ctrl_c_stops_at_once(short_sequence: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    handler = signal.getsignal(signal.SIGINT)

    def press(self: RunProgress, *arguments: Any) -> None:
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(RunProgress, "__call__", press)
    assert run(str(short_sequence), "--yes", "--out", "out") == 3
    record = read_record(Path("out"))
    assert (record.state, record.de_energised) == ("stopped", True)
    assert "phase approach" in record.message or "phase excite" in record.message
    assert read_run(Path("out/recording.mcap")).events[-1]["event"] == "stopped"
    assert signal.getsignal(signal.SIGINT) is handler


def test_a_tripped_limit_is_a_bad_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "tight.yaml"
    path.write_text(ONE_STAGE + "limits: {encoder_disagreement_deg: 1.0e-9}\n")
    assert run(str(path), "--yes", "--out", "out") == 1
    assert "tripped: stage empty" in capsys.readouterr().err
    record = read_record(Path("out"))
    assert record.trip is not None
    assert record.trip["check"] == "encoder against drive"
    assert record.de_energised is True


def test_a_bus_that_dies_is_a_device_failure(
    short_sequence: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    collect, count = SimulatedBus.collect, iter(range(10**9))

    def dying(self: SimulatedBus, timeout_s: float) -> Sequence[RawFrame]:
        if next(count) > 2000:
            raise can.CanOperationError("bus-off")
        return collect(self, timeout_s)

    monkeypatch.setattr(SimulatedBus, "collect", dying)
    assert run(str(short_sequence), "--yes", "--out", "out") == 4
    text = capsys.readouterr().err
    assert "bus-off" in text
    assert "could NOT be verified" in text
    record = read_record(Path("out"))
    assert (record.state, record.de_energised) == ("failed", False)
    assert read_run(Path("out/recording.mcap")).damage is None


def test_an_operator_may_take_a_minute(runner: Any) -> None:
    """The bus is silent while a person hangs a weight; the drive is off, and the run goes on
    afterwards.
    """
    with connect(runner.inputs.bench, 0, False) as devices:

        class Slow(AutomaticOperator):
            def confirm_weight(self, stage: str, weight_kg: float) -> float:
                assert not devices.servo.state().energised
                devices.link.clock.sleep_until_ns(devices.link.clock.now_ns() + 60 * 10**9)
                return weight_kg

        runner.folder.mkdir()
        folder, outcome = execute(
            runner.inputs,
            runner.plan,
            devices,
            runner.folder,
            Slow(),
            StopButton(),
            lambda *_: None,
        )
        assert outcome.ending.value == "done", outcome.message
        assert devices.servo.state() is ServoState.SWITCH_ON_DISABLED
    assert folder.record.stale == 0


def test_a_bench_without_a_bus_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["check", "literal"]) == 2
    assert "has no bus" in capsys.readouterr().err


def test_scales_that_differ_from_the_drive_are_refused(
    tmp_path: Path, short_sequence: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "b.yaml"
    path.write_text(
        resolve("practical", "benches").read_text().replace("motor_turn: 4096", "motor_turn: 2048")
    )
    assert run(str(short_sequence), "--bench", str(path), "--yes", "--out", "out") == 4
    assert "608Fh" in capsys.readouterr().err
    assert read_record(Path("out")).de_energised is True


@pytest.mark.parametrize("kind", ["csv", "mat", "parquet"])
def test_export(finished: Path, kind: str) -> None:
    assert status(["export", str(finished), "--format", kind, "--out", f"x.{kind}"]) == 0
    (recording,) = load_run(finished).recordings
    if kind == "csv":
        lines = Path("x.csv").read_text().splitlines()
        header = lines[0].split(",")
        assert len(lines) == 1 + len(recording.time)
        assert header[0] == "time"
        angle = [float(line.split(",")[header.index("angle")]) for line in lines[1:]]
    elif kind == "mat":
        content = loadmat("x.mat", squeeze_me=True, struct_as_record=False)
        angle = content["recordings"].angle
        assert content["recordings"].name == "empty"
        assert content["units"].angle == "rad"
    else:
        parquet = pytest.importorskip("pyarrow.parquet")
        table = parquet.read_table("x.parquet")
        angle = table["angle"].to_numpy()
        assert table.schema.field("angle").metadata == {b"unit": b"rad"}
    np.testing.assert_array_equal(angle, recording.channels["angle"])


def test_csv_is_one_file_a_recording_and_a_campaign_takes_it(
    short_sequence: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(str(short_sequence), "--yes", "--out", "out") == 0
    assert status(["export", "out", "--out", "x.csv"]) == 0
    written = load_run(Path("out")).recordings
    assert [r.name for r in written] == ["empty[1]", "empty[2]", "heavy"]
    places = ["x-empty-1.csv", "x-empty-2.csv", "x-heavy.csv"]
    assert [line.partition(":")[0] for line in capsys.readouterr().out.splitlines()[-3:]] == places
    columns = (
        "{time: time, current: {column: current, average: true}, angle: angle, motor_angle: "
        "motor_angle}"
    )
    Path("campaign.yaml").write_text(
        "campaign: 1\nbench: {torque_constant: 0.03, gear_ratio: 100, moment_arm: 0.095, "
        "lever_ratio: 10}\n"
        "recordings:\n"
        f"  - {{file: [x-empty-1.csv, x-empty-2.csv], stage: unloaded, channels: {columns}}}\n"
        f"  - {{file: x-heavy.csv, stage: loaded, weight_mass: 10, channels: {columns}}}\n"
    )
    for there, here in zip(load_source(Path("campaign.yaml")).recordings, written, strict=True):
        np.testing.assert_array_equal(there.channels["current"], here.channels["current"])
        np.testing.assert_allclose(there.time, here.time)
    # None of them is overwritten, and none is written while one is in the way.
    Path("x-heavy.csv").rename("y-heavy.csv")
    assert status(["export", "out", "--out", "y.csv"]) == 2
    assert "y-heavy.csv: exists already" in capsys.readouterr().err
    assert not Path("y-empty-1.csv").exists()


def torn(finished: Path, share: float) -> Path:
    """Copy a run as a killed writer leaves it: recording cut off, run.json from the middle of the
    run.
    """
    folder = Path("torn")
    folder.mkdir()
    content = (finished / "recording.mcap").read_bytes()
    (folder / "recording.mcap").write_bytes(content[: int(share * len(content))])
    record = json.loads((finished / "run.json").read_text())
    record.update(state="running", message="", segments=[])
    record["stages"][0]["state"] = "running"
    (folder / "run.json").write_text(json.dumps(record))
    return folder


def test_recover_a_run_that_had_finished_its_stage(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = torn(finished, 0.985)
    assert status(["recover", str(folder)]) == 0
    assert "kept as recording.damaged.mcap" in capsys.readouterr().out
    assert read_run(folder / "recording.mcap").damage is None
    assert read_run(folder / "recording.damaged.mcap").damage is not None
    (mended,), (whole,) = load_run(folder).recordings, load_run(finished).recordings
    for name, values in whole.channels.items():
        np.testing.assert_array_equal(mended.channels[name], values)
    record = read_record(folder)
    assert record.stages[0].state == "done"
    assert (record.state, record.cycles) == ("done", 1151)
    before, after = read_run(finished / "recording.mcap"), read_run(folder / "recording.mcap")
    assert after.attachments == before.attachments
    count = len(after.messages["/frames"])
    assert after.messages["/frames"] == before.messages["/frames"][:count]


def test_recover_a_run_cut_off_in_its_stage(finished: Path) -> None:
    folder = torn(finished, 0.5)
    assert status(["recover", str(folder)]) == 0
    record = read_record(folder)
    assert record.stages[0].state == "failed"
    assert record.segments[0].end is None
    assert status(["export", str(folder)]) == 2
    assert status(["recover", str(folder)]) == 0


def test_recover_leaves_a_whole_run_alone(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path.name: path.read_bytes() for path in finished.iterdir()}
    assert status(["recover", str(finished)]) == 0
    assert "recording complete" in capsys.readouterr().out
    assert {path.name: path.read_bytes() for path in finished.iterdir()} == before


def test_a_finished_run_that_was_damaged_later_is_not_read_silently(
    finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = torn(finished, 0.9)
    (folder / "run.json").write_bytes((finished / "run.json").read_bytes())
    assert status(["export", str(folder)]) == 2
    assert "rig recover" in capsys.readouterr().err


@pytest.fixture
def holed(finished: Path, tmp_path: Path) -> Path:
    """A copy of the finished run with a bad place in the middle of its recording."""
    folder = tmp_path / "holed"
    shutil.copytree(finished, folder)
    content = bytearray((folder / "recording.mcap").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (folder / "recording.mcap").write_bytes(content)
    return folder


def test_a_hole_in_a_recording_is_mended_around_and_its_stage_done_again(
    holed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(["export", str(holed), "--out", "x.csv"]) == 2
    assert "rig recover" in capsys.readouterr().err
    assert status(["recover", str(holed)]) == 0
    assert "lost between" in capsys.readouterr().out
    record = read_record(holed)
    assert (record.state, record.stages[0].state) == ("failed", "failed")
    assert "samples of empty are missing" in record.message
    # What came behind the hole is there: the end of the run, and most of its samples.
    log = read_run(holed / "recording.mcap")
    assert log.events[-1]["event"] == "done"
    assert 900 < len(log.samples["time"]) < 1151
    assert status(["resume", str(holed), "--yes"]) == 0
    assert len(load_run(holed).recordings) == 1


def test_a_real_bench_needs_an_eds_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "b.yaml"
    text = resolve("practical", "benches").read_text().split("mock:  ")[0]
    path.write_text(text.replace("interface: mock", "interface: virtual, channel: nobody"))
    assert status(["check", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[1] for line in lines] == ["servo.eds", "encoder.eds"]
    assert all("missing; name the EDS file" in line for line in lines)


@pytest.mark.parametrize("verbose", [False, True])
def test_the_bus_libraries_speak_only_when_asked(tmp_path: Path, verbose: bool) -> None:
    path = tmp_path / "b.yaml"
    path.write_text(resolve("practical", "benches").read_text().replace("node: 1,", "node: 3,"))
    code = (
        "import sys, rig.cli.entry, rig.wiring.connect, drivers.mock.bench as mock;"
        "made = mock.simulated_bench;"
        "rig.wiring.connect.simulated_bench = lambda m, s, b, d, e, *_: made(m, s, b, 1, e);"
        "sys.exit(rig.cli.entry.status(sys.argv[1:]))"
    )
    options = ["--verbose"] if verbose else []
    done = subprocess.run(
        [sys.executable, "-c", code, *options, "check", str(path)], capture_output=True, text=True
    )
    assert done.returncode == 4
    spoken = done.stderr.splitlines()
    assert spoken[-1].startswith("device error: node 3")
    assert (len(spoken) > 1) is verbose


def test_a_real_bus_where_nobody_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """python-can's in-process bus, opened by name; time is simulated so that the time-out costs
    none.
    """
    path = tmp_path / "b.yaml"
    text = resolve("practical", "benches").read_text().split("mock:  ")[0]
    text = text.replace("interface: mock", "interface: virtual, channel: nobody")
    text = text.replace("servo: {", f"servo: {{eds: {DRIVE_EDS}, ").replace(
        "encoder: {", f"encoder: {{eds: {ENCODER_EDS}, "
    )
    path.write_text(text)

    class Impatient(SimulatedClock):
        def now_ns(self) -> int:
            self.sleep_until_ns(super().now_ns() + 50_000_000)
            return super().now_ns()

    monkeypatch.setattr("rig.wiring.connect.RealClock", Impatient)
    assert status(["check", str(path)]) == 4
    assert capsys.readouterr().err.startswith("device error: ")
