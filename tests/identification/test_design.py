"""What a planned experiment determines, and the shares of excitations."""

import math

import numpy as np
import pytest

from identification.design.search import Excitation, best_shares
from identification.design.simulated import (
    NAMES,
    NOTHING,
    Information,
    PlannedModel,
    PlannedStage,
    Sensors,
    expected,
    intervals_of,
    recorded,
    stage_information,
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


def information(stage: PlannedStage, model: PlannedModel | None = None) -> Information:
    return stage_information(stage, with_drives(model or nominal()))


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
    assert out.peak_speed == 0.0


def test_noise_and_encoder_widen_intervals() -> None:
    fine, noisy, coarse = (
        intervals_of([information(figure10(0.0, 12.0), model)], loaded=False)
        for model in (nominal(), nominal(noise=3.0 * NOISE), nominal(step=2.0 * np.pi / 102400.0))
    )
    assert noisy.half_widths["sigma_2"] > 2.0 * fine.half_widths["sigma_2"]
    assert coarse.half_widths["J"] > fine.half_widths["J"]
    assert 0.0 < fine.worst < 0.05


def test_loaded_parameters_need_a_load() -> None:
    free, heavy = (information(figure10(w, 10.0)) for w in (0.0, 30.6))
    alone = intervals_of([free], loaded=True)
    both = intervals_of([free, heavy], loaded=True)
    assert math.isinf(alone.half_widths["mu_c"])
    assert alone.weakest in ("mu_c", "mu_s", "omega_sL", "mu_2")
    assert all(math.isfinite(w) for w in both.half_widths.values())
    one_load = intervals_of([heavy], loaded=True)
    assert math.isinf(one_load.half_widths["Mc"])


def test_one_breakaway_says_nothing() -> None:
    ramp = PlannedStage(0.05 * PERIOD * np.arange(4000), 0.0)
    assert information(ramp) is NOTHING
    assert all(math.isinf(w) for w in intervals_of([NOTHING], loaded=False).half_widths.values())


def rates(*diagonals: tuple[float, ...]) -> list[Information]:
    found = []
    for diagonal in diagonals:
        normal = np.zeros((len(NAMES), len(NAMES)))
        normal[:5, :5] = np.diag(diagonal)
        found.append(Information(normal, normal, normal))
    return found


def test_shares_are_those_of_neyman() -> None:
    known = rates((1.0, 1.0, 1.0, 1.0, 1e-9), (1e-9, 1e-9, 1e-9, 1e-9, 4.0))
    others, target = np.sqrt(4 * 0.04 / 1.0), np.sqrt(1.0 / 4.0)
    expected = np.array([others, target]) / (others + target)
    assert best_shares(known, "J", loaded=False) == pytest.approx(expected, rel=1e-3)
    # What each gets in any case counts toward its share.
    for least in (0.1, expected[0] + 0.2):
        share = best_shares(known, "J", loaded=False, least=np.array([least, 0.0]))
        held = max(least, expected[0])
        assert share == pytest.approx([held, 1.0 - held], rel=1e-2)


def test_a_proposed_sine_ends_where_it_began_and_fades_in_no_longer_than_it_must() -> None:
    sine = Excitation(((0.1, 0.35),), 5.0, 0.0)
    lasting = sine.lasting(10.2)
    assert lasting.seconds == pytest.approx(7 / 0.7)
    assert sine.lasting(7 / 0.7).seconds == lasting.seconds
    assert sine.lasting(0.1).seconds == pytest.approx(1 / 0.7, abs=1e-3)
    assert lasting.fade == pytest.approx(2.0 * math.pi * 0.35 * 0.1 / 2.0, abs=1e-3)
    assert Excitation(((0.4, 2.0),), 0.0, 10.0).fade == 1.0
    assert Excitation(((0.4, 2.0),), 0.0, 1.0).fade == 0.25  # two of them lie inside


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
