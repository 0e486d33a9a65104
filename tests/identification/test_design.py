"""What a planned experiment pins, and the search for a better one."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from identification.design import propose as proposing
from identification.design import search
from identification.design.propose import attained, expected, propose
from identification.design.search import Bounds, Draws, Excitation, Frame, Part, Ramps, best_shares
from identification.design.simulated import (
    NAMES,
    NOTHING,
    Information,
    PlannedModel,
    PlannedStage,
    Sensors,
    intervals_of,
    stage_information,
    stage_response,
    with_drives,
)
from identification.model.parameters import NOMINAL
from identification.recording import Array
from identification.simulation.drive_loop import respond, usual_loop

from .synthetic import BENCH, friction

PERIOD = 1e-3
NOISE = 0.06
MOMENT = 10.0 * 30.6 * 9.80665 * 0.095


BOUNDS = Bounds(-0.5, 0.5, 1.5, 60.0, 0.03, 20.0, (5.0, 10.0))


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


def test_a_simulated_trial_repeats_and_is_infinite_without_motion() -> None:
    stages = [figure10(0.0, 10.0)]
    one, two = (attained(stages, nominal(), np.random.default_rng(3)) for _ in range(2))
    assert one == two
    assert 0.0 < one.worst < 0.2
    still = attained([PlannedStage(np.zeros(4000), 0.0)], nominal(), np.random.default_rng(0))
    assert math.isinf(still.worst)


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


SINES = (
    (0.35, 0.4),
    (0.3, 0.6),
    (0.18, 1.0),
    (0.09, 2.0),
    (0.05, 3.5),
    (0.1, 0.5),
    (0.02, 1.0),
    (0.45, 0.3),
    (0.1, 3.0),
)
RAMPS = ((0.06, 1.0), (0.08, 0.5), (0.15, 0.3))
DRAWN = [Excitation((sine,), 0.0, 0.0) for sine in SINES] + [
    Excitation((), 0.0, 0.0, Ramps(*r)) for r in RAMPS
]
"""Such as are drawn; the last two sines break the limits on angle and speed of the tests below."""


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = itertools.cycle(DRAWN)
    monkeypatch.setattr(Draws, "random", lambda *_: Part(0, next(drawn).lasting(5.0)))
    for module, name, value in (
        (proposing, "CANDIDATES", (len(DRAWN), 0)),
        (proposing, "REFINEMENTS", 2),
        (proposing, "TOGETHER", 1),
        (proposing, "NOISES", 1),
        (search, "_ROUNDS", 50),
        (search, "DESIGNS", 1),
    ):
        monkeypatch.setattr(module, name, value)


def frames(weights: tuple[float, ...]) -> list[Frame]:
    def render(e: Excitation) -> Array:
        if e.ramps:
            time = PERIOD * np.arange(round(e.seconds / PERIOD)) % e.step
            return np.asarray(e.ramps.speed * np.minimum(time, e.step - time))
        return np.asarray(sum(command(math.degrees(a), f, e.seconds) for a, f in e.tones))

    return [
        Frame(w > 0.0, Excitation(((math.radians(20.0), 0.2),), w, 12.0), 12.0, 0.0, render)
        for w in weights
    ]


@pytest.mark.proof
@pytest.mark.usefixtures("few")
def test_a_proposal_keeps_the_limits_and_the_time_and_is_no_worse(monkeypatch):
    stages = frames((0.0,))
    found = propose(stages, nominal(), BOUNDS, np.random.default_rng(1), weakest="J")
    assert found.stages != (Part(0, stages[0].present),)
    assert found.proposed.half_widths["J"] < 0.6 * found.present.half_widths["J"]
    assert found.judged > 5
    assert 9.0 < sum(p.excitation.seconds for p in found.stages) <= 12.0
    for part in found.stages:
        angles = stages[0].render(part.excitation)
        out = stage_response(PlannedStage(angles, part.excitation.weight), nominal())
        assert np.max(np.abs(angles)) < 0.5
        assert out.peak_speed < 1.5
        assert out.peak_torque < 60.0
    monkeypatch.setattr(
        proposing, "attained", lambda *_: found.proposed
    )  # takes most of the time, and repeats
    again = propose(stages, nominal(), BOUNDS, np.random.default_rng(1), weakest="J")
    assert again.stages == found.stages


@pytest.mark.usefixtures("few")
def test_where_no_other_sine_is_within_the_limits_the_present_one_stays() -> None:
    stages = frames((0.0,))
    bounds = replace(BOUNDS, torque=5.0)  # less than the static limit
    # A parameter of the load cannot be the target without load.
    found = propose(stages, nominal(), bounds, np.random.default_rng(1), weakest="omega_sL")
    assert found.stages == (Part(0, stages[0].present),)
    assert found.proposed == found.present
    assert found.weakest == found.present.weakest


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
    (there, steepness), whole = (
        expected(stages, [nominal()] * 3),
        attained(stages, nominal(), np.random.default_rng(2)),
    )
    assert 1.0 <= steepness < 2.0
    for name, width in whole.half_widths.items():
        assert there.half_widths[name] == pytest.approx(width, rel=0.6)
    still, _ = expected([PlannedStage(np.zeros(4000), 0.0)], [nominal()] * 3)
    assert math.isinf(still.worst)
