"""Machines that packages of others simulate: their effects are the catalogue's, and worlds on them
are sealed and readable.
"""

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.worlds import draw as drawing
from benchmarks.worlds.__main__ import ELECTRIC_MOTOR, MOTULATOR, main, plant_named
from benchmarks.worlds.world import Array, Pendulum, Signals, World
from identification.effects import EFFECTS
from rig.common.errors import InputError
from rig.results.prove.run import sealed_rigs
from rig.results.prove.truth import load_truth, unseal
from rig.sources import load_source
from tests.worlds.test_plants import RATE_HZ, played, speed, torque, world_of

PACKAGES = {ELECTRIC_MOTOR: "gym_electric_motor", MOTULATOR: "motulator"}


def run(plant: str, world: World) -> Signals:
    pytest.importorskip(PACKAGES[plant])
    (signals,) = plant_named(plant).play(world)
    return signals


def missing_V(world: World, signals: Signals) -> Array:
    """Return the commanded voltage less that of winding and back-EMF, from the second sample."""
    motor, mean = world.motor, signals.mean_current[1:-1]
    turning = motor.constant * np.gradient(signals.motor_angle, 1.0 / RATE_HZ)[1:-1]
    rising = motor.inductance_H * RATE_HZ * np.diff(signals.current)[1:]
    return np.asarray(signals.voltage[1:-1] - motor.resistance_ohm * mean - rising - turning)


def slope(y: Array, x: Array) -> float:
    return float(np.sum(y * x) / np.sum(x**2))


@pytest.mark.parametrize("plant", PACKAGES)
def test_a_plant_that_is_not_installed_says_what_to_install(plant: str) -> None:
    if find_spec(PACKAGES[plant]):
        pytest.skip("is installed")
    with pytest.raises(InputError, match=r"loadrig\[plants\]"):
        plant_named(plant)


@pytest.mark.parametrize("plant", PACKAGES)
def test_the_nominal_machine_is_that_of_the_third_plant(plant: str) -> None:
    for loaded in ({}, {"weight_kg": 20.0}, {"pendulum": Pendulum(5.0, 0.1, -1.0)}):
        world = world_of(**loaded)  # type: ignore[arg-type]
        signals = run(plant, world)
        curves = []
        for found in (signals, played(world)):
            w, at = speed(found), found.command
            inside = (w > 0.5) & (np.abs(at) < 0.1) & (np.arange(len(w)) > 4000)
            curves.append(np.mean(torque(world, found)[inside]))
        assert curves[0] == pytest.approx(curves[1], rel=0.02)
        left = missing_V(world, signals)
        assert np.sqrt(np.mean(left**2)) < 2e-3 * np.sqrt(np.mean(signals.voltage**2))
        assert np.count_nonzero(np.diff(signals.angle) == 0.0) > 100, "a stuck joint is still"


@pytest.mark.parametrize("plant", PACKAGES)
def test_drag_of_the_package_is_the_catalogues(plant: str) -> None:
    world = world_of()
    draggy = replace(world, effects={"quadratic_drag": {"coefficient_Nms2_rad2": 3.0}})
    plain, found = run(plant, world), run(plant, draggy)
    w = speed(found)[2000:]
    more = (torque(world, found) - torque(world, plain))[2000:]
    assert slope(more, w * np.abs(w)) == pytest.approx(3.0, rel=0.02)


def test_bridge_and_supply_of_the_dc_machine_are_the_catalogues() -> None:
    world = world_of({"inverter_dead_time": {"voltage_V": 1.2}})
    found = run(ELECTRIC_MOTOR, world)
    current = found.current[1:-1]
    lost = (missing_V(world, found) * np.sign(current))[np.abs(current) > 1.0]
    assert np.mean(lost) == pytest.approx(1.2, rel=0.01)
    world = world_of({"supply_sag": {"resistance_ohm": 1.0}})
    found = run(ELECTRIC_MOTOR, world)
    falls = found.voltage**2 * found.current / world.motor.supply_V**2
    assert slope(missing_V(world, found), falls[1:-1]) == pytest.approx(1.0, rel=0.02)
    assert found.supply.min() < 0.99 * world.motor.supply_V


def test_a_field_on_a_weak_supply_needs_more_current() -> None:
    world = world_of({"x_field_sag": {"resistance_ohm": 3.0, "time_s": 0.1}})
    found, plain = run(ELECTRIC_MOTOR, world), run(ELECTRIC_MOTOR, replace(world, effects={}))
    fast = np.abs(speed(found)) > 0.5
    assert np.mean(np.abs(found.current[fast])) > 1.02 * np.mean(np.abs(plain.current[fast]))


def test_the_elastic_shaft_is_the_catalogues() -> None:
    world = world_of({"compliance": {"stiffness_Nm_rad": 3000.0}})
    found = run(MOTULATOR, world)
    twist = (found.motor_angle / world.motor.gear_ratio - found.angle)[2000:]
    assert slope(torque(world, found)[2000:], twist) == pytest.approx(3000.0, rel=0.01)


@pytest.mark.parametrize("plant", PACKAGES)
def test_a_world_is_readable_and_its_truth_sealed(plant, tmp_path, monkeypatch):
    pytest.importorskip(PACKAGES[plant])
    for name, value in (("SHORTEST_S", 1.0), ("LONGEST_S", 2.0), ("MOST", 3)):
        monkeypatch.setattr(drawing, name, value)
    made = CliRunner().invoke(
        main, [str(tmp_path), "--plant", plant, "--rigs", "4", "--seed", "41"]
    )
    assert made.exit_code == 0, made.output
    machine, seen = plant_named(plant), set()
    for rig in sealed_rigs(tmp_path):
        assert rig.digest in made.stdout
        truth = unseal(rig.truth, rig.digest)
        seen |= truth.effects.keys()
        assert truth.effects.keys() <= {*machine.effects, *machine.outside}
        assert set(truth.outside) == truth.effects.keys() - EFFECTS.keys()
        text = rig.campaign.read_text()
        assert not [name for name in (*machine.effects, *machine.outside) if name in text]
        dataset = load_source(rig.campaign)
        assert len(dataset.recordings) == truth.axes["recordings"]
        for recording in dataset.recordings:
            assert all(np.isfinite(values).all() for values in recording.channels.values())
        assert load_truth(rig.truth).parameters
    assert seen
