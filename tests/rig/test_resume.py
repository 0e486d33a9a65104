"""``rig resume``: into the same folder, at the first unfinished stage."""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.mock.dbc_drive import DRIVE_DBC
from rig.cli.entry import status
from rig.config.configuration import resolve
from rig.control.remote import RunProgress
from rig.results.acceptance.evidence import gather
from rig.runs.mcap.reader import read_run
from rig.runs.run import load_run, read_record
from rig.wiring.connect import DRIVE_EDS, ENCODER_EDS

from .benches import stages, swing

STAGES = stages(swing("a", more=", repeats: 2"), swing("b", weight_kg=10))


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "three.yaml").write_text(STAGES)


def start(*options: str) -> int:
    return status(["run", str(Path("three.yaml").resolve()), "--yes", "--out", "out", *options])


def stop_in(monkeypatch: pytest.MonkeyPatch, stage: str) -> None:
    def press(self: RunProgress, name: str, *rest: Any) -> None:
        if name == stage:
            raise KeyboardInterrupt

    monkeypatch.setattr(RunProgress, "__call__", press)


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run that Ann started and that was stopped in its second stage."""
    folder = tmp_path_factory.mktemp("stopped")
    (folder / "three.yaml").write_text(STAGES)
    with pytest.MonkeyPatch.context() as context:
        context.chdir(folder)
        stop_in(context, "b")
        assert start("--operator", "Ann") == 3
    return folder


@pytest.fixture
def stopped(once: Path) -> None:
    shutil.copytree(once / "out", "out")
    record = Path("out/run.json")
    text = record.read_text().replace(str(once / "three.yaml"), str(Path("three.yaml").resolve()))
    record.write_text(text)


@pytest.mark.usefixtures("stopped")
def test_a_stopped_run_goes_on_at_its_stage() -> None:
    first = Path("out/recording.mcap").read_bytes()
    assert status(["resume", "out", "--yes", "--operator", "Bob", "--json", "copy.json"]) == 0
    assert Path("out/recording.mcap").read_bytes() == first
    record = read_record(Path("out"))
    assert record.state == "done"
    assert [s.state for s in record.stages] == ["done", "done"]
    assert [(p.file, p.state, p.operator) for p in record.parts] == [
        ("recording.mcap", "stopped", "Ann"),
        ("recording-2.mcap", "done", "Bob"),
    ]
    assert [(s.index, s.name, s.part, s.kept) for s in record.segments][-2:] == [
        (3, "b", 1, False),
        (4, "b", 2, True),
    ]
    second = read_run(Path("out/recording-2.mcap"))
    assert set(np.unique(second.samples["segment"])) == {0, 4}
    assert second.metadata["run"]["part"] == "2"
    dataset = load_run(Path("out"))
    assert [(r.name, Path(r.source).name) for r in dataset.recordings] == [
        ("a[1]", "recording.mcap"),
        ("a[2]", "recording.mcap"),
        ("b", "recording-2.mcap"),
    ]
    assert record.cycles == sum(part.cycles for part in record.parts)
    assert json.loads(Path("copy.json").read_text()) == json.loads(Path("out/run.json").read_text())


def crash(part: str, keep: float) -> None:
    """Leave the folder as a killed writer does."""
    path = Path("out") / part
    content = path.read_bytes()
    path.write_bytes(content[: int(keep * len(content))])
    record = json.loads(Path("out/run.json").read_text())
    record.update(state="running", message="")
    record["parts"][-1]["state"] = "running"
    Path("out/run.json").write_text(json.dumps(record))


@pytest.mark.usefixtures("stopped")
def test_a_resumed_run_that_died_is_mended_too(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as context:
        stop_in(context, "b")
        assert status(["resume", "out", "--yes"]) == 3
    crash("recording-2.mcap", 0.8)
    assert status(["resume", "out", "--yes"]) == 0
    assert Path("out/recording-2.damaged.mcap").exists()
    record = read_record(Path("out"))
    assert [p.state for p in record.parts][::2] == ["stopped", "done"]
    assert [s.index for s in record.segments] == sorted({s.index for s in record.segments})
    assert len(load_run(Path("out")).recordings) == 3


@pytest.mark.usefixtures("stopped")
def test_a_part_that_never_began_is_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as context:
        stop_in(context, "b")
        assert status(["resume", "out", "--yes"]) == 3
    crash("recording-2.mcap", 0.0)
    Path("out/recording-2.mcap").unlink()
    assert status(["resume", "out", "--yes"]) == 0
    files = [part.file for part in read_record(Path("out")).parts]
    assert files == ["recording.mcap", "recording-2.mcap"]


@pytest.mark.usefixtures("stopped")
def test_a_recording_that_was_complete_and_is_missing_is_asked_for() -> None:
    assert status(["resume", "out", "--yes"]) == 0
    before = Path("out/run.json").read_bytes()
    Path("out/recording-2.mcap").rename("elsewhere.mcap")
    assert status(["recover", "out"]) == 2
    assert Path("out/run.json").read_bytes() == before
    Path("elsewhere.mcap").rename("out/recording-2.mcap")
    assert status(["recover", "out"]) == 0


@pytest.mark.usefixtures("stopped")
def test_a_result_of_a_part_of_the_run_is_not_current() -> None:
    part = {"inputs": [{"file": "recording.mcap", "sha256": sha("recording.mcap")}]}
    assert status(["resume", "out", "--yes"]) == 0
    whole = [*part["inputs"], {"file": "recording-2.mcap", "sha256": sha("recording-2.mcap")}]
    constant = {"name": "Mc", "value": 6.8, "low": 6.7, "high": 6.9, "unit": "N m"}
    for inputs, current in ((part["inputs"], False), (whole, True)):
        result = {"inputs": inputs, "parameters": [constant], "method": "default"}
        Path("out/identify.json").write_text(json.dumps(result))
        found = gather(Path("out"), (), lambda what, share: None)
        assert (found.method == "default") is current


def sha(name: str) -> str:
    return hashlib.sha256((Path("out") / name).read_bytes()).hexdigest()


def test_the_confirmed_masses_come_back_from_the_recording() -> None:
    assert start() == 0
    kept = json.loads(Path("out/run.json").read_text())
    Path("out/run.json").unlink()
    assert status(["recover", "out"]) == 0
    found = json.loads(Path("out/run.json").read_text())
    masses = [[stage["confirmed_kg"] for stage in record["stages"]] for record in (kept, found)]
    assert masses[0] == masses[1]
    assert masses[0][1] == 10.0


def test_a_finished_run_has_nothing_to_go_on_with() -> None:
    assert start() == 0
    before = Path("out/run.json").read_bytes()
    assert status(["resume", "out", "--yes"]) == 2
    assert Path("out/run.json").read_bytes() == before


@pytest.mark.usefixtures("stopped")
def test_a_changed_sequence_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    Path("three.yaml").write_text(STAGES.replace("weight_kg: 10", "weight_kg: 12"))
    assert status(["resume", "out", "--yes"]) == 2
    assert "three.yaml: changed since out was run with this file" in capsys.readouterr().err
    Path("three.yaml").unlink()
    assert status(["resume", "out", "--yes"]) == 2


def test_a_recording_says_where_it_comes_from(tmp_path: Path) -> None:
    bench = tmp_path / "b.yaml"
    text = resolve("practical", "benches").read_text()
    bench.write_text(text + 'calibrations: [{device: encoder, id: C-17, due: "2099-01-31"}]\n')
    assert start("--bench", str(bench), "--operator", "Ann") == 0
    metadata = read_run(Path("out/recording.mcap")).metadata
    assert metadata["run"]["operator"] == "Ann"
    assert metadata["servo"]["software_version"] == "1.0"
    assert metadata["servo"]["serial_number"] == "1"
    assert metadata["calibrations"] == {"encoder": "C-17, due 2099-01-31"}
    record = read_record(Path("out"))
    assert metadata["sha256"]["bench.yaml"] == record.inputs["bench.yaml"]["sha256"]
    assert "numpy" in metadata["versions"]
    assert [s.confirmed_kg for s in record.stages] == [0.0, 10.0]
    assert record.parts[0].devices["encoder"]["product_code"] == 0x406
    assert record.warnings == []


@pytest.mark.parametrize(
    ("bench", "files"),
    [
        ("practical", {"servo.eds": DRIVE_EDS, "encoder.eds": ENCODER_EDS}),
        ("practical_dbc", {"servo.dbc": DRIVE_DBC, "encoder.eds": ENCODER_EDS}),
    ],
)
def test_a_recording_says_by_which_device_files_it_was_made(bench, files):
    # Slowly enough for the serial bench, whose limits are lower.
    Path("three.yaml").write_text(STAGES.replace("frequency_Hz: 2", "frequency_Hz: 1"))
    assert start("--bench", bench) == 0
    metadata = read_run(Path("out/recording.mcap")).metadata
    digests = {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in files.items()}
    own = {"bench.yaml", "sequence.yaml"}
    assert {
        name: digest for name, digest in metadata["sha256"].items() if name not in own
    } == digests
    assert metadata["servo"]["name"]
    assert metadata["encoder"]["name"]


def test_an_overdue_calibration_is_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    overdue = (
        'calibrations: [{device: lever, id: L-2, due: "2001-01-31"}]\noverdue_calibration: warn\n'
    )
    Path("b.yaml").write_text(resolve("practical", "benches").read_text() + overdue)
    assert start("--bench", str(Path("b.yaml").resolve())) == 0
    assert "warning: calibration L-2 of lever" in capsys.readouterr().err
    assert "(OVERDUE)" in Path("out/run.html").read_text()


def limits(name: str, *lines: str) -> str:
    path = Path(name)
    path.write_text("\n".join(("acceptance: 1", "limits:", *(f"  - {line}" for line in lines))))
    return str(path)


def judged() -> tuple[str, bool, list[str]]:
    found = json.loads(Path("out/acceptance.json").read_text())
    return (
        Path(found["limits"]).name,
        found["verdict"] == "accepted",
        [check["limit"] for check in found["checks"][1:]],
    )


@pytest.mark.usefixtures("undrawn")
def test_a_resumed_run_is_judged_by_the_limits_that_it_was_given(monkeypatch):
    with monkeypatch.context() as context:
        stop_in(context, "b")
        given = limits("given.yaml", "lost samples < 1", "current worst < 1 mA")
        assert start("--acceptance", given) == 3
    assert not Path("out/acceptance.json").exists()
    # The recording holds the limits.
    Path(given).unlink()
    assert status(["resume", "out", "--yes", "--junit", "out.xml"]) == 1
    expected = ("given.yaml", False, ["lost samples < 1", "current worst < 1 mA"])
    assert judged() == expected
    assert 'failures="1"' in Path("out.xml").read_text()
    assert status(["runs", "accept", "out"]) == 1
    assert judged() == expected


@pytest.mark.usefixtures("stopped")
def test_the_certificate_states_a_stop_and_the_continuation() -> None:
    given = limits("given.yaml", "lost samples < 1")
    resume = ["resume", "out", "--yes", "--operator", "Bob", "--acceptance", given]
    assert status(resume) == 0
    page = Path("out/certificate.html").read_text()
    for words in ("Course of the run", "continued", "Ann", "Bob"):
        assert words in page
    for part in read_record(Path("out")).parts:
        assert part.created[:19].replace("T", " ") in page
        assert f" to {part.ended[11:19]}" in page
