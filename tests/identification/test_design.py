"""What a planned experiment determines."""

import math

import numpy as np
import pytest

from identification.design.simulated import (
    PlannedModel,
    PlannedStage,
    Sensors,
    expected,
    recorded,
    with_drives,
)
from identification.estimate.default import identify
from identification.model.parameters import NOMINAL
from identification.recording import Array, Dataset
from identification.simulation.drive_loop import respond, usual_loop

from .synthetic import BENCH, friction

PERIOD = 1e-3
NOISE = 0.06
MOMENT = 10.0 * 30.6 * 9.80665 * 0.095


def nominal(noise: float = NOISE, step: float = 2.0 * np.pi / 409600.0) -> PlannedModel:
    return PlannedModel(NOMINAL, BENCH, Sensors(PERIOD, step, noise), 75.0)


def command(amplitude_deg: float, frequency: float, seconds: float = 20.0) -> Array:
    time = PERIOD * np.arange(round(seconds / PERIOD))
    return np.asarray(
        math.radians(amplitude_deg) * np.sin(2.0 * np.pi * frequency * time) * np.minimum(time, 1.0)
    )


def figure10(weight: float, seconds: float = 20.0) -> PlannedStage:
    return PlannedStage(command(20.0, 0.2, seconds), weight)


@pytest.mark.parametrize("moment", [0.0, MOMENT])
def test_forward_simulation_obeys_the_equation_of_motion(moment: float) -> None:
    """The mean torque of a period is friction plus J domega/dt wherever the shaft slips."""
    out = respond(
        command(20.0, 0.2, 5.0), PERIOD, NOMINAL, moment, 2.0, usual_loop(NOMINAL["J"], 75.0)
    )
    velocity = np.gradient(out.angle, PERIOD)
    acceleration = np.gradient(velocity, PERIOD)
    middle = 0.5 * (out.torque[1:-1] + out.torque[2:])  # the two means beside a sample
    expected = friction(velocity, NOMINAL, moment) + NOMINAL["J"] * acceleration
    slipping = np.abs(velocity[1:-1]) > 0.3  # past breakaway, which lasts less than a sample
    assert np.sum(slipping) > 1000
    assert np.percentile(np.abs(middle - expected[1:-1])[slipping], 99.5) < 0.02


def test_a_shaft_below_its_static_limit_stays() -> None:
    tiny = np.full(2000, 1e-5)
    tiny[0] = 0.0
    loop = usual_loop(NOMINAL["J"], 0.99 * (12.025 + 0.086 * MOMENT))
    out = respond(tiny, PERIOD, NOMINAL, MOMENT, 2.0, loop)
    assert np.all(out.angle == 0.0)


def test_noise_and_encoder_widen_intervals() -> None:
    fine, noisy, coarse = (
        expected([figure10(0.0, 12.0)], with_drives(model))[0]
        for model in (nominal(), nominal(noise=3.0 * NOISE), nominal(step=2.0 * np.pi / 102400.0))
    )
    assert noisy.half_widths["sigma_2"] > 2.0 * fine.half_widths["sigma_2"]
    assert coarse.half_widths["J"] > fine.half_widths["J"]
    assert 0.0 < fine.worst < 0.05


def test_one_load_does_not_separate_its_friction_from_that_of_the_system() -> None:
    alone, both = (
        expected([figure10(weight, 10.0) for weight in weights], with_drives(nominal()))[0]
        for weights in ((30.6,), (0.0, 30.6))
    )
    assert math.isinf(alone.half_widths["Mc"])
    assert math.isinf(alone.half_widths["mu_c"])
    assert all(math.isfinite(width) for width in both.half_widths.values())


@pytest.mark.proof
def test_what_is_expected_is_near_what_the_whole_method_states() -> None:
    stages = [figure10(0.0, 12.0)]
    there, steepness = expected(stages, [nominal()] * 3)
    rng = np.random.default_rng(2)
    made = tuple(recorded(k, s, nominal(), rng) for k, s in enumerate(stages))
    whole = identify(Dataset(made), rng=rng)
    assert 1.0 <= steepness < 2.0
    for name, (low, high) in whole.intervals.items():
        width = 0.5 * (high - low) / whole.values[name]
        assert there.half_widths[name] == pytest.approx(width, rel=0.6)
    still, _ = expected([PlannedStage(np.zeros(4000), 0.0)], [nominal()] * 3)
    assert math.isinf(still.worst)
