"""``rig identify`` as a user runs it."""

import contextlib
import io
import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from identification.estimate.paper_method import identify_paper
from rig.cli.entry import status
from rig.results.identify.identify import METHODS

RATE = 200.0
CAMPAIGN = """\
campaign: 1
bench: {moment_arm: 0.095, lever_ratio: 10}
defaults: {channels: {time: t, angle: q, velocity: w, torque: tau}}
recordings:
  - {file: free.csv, stage: unloaded}
  - {file: heavy.csv, stage: loaded, weight_mass: 30.6}
  - {file: later.csv, stage: unloaded, role: validate}
"""


def write_csv(path: Path, moment: float, frequency: float) -> None:
    time = np.arange(int(12 * RATE)) / RATE
    w = 2.0 * np.pi * frequency
    velocity = 0.35 * w * np.cos(w * time)
    torque = (
        np.sign(velocity) * (6.825 + 5.2 * np.exp(-((velocity / 0.0557) ** 2))) + 5.3462 * velocity
    )
    torque += moment * (
        np.sign(velocity) * (0.052 + 0.034 * np.exp(-((velocity / 0.0326) ** 2))) + 0.032 * velocity
    )
    rows = np.column_stack([time, 0.35 * np.sin(w * time), velocity, torque])
    np.savetxt(path, rows, delimiter=",", header="t,q,w,tau", comments="", fmt="%.9g")


def write_campaign(folder: Path) -> Path:
    write_csv(folder / "free.csv", 0.0, 0.2)
    write_csv(folder / "heavy.csv", 10.0 * 30.6 * 9.80665 * 0.095, 0.2)
    write_csv(folder / "later.csv", 0.0, 0.17)
    path = folder / "bench.yaml"
    path.write_text(CAMPAIGN)
    return path


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    return write_campaign(tmp_path)


SHORT = partial(identify_paper, generations=30)
"""The paper's method in a few generations, for tests that do not depend on its values."""


@pytest.fixture
def short_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "paper", SHORT)


@dataclass(frozen=True)
class Identified:
    """A campaign, what its identification printed, and the folder of the results."""

    campaign: Path
    shown: str
    folder: Path


@pytest.fixture(scope="module")
def identified(tmp_path_factory: pytest.TempPathFactory) -> Identified:
    """One identification with seed 4, not to be changed; two recordings lack a sample."""
    folder = tmp_path_factory.mktemp("identified")
    campaign = write_campaign(folder)
    for name in ("free.csv", "heavy.csv"):
        lines = (folder / name).read_text().splitlines()
        lines[100] = lines[100].rsplit(",", 1)[0] + ","
        (folder / name).write_text("\n".join(lines))
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.chdir(folder),
        contextlib.redirect_stdout(io.StringIO()) as shown,
    ):
        patch.setitem(METHODS, "paper", SHORT)
        patch.setattr("identification.plots.style.png", lambda made, dpi=110: b"\x89PNG")
        assert status(["identify", str(campaign), "--method", "paper", "--seed", "4"]) == 0
    return Identified(campaign, shown.getvalue(), folder / "bench-identified")


@pytest.mark.usefixtures("undrawn")
def test_both_methods(campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, record_file = tmp_path / "out", tmp_path / "result.json"
    arguments = ["identify", str(campaign), "--method", "both", "--out", str(out)]
    assert status([*arguments, "--json", str(record_file)]) == 0
    printed = capsys.readouterr().out
    assert "default: value" in printed
    assert "paper: value" in printed
    record = json.loads(record_file.read_text())
    assert record == json.loads((out / "identify.json").read_text())
    assert (record["method"], record["compared"][0]["method"]) == ("default", "paper")
    assert record["parameters"]["Mc"]["value"] == pytest.approx(6.825, rel=0.01)
    assert record["parameters"]["mu_c"]["value"] == pytest.approx(0.052, rel=0.01)
    for one in (record, record["compared"][0]):
        assert {"J", "Mc", "Ms", "omega_sf", "sigma_2", "mu_c", "mu_s", "omega_sL", "mu_2"} == set(
            one["parameters"]
        )
        assert one["fit"]["validate_rms"] > 0.0
    inputs = {Path(entry["file"]).name for entry in record["inputs"]}
    assert inputs == {"bench.yaml", "free.csv", "heavy.csv", "later.csv"}
    assert (out / "report.html").is_file()


@pytest.mark.usefixtures("undrawn")
def test_compare(
    campaign: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rig.results.identify.identify.COMPARED_SEEDS", 1)
    out = tmp_path / "out"
    assert status(["identify", str(campaign), "--compare", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    record = json.loads((out / "identify.json").read_text())
    names = [row["name"] for row in record["comparison"]]
    assert names == [
        "default method",
        "variable projection",
        "genetic algorithm",
        "differential evolution",
        "CMA-ES",
        "multi-start least squares",
    ]
    page = (out / "report.html").read_text()
    assert all(name in printed and name in page for name in names)
    assert all(row["true_error"] is None for row in record["comparison"])


def record_of(folder: Path) -> dict[str, object]:
    record = json.loads((folder / "identify.json").read_text())
    return {k: v for k, v in record.items() if k not in ("created", "seconds")}


@pytest.mark.usefixtures("short_search")
@pytest.mark.usefixtures("undrawn")
def test_same_seed_same_record(identified: Identified, tmp_path: Path) -> None:
    arguments = ["identify", str(identified.campaign), "--method", "paper", "--seed", "4"]
    assert status([*arguments, "--out", str(tmp_path / "two")]) == 0
    assert record_of(identified.folder) == record_of(tmp_path / "two")
    assert record_of(tmp_path / "two")["seed"] == 4


@pytest.mark.parametrize(
    ("old", "new", "options", "named"),
    [
        ("", "", ["--compare", "--method", "paper"], "--method paper"),
        ("", "", ["--ladder", "--method", "paper"], "default method"),
        ("campaign: 1", "campaign: 1\nmodel: {fixed: {J: 0.2}}", ["--compare"], "model.fixed"),
        ("- {file: free.csv, stage: unloaded}", "", ["--method", "paper"], "unloaded"),
        ("", "", ["--bandwidth", "1e-9"], "bandwidth of 1e-09"),
        ("", "", ["--bandwidth", "100.1"], "bandwidth of 100.1"),
        ("", "", ["--json", "missing/r.json"], "missing does not exist"),
        ("", "", ["--out", "bench.yaml/inside"], "--out"),
    ],
)
def test_what_is_refused_before_a_file_is_written(
    campaign: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    old: str,
    new: str,
    options: list[str],
    named: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    campaign.write_text(CAMPAIGN.replace(old, new, 1))
    assert status(["identify", "bench.yaml", "--out", "out", *options]) == 2
    assert named in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_corrections_are_told(identified: Identified) -> None:
    assert "free: `torque`: 1 missing samples" in identified.shown
    assert record_of(identified.folder)["corrections"] == {
        name: ["`torque`: 1 missing samples interpolated"] for name in ("free", "heavy")
    }
