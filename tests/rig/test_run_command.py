"""``rig run``, ``check``, ``export`` and ``recover`` as a user runs them, on the simulated bus."""

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from drivers.clock import SimulatedClock
from drivers.interfaces import RawFrame, ServoState
from drivers.mock.wires.bus import SimulatedBus
from rig.cli.entry import COMMANDS, status
from rig.config.configuration import resolve
from rig.control.operator import AutomaticOperator
from rig.control.session import execute
from rig.runs.mcap.layout import decode_frames
from rig.runs.mcap.reader import read_run
from rig.runs.run import load_run, read_record
from rig.terminal.stop_button import StopButton
from rig.wiring.connect import DRIVE_EDS, ENCODER_EDS, connect

from .benches import stages, swing

pytestmark = pytest.mark.usefixtures("elsewhere")


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of the short sequence, not to be changed."""
    folder = tmp_path_factory.mktemp("finished")
    sequence = folder / "short.yaml"
    sequence.write_text(ONE_STAGE)
    assert status(["run", str(sequence), "--yes", "--out", str(folder / "run")]) == 0
    return folder / "run"


ONE_STAGE = stages(swing(duration_s=1))


def run(*arguments: str) -> int:
    return status(["run", *arguments])


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(name, capsys):
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


def test_dry_run_prints_the_plan_and_touches_nothing(capsys, tmp_path):
    assert run("figure10", "--dry-run") == 0
    lines = capsys.readouterr().out.splitlines()
    row = next(line for line in lines if line.startswith("case-2")).split()
    assert row == ["case-2", "loaded", "1", "20", "30.6", "3000.8", "32.91", "+20.00"]
    assert any("joint speed" in line and "120" in line for line in lines)
    assert list(tmp_path.iterdir()) == []


def test_a_bus_that_dies_is_a_device_failure(short_sequence, monkeypatch, capsys):
    collect, count = SimulatedBus.collect, iter(range(10**9))

    def dying(self: SimulatedBus, timeout_s: float) -> Sequence[RawFrame]:
        if next(count) > 2000:
            raise can.CanOperationError("bus-off")
        return collect(self, timeout_s)

    monkeypatch.setattr(SimulatedBus, "collect", dying)
    assert run(str(short_sequence), "--yes", "--out", "out") == 4
    text = capsys.readouterr().err
    assert "bus-off" in text
    record = read_record(Path("out"))
    assert (record.state, record.de_energised) == ("failed", False)
    assert read_run(Path("out/recording.mcap")).damage is None


def test_an_operator_may_take_a_minute(runner: Any) -> None:
    """The bus is silent while a person hangs a weight."""
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


def test_a_bench_without_a_bus_says_so() -> None:
    assert status(["check", "literal"]) == 2


def torn(finished: Path, share: float) -> Path:
    """Copy a run as a killed writer leaves it."""
    folder = Path("torn")
    folder.mkdir()
    content = (finished / "recording.mcap").read_bytes()
    (folder / "recording.mcap").write_bytes(content[: int(share * len(content))])
    record = json.loads((finished / "run.json").read_text())
    record.update(state="running", message="", segments=[])
    record["stages"][0]["state"] = "running"
    (folder / "run.json").write_text(json.dumps(record))
    return folder


def test_recover_a_run_that_had_finished_its_stage(finished: Path) -> None:
    folder = torn(finished, 0.985)
    assert status(["recover", str(folder)]) == 0
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


@pytest.fixture
def holed(finished: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "holed"
    shutil.copytree(finished, folder)
    content = bytearray((folder / "recording.mcap").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (folder / "recording.mcap").write_bytes(content)
    return folder


def test_a_hole_in_a_recording_is_mended_around_and_its_stage_done_again(holed, capsys):
    assert status(["export", str(holed), "--out", "x.csv"]) == 2
    assert "rig recover" in capsys.readouterr().err
    assert status(["recover", str(holed)]) == 0
    assert "lost between" in capsys.readouterr().out
    record = read_record(holed)
    assert (record.state, record.stages[0].state) == ("failed", "failed")
    # What came behind the hole is there: the end of the run, and most of its samples.
    log = read_run(holed / "recording.mcap")
    assert log.events[-1]["event"] == "done"
    assert 900 < len(log.samples["time"]) < 1151
    assert status(["resume", str(holed), "--yes"]) == 0
    assert len(load_run(holed).recordings) == 1


def test_the_bus_libraries_speak_when_asked(tmp_path: Path) -> None:
    path = tmp_path / "b.yaml"
    path.write_text(resolve("practical", "benches").read_text().replace("node: 1,", "node: 3,"))
    code = (
        "import sys, rig.cli.entry, rig.wiring.connect, drivers.mock.bench as mock;"
        "made = mock.simulated_bench;"
        "rig.wiring.connect.simulated_bench = lambda m, s, b, d, e, *_: made(m, s, b, 1, e);"
        "sys.exit(rig.cli.entry.status(sys.argv[1:]))"
    )
    words = [sys.executable, "-c", code, "--verbose", "check", str(path)]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 4
    spoken = done.stderr.splitlines()
    assert spoken[-1].startswith("device error: node 3")
    assert len(spoken) > 1


def test_a_real_bus_where_nobody_answers(tmp_path, monkeypatch, capsys):
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
