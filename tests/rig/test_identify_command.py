"""``rig identify`` as a user runs it, also with what a campaign says is known."""

import contextlib
import io
import json
import subprocess
import sys
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
def test_compare(campaign, tmp_path, capsys, monkeypatch):
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


G, GEAR = 9.80665, 3.0
KNOWN = """\
campaign: 1
bench: {torque_constant: {value: 0.03, std: 0.001}, gear_ratio: 100}
model: {fixed: {J: {value: 0.22, std: 0.02}}}
defaults: {channels: {time: t, current: i, angle: a}}
recordings: {table: files.csv}
"""
TABLE = """\
file,start,hoisted.mass,hoisted.radius,window.from,role
bare.csv,0,,,,
light.csv,100,3,0.3,2.0,
heavy.csv,300,6,0.3,,validate
"""


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Sines of a joint with J = 0.2 kg m^2 and 7 N m of Coulomb friction that lifts a mass."""
    rng = np.random.default_rng(0)
    time = np.arange(15_000) / 1000.0 + 2e-4
    for name, hertz, mass in (("bare", 0.2, 0.0), ("light", 0.5, 3.0), ("heavy", 0.4, 6.0)):
        w = 2.0 * np.pi * hertz
        speed, acceleration = 0.3 * w * np.cos(w * time), -0.3 * w * w * np.sin(w * time)
        torque = (0.2 + mass * 0.09) * acceleration + 7.0 * np.sign(speed) + 5.0 * speed
        torque += mass * G * 0.3 + rng.normal(0.0, 0.1, len(time))
        columns = np.column_stack([time, 0.3 * np.sin(w * time), torque / GEAR])
        np.savetxt(
            tmp_path / f"{name}.csv", columns, "%.8g", delimiter=",", header="t,a,i", comments=""
        )
    (tmp_path / "files.csv").write_text(TABLE)
    (tmp_path / "c.yaml").write_text(KNOWN)
    return tmp_path / "c.yaml"


@pytest.mark.usefixtures("undrawn")
def test_identify_uses_and_shows_all_of_it(source, tmp_path, capsys):
    out = tmp_path / "out"
    assert status(["identify", str(source), "--out", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "begins 0 s into the session" in said
    assert "hoisted 3 kg: -8.826 N m on the joint" in said
    assert "window 2 s to the end" in said
    assert "recordings alone" in said
    assert "bench.torque_constant 0.03 +- 0.001" in said
    found = json.loads((out / "identify.json").read_text())
    mc, prior = found["parameters"]["Mc"], found["priors"]["J"]
    assert mc["value"] == pytest.approx(7.0, rel=0.05)
    assert mc["high"] - mc["low"] > 2.0 * 1.6 * mc["value"] * 0.001 / 0.03 * 0.8
    assert prior["alone"] == pytest.approx(0.2, abs=0.01)
    assert prior["alone"] <= prior["posterior"] <= prior["value"] == 0.22
    assert found["known_constants"][0]["shifts"]["Mc"] == pytest.approx(7.0 / 30.0, rel=0.05)
    assert found["fit"]["validate_rms"] < 0.2
    assert inputs_of(out / "identify.json") >= {"c.yaml", "files.csv", "bare.csv"}
    report = (out / "report.html").read_text()
    assert "recordings alone" in report
    assert "hoisted 6 kg" in report


def inputs_of(file: Path) -> set[str]:
    """Return the names of a result's input files."""
    return {Path(one["file"]).name for one in json.loads(file.read_text())["inputs"]}


PROGRAM = """
import sys
from identification.plots import style
from rig.cli.entry import status
style.png = lambda made, dpi=110: b""
campaign, out = sys.argv[1:]
assert status(["look", campaign]) == status(["identify", campaign, "--out", out]) == 0
from rig.results.diagnose import diagnose, document
from rig.runs import run
print(*(name for name in sys.modules if name.split(".")[0] == "drivers"), file=sys.stderr)
"""


def test_a_campaign_is_looked_at_and_identified_without_a_driver(campaign, tmp_path):
    """As on a computer that has no bus."""
    arguments = [sys.executable, "-c", PROGRAM, str(campaign), str(tmp_path / "o")]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr.split()) == (0, []), done.stderr
