"""The paper's figures and tables, done again: each says what the numbers of its file say."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from identification.estimate.paper_method import identify_paper
from identification.recording import Dataset
from rig.cli.entry import status
from rig.config.configuration import resolve
from rig.results.identify.identify import METHODS
from rig.results.paper import figures
from rig.results.paper import tables as paper
from rig.results.paper.figures import Exhibit
from rig.results.paper.tables import TABLE_1, TABLE_2


def numbers(exhibit: Exhibit, name: str | None = None) -> dict[str, np.ndarray]:
    """Columns of numbers of an exhibit's data."""
    titles, rows = exhibit.data[name or exhibit.name]
    return {
        title: np.array(column)
        for title, column in zip(titles, zip(*rows, strict=True), strict=True)
    }


@pytest.fixture(scope="module")
def ramps(tmp_path_factory: pytest.TempPathFactory) -> list[Exhibit]:
    """Fig. 2 and 9 on a shorter ramp."""
    scratch = tmp_path_factory.mktemp("ramps")
    with pytest.MonkeyPatch.context() as patch:
        short = scratch / "slow_ramp.yaml"
        text = resolve("slow_ramp", "sequences").read_text()
        short.write_text(
            text.replace("travel_deg: 8", "travel_deg: 4").replace(
                "duration_s: 18", "duration_s: 9.5"
            )
        )
        patch.setattr(figures, "RAMP_SEQUENCE", str(short))
        return figures.ramp_exhibits(scratch, 3)


@pytest.mark.proof
def test_fig_2_shows_stick_slip_and_steady_state_error(ramps: list[Exhibit]) -> None:
    data = numbers(ramps[0])
    assert abs(data["command_rad"][-1] - data["angle_rad"][-1]) > 5e-3
    jumps = np.diff(data["angle_rad"]) / np.diff(data["time_s"])
    assert jumps.max() > 10 * np.deg2rad(1.0)
    assert "mrad off at the end" in ramps[0].found[0]


@pytest.mark.proof
def test_fig_9_is_the_speed_of_both_loads(ramps: list[Exhibit]) -> None:
    data = numbers(ramps[1])
    moving = np.abs(data["command_rad_s"] - np.deg2rad(1.0)) < 1e-9
    assert np.mean(np.abs(data["unloaded_rad_s"][moving]) < 1e-4) > 0.7  # it waits


def test_fig_3_is_what_the_paper_says_of_it() -> None:
    made = figures.valve_exhibit()
    data = numbers(made)
    total = data["impacted_area_m2"] + data["throat_area_m2"]
    np.testing.assert_allclose(total, np.pi * 0.04**2 / 4, rtol=1e-12)
    assert data["impacted_area_m2"][0] == pytest.approx(7.66e-4, rel=1e-3)
    assert data["throat_area_m2"][0] == pytest.approx(np.pi * 0.025**2 / 4)
    assert np.all(np.diff(data["impacted_area_m2"]) <= 1e-18)
    assert "29.65 deg" in made.found[0]


@pytest.mark.proof
def test_eq_14_works_where_motion_is_smooth_and_fails_where_it_is_not(tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "SPEEDS_DEG_S", (1.5, 2.5, 4.0, 8.0, 20.0))
    monkeypatch.setattr(figures, "TRAVEL_DEG", {0.0: 5.0})
    study = figures.measure(tmp_path, 4)
    stiff, soft = study.points["stiff"], study.points["soft"]
    assert all(p.uniform for p in stiff)
    assert not any(p.uniform for p in soft if abs(p.speed) < np.deg2rad(5.0))
    made = figures.uniform_exhibit(study)
    rows = {row[0]: row for row in made.table.rows}
    at = made.table.header.index("stiff gains, no weight") + 1
    errors = {
        name: float(rows[name][at].removesuffix(" %"))
        for name in ("Mc", "Ms", "omega_sf", "sigma_2")
    }
    assert max(map(abs, errors.values())) < 3.0
    at = made.table.header.index("soft gains, all points") + 1
    assert abs(float(rows["Ms"][at].removesuffix(" %"))) > 15.0
    assert any("Soft gains, uniform points: too few" in line for line in made.found)


STEPS = """\
sequence: 1
name: steps
stages:
  - name: flow
    stage: hot_fire
    duration_s: 6
    flow:
      steps: [{at_s: 0, flow_kg_s: 1.8}, {at_s: 1.5, flow_kg_s: 1.0}, {at_s: 4, flow_kg_s: 1.6}]
      ramp_s: 0.2
"""


def test_the_closed_loop_settles_and_moves_its_own_load(tmp_path, monkeypatch):
    path = tmp_path / "steps.yaml"
    path.write_text(STEPS)
    monkeypatch.setattr(figures, "LOOP_SEQUENCE", str(path))
    made = figures.loop_exhibit(tmp_path, 2)
    data = numbers(made)
    late = (data["time_s"] > 3.0) & (data["time_s"] < 3.9)
    np.testing.assert_allclose(data["flow_kg_s"][late], data["flow_command_kg_s"][late], rtol=0.02)
    assert data["contact_force_N"].max() > 4 * data["contact_force_N"].min() > 0.0
    assert "not before the next step" not in made.found[1]
    # More flow is asked for: the throat closes, and the flow falls before it rises.
    rise = (data["time_s"] >= 4.0) & (data["time_s"] < 4.3)
    assert data["flow_kg_s"][rise].min() < 0.97 * 1.0


def test_fig_4_falls_with_pressure_and_area() -> None:
    made = figures.sweep_exhibit(0)
    for name, fastest in (("fig_4", 0.7), ("fig_4_slow", 7.0)):
        data = numbers(made, name)
        even = data["uniform"] > 0.5
        early, late = even & (data["angle_rad"] < 0.15), even & (data["angle_rad"] > 0.45)
        for column in ("current_A", "pressure_Pa", "impacted_area_m2"):
            assert data[column][early].mean() > 1.3 * data[column][late].mean(), column
        assert data["time_s"][-1] < fastest
    assert "At 50 deg/s" in made.found[0]


@pytest.fixture(scope="module")
def cases() -> tuple[Dataset, dict[str, float]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper, "DURATION_S", 2.5)  # half a period, one half cycle each way
        return paper.simulate_cases()


@pytest.fixture(scope="module")
def folder(
    cases: tuple[Dataset, dict[str, float]], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    path = tmp_path_factory.mktemp("paper")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper, "simulate_cases", lambda: cases)
        patch.setattr(paper, "study", lambda seed, progress: [figures.valve_exhibit()])
        patch.setitem(METHODS, "paper", partial(identify_paper, generations=15))
        patch.setattr("identification.plots.style.png", lambda made, dpi=110: b"\x89PNG")
        assert (
            status(["paper", "--seeds", "2", "--out", str(path), "--json", str(path / "copy.json")])
            == 0
        )
    return path


def test_json_follows_the_contract(folder: Path) -> None:
    record = json.loads((folder / "copy.json").read_text(), parse_constant=pytest.fail)
    assert record["schema"] == "loadrig.paper/1"
    assert set(record["tables"]) == {"default", "paper"}
    for table in record["tables"].values():
        assert set(table) == {*TABLE_1, *TABLE_2}
        for entry in table.values():
            assert {"true", "printed", "identified", "error_percent", "seeds"} <= set(entry)
            assert set(entry["seeds"]) == {"0", "1"}
            if None not in entry["seeds"].values():
                errors = [100.0 * abs(v / entry["true"] - 1.0) for v in entry["seeds"].values()]
                assert entry["error_percent"] == pytest.approx(max(errors)), "the worst"
    default = record["tables"]["default"]
    for name in ("Mc", "Ms", "sigma_2", "mu_c", "mu_s", "omega_sL", "mu_2"):
        assert default[name]["error_percent"] < default[name]["printed_error_percent"], name
    for files in record["figures"].values():
        assert all((folder / file).is_file() for file in files)
        assert sorted(Path(file).suffix for file in files) == [".csv", ".png"]
    assert {"fig_3", "fig_12", "fig_13", "errors", "stribeck"} <= set(record["figures"])
    assert "fig_3" in record["findings"]
    assert any("C_r" in line for line in record["chosen"])


def test_printed_and_simulated_omega_sf_are_both_shown(folder: Path) -> None:
    entry = json.loads((folder / "paper.json").read_text())["tables"]["paper"]["omega_sf"]
    assert (entry["true"], entry["printed_true"]) == (0.0557, 0.0577)
    page = (folder / "paper.html").read_text()
    assert "0.0557" in page
    assert "0.0577" in page


def test_the_simulated_cases(cases: tuple[Dataset, dict[str, float]]) -> None:
    dataset, truth = cases
    unloaded, loaded = dataset.recordings
    assert loaded.contact_force == pytest.approx(3000.0)
    assert unloaded.contact_force == 0.0
    assert truth["omega_sf"] == 0.0557
    for recording in dataset.recordings:
        error = abs(recording.channels["angle"] - recording.channels["command"])
        assert error.max() < 0.01
