"""``python -m benchmarks.worlds``: every effect leaves a trace, the same bytes with any number of
processes, and the command as a user runs it.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from benchmarks.worlds import draw as drawing
from benchmarks.worlds.__main__ import main
from benchmarks.worlds.draw import draw_world, without_effects
from benchmarks.worlds.logger import columns
from benchmarks.worlds.own_plant.machine import OF_THE_WORLD, STEP_S, machine_of
from benchmarks.worlds.own_plant.plant import OwnPlant
from benchmarks.worlds.seal import log_of, seal_worlds, strength_of
from benchmarks.worlds.sizes import SIZES
from rig.cli.entry import status
from rig.results.prove.engine import Processes
from rig.results.prove.interchange import sealed_rigs
from rig.results.prove.run import SUMS_FILE
from rig.results.prove.truth import load_truth, repeated_salt

PLANT = OwnPlant()
CHANNELS = ("current", "voltage", "motor_angle", "angle")


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "SHORTEST_S", 3.0)
    monkeypatch.setattr(drawing, "LONGEST_S", 4.0)
    monkeypatch.setattr(drawing, "MOST", 4)


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("name", sorted({*PLANT.effects, *PLANT.outside}))
def test_every_effect_leaves_a_trace(name: str) -> None:
    """Sizes begin near the noise: of three machines one at least shows the effect."""
    found = []
    for seed in range(3):
        world = draw_world("outside" if name in PLANT.outside else "one", (name,), (3, seed))
        logged, plain = log_of(PLANT, world), log_of(PLANT, without_effects(world))
        for channels in (*logged, *plain):
            assert all(np.isfinite(values).all() for values in channels.values())
        strength = strength_of(world, logged, plain)
        # A set's order would differ by process, and with it the bytes of the truth.
        assert list(strength) == [channel for channel in CHANNELS if channel in logged[0]]
        found.append(max(strength.values()))
    assert max(found) > 2.0


@pytest.mark.usefixtures("short")
def test_an_averaged_current_is_the_mean_of_the_plant() -> None:
    world = draw_world("nothing", (), (5, 3))
    world = replace(world, log=replace(world.log, current="averaged", rate_Hz=500))
    signals = next(iter(PLANT.play(world)))
    quiet = replace(world.sensing, current_noise_A=0.0, current_quantum_A=1e-12)
    logged = columns(replace(world, sensing=quiet), 0, signals, np.random.default_rng(1))["current"]
    assert signals.mean_current is not None
    step = world.drive.rate_Hz // 500
    means = signals.mean_current[: len(logged) * step].reshape(-1, step).mean(axis=1)
    assert np.allclose(logged, means, atol=1e-9)
    line = columns(
        replace(world, sensing=quiet), 0, replace(signals, mean_current=None),
        np.random.default_rng(1),
    )["current"]  # fmt: skip
    assert np.abs(line - means).max() > 1e-3 * np.abs(means).max()


def test_the_plant_has_the_whole_catalogue() -> None:
    from identification.effects import MOTION

    names = {e.name for e in MOTION}
    assert set(PLANT.effects) == {n for n in SIZES if n in names} == names
    assert PLANT.outside
    assert not PLANT.outside & names


@pytest.mark.usefixtures("short")
def test_the_machine_is_the_world_s() -> None:
    for seed in range(12):
        world = draw_world("two", ("backlash", "wrong_weight"), (4, seed))
        machine = machine_of(world)
        assert machine.effects.keys() == {"backlash", "compliance"}
        assert not OF_THE_WORLD & machine.effects.keys()
        rotor = machine.motor.rotor_inertia_kg_m2 * machine.motor.gear_ratio**2
        assert rotor == pytest.approx(world.motor.rotor_share * world.constants.J)
        assert 1.0 / (machine.loops.rate_Hz * machine.steps_per_loop) <= STEP_S
        opened = world.drive.kind in ("torque", "host")
        assert (machine.loops.position_gain == 0.0) is opened
        assert (machine.loops.velocity_gain_N_m_s_rad is None) is opened


def test_the_same_bytes_with_one_process_and_two(tmp_path: Path) -> None:
    sums = []
    for jobs in (1, 2):
        home = tmp_path / str(jobs)
        salt = partial(repeated_salt, 30)
        seal_worlds(home, PLANT, 2, 30, Processes(jobs), lambda what, share: None, salt)
        sums.append((home / SUMS_FILE).read_text())
    assert sums[0] == sums[1]
    assert sums[0].count("campaign.yaml") == 3


@pytest.mark.usefixtures("short")
def test_the_program_seals_worlds_and_continues(tmp_path: Path) -> None:
    home = tmp_path / "sealed"
    asked = [str(home), "--plant", "own", "--rigs", "4", "--seed", "5"]
    done = CliRunner().invoke(main, asked)
    assert done.exit_code == 0
    rigs = sealed_rigs(home)
    assert [rig.name for rig in rigs] == [f"rig-{n:04d}" for n in range(1, 5)]
    said = done.stdout
    for rig in rigs:
        assert rig.digest in said
        truth = load_truth(rig.truth)
        assert truth.effects.keys() <= {*PLANT.effects, *PLANT.outside}
        assert not truth.not_scored
        campaign = yaml.safe_load(rig.campaign.read_text())
        assert campaign["bench"]["motion"] == truth.axes["machine"]
    rigs[1].truth.unlink()
    kept = rigs[0].truth.stat().st_mtime_ns
    assert CliRunner().invoke(main, asked).exit_code == 0
    assert rigs[1].truth.is_file()
    assert rigs[0].truth.stat().st_mtime_ns == kept


@pytest.mark.usefixtures("short")
def test_sealed_worlds_are_judged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    home, out = tmp_path / "worlds", tmp_path / "proof"
    made = CliRunner().invoke(main, [str(home), "--rigs", "2", "--seed", "6"])
    assert made.exit_code == 0
    asked = ["prove", "--from", str(home), "--out", str(out)]
    assert status(asked) == 0
    first = (out / SUMS_FILE).read_text()
    assert "report.html" in capsys.readouterr().out
    rows = json.loads((out / "prove.json").read_text())["rigs"]
    assert len(rows) == 2
    assert {row["axes"]["machine"] for row in rows} <= {"rotary", "linear"}
    assert status(asked) == 0
    assert (out / SUMS_FILE).read_text() == first
