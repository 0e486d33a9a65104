"""The truth of a run on the simulated bench: read for the tables, absent everywhere else."""

import json
import re
import shutil
from functools import partial
from pathlib import Path

import pytest

from identification.estimate.paper_method import identify_paper
from rig.cli.entry import status
from rig.config.bench import load_bench, redacted
from rig.config.configuration import resolve
from rig.results.identify.identify import METHODS
from rig.runs.mcap.reader import read_run
from rig.runs.recorded_inputs import truth_of

from .benches import sine, stages

SEQUENCE = stages(sine("free", 15, 1.0, 3, more=", ramp_in_s: 0.5, ramp_out_s: 0.5"))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("truth")
    (folder / "short.yaml").write_text(SEQUENCE)
    assert status(["run", str(folder / "short.yaml"), "--yes", "--out", str(folder / "run")]) == 0
    return folder / "run"


def test_it_is_what_the_simulated_machine_was_given(run: Path) -> None:
    truth = truth_of(run)
    machine = load_bench("practical").value.mock
    assert truth["Mc"] == machine.joint.Mc_N_m
    assert truth["J"] == machine.joint.inertia_kg_m2
    assert len(truth) == 9


def test_a_bench_that_was_changed_or_is_gone_has_none(run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    record = json.loads((copy / "run.json").read_text())
    record["inputs"]["bench.yaml"]["file"] = str(
        tmp_path / "practical.yaml"
    )  # elsewhere: the packaged one answers
    (copy / "run.json").write_text(json.dumps(record))
    assert truth_of(copy) == truth_of(run)
    record["inputs"]["bench.yaml"]["sha256"] = "0" * 64
    (copy / "run.json").write_text(json.dumps(record))
    assert truth_of(copy) is None


EFFECTS = {
    "asymmetric_coulomb": {"torque_Nm": 1.2345},
    "backlash": {"gap_rad": 0.0023456},
    "x_root_drag": {"coefficient_Nms05_rad05": 0.87654},
}
TRUE = {
    "Mc_N_m": "5.83791",
    "Ms_N_m": "11.83791",
    "sigma_2_N_m_s_rad": "4.83791",
    "inertia_kg_m2": "0.183791",
}


@pytest.fixture(scope="module")
def hiding(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an identified run on a bench that hides physics and has constants of its own."""
    folder = tmp_path_factory.mktemp("hiding")
    text = resolve("practical", "benches").read_text()
    for name, value in TRUE.items():
        text = re.sub(rf" {name}: .*", f" {name}: {value}", text)
    (folder / "bench.yaml").write_text(
        re.sub("effects: .*", f"effects: {json.dumps(EFFECTS)}", text)
    )
    (folder / "short.yaml").write_text(SEQUENCE)
    arguments = ["--bench", str(folder / "bench.yaml"), "--yes", "--out", str(folder / "run")]
    assert status(["run", str(folder / "short.yaml"), *arguments]) == 0
    found = ["--method", "paper", "--json", str(folder / "run" / "identified.json")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(METHODS, "paper", partial(identify_paper, generations=10))
        patch.setattr("identification.plots.style.png", lambda made, dpi=110: b"\x89PNG")
        assert status(["identify", str(folder / "run"), *found]) == 0
    return folder / "run"


def test_what_a_bench_hides_is_in_no_file_of_the_run(hiding: Path) -> None:
    kept = {path: path.read_bytes() for path in hiding.rglob("*") if path.is_file()}
    log = read_run(hiding / "recording.mcap")
    kept |= {Path(name): content for name, content in log.attachments.items()}
    kept[Path("metadata")] = json.dumps(log.metadata, default=str).encode()
    assert {"run.json", "recording.mcap", "report.html", "identified.json"} <= {
        path.name for path in kept
    }
    secret = [*EFFECTS, *TRUE.values(), "effects"]
    secret += [str(value) for given in EFFECTS.values() for value in given.values()]
    told = [
        (path, word)
        for path, content in kept.items()
        for word in secret
        if word.encode() in content
    ]
    assert told == []
    assert truth_of(hiding) is None


def test_the_attached_bench_is_one_that_an_engineer_could_write(hiding, tmp_path):
    attached = tmp_path / "attached.yaml"
    attached.write_bytes(read_run(hiding / "recording.mcap").attachments["bench.yaml"])
    bench, original = load_bench(attached).value, load_bench("practical").value
    assert bench.limits == original.limits
    assert bench.machine == original.machine
    assert (bench.mock.motor, bench.mock.loops) == (original.mock.motor, original.mock.loops)


def test_a_bench_without_simulation_is_attached_as_it_is() -> None:
    content = b"# mine\nbench: 1\nname: real\n"
    assert redacted(content) == content
