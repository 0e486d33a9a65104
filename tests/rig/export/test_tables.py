"""Exported tables: every sample to the last bit, and names of files."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import scipy.io

from identification.recording import Bench, Controller, Dataset, Hoist, Pendulum, Recording
from rig.cli.entry import status
from rig.runs.export import WRITERS, export, files
from rig.runs.exported import describe
from rig.sources import load_source

BENCH = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095, gravity=9.81)
GENERATOR = np.random.default_rng(7)


def recording(name: str, n: int, start: float | None, **others: object) -> Recording:
    channels = {
        "time": 3.25 + np.arange(n) * 0.001 + GENERATOR.uniform(0, 1e-5, n),
        "current": GENERATOR.normal(size=n),
        "angle": GENERATOR.normal(size=n) * 1e-12,
    }
    plain = Recording(name=name, channels=channels, bench=BENCH, start=start)
    return replace(plain, **others)  # type: ignore[arg-type]


def dataset() -> Dataset:
    gaps = GENERATOR.normal(size=400)
    gaps[50:60] = np.nan
    one = recording("empty[1]", 300, 0.0, averaged=frozenset({"current"}))
    two = recording("empty[2] (partial)", 400, 10.0, stage="loaded", weight_mass=30.625)
    two = replace(
        two,
        channels={**two.channels, "voltage": gaps, "enabled": np.ones(400)},
        pendulum=Pendulum(0.259, 0.1, 0.126),
        constant_torque=-1.5,
        partial=True,
        uncertainties={"bench.torque_constant": 0.001, "weight_mass": 0.01},
    )
    three = recording("schön/ä", 200, 20.0, role="validate", hoist=Hoist(2.0, -0.05))
    three = replace(
        three,
        bench=replace(BENCH, moment_arm=0.2, resistance=1.56),
        controller=Controller("duty", 12.0, 0.5, 1.0),
    )
    return Dataset((one, two, three))


def column(path: Path, name: str) -> np.ndarray:
    with path.open(encoding="utf-8") as stream:
        return np.array([float(row[name] or "nan") for row in csv.DictReader(stream)])


def field(path: Path, name: str) -> np.ndarray:
    parts = scipy.io.loadmat(path)["recordings"].ravel()
    return np.concatenate([part[name].ravel() for part in parts])


READERS = {
    "csv": lambda path: partial(column, path),
    "mat": lambda path: partial(field, path),
    "parquet": lambda path: lambda name: pq.read_table(path).column(name).to_numpy(),
}


@pytest.mark.parametrize("kind", sorted(set(WRITERS) - {"mcap"}))
def test_every_sample_is_in_the_table_to_the_last_bit(tmp_path: Path, kind: str) -> None:
    given = dataset()
    for place, part in files(given, tmp_path / f"x.{kind}", kind).items():
        export(part, place, kind)
        table = READERS[kind](place)
        for name in {name for one in part.recordings for name in one.channels}:
            missing = [np.full(len(one.time), np.nan) for one in part.recordings]
            wanted = [
                one.channels.get(name, nan)
                for one, nan in zip(part.recordings, missing, strict=True)
            ]
            assert table(name).tobytes() == np.concatenate(wanted).tobytes(), name
    assert json.loads(describe(given.recordings))["recordings"][1]["weight_mass"] == 30.625


@pytest.mark.parametrize(
    ("options", "remedies"),
    [
        (["--out", "exp.mat"], ["--out exp.mat.csv", "--format mat"]),
        (["--out", "exp.csv", "--format", "candump"], ["--out exp.csv.log", "--format csv"]),
    ],
)
def test_an_ending_of_another_format_is_refused(
    tmp_path: Path,
    run: Path,
    options: list[str],
    remedies: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert status(["export", str(run), *options]) == 2
    told = capsys.readouterr().err
    assert all(remedy in told for remedy in remedies)
    assert not list(tmp_path.glob("exp*"))


@pytest.mark.parametrize("kind", ["csv", "mat", "candump"])
def test_a_missing_ending_is_added(run: Path, kind: str) -> None:
    before = set(Path().iterdir())
    assert status(["export", str(run), "--out", "exp", "--format", kind]) == 0
    made = {path.name for path in set(Path().iterdir()) - before}
    several = kind == "csv" and len(load_source(run).recordings) > 1
    ending = "log" if kind == "candump" else kind
    assert any(name.startswith("exp-" if several else "exp.") for name in made)
    for name in made:
        assert name.removesuffix(".json").endswith(f".{ending}"), name


def test_the_file_beside_a_csv_file_is_not_overwritten(
    tmp_path: Path, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = [recording.name for recording in load_source(run).recordings]
    Path("x-heavy.csv.json" if len(names) > 1 else "x.csv.json").write_text("mine")
    assert status(["export", str(run), "--out", "x.csv"]) == 2
    assert "csv.json: exists already" in capsys.readouterr().err
    assert not list(tmp_path.glob("x*.csv"))
