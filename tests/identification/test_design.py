"""What a planned experiment pins, and the search for a better one."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from identification.design import propose as search
from identification.design.forward import respond, usual_loop
from identification.design.pinning import (
    NAMES,
    NOTHING,
    Nominal,
    PlannedStage,
    Sensors,
    pinned,
    stage_information,
    stage_response,
)
from identification.design.propose import Bounds, Excitation, Frame, present_pins, propose
from identification.design.rehearsal import rehearse
from identification.model.nominal import NOMINAL
from identification.recording import Array, Bench

from .synthetic import BENCH, friction

PERIOD = 1e-3
NOISE = 0.06
MOMENT = 10.0 * 30.6 * 9.80665 * 0.095


def nominal(noise: float = NOISE, step: float = 2.0 * np.pi / 409600.0) -> Nominal:
    return Nominal(NOMINAL, BENCH, Sensors(PERIOD, step, noise), 75.0)


def command(amplitude_deg: float, frequency: float, seconds: float = 20.0) -> Array:
    time = PERIOD * np.arange(round(seconds / PERIOD))
    return np.asarray(math.radians(amplitude_deg) * np.sin(2.0 * np.pi * frequency * time) * np.minimum(time, 1.0))


def figure10(weight: float, seconds: float = 20.0) -> PlannedStage:
    return PlannedStage(command(20.0, 0.2, seconds), weight)


@pytest.mark.parametrize("moment", [0.0, MOMENT])
def test_forward_simulation_obeys_the_equation_of_motion(moment: float) -> None:
    """The mean torque of a period is friction plus J domega/dt wherever the shaft slips; written without the kernel."""
    out = respond(command(20.0, 0.2, 5.0), PERIOD, NOMINAL, moment, 2.0, usual_loop(NOMINAL["J"], 75.0))
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
    out = respond(tiny, PERIOD, NOMINAL, MOMENT, 2.0, usual_loop(NOMINAL["J"], 0.99 * (12.025 + 0.086 * MOMENT)))
    assert np.all(out.angle == 0.0)
    assert out.peak_speed == 0.0


def test_noise_and_encoder_widen_what_is_pinned() -> None:
    fine = pinned([stage_information(figure10(0.0), nominal())], loaded=False)
    noisy = pinned([stage_information(figure10(0.0), nominal(noise=3.0 * NOISE))], loaded=False)
    coarse = pinned([stage_information(figure10(0.0), nominal(step=2.0 * np.pi / 102400.0))], loaded=False)
    assert noisy.half_widths["sigma_2"] > 2.0 * fine.half_widths["sigma_2"]
    assert coarse.half_widths["J"] > fine.half_widths["J"]
    assert 0.0 < fine.worst < 0.05


def test_loaded_parameters_need_a_load() -> None:
    free, heavy = (stage_information(figure10(w), nominal()) for w in (0.0, 30.6))
    alone = pinned([free], loaded=True)
    both = pinned([free, heavy], loaded=True)
    assert math.isinf(alone.half_widths["mu_c"])
    assert alone.weakest in ("mu_c", "mu_s", "omega_sL", "mu_2")
    assert all(math.isfinite(w) for w in both.half_widths.values())
    one_load = pinned([heavy], loaded=True)
    assert math.isinf(one_load.half_widths["Mc"])


def test_one_breakaway_says_nothing() -> None:
    ramp = PlannedStage(0.05 * PERIOD * np.arange(4000), 0.0)
    assert stage_information(ramp, nominal()) is NOTHING
    assert all(math.isinf(w) for w in pinned([NOTHING], loaded=False).half_widths.values())


def test_the_rehearsal_repeats_and_knows_what_it_cannot_do() -> None:
    stages = [figure10(0.0, 10.0)]
    one, two = (rehearse(stages, nominal(), np.random.default_rng(3)) for _ in range(2))
    assert one == two
    assert 0.0 < one.worst < 0.2
    still = rehearse([PlannedStage(np.zeros(4000), 0.0)], nominal(), np.random.default_rng(0))
    assert math.isinf(still.worst)


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("CANDIDATES", 6), ("REFINEMENTS", 3), ("RUNNERS_UP", 1)):
        monkeypatch.setattr(search, name, value)


def frames(weights: tuple[float, ...]) -> list[Frame]:
    def render_for() -> Callable[[Excitation], Array]:
        return lambda e: np.asarray(sum(command(math.degrees(a), f, 10.0) for a, f in e.tones))

    return [Frame(w > 0.0, Excitation(((math.radians(20.0), 0.2),), w), render_for()) for w in weights]


@pytest.mark.usefixtures("few")
def test_a_proposal_keeps_the_limits_and_is_no_worse() -> None:
    bounds = Bounds(-0.5, 0.5, 1.5, 60.0, 0.03, 20.0, (5.0, 10.0))
    tight = nominal()
    found = propose(frames((0.0,)), tight, bounds, np.random.default_rng(1))
    assert found.weakest == found.present.weakest
    assert found.pinned.half_widths[found.weakest] <= found.present.half_widths[found.weakest]
    assert found.judged > 5
    for frame, e in zip(frames((0.0,)), found.stages, strict=True):
        if e == frame.present:
            continue
        out = stage_response(PlannedStage(frame.render(e), e.weight), tight)
        assert np.max(np.abs(frame.render(e))) < 0.5
        assert out.peak_speed < 1.5
        assert out.peak_torque < 60.0
    again = propose(frames((0.0,)), tight, bounds, np.random.default_rng(1))
    assert again.stages == found.stages


def test_present_pins_is_the_information_of_the_stages() -> None:
    found = present_pins(frames((0.0,)), nominal())
    assert set(found.half_widths) == set(NAMES[:5])


def test_moment_of_a_bench_without_lever() -> None:
    assert Nominal(NOMINAL, Bench(), Sensors(1e-3, 1e-5, 0.1), 1.0).moment(0.0) == 0.0
