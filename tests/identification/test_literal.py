"""The literal bench: noise-free exact channels at 1 kHz, where all nine come back, J included."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.mock.plant.machine import simulate
from drivers.mock.plant.parts.constants import Joint, Loops, Machine, Motor, Sensing
from identification.estimate.default import identify
from identification.recording import Array, Bench, Dataset, Recording
from rig.runs.recorded_inputs import JOINT_FIELDS

PAPER = Joint(inertia_kg_m2=0.000204)
# Stiff enough to hold this tiny inertia on the falling branch, where friction loses up to 340 N m
# s/rad.
LOOPS = Loops(
    rate_Hz=2e6,
    position_gain=100.0,
    velocity_gain_N_m_s_rad=300.0,
    velocity_filter_Hz=1e6,
    current_gain_V_A=3700.0,
    voltage_limit_V=1e6,
    current_limit_A=1e6,
)


def random_joint(seed: int) -> Joint:
    """Each of the nine within 40 % of the paper's, Ms above Mc and mu_s above mu_c."""
    rng = np.random.default_rng(seed)
    while True:
        values = {
            field: getattr(PAPER, field) * rng.uniform(0.6, 1.4) for field in JOINT_FIELDS.values()
        }
        if values["Ms_N_m"] > values["Mc_N_m"] and values["mu_s"] > values["mu_c"]:
            return replace(PAPER, **values)


def command(time: Array) -> Array:
    return np.asarray(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time))


def recording(joint: Joint, force_N: float) -> Recording:
    machine = Machine(
        Motor(gear_ratio=1.0), joint, LOOPS, Sensing(0, 0, 0.0), steps_per_loop=1, supply_V=1e6
    )
    out = simulate(machine, command, 2.6, 1000.0, contact_force_N=force_N)
    bench = Bench(torque_constant=0.03, moment_arm=0.095)
    return Recording(
        name=f"{force_N:g} N",
        channels={name: out[name] for name in ("time", "angle", "velocity", "current")},
        bench=bench,
        stage="loaded" if force_N else "unloaded",
        weight_mass=force_N / (bench.lever_ratio * bench.gravity),
    )


@pytest.mark.parametrize(
    "joint",
    [random_joint(1), pytest.param(PAPER, marks=pytest.mark.proof)],
    ids=["random", "paper"],
)
def test_all_nine_within_a_hundredth_of_a_percent(joint: Joint) -> None:
    result = identify(
        Dataset((recording(joint, 0.0), recording(joint, 3000.0))), bandwidth_Hz=500.0
    )
    found = result.values
    for name, field in JOINT_FIELDS.items():
        assert found[name] == pytest.approx(getattr(joint, field), rel=1e-4), name
