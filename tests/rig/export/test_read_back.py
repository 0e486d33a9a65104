"""Exports read back by one entry of a campaign: the same recordings, to the last bit."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from identification.recording import Bench, Controller, Dataset, Hoist, Pendulum, Recording
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.runs.export import WRITERS, export, files
from rig.sources import load_source

KINDS = sorted(WRITERS)
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


def campaign(folder: Path, file: str, extra: str = "", bench: str = "{}") -> Path:
    path = folder / "back.yaml"
    path.write_text(
        f"campaign: 1\nbench: {bench}\nrecordings:\n  - {{file: {json.dumps(file)}{extra}}}\n"
    )
    return path


def assert_same(found: Recording, wanted: Recording) -> None:
    assert list(found.channels) == [name for name in found.channels if name in wanted.channels]
    for name, values in wanted.channels.items():
        assert found.channels[name].tobytes() == values.tobytes(), name
    for field in fields(Recording):
        if field.name not in ("channels", "source", "sha256", "notes"):
            assert getattr(found, field.name) == getattr(wanted, field.name), field.name


def exported(folder: Path, kind: str, given: Dataset) -> str:
    """Export as the command does; return what a campaign names."""
    for place, part in files(given, folder / f"x.{kind}", kind).items():
        export(part, place, kind)
    return f"x*.{kind}"


@pytest.mark.parametrize("kind", KINDS)
def test_every_recording_comes_back_with_stage_loads_and_masses(tmp_path: Path, kind: str) -> None:
    given = dataset()
    name = exported(tmp_path, kind, given)
    found = load_source(campaign(tmp_path, name)).recordings
    assert len(found) == 3
    for one, wanted in zip(found, given.recordings, strict=True):
        assert_same(one, wanted)


@pytest.mark.parametrize("kind", KINDS)
def test_a_run_comes_back(tmp_path: Path, kind: str, run: Path) -> None:
    # The ending that is missing is added, by which a campaign recognises the format.
    assert status(["export", str(run), "--format", kind, "--out", "x"]) == 0
    found = load_source(campaign(tmp_path, f"x*.{kind}")).recordings
    wanted = load_source(run).recordings
    for one, other in zip(found, sorted(wanted, key=lambda r: r.name), strict=True):
        assert_same(one, other)
    assert {r.weight_mass for r in found} != {0.0}


@pytest.mark.parametrize(
    ("options", "remedies"),
    [
        (["--out", "exp.mat"], ["--out exp.mat.csv", "--format mat"]),
        (["--out", "exp.csv", "--format", "candump"], ["--out exp.csv.log", "--format csv"]),
    ],
)
def test_an_ending_of_another_format_is_refused(tmp_path, run, options, remedies, capsys):
    assert status(["export", str(run), *options]) == 2
    told = capsys.readouterr().err
    assert all(remedy in told for remedy in remedies)
    assert not list(tmp_path.glob("exp*"))


def test_constants_and_role_of_the_campaign_win(tmp_path: Path) -> None:
    name = exported(tmp_path, "parquet", dataset())
    path = campaign(tmp_path, name, ", role: fit", "{torque_constant: {value: 0.031, std: 0.002}}")
    found = load_source(path).recordings
    assert {r.bench.torque_constant for r in found} == {0.031}
    assert {r.bench.gravity for r in found} == {9.81}
    assert [r.bench.moment_arm for r in found] == [0.095, 0.095, 0.2]
    assert {r.role for r in found} == {"fit"}
    assert found[1].uncertainties == {"bench.torque_constant": 0.002, "weight_mass": 0.01}


@pytest.mark.parametrize("extra", [", stage: loaded", ", window: [0, 1]"])
def test_what_the_file_states_is_not_stated_twice(tmp_path: Path, extra: str) -> None:
    name = exported(tmp_path, "mat", dataset())
    with pytest.raises(InputError, match="itself; for a file of `rig export` remove `"):
        load_source(campaign(tmp_path, name, extra))


def test_another_programs_file_needs_channels(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,a\n0,1\n1,2\n")
    scipy.io.savemat(tmp_path / "a.mat", {"t": np.arange(3.0)})
    (tmp_path / "a.mcap").write_bytes(b"no MCAP file")
    for name in ("a.csv", "a.mat", "a.mcap"):
        with pytest.raises(InputError, match=r"back\.yaml:4:.*`channels` is missing; .* and a\."):
            load_source(campaign(tmp_path, name))


def test_a_changed_export_is_refused(tmp_path: Path) -> None:
    exported(tmp_path, "csv", dataset())
    place = tmp_path / "x-empty-1.csv"
    place.write_text("\n".join(place.read_text().splitlines()[:-1]))
    with pytest.raises(InputError, match="the file contains 299 rows, its description states 300"):
        load_source(campaign(tmp_path, place.name))
    described = tmp_path / "x-empty-1.csv.json"
    described.write_text(described.read_text().replace('"fit"', '"fits"'))
    with pytest.raises(InputError, match=r"cannot be read \(recordings\.0\.role"):
        load_source(campaign(tmp_path, place.name))


def test_the_file_beside_a_csv_file_is_not_overwritten(tmp_path, run, capsys):
    names = [recording.name for recording in load_source(run).recordings]
    Path("x-heavy.csv.json" if len(names) > 1 else "x.csv.json").write_text("mine")
    assert status(["export", str(run), "--out", "x.csv"]) == 2
    assert "csv.json: exists already" in capsys.readouterr().err
    assert not list(tmp_path.glob("x*.csv"))
