"""Errors over the Cramer-Rao floor on random practical benches, and how often the 90 % intervals
hold the truth.

Each bench has the nine constants within 40 % of the practical bench's, 4096 to 65536 counts per
motor turn and a current noise of 0.2 to 1 % of full scale. Its Figure 10 run goes through the whole
simulated chain; its log is identified by the default method, by the equation error alone and, for
the first few, by the paper's genetic algorithm. Rows are kept as they come, and a study that was
stopped goes on where it was.

    python benchmarks/floor.py --benches 200 --first 5000 --out out/floor
    python benchmarks/floor.py --practical --benches 50  # the practical bench, seeds of noise
    python benchmarks/floor.py --model --benches 50      # the fitted model's own data
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from floor_benches import of_the_model, random_bench, record

import rig.config.bench
from identification.estimate.default import identify, solve_stages
from identification.estimate.paper_method import identify_paper
from identification.estimate.refinement import refine_recordings
from identification.prepare import prepare
from identification.recording import Dataset
from identification.result import Identification
from rig.common.tables import table
from rig.runs.recorded_inputs import JOINT_FIELDS, truth_of
from rig.runs.run import load_run

NORMAL_90 = 1.6449
FAR_OFF = 0.5
"""A value off by more than this share is in doubt: the search is made again from the true
values.
"""
SAME_BASIN = 0.25
"""Share by which it may differ from where that ends, and not be in a wrong basin."""


def main() -> None:
    """Run what is missing, print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--benches", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument(
        "--paper", type=int, default=0, help="benches that the genetic algorithm gets as well"
    )
    parser.add_argument(
        "--practical", action="store_true", help="the practical bench as it is, over seeds of noise"
    )
    parser.add_argument(
        "--model",
        action="store_true",
        help="data of the fitted model itself, not of the simulated bench",
    )
    parser.add_argument("--out", type=Path, default=Path("out/floor"))
    arguments = parser.parse_args()
    template = (Path(rig.config.bench.__file__).parent / "benches" / "practical.yaml").read_text(
        encoding="utf-8"
    )
    kind = "practical" if arguments.practical else "model" if arguments.model else "row"
    rows = []
    for seed in range(arguments.first, arguments.first + arguments.benches):
        file = arguments.out / f"{kind}{seed}.json"
        wanted = seed < arguments.first + arguments.paper
        row = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else None
        if row is None or (wanted and "paper" not in row):
            bench = (
                yaml.safe_load(template) if arguments.practical else random_bench(template, seed)
            )
            truth, dataset = (
                of_the_model(bench, seed)
                if arguments.model
                else of_a_run(record(bench, seed, arguments.out))
            )
            row = study(truth, dataset, wanted, seed)
            row["seed"] = seed
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(json.dumps(row), encoding="utf-8")
            print(f"bench {seed}: {row['seconds']:.1f} s {'; '.join(row['warnings'])}", flush=True)
        rows.append(row)
    print(summary(rows))


def of_a_run(run: Path) -> tuple[dict[str, float], Dataset]:
    """Return the true values and the recordings of a run on the simulated bench."""
    truth = truth_of(run)
    assert truth is not None
    return truth, load_run(run)


def study(truth: dict[str, float], dataset: Dataset, with_paper: bool, seed: int) -> dict[str, Any]:
    """Return truth, estimates, intervals and floors of one experiment; ``seed`` is the genetic
    algorithm's.
    """
    found = identify(dataset)
    row: dict[str, Any] = {
        "truth": truth,
        "seconds": found.seconds,
        "warnings": list(found.warnings),
        "default": estimates(found),
        "equation": equation_error(dataset, found.fit.bandwidth_Hz),
    }
    if any(_far_off(cell["value"], truth[name]) for name, cell in row["default"].items()):
        row["from_truth"] = from_truth(truth, dataset, found)
    if with_paper:
        found = identify_paper(dataset, rng=np.random.default_rng(seed))
        row["paper"] = {n: e["value"] for n, e in estimates(found).items()}
    return row


def estimates(found: Identification) -> dict[str, dict[str, float | None]]:
    """Return name to value, interval and floor (standard deviation)."""
    return {
        name: {
            "value": p.value,
            "low": p.low,
            "high": p.high,
            "floor": None if p.floor is None else p.floor / NORMAL_90,
        }
        for name, p in found.parameters.items()
    }


def _far_off(value: float | None, truth: float) -> bool:
    return value is not None and abs(value / truth - 1.0) > FAR_OFF


def from_truth(
    truth: Mapping[str, float], dataset: Dataset, found: Identification
) -> dict[str, float]:
    """Return where the searches end that begin at the true values; empty where they come to
    nothing.

    With noise the likeliest values are not the true ones: a value that is far off, and is where the
    search from the truth ends too, is in the right basin. Refined with the kind of noise that was
    ``found``.
    """
    correlated = found.noise is not None and found.noise.correlated > 0.0
    refined = refine_recordings(dataset.part("fit"), truth, tuple(truth), dataset.model, correlated)
    return {} if isinstance(refined, str) else dict(refined.values)


def _wrong_basin(row: Mapping[str, Any], name: str) -> bool:
    """Return whether a value is far off, and not where the search from the true values ends."""
    value, right = row["default"][name]["value"], row.get("from_truth", {}).get(name)
    return _far_off(value, row["truth"][name]) and (
        right is None or abs(value / right - 1.0) > SAME_BASIN
    )


def equation_error(dataset: Dataset, bandwidth_Hz: float) -> dict[str, float]:
    """Return the values by variable projection alone."""
    prepared = [prepare(r, bandwidth_Hz) for r in dataset.part("fit")]
    unloaded = [p for p in prepared if p.recording.stage == "unloaded"]
    loaded = [p for p in prepared if p.recording.stage == "loaded"]
    return solve_stages(unloaded, loaded, dataset.model, lambda _stage, _share: None)[0]


def summary(rows: list[Mapping[str, Any]]) -> str:
    """Return the tables in words."""
    lines = []
    inside_all: list[bool] = []
    for name in JOINT_FIELDS:
        truth = np.array([r["truth"][name] for r in rows])
        cells = [r["default"][name] for r in rows]
        value = np.array([c["value"] if c["value"] is not None else np.nan for c in cells])
        floor = np.array([c["floor"] if c["floor"] is not None else np.nan for c in cells])
        low = np.array([c["low"] if c["low"] is not None else np.nan for c in cells])
        high = np.array([c["high"] if c["high"] is not None else np.nan for c in cells])
        known = np.isfinite(value)
        over = (value - truth)[known] / floor[known]
        over = over[np.isfinite(over)]
        inside = ((low <= truth) & (truth <= high))[known]
        inside_all += inside.tolist()
        simple = np.array([r["equation"][name] for r in rows])
        far = [_far_off(c["value"], r["truth"][name]) for c, r in zip(cells, rows, strict=True)]
        lines.append(
            [
                name,
                f"{np.sqrt(np.mean(over**2)):.2f}",
                f"{np.mean(over):+.2f}",
                f"{np.median(np.abs(over)) / 0.6745:.2f}",
                f"{100.0 * np.mean(inside):.1f}",
                f"{100.0 * np.nanmedian(np.abs(value / truth - 1.0)):.3f}",
                f"{100.0 * np.nanmax(np.abs(value / truth - 1.0)):.2f}",
                f"{100.0 * np.nanmedian(floor / truth):.3f}",
                f"{np.sqrt(np.nanmean(((simple - truth) / floor) ** 2)):.1f}",
                f"{100.0 * np.median(np.abs(simple / truth - 1.0)):.2f}",
                *_paper_cells(rows, name),
                f"{int(np.sum(~known))}",
                f"{sum(far)}",
                f"{sum(_wrong_basin(r, name) for r in rows)}",
            ]
        )
    header = [
        "parameter", "rms/floor", "mean/floor", "median/floor", "covered %", "median error %",
         "worst %", "floor %",
        "EE rms/floor", "EE median %", "GA median %", "GA worst %", "no value", "off by half",
         "wrong basin",
    ]  # fmt: skip
    pooled = f"pooled coverage {100.0 * np.mean(inside_all):.1f} % of {len(inside_all)} intervals"
    refused = [f"bench {r['seed']}: {w}" for r in rows for w in r["warnings"]]
    told = [f"{len(rows)} benches, {len(refused)} warnings", *refused]
    return "\n".join([table(header, lines), pooled, *told])


def _paper_cells(rows: list[Mapping[str, Any]], name: str) -> list[str]:
    errors = [
        abs(r["paper"][name] / r["truth"][name] - 1.0)
        for r in rows
        if r.get("paper", {}).get(name) is not None
    ]
    return (
        [f"{100.0 * np.median(errors):.2f}", f"{100.0 * np.max(errors):.1f}"]
        if errors
        else ["-", "-"]
    )


if __name__ == "__main__":
    main()
