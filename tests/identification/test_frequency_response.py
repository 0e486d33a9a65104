"""Margins, open loops and gains from frequency responses, held against closed forms."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.simulation import frequency_response as fr
from identification.simulation.frequency_response import ClosedLoop, Gains, OpenLoop, Wanted

LINES = np.geomspace(0.5, 200.0, 24)
S = fr.laplace(LINES)


def delayed_integrator(crossover: float, delay: float) -> OpenLoop:
    """Return wc / s exp(-s d): phase margin 90 deg - wc d, gain margin pi / (2 d wc)."""
    return OpenLoop(LINES, crossover / S * np.exp(-S * delay))


@given(st.floats(2.0, 40.0), st.floats(0.5, 6.0))
def test_margins_of_a_delayed_integrator(crossover_Hz: float, delay_ms: float) -> None:
    crossover, delay = 2.0 * math.pi * crossover_Hz, delay_ms * 1e-3
    found = fr.margins(delayed_integrator(crossover, delay))
    turn = 1.0 / (4.0 * delay)
    if turn < 0.95 * LINES[-1]:
        assert found.phase_crossing_Hz == pytest.approx(turn, rel=0.02)
        stable = 0.5 * math.pi > crossover * delay
        if stable:
            expected = 20.0 * math.log10(0.5 * math.pi / (crossover * delay))
            assert found.gain_dB == pytest.approx(expected, abs=0.3)
    assert found.phase_deg == pytest.approx(90.0 - math.degrees(crossover * delay), abs=0.5)
    assert found.crossover_Hz == pytest.approx(crossover_Hz, rel=0.01)


@given(st.floats(1.0, 30.0), st.floats(0.3, 1.5))
def test_margin_of_a_second_order_loop(natural_Hz: float, damping: float) -> None:
    # L = wn^2 / (s (s + 2 z wn)), whose phase margin is atan(2 z / sqrt(sqrt(1 + 4 z^4) - 2 z^2)).
    wn = 2.0 * math.pi * natural_Hz
    loop = OpenLoop(LINES, wn**2 / (S * (S + 2.0 * damping * wn)))
    root = math.sqrt(math.sqrt(1.0 + 4.0 * damping**4) - 2.0 * damping**2)
    found = fr.margins(loop)
    if natural_Hz * root > 1.05 * LINES[0]:
        expected = math.degrees(math.atan(2.0 * damping / root))
        assert found.phase_deg == pytest.approx(expected, abs=0.5)
    assert found.gain_dB is None


@given(st.floats(2.0, 40.0), st.floats(2.0, 12.0))
def test_stability_of_a_delayed_integrator(crossover_Hz: float, delay_ms: float) -> None:
    crossover, delay = 2.0 * math.pi * crossover_Hz, delay_ms * 1e-3
    found = fr.margins(delayed_integrator(crossover, delay))
    if abs(crossover * delay - 0.5 * math.pi) > 0.05:
        assert found.stable is (crossover * delay < 0.5 * math.pi)


def test_an_unstable_loop_has_no_margins_by_a_further_turn() -> None:
    # The phase at gain 1 is -440 deg: with a turn more, a margin of 100 deg.
    delay = math.radians(350.0) / (2.0 * math.pi * 30.0)
    found = fr.margins(delayed_integrator(2.0 * math.pi * 30.0, delay))
    assert found.phase_deg == pytest.approx(100.0, abs=3.0)
    assert found.stable is False
    assert not found.reach(60.0, 3.0)
    # A loop whose phase is below -180 deg only where its gain is high is stable; with a
    # hundredth of the gain it is not.
    lead = (S + 20.0) ** 2 / S**3
    for factor, stable in ((100.0, True), (1.0, False)):
        assert fr.margins(OpenLoop(LINES, factor * lead)).stable is stable
    assert fr.margins(OpenLoop(LINES, 1e5 * lead)).stable is None


def test_a_margin_read_off_a_closed_loop_is_refused() -> None:
    # The phase of the closed loop where its gain falls below 1 is no margin: it says 163 deg where
    # 78 deg are true.
    loop = OpenLoop(LINES, 60.0 / S * (1.0 + 1.75 / S) * np.exp(-S * 0.003))
    closed = ClosedLoop(LINES, loop.response / (1.0 + loop.response))
    true = fr.margins(loop)
    wrong = fr.margins(OpenLoop(LINES, closed.response))
    assert true.phase_deg == pytest.approx(78.0, abs=0.5)
    assert wrong.phase_deg == pytest.approx(163.0, abs=1.0)
    with pytest.raises(fr.NotOpenLoopError):
        fr.margins(closed)  # type: ignore[arg-type]
    opened = fr.margins(closed.opened())
    assert opened.phase_deg == pytest.approx(true.phase_deg, abs=1e-6)


@given(st.floats(0.0, 0.05))
def test_feed_forward_is_outside_the_opened_loop(ahead: float) -> None:
    loop = delayed_integrator(60.0, 2e-3)
    closed = loop.response * (1.0 + ahead * S) / (1.0 + loop.response)
    opened = ClosedLoop(LINES, closed).opened(ahead)
    assert np.allclose(opened.response, loop.response)


GAINS = Gains(60.0, 100.0, 20.0, 0.5, 3e-4, 300.0)
PLANT = fr.rigid_plant(LINES, 0.2, 5.0)


def closed_forms(gains: Gains) -> dict[str, np.ndarray]:
    """Return the loops of a cascade on the rigid joint."""
    drive = gains.speed * (1.0 + gains.reset / S) * np.exp(-S * gains.delay_s)
    speed = drive * PLANT * S * gains.filtered(S)
    return {"position": gains.position * drive * PLANT / (1.0 + speed), "speed": speed}


def test_loops_of_a_cascade_are_its_closed_forms() -> None:
    seen = fr.modelled(LINES, GAINS, PLANT)
    for name, expected in closed_forms(GAINS).items():
        assert np.allclose(fr.loops(seen, GAINS)[name].response, expected)
    assert np.allclose(seen.plant, PLANT)
    assert fr.rigid_fit(seen) == pytest.approx((0.2, 5.0))


def test_loops_with_other_gains_and_another_plant() -> None:
    seen = fr.modelled(LINES, GAINS, PLANT)
    other = Gains(90.0, 70.0, 10.0, 0.5, 3e-4, 300.0)
    for name, loop in fr.with_gains(seen, GAINS, other).items():
        assert np.allclose(loop.response, closed_forms(other)[name])
    heavy = fr.modelled(LINES, GAINS, fr.rigid_plant(LINES, 0.5, 2.0))
    for name, loop in fr.with_plant(heavy, GAINS, PLANT).items():
        assert np.allclose(loop.response, closed_forms(GAINS)[name])


def test_a_position_controller_alone_is_its_torque_over_its_error() -> None:
    gains = Gains(400.0, delay_s=1e-3)
    found = fr.loops(fr.modelled(LINES, gains, PLANT), gains)
    assert list(found) == ["position"]
    assert np.allclose(found["position"].response, 400.0 * PLANT * np.exp(-S * 1e-3))


@settings(max_examples=20)
@given(st.floats(45.0, 75.0), st.floats(6.0, 12.0))
def test_proposed_gains_have_the_wanted_margins(phase: float, gain: float) -> None:
    seen = fr.modelled(LINES, GAINS, PLANT)
    found = fr.propose(seen, GAINS, Wanted(phase, gain))
    assert not found.problem
    for name, response in closed_forms(found.gains).items():
        true = fr.margins(OpenLoop(LINES, response))
        assert true.reach(phase - 1e-6, gain - 1e-6)
        assert true.phase_deg == pytest.approx(found.margins[name].phase_deg, abs=1e-6)


def test_a_bandwidth_is_met_or_said_to_be_out_of_reach() -> None:
    seen = fr.modelled(LINES, GAINS, PLANT)
    slow = fr.propose(seen, GAINS, Wanted(60.0, 8.0, 5.0))
    assert slow.margins["position"].crossover_Hz == pytest.approx(5.0, rel=0.01)
    assert not slow.problem
    assert fr.propose(seen, GAINS, Wanted(60.0, 8.0, 100.0)).problem


def test_a_bandwidth_below_the_lines_is_out_of_reach() -> None:
    seen = fr.modelled(LINES, GAINS, PLANT)
    assert fr.propose(seen, GAINS, Wanted(60.0, 8.0, 0.9 * LINES[0])).problem
    assert not fr.propose(seen, GAINS, Wanted(60.0, 8.0, 1.1 * LINES[0])).problem


def test_a_speed_loop_without_the_wanted_margins_is_a_problem() -> None:
    # At a resonance of 80 Hz the speed loop lacks its margins with every gain that is tried.
    gains, at = Gains(5.0, 60.0, 2.0, 0.5, 2e-3), 160.0 * math.pi
    resonance = 1.0 + 0.5 * S**2 / (S**2 + 0.2 * at * S + at**2)
    plant = fr.rigid_plant(LINES, 0.2, 50.0) * resonance
    found = fr.propose(fr.modelled(LINES, gains, plant), gains, Wanted(60.0, 10.0))
    assert found.margins["position"].reach(60.0, 10.0)
    assert found.margins["speed"].phase_deg == pytest.approx(39.1, abs=0.1)
    assert found.problem


def test_step_of_a_first_order_loop() -> None:
    time = np.linspace(0.0, 0.2, 50)
    step = fr.step_response(OpenLoop(LINES, 60.0 / S), time)
    assert np.allclose(step, 1.0 - np.exp(-60.0 * time), atol=0.02)


def test_amplitudes_on_a_carrier_and_a_decay() -> None:
    time = np.arange(0.0, 2.5, 1e-3)
    lines = np.array([1.0, 2.2, 7.0, 31.0])
    wanted = np.array([1e-3, 2e-3j, -1e-3, 5e-4 - 5e-4j])
    tones = np.real(np.exp(2j * np.pi * np.outer(time, lines)) @ wanted)
    carrier = 0.3 * np.sin(2.0 * np.pi * 0.1 * time) + 0.1 * np.exp(-time / 0.3)
    found = fr.amplitudes(time, np.array([tones + carrier]), lines, (0.0, 2.5))[0]
    assert np.allclose(found[1:], wanted[1:], atol=2e-6)
    with pytest.raises(fr.NoResponseError):
        fr.amplitudes(time[:9], np.array([tones[:9]]), lines, (0.0, 2.5))


def test_lines_that_the_noise_hides_are_left_out() -> None:
    one = fr.modelled(LINES, GAINS, PLANT)
    rng = np.random.default_rng(0)
    noisy = one
    for _ in range(7):
        shaken = one.angle * (1.0 + (LINES < 2.0) * rng.normal(0.0, 2.0, (1, len(LINES))))
        noisy = noisy.together(
            fr.Spectra(**{**vars(one), "angle": shaken, "speed": S * shaken, "error": 1.0 - shaken})
        )
    assert fr.loops(noisy, GAINS)["position"].frequency_Hz[0] >= 2.0
    held = fr.with_intervals(
        noisy.only(LINES > 2.0),
        lambda seen: fr.margins(fr.loops(seen.mean(), GAINS)["position"]).values(),
    )
    phase = held["phase_deg"]
    assert phase.low is not None
    assert phase.high is not None
    assert phase.low <= phase.value <= phase.high  # type: ignore[operator]


def test_friction_around_rest_is_a_damping_that_falls_with_the_amplitude() -> None:
    # The torque M sgn(v) of a sine v has the first harmonic 4 M / pi.
    angle = np.linspace(0.0, 2.0 * np.pi, 100_001)
    first = 2.0 * float(np.mean(6.8 * np.sign(np.sin(angle)) * np.sin(angle)))
    found = fr.describing_damping(6.8, np.array([0.1, 0.2]))
    assert found == pytest.approx([first / 0.1, first / 0.2], rel=1e-3)
