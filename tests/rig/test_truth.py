"""The truth of a run on the simulated bench: read for the tables, absent everywhere else."""

import dataclasses
from pathlib import Path

import pytest

from rig import truth
from rig.bench import load_bench
from rig.cli import status
from rig.sources import load_source
from rig.truth import truth_of

SEQUENCE = """\
sequence: 1
name: short
stages:
  - name: free
    stage: unloaded
    weight_kg: 0
    tones: [{amplitude_deg: 15, frequency_Hz: 1.0, phase_deg: 0}]
    duration_s: 3
    ramp_in_s: 0.5
    ramp_out_s: 0.5
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("truth")
    (folder / "short.yaml").write_text(SEQUENCE)
    assert status(["run", str(folder / "short.yaml"), "--yes", "--out", str(folder / "run")]) == 0
    return folder / "run"


def test_it_is_what_the_simulated_machine_was_given(run: Path) -> None:
    truth = truth_of(run)
    machine = load_bench("practical").value.mock
    assert truth is not None
    assert machine is not None
    assert truth["Mc"] == machine.joint.Mc_N_m
    assert truth["J"] == machine.joint.inertia_kg_m2
    assert len(truth) == 9


def test_the_dataset_holds_nothing_of_it(run: Path) -> None:
    dataset = load_source(run)
    assert dataset.model.fixed == {}
    constants = {value for value in vars(dataset.recordings[0].bench).values() if isinstance(value, float)}
    truth = truth_of(run)
    assert truth is not None
    assert constants.isdisjoint(truth.values())


def test_a_campaign_has_none(tmp_path: Path) -> None:
    assert truth_of(tmp_path / "bench.yaml") is None
    assert truth_of(tmp_path) is None


def test_the_report_goes_into_the_run_folder_with_the_truth_beside(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(["identify", str(run), "--method", "paper"]) == 0
    header = capsys.readouterr().out.split("\n")[0]
    assert "true" in header
    assert "error" in header
    assert (run / "report.html").is_file()
    assert (run / "identify.json").is_file()


@pytest.mark.parametrize("attached", [b"bench: 99", b"]", b"\xff"])
def test_a_bench_file_of_another_version_has_none(run: Path, monkeypatch: pytest.MonkeyPatch, attached: bytes) -> None:
    log = dataclasses.replace(truth.read_run(run / "recording.mcap"), attachments={"bench.yaml": attached})
    monkeypatch.setattr(truth, "read_run", lambda path: log)
    assert truth.truth_of(run) is None
