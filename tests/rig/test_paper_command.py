"""``rig paper``: the tables beside the printed values."""

import json
from pathlib import Path

import pytest

from identification.recording import Dataset
from rig.cli.entry import status
from rig.results.paper import figures
from rig.results.paper import tables as paper
from rig.results.paper.tables import TABLE_1, TABLE_2


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
