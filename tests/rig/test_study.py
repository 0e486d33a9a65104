"""Repeatability of the constants of one unit: variance components, their intervals, the command."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from identification.numerics.spread import Scatter, variance_components
from rig.cli.entry import status

from .conftest import IDENTIFIED, run_in

Design = Sequence[tuple[str, str]]
"""Day and operator of each run."""
CROSSED = [(f"d{d}", f"o{o}") for d in range(3) for o in range(4) for _ in range(3)]
UNBALANCED = [*CROSSED[:8], *CROSSED[11:20], *CROSSED[24:31]]
OPERATORS = [("d0", name) for name in "aabbbbbcccddddddd"]
NESTED = [(f"d{o}{d}", f"o{o}") for o in range(4) for d in range(3) for _ in range(2)]


def found(
    values: Sequence[float] | np.ndarray, design: Design, seed: int = 0
) -> tuple[dict[str, Scatter], tuple[str, ...]]:
    days, operators = zip(*design, strict=True)
    factors = {"day": days, "operator": operators}
    return variance_components(np.asarray(values), factors, np.random.default_rng(seed))


def drawn(design: Design, sigma: Mapping[str, float], rng: np.random.Generator) -> np.ndarray:
    """Return values with these standard deviations, in the order of the runs."""
    values = 7.0 + rng.normal(0.0, sigma["repeatability"], len(design))
    for column, name in enumerate(("day", "operator")):
        levels = [row[column] for row in design]
        effect = {level: rng.normal(0.0, sigma[name]) for level in sorted(set(levels))}
        values += [effect[level] for level in levels] if sigma.get(name) else 0.0
    return values


def held(design: Design, studies: int) -> dict[str, int]:
    """Return in how many simulated studies the interval of each part holds the true value."""
    rng = np.random.default_rng(11)
    count: dict[str, int] = {}
    for study in range(studies):
        ratio = 0.5 if study % 2 else 2.0
        days = ratio if len({day for day, _ in design}) > 1 else 0.0
        true = {"repeatability": 1.0, "day": days, "operator": ratio}
        between = np.hypot(days, ratio)
        true |= {"reproducibility": between, "total": np.hypot(between, 1.0)}
        for name, each in found(drawn(design, true, rng), design)[0].items():
            count[name] = count.get(name, 0) + bool(each.low <= true[name] <= each.high)
    return count


@pytest.mark.parametrize(
    ("design", "studies"),
    [
        (UNBALANCED, 16),
        *(
            pytest.param(design, 100, marks=pytest.mark.proof)
            for design in (CROSSED, UNBALANCED, OPERATORS, NESTED)
        ),
    ],
)
def test_the_intervals_hold_the_true_components(design: Design, studies: int) -> None:
    count = held(design, studies)
    # A right method leaves these bounds once in 10 000 studies of one component.
    least, most = stats.binom.interval(1.0 - 1e-4, studies, 0.9)
    assert all(least <= each <= most for each in count.values()), count
    assert set(count) >= {"repeatability", "operator", "total"}


def test_the_estimates_of_a_balanced_study_are_those_of_the_analysis_of_variance() -> None:
    rng = np.random.default_rng(3)
    values = drawn(CROSSED, {"repeatability": 1.0, "day": 3.0, "operator": 2.0}, rng)
    table = values.reshape(3, 4, 3)
    effects = {"day": table.mean(axis=(1, 2)), "operator": table.mean(axis=(0, 2))}
    left = table - effects["day"][:, None, None] - effects["operator"][None, :, None]
    within = np.sum((left + table.mean()) ** 2) / (36 - 6)
    parts, _ = found(values, CROSSED)
    assert parts["repeatability"].value == pytest.approx(np.sqrt(within))
    for name, per_level in (("day", 12), ("operator", 9)):
        variance = np.var(effects[name], ddof=1) - within / per_level
        assert parts[name].value == pytest.approx(np.sqrt(variance))


def test_what_the_runs_do_not_separate_is_named() -> None:
    values = np.random.default_rng(1).normal(size=8)
    # Each operator has a day: the scatter by day is in that by operator.
    parts, merged = found(values, [(f"d{i // 4}", f"o{i // 4}") for i in range(8)])
    assert (list(parts), merged) == (["repeatability", "operator", "total"], ("day",))
    # Each day has one run: the scatter by day is in the repeatability.
    assert found(values, [(f"d{i}", f"o{i % 2}") for i in range(8)])[1] == ("day",)
    # One condition: nothing but repeatability, with the interval of chi-squared.
    alone, merged = found(values, [("d", "o")] * 8)
    assert (list(alone), merged) == (["repeatability"], ())
    high = np.sqrt(np.var(values, ddof=1) * 7 / stats.chi2.ppf(0.05, 7))
    assert alone["repeatability"].high == pytest.approx(high, rel=0.01)
    assert found(values[:1], [("d", "o")]) == ({}, ())
    equal, _ = found(np.full(6, 3.0), [("d", f"o{i % 2}") for i in range(6)])
    assert equal["total"].high < 1e-12


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve identified runs of two operators on two days."""
    made = run_in(tmp_path_factory.mktemp("made")).path
    root = tmp_path_factory.mktemp("runs")
    rng = np.random.default_rng(5)
    for index in range(12):
        day, operator = index // 6, "Ada" if index % 2 else "Bob"
        folder = root / f"run-{index}"
        shutil.copytree(made, folder)
        record = json.loads((folder / "run.json").read_text())
        for part in (record, *record["parts"]):
            part.update(operator=operator, created=f"2026-11-{23 + day}T08:{index:02}:00+00:00")
        (folder / "run.json").write_text(json.dumps(record))
        result = json.loads(json.dumps(IDENTIFIED))
        shift = rng.normal(0.0, 0.01) + 0.1 * (operator == "Ada")
        for end in ("value", "low", "high"):
            result["parameters"]["Mc"][end] += shift
        result["parameters"]["J"] = {"value": None, "low": None, "high": None, "unit": "kg m^2"}
        (folder / "identify.json").write_text(json.dumps(result))
    return root


def result_of(*arguments: str | Path, tmp_path: Path) -> dict[str, Any]:
    file = tmp_path / "study.json"
    assert status(["runs", "study", *map(str, arguments), "--json", str(file)]) == 0
    result: dict[str, Any] = json.loads(file.read_text())
    return result


def test_the_command_studies_runs(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limits = tmp_path / "limits.yaml"
    limits.write_text("acceptance: 1\nlimits: ['Mc: 6..7', 'Ms: 3..']\n")
    result = result_of(root, "--acceptance", limits, tmp_path=tmp_path)
    (study,) = result["studies"]
    assert list(study["constants"]) == ["Mc"]
    found = study["constants"]["Mc"]
    assert found["runs"] == len(study["runs"]) == 12
    assert list(found["scatter"]) == [
        "repeatability", "day", "operator", "reproducibility", "total",
    ]  # fmt: skip
    parts = found["scatter"]
    assert parts["repeatability"]["low"] < 0.01 < parts["repeatability"]["high"]
    assert parts["operator"]["low"] < 0.1 / np.sqrt(2.0) < parts["operator"]["high"]
    assert found["tolerance"] == [6.0, 7.0]
    assert found["shares"]["total"] == pytest.approx(6.0 * parts["total"]["value"])
    assert found["from_intervals"] == pytest.approx(0.1 / 1.645, rel=1e-3)
    shown = capsys.readouterr().out
    assert "12 runs, 2 operators, 2 days" in shown
    # The same folder twice, or a folder and a run in it: each run counts once.
    again = result_of(root, root / "run-3", root, tmp_path=tmp_path)
    assert len(again["studies"][0]["runs"]) == 12
    assert again["studies"][0]["constants"]["Mc"]["tolerance"] is None


def test_runs_are_chosen_and_too_few_are_no_study(root: Path, tmp_path: Path) -> None:
    chosen = result_of(root, "--operator", "Ada", "--since", "2026-11-24", tmp_path=tmp_path)
    (study,) = chosen["studies"]
    assert list(study["constants"]["Mc"]["scatter"]) == ["repeatability"]
    few = result_of(root / "run-1", tmp_path=tmp_path)
    assert few["studies"][0]["constants"]["Mc"]["scatter"] == {}
    assert status(["runs", "study", str(root), "--operator", "nobody"]) == 2
    assert status(["runs", "study", str(root), "--acceptance", str(tmp_path / "none.yaml")]) == 2
    # Without its recording, a run has no limits, but still a study.
    shutil.copytree(root, tmp_path / "moved")
    (tmp_path / "moved" / "run-11" / "recording.mcap").unlink()
    result_of(tmp_path / "moved", tmp_path=tmp_path)
