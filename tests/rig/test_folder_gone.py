"""The folder of a run that is deleted, moved or out of space: noticed, safe, and rightly worded."""

import errno
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from rig.cli.entry import status
from rig.common.errors import InputError, StorageError
from rig.common.sample import Sample
from rig.control.remote import RunProgress
from rig.runs import run as run_module
from rig.runs.catalogue.index import list_runs
from rig.runs.recorder import GoneError, Recorder, open_recorder
from rig.runs.run import RESERVE_FILE, read_record, require_space

from .benches import sine, stages

SEQUENCE = stages(sine("empty", 5, 1, 10), name="long")
SAMPLE = Sample(*([0.0] * 13), 0x27, 1, True)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("s.yaml").write_text(SEQUENCE)


def gone(how: str) -> None:
    if how == "deleted":
        shutil.rmtree("out")
    else:
        Path("out").rename("elsewhere")


@pytest.mark.parametrize("how", ["deleted", "moved"])
def test_a_folder_that_goes_under_a_run_stops_it_within_a_second(how, monkeypatch, capsys):
    event, sample, times = Recorder.event, Recorder.sample, []

    def noted(self: Recorder, time_ns: int, name: str, **details: Any) -> None:
        event(self, time_ns, name, **details)
        if name == "segment":
            gone(how)
            times.append(time_ns)

    def timed(self: Recorder, time_ns: int, *rest: Any) -> None:
        sample(self, time_ns, *rest)
        if times:
            times.append(time_ns)

    monkeypatch.setattr(Recorder, "event", noted)
    monkeypatch.setattr(Recorder, "sample", timed)
    # The journal writes when the excitation begins; here it is the recorder that must notice.
    monkeypatch.setattr("rig.runs.run.RunFolder.segment_started", lambda *_: None)
    assert status(["run", "s.yaml", "--yes", "--out", "out"]) == 4
    assert times[-1] - times[0] < 1_000_000_000
    told = "".join(capsys.readouterr())
    assert "de-energised (read back" in told
    assert how in told
    for wrong in ("free disk space", "rig resume", "recorded in"):
        assert wrong not in told
    assert not Path("out").exists()


def test_the_recorder_notices_that_another_file_is_at_its_place() -> None:
    path, sample = Path("recording.mcap"), Sample(*([0.0] * 13), 0x27, 1, True)
    recorder = open_recorder(path)
    recorder.sample(600_000_000, sample, [])
    path.rename("other.mcap")
    path.write_bytes(b"")
    recorder.sample(650_000_000, sample, [])
    with pytest.raises(GoneError):
        recorder.sample(1_200_000_000, sample, [])
    with pytest.raises(StorageError):
        recorder.sample(1_300_000_000, sample, [])
    recorder.close()


def test_the_space_for_the_whole_run_is_checked_before(monkeypatch, capsys):
    Path("s.yaml").write_text(SEQUENCE.replace("duration_s: 10", "duration_s: 2"))
    assert status(["run", "s.yaml", "--yes", "--out", "enough"]) == 0
    assert not Path("enough", RESERVE_FILE).exists()
    size = Path("enough/recording.mcap").stat().st_size
    cycles = read_record(Path("enough")).cycles
    assert size < cycles * run_module.CYCLE_BYTES
    usage = shutil.disk_usage(".")
    free = run_module._MARGIN_BYTES + size // 2
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage._replace(free=free))
    assert status(["run", "s.yaml", "--yes", "--out", "little"]) == 2
    assert "MB are free" in capsys.readouterr().err
    assert not Path("little").exists()
    require_space(Path("a/b/c"), 100)
    with pytest.raises(InputError):
        require_space(Path("a/b/c"), 1e6)


def test_the_space_for_the_rest_is_checked_before_a_run_goes_on(monkeypatch, capsys):
    def press(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as context:
        context.setattr(RunProgress, "__call__", press)
        assert status(["run", "s.yaml", "--yes", "--out", "out"]) == 3
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    usage = shutil.disk_usage(".")._replace(free=run_module._MARGIN_BYTES)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    capsys.readouterr()
    assert status(["resume", "out", "--yes"]) == 2
    assert "MB are free" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before


@pytest.mark.parametrize("first", ["recording", "run.json"])
def test_the_state_of_a_run_that_filled_the_disk_is_kept(first, monkeypatch):
    """The disk is full from some time on, and nothing can be written until space is given back."""
    write, sample, event = run_module.write_json, Recorder.sample, Recorder.event

    def full_disk() -> bool:
        return Path("full").exists() and Path("out", RESERVE_FILE).exists()

    def limited(path: Path, record: Any) -> None:
        if full_disk():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(path, record)

    def filling(self: Recorder, time_ns: int, *rest: Any) -> None:
        if time_ns > 3_000_000_000:
            Path("full").touch()
            raise StorageError("the recording cannot be written")
        sample(self, time_ns, *rest)

    def filled(self: Recorder, time_ns: int, name: str, **details: Any) -> None:
        event(self, time_ns, name, **details)
        if name == "segment":
            Path("full").touch()

    monkeypatch.setattr(run_module, "write_json", limited)
    if first == "recording":
        monkeypatch.setattr(Recorder, "sample", filling)
    else:
        monkeypatch.setattr(Recorder, "event", filled)
    assert status(["run", "s.yaml", "--yes", "--out", "out"]) == 4
    record = read_record(Path("out"))
    assert (record.state, record.de_energised) == ("failed", True)
    assert not Path("out", RESERVE_FILE).exists()
    (entry,) = list_runs(Path()).entries
    assert entry.head.state == "failed"
