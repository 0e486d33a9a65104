"""A model that does not describe the machine: the noise floor, the codes, and the intervals."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.default import by_load, free_names, identify, solve_stages
from identification.estimate.equation_error import block_sandwich, discrepancy
from identification.estimate.parameter_table import parameter_table, printed_fit
from identification.numerics.arrays import silent
from identification.numerics.spread import Spread
from identification.prepare import Prepared, prepare
from identification.recording import Array, Dataset, Model, Recording
from identification.result import LEAST_EXPLAINED, MOST_FLOORS, Identification, Misfit
from identification.views.predicted import Predicted, noise_floor
from identification.views.view import views

from .diagnosis.benches import campaign
from .synthetic import TRUTH, sine

NOISE_N_M = 0.2
NAMES = ("Mc", "sigma_2", "J")


def noisy(duration: float, missing: float = 0.0, seed: int = 1) -> Recording:
    """A fast sine with noise and, against the motion, a missing torque below a speed."""
    clean = sine(frequency=1.0, duration=duration)
    speed = clean.channels["velocity"]
    shape = np.sign(speed) * (np.abs(speed) < 1.0)
    noise = NOISE_N_M * np.random.default_rng(seed).standard_normal(len(speed))
    torque = clean.channels["torque"] + missing * shape + noise
    return replace(clean, channels={**clean.channels, "torque": torque})


def identified(recording: Recording) -> Identification:
    return identify(Dataset((recording,), Model()), bandwidth_Hz=40.0)


def test_the_floor_is_the_noise_whatever_smooth_torque_is_missing() -> None:
    (view,) = views([noisy(20.0)], 40.0)
    outputs = len(view.kept_times)
    passed = view.low_pass(NOISE_N_M * np.random.default_rng(2).standard_normal(len(view.time)))
    smooth = 3.0 * np.sin(2.0 * np.pi * 0.7 * view.kept_times)
    measured = 10.0 + smooth + passed
    measured[outputs // 3 : outputs // 2] = math.nan
    part = Predicted("torque", "r", "fit", view.kept_times, measured, np.full(outputs, 10.0))
    known = passed[np.isfinite(measured)]
    floor = noise_floor([part], view.low_pass)
    assert floor == pytest.approx(float(np.sqrt(np.mean(known**2))), rel=0.1)
    nothing = replace(part, measured=np.full(outputs, math.nan))
    assert noise_floor([nothing], view.low_pass) is None


def test_what_differs_between_periods_of_the_command_is_floor() -> None:
    recording = noisy(20.0)
    command = np.sin(2.0 * np.pi * recording.time)
    wander = np.sin(2.0 * np.pi * 0.37 * recording.time)
    torque = recording.channels["torque"] + wander
    channels = {**recording.channels, "torque": torque, "command": command}
    floors = [
        identified(replace(recording, channels=c)).fit.noise_floor_rms
        for c in (channels, {k: v for k, v in channels.items() if k != "command"})
    ]
    between = float(np.sqrt(0.5 * np.mean((wander[1000:] - wander[:-1000]) ** 2)))
    assert floors[0] == pytest.approx(between, rel=0.1)
    assert floors[1] < 0.2 * floors[0]


def test_a_right_model_has_no_misfit_and_a_missing_torque_is_above_the_floor() -> None:
    right, lacking = identified(noisy(10.0)), identified(noisy(10.0, 3.0))
    assert right.misfit == ()
    assert right.fit.floors == pytest.approx(1.0, abs=0.15)
    assert lacking.misfit == (Misfit.ABOVE_FLOOR,)
    assert lacking.fit.floors > 2.0 * MOST_FLOORS
    assert 0.9 < lacking.fit.noise_floor_rms / right.fit.noise_floor_rms < 1.5


def test_a_torque_against_the_model_puts_constants_at_their_bounds() -> None:
    clean = sine(frequency=1.0, duration=10.0)
    torque = np.random.default_rng(3).standard_normal(len(clean.time)).cumsum() / 20.0
    torque -= np.sign(clean.channels["velocity"])
    found = identified(replace(clean, channels={**clean.channels, "torque": torque}))
    assert found.fit.explained < LEAST_EXPLAINED
    assert "Mc" in found.bounded
    assert found.misfit[:2] == (Misfit.EXPLAINS_LITTLE, Misfit.AT_BOUNDS)


def both(prepared: Prepared) -> tuple[Array, Array]:
    """Return half widths by the blocks, and due to what is missing."""
    left = 0.5
    sandwich = block_sandwich([prepared], TRUTH, NAMES, 2.0)
    missing = discrepancy([prepared], TRUTH, NAMES, 2.0, left, 0.0)
    alone = Spread(NAMES, missing, math.inf)
    widths = [[s.half_width(n) for n in NAMES] for s in (sandwich, alone)]
    return np.array(widths[0]), np.array(widths[1])


def test_repetition_averages_noise_but_not_what_is_missing() -> None:
    short, long = (both(prepare(noisy(seconds), 40.0)) for seconds in (8.0, 32.0))
    assert np.all(long[0] < 0.75 * short[0])
    np.testing.assert_allclose(long[1], short[1], rtol=0.1)


def test_a_missing_torque_of_twice_the_size_is_twice_the_interval() -> None:
    here = prepare(sine(frequency=1.0), 40.0)
    one, two = (discrepancy([here], TRUTH, NAMES, 2.0, size, 0.0) for size in (0.4, 0.8))
    np.testing.assert_allclose(two, 4.0 * one, rtol=1e-6)


SEEDS = (41, 42)
HIDDEN: Mapping[str, Mapping[str, float]] = {
    "backlash": {"gap_rad": 0.004},
    "torque_saturation": {"knee_A": 30.0, "rational": 1.0},
    "asymmetric_coulomb": {"torque_Nm": 0.4},
    "friction_memory": {"time_s": 0.03, "of_speed": 0.0},
    "time_skew": {"time_s": 0.008},
    "position_dependent_friction": {"torque_Nm": 1.0, "center_rad": 0.1, "width_rad": 0.08},
    "presliding": {"stiffness_Nm_rad": 1e4},
    "x_timed_torque": {"torque_Nm": 0.5, "frequency_Hz": 3.7, "phase_rad": 0.0},
    "quadratic_drag": {"coefficient_Nms2_rad2": 3.0},
    "gravity_imbalance": {"torque_Nm": 2.0, "zero_rad": 0.3},
    "current_offset": {"current_A": 0.3},
}


@pytest.mark.proof
def test_intervals_hold_where_something_is_hidden() -> None:
    # An effect that only scales the torque, such as an efficiency, leaves nothing and is not here.
    truth, inside, narrow, known = dict(TRUTH), 0, 0, 0
    for name, parameters in HIDDEN.items():
        for seed in SEEDS:
            recordings = campaign({name: parameters}, seed, 8.0)
            found = equation_error(recordings)
            for parameter, (value, half, alone) in found.items():
                known += 1
                inside += abs(value - truth[parameter]) <= half
                narrow += abs(value - truth[parameter]) <= alone
    assert inside >= 0.82 * known, (inside, narrow, known)
    assert inside - narrow > 0.15 * known, "without what is left, intervals are far too narrow"


def equation_error(recordings: tuple[Recording, ...]) -> dict[str, tuple[float, float, float]]:
    """Return value and half widths, with and without what is left, of determined parameters."""
    prepared = [prepare(r, 25.0) for r in recordings if r.role == "fit"]
    values, _ = solve_stages(*by_load(prepared), Model(), silent)
    names = free_names(values, Model())
    alone = block_sandwich(prepared, values, names, 2.0)
    fit, _ = printed_fit(prepared, False, values, 2.0)
    more = discrepancy(prepared, values, names, 2.0, fit.discrepancy_rms, fit.noise_floor_rms)
    wide = replace(alone, matrix=alone.matrix + more)
    table = parameter_table(prepared, values, wide, Model(), {}, fit.floors > MOST_FLOORS)
    return {
        n: (values[n], wide.half_width(n), alone.half_width(n))
        for n, p in table.items()
        if p.identifiable
    }
