"""By how much the likelihood is off, foretold by replicates and held against the simulated
machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy, deepcopy
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.mock.plant.parts.constants import Joint, Machine, Sensing
from identification.estimate.default import identify
from identification.estimate.inertia.half_cycles import Replicate
from identification.estimate.inertia.inertia_equation import Equation, least_variance
from identification.estimate.inertia.instruments import instruments, replicate_instruments
from identification.estimate.likelihood import refinement, replicates
from identification.estimate.likelihood.refinement import Found, _unbiased
from identification.estimate.likelihood.replicates import (
    Bias,
    _Scored,
    likelihood_bias,
    logged_share,
)
from identification.estimate.uncertainty.covariance import Covariances, covariances
from identification.estimate.uncertainty.cramer_rao import bound
from identification.filter.likelihood import Problem, static_limit
from identification.filter.noise import Noise
from identification.filter.noise_level import HUBER_THRESHOLD, likeliest_noise, torque_noise
from identification.filter.segment_table import DIRECTION
from identification.filter.segments import motion
from identification.model.parameters import INDEX, INERTIA, LOGARITHMIC, pack, unpack
from identification.numerics.block_arrow import BlockArrow
from identification.numerics.levenberg_marquardt import minimise_deviance
from identification.numerics.spread import Spread
from identification.recording import Array, Dataset, Model, Pendulum, Recording

from .practical import beginning, command, logged, simulated
from .synthetic import TRUTH

NAMES = ("Mc", "Ms", "omega_sf", "sigma_2", "mu_c", "mu_s", "omega_sL", "mu_2", "J")
STICKY = {**TRUTH, "mu_c": 0.034, "mu_s": 0.1}
"""A load that breaks away at three times its sliding friction, where the likelihood errs most."""


def seen(recording: Recording) -> Recording:
    """Return a recording that logs its command too, by which the drive's loop is seen."""
    return replace(recording, channels={**recording.channels, "command": command(recording.time)})


def sticky(seed: int) -> list[Recording]:
    joint = replace(Joint(), mu_c=STICKY["mu_c"], mu_s=STICKY["mu_s"])
    machine = replace(Machine(), joint=joint, sensing=replace(Sensing(), current_noise_A=0.15))
    return [seen(logged(simulated(2 * seed + int(w > 0.0), w, machine), w)) for w in (0.0, 30.6)]


def at(
    values: dict[str, float], recordings: list[Recording], names: tuple[str, ...] = NAMES
) -> Problem:
    """Return the joint problem at these values, its breakaways and noise levels the likeliest."""
    motions = [m for r in recordings if (m := motion(r)) is not None]
    problem = Problem(motions, pack(values, 2.0), [], Model(), Noise(torque_noise(motions)))
    problem.breakaway_times = [m.static_crossing(static_limit(problem.start, m)) for m in motions]
    problem.noise = likeliest_noise(problem)
    problem.hold_weights()
    problem.move_breakaways(HUBER_THRESHOLD)
    problem.free = tuple(INDEX[n] for n in names)
    return problem


@cache
def _sticky_with_bias(seed: int) -> tuple[Problem, Bias]:
    problem = at(STICKY, sticky(seed))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(replicates, "_TURNS", 1)  # the true values are at hand
        bias = likelihood_bias(problem, NAMES)
    assert bias is not None
    return problem, bias


def sticky_with_bias(seed: int) -> tuple[Problem, Bias]:
    """Return a sticky bench's problem at the true values, one's own, and what the likelihood puts
    off there.
    """
    problem, bias = _sticky_with_bias(seed)
    return deepcopy(problem), bias


def silent(problem: Problem) -> Replicate:
    """Return a rehearsal that says nothing."""
    rows = len(problem.owners)
    nothing = BlockArrow(
        np.zeros((rows, len(problem.free))), np.zeros(rows), problem.owners, problem.breakaways
    )
    return Replicate(problem, nothing, np.zeros(rows), 0)


def slopes(problem: Problem) -> BlockArrow:
    problem.hold_weights()
    return problem.jacobian(problem.origin(), problem.residuals(problem.origin()))


def likeliest(problem: Problem) -> dict[str, float]:
    """Return the likeliest of all but the inertia, from the values at which a problem stands."""
    problem.free = tuple(k for k in problem.free if k != INERTIA)
    found = minimise_deviance(
        problem.predictions,
        problem.derivatives,
        problem.origin(),
        threshold=HUBER_THRESHOLD,
        tolerance=0.05,
    )
    return unpack(problem.parameters(found.x), [n for n in NAMES if n != "J"])


def test_where_static_friction_is_high_the_likelihood_errs_as_foretold() -> None:
    errors, foretold = [], []
    for seed in range(2):
        problem, bias = sticky_with_bias(seed)
        foretold.append(bias.shifts["mu_s"] / STICKY["mu_s"])
        errors.append(likeliest(problem)["mu_s"] / STICKY["mu_s"] - 1.0)
    error, told = float(np.mean(errors)), float(np.mean(foretold))
    assert error > 0.004
    assert abs(error - told) < 0.5 * error


def test_a_rehearsal_is_the_same_each_time_and_changes_nothing() -> None:
    recordings = [seen(logged(simulated(0, 0.0), 0.0))]
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
    problem = at(TRUTH, recordings, names)
    before = problem.start.copy(), [b.copy() for b in problem.breakaway_times]
    bias = likelihood_bias(problem, names)
    assert bias is not None
    assert bias.shifts["J"] == bias.variances["J"] == 0.0
    assert all(v > 0.0 for n, v in bias.variances.items() if n != "J")
    assert all(abs(bias.shifts[n]) < 0.01 * TRUTH[n] for n in names)
    assert np.array_equal(problem.start, before[0])
    assert all(
        np.array_equal(a, b) for a, b in zip(problem.breakaway_times, before[1], strict=True)
    )
    assert likelihood_bias(problem, names) == bias


def test_an_estimate_is_moved_by_it_and_profile_and_draws_with_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    dataset = Dataset((beginning(logged(simulated(0, 0.0), 0.0), 10.0),))
    likely = identify(dataset, profile=True, draws=20)
    shifts = {"Mc": 0.01, "Ms": -0.02, "omega_sf": 1e-4, "sigma_2": 0.0, "J": 0.0}
    bias = Bias(shifts, {**dict.fromkeys(shifts, 0.0), "Ms": 1e-4})
    monkeypatch.setattr(refinement, "likelihood_bias", lambda _joint, _names: bias)
    moved = identify(dataset, profile=True, draws=20)
    for name, shift in shifts.items():
        assert moved.values()[name] == pytest.approx(likely.values()[name] - shift)
    for one, other in ((likely.profiles, moved.profiles), (likely.resampled, moved.resampled)):
        for before, after in zip(one, other, strict=True):
            assert (before.low is None) == (after.low is None)
            if (
                before.low is not None
                and after.low is not None
                and not (one is likely.profiles and before.name == "Ms")
            ):
                assert after.low == pytest.approx(before.low - shifts[before.name])
    width, wider = (r.parameters["Ms"] for r in (likely, moved))
    assert width.high is not None
    assert wider.high is not None
    assert wider.high - moved.values()["Ms"] == pytest.approx(
        math.hypot(width.high - likely.values()["Ms"], 1.6449 * 0.01), rel=1e-4
    )
    (curve,) = (p for p in moved.profiles if p.name == "Ms")
    assert curve.high is not None
    assert curve.low is not None
    assert curve.high - curve.low == pytest.approx(
        2.0 * (wider.high - moved.values()["Ms"]), rel=0.05
    )


@pytest.mark.parametrize("share", [0.0, 0.3, 0.8])
def test_the_share_of_the_noise_that_is_logged_is_seen(share: float) -> None:
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
    problem = at(TRUTH, [seen(beginning(logged(simulated(0, 0.0), 0.0), 10.0))], names)
    problem.noise = Noise(0.4)
    seen_loop = replicates._loop(problem.motions)
    assert seen_loop is not None
    loop = replace(
        seen_loop, count=1e-6
    )  # of a finer encoder, whose steps the drive does not answer loudly
    noise = replicates._drawn(problem, problem.motions[0], np.random.default_rng(1), 1.0, share)
    played = replicates._replicate(problem, problem.motions[0], loop, noise)
    assert played is not None
    channels = {
        **played.recording.channels,
        "command": problem.motions[0].recording.channels["command"],
    }
    again = copy(problem)
    again.motions = (replace(played, recording=replace(played.recording, channels=channels)),)
    assert logged_share(again, loop) == pytest.approx(share, abs=0.1)


def test_where_the_drive_answers_louder_than_the_noise_half_of_it_is_logged() -> None:
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
    problem = at(TRUTH, [seen(beginning(logged(simulated(0, 0.0), 0.0), 3.0))], names)
    loop = replicates._loop(problem.motions)
    assert loop is not None
    for quiet in (0.0, 1e-4):  # the drive answers to its encoder's steps too
        problem.noise = Noise(quiet)
        assert logged_share(problem, loop) == 0.5


def test_the_inertias_equation_is_solved_where_the_likelihoods_bias_is_taken_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
    problem = at(TRUTH, [seen(beginning(logged(simulated(0, 0.0), 0.0), 10.0))], names)
    values = {name: TRUTH[name] for name in names}
    found = Found(values, Spread(names, 1e-6 * np.eye(5), math.inf))
    bias = likelihood_bias(problem, names)
    assert bias is not None
    before = problem.start.copy(), [b.copy() for b in problem.breakaway_times]
    there: list[Array] = []

    def recorded(moved: Problem, replicates: Sequence[Replicate]) -> Covariances:
        there.append(moved.start.copy())
        return covariances(moved, replicates)

    monkeypatch.setattr(refinement, "covariances", recorded)
    solved = refinement._with_instruments(refinement._unbiased(found, bias), problem, bias)
    expected = {name: values[name] - bias.shifts[name] for name in names}
    assert unpack(there[0], names) == pytest.approx(expected)
    assert solved.values["J"] != expected["J"]
    assert np.all(np.diag(solved.spread.covariance)[:4] > [bias.variances[n] for n in names[:4]])
    assert np.array_equal(problem.start, before[0])
    assert all(
        np.array_equal(a, b) for a, b in zip(problem.breakaway_times, before[1], strict=True)
    )


def test_what_cannot_be_rehearsed_is_left_as_it_is() -> None:
    recordings = [logged(simulated(0, 0.0), 0.0)]
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
    assert likelihood_bias(at(TRUTH, recordings, names), names) is None  # no command
    known = [seen(recordings[0])]
    assert likelihood_bias(at(TRUTH, known, (*names, "offset")), names) is None
    hanging = [replace(known[0], pendulum=Pendulum(0.1, 0.1))]
    assert likelihood_bias(at(TRUTH, hanging, names), names) is None


def test_a_bias_that_would_turn_friction_over_is_not_taken_off() -> None:
    names = ("Mc", "Ms", "omega_sf")
    found = Found(
        {"Mc": 6.0, "Ms": 12.0, "omega_sf": 0.05}, Spread(names, 1e-4 * np.eye(3), np.inf)
    )
    small = Bias({"Mc": 0.1, "Ms": -0.1, "omega_sf": 0.001}, dict.fromkeys(names, 1e-6))
    corrected = _unbiased(found, small)
    assert corrected.values == pytest.approx({"Mc": 5.9, "Ms": 12.1, "omega_sf": 0.049})
    assert np.diag(corrected.spread.covariance) == pytest.approx(1.01e-4)
    for name, shift in (("Ms", 6.5), ("omega_sf", 0.06)):
        assert _unbiased(found, Bias({**small.shifts, name: shift}, small.variances)) is found


def test_where_a_rehearsal_fails_another_noise_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
    problem = at(TRUTH, [seen(beginning(logged(simulated(0, 0.0), 0.0), 3.0))], names)
    failing = {0}

    def step(
        _joint: Problem, _loop: object, _share: float, seed: int, sign: float
    ) -> _Scored | None:
        if seed in failing and sign < 0.0:
            return None
        out = np.zeros(len(problem.free))
        out[problem.free.index(INDEX["Ms"])] = 1e-3 * (seed + 2.0 * sign)
        return _Scored(out, np.ones(len(problem.free)), silent(problem))

    monkeypatch.setattr(replicates, "_step", step)
    bias = likelihood_bias(problem, names)
    assert bias is not None
    assert bias.shifts["Ms"] == pytest.approx(1e-3 * (1 + 2 + 3) / 3)
    assert bias.variances["Ms"] == pytest.approx(1e-6 / 3)
    failing |= set(range(9)) - {3}  # one pair tells no variance
    assert likelihood_bias(problem, names) is None


@pytest.mark.parametrize(("spread", "noises"), [(0.1, 3), (0.5, 6)])
def test_more_noises_are_taken_where_three_leave_the_bias_uncertain(
    monkeypatch: pytest.MonkeyPatch, spread: float, noises: int
) -> None:
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
    problem = at(TRUTH, [seen(beginning(logged(simulated(0, 0.0), 0.0), 3.0))], names)
    taken: list[int] = []

    def step(_joint: Problem, _loop: object, _share: float, seed: int, _sign: float) -> _Scored:
        taken.append(seed)
        out = np.zeros(len(problem.free))
        out[problem.free.index(INDEX["Ms"])] = spread * (-1.0) ** seed
        return _Scored(out, np.ones(len(problem.free)), silent(problem))

    monkeypatch.setattr(replicates, "_step", step)
    assert likelihood_bias(problem, names) is not None
    assert taken == [k for k in range(noises) for _ in range(2)]


def test_a_large_bias_is_that_of_values_as_far_from_the_estimate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where it is a tenth of the value, the estimate less an eleventh is off by as much."""
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
    problem = at(TRUTH, [seen(beginning(logged(simulated(0, 0.0), 0.0), 3.0))], names)
    place = problem.free.index(INDEX["Ms"])

    def step(joint: Problem, _loop: object, _share: float, _seed: int, _sign: float) -> _Scored:
        out = np.zeros(len(joint.free))
        out[place] = 0.1 * joint.origin()[place]
        return _Scored(out, np.full(len(joint.free), deviation), silent(joint))

    monkeypatch.setattr(replicates, "_step", step)
    whole = problem.origin()[place]
    found = {}
    for deviation in (1e-3, 1e3):
        bias = likelihood_bias(problem, names)
        assert bias is not None
        found[deviation] = bias.shifts["Ms"] / whole
    assert found[1e3] == pytest.approx(0.1)
    assert found[1e-3] == pytest.approx(1.0 / 11.0, rel=2e-3)


def test_a_stretch_has_the_instruments_of_its_own_rehearsals() -> None:
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
    problem = at(TRUTH, [seen(logged(simulated(0, 0.0), 0.0))], names)
    jacobian = slopes(problem)
    every = instruments(problem, jacobian)
    problem.inflation[1] = 2.0
    level = 2.5 / problem.inflation[problem.owners]
    plain = replace(every, parameters=np.repeat(level[:, None], len(names), axis=1), own=level)
    marked = [replace(jacobian, parameters=np.full_like(every.parameters, k)) for k in (1.0, 4.0)]
    found = replicate_instruments(
        problem, plain, [Replicate(problem, m, np.zeros(len(m.own)), 0) for m in marked]
    )
    ties = len(plain.own) - problem.breakaways
    assert np.array_equal(found.parameters[ties:], plain.parameters[ties:])
    assert np.array_equal(found.own[ties:], plain.own[ties:])
    for j, doubt in enumerate(problem.inflation):
        assert np.allclose(found.parameters[:ties][problem.owners[:ties] == j], 2.5 / doubt)
    # What goes the other way is no rehearsal of a stretch.
    other = at(TRUTH, [seen(logged(simulated(0, 0.0), 0.0))], names)
    other.motions[0].table[:2, DIRECTION] *= -1.0
    plain = replace(plain, parameters=np.full_like(plain.parameters, 7.0))
    found = replicate_instruments(
        problem, plain, [Replicate(other, marked[0], np.zeros(len(plain.own)), 0)]
    )
    for j in range(problem.breakaways):
        rows = np.flatnonzero(problem.owners[:ties] == j)[:100]
        assert np.allclose(found.parameters[rows], 7.0 if j < 2 else 1.0)


@given(
    arrays(np.float64, 6, elements=st.floats(-10.0, 10.0)),
    arrays(np.float64, 6, elements=st.floats(-10.0, 10.0)),
)
def test_the_mean_of_two_equations_has_no_more_variance_than_either(
    one: Array, other: Array
) -> None:
    found = least_variance(Equation(one, 2.0 * one), Equation(other, 2.0 * other))
    assert found.influence @ found.influence <= min(one @ one, other @ other) * (1.0 + 1e-9) + 1e-12
    assert np.allclose(found.parts, 2.0 * found.influence)


def test_two_equations_that_err_apart_count_by_their_variances() -> None:
    one, other = np.array([2.0, 0.0]), np.array([0.0, 1.0])
    assert least_variance(Equation(one, one), Equation(other, other)).influence == pytest.approx(
        [0.4, 0.8]
    )


def test_the_inertia_goes_to_where_the_rehearsals_solve_its_equation_and_the_others_follow() -> (
    None
):
    problem, bias = sticky_with_bias(0)
    assert len({r.noise for r in bias.replicates}) >= 3
    j = problem.free.index(INERTIA)
    plain, found = covariances(problem), covariances(problem, bias.replicates)
    assert found.achieved[j, j] < plain.achieved[j, j]
    x = problem.origin()
    x[: len(found.step)] += found.step
    problem.keep(x)
    assert abs(covariances(problem, bias.replicates).step[j]) < 0.1 * abs(found.step[j])


def test_instruments_of_a_rehearsal_are_what_it_shows_from_sample_to_sample() -> None:
    """The drive's answer to single counts is in them, and a smoothed mean would have none of it."""
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
    problem = at(TRUTH, [seen(beginning(logged(simulated(0, 0.0), 0.0), 10.0))], names)
    own = slopes(problem)
    rough = replace(own, parameters=own.parameters * np.resize([1.0, -1.0], len(own.own))[:, None])
    rehearsal = Replicate(problem, rough, np.zeros(len(own.own)), 0)
    found = replicate_instruments(problem, instruments(problem, own), [rehearsal])
    inside = np.flatnonzero(
        np.diff(problem.owners[: len(own.own) - problem.breakaways]) == 0
    )  # all but the last
    assert found.parameters[inside] == pytest.approx(rough.parameters[inside], rel=1e-9)


def test_the_floor_is_that_of_a_bench_without_noise() -> None:
    """Its sensitivities hold none, and at the noise levels of the noisy one give the bound
    itself.
    """
    over = []
    for seed in range(2):
        problem, bias = sticky_with_bias(seed)
        joint = replace(Joint(), mu_c=STICKY["mu_c"], mu_s=STICKY["mu_s"])
        machine = replace(Machine(), joint=joint, sensing=replace(Sensing(), current_noise_A=0.0))
        quiet = at(STICKY, [seen(logged(simulated(9, w, machine), w)) for w in (0.0, 30.6)])
        quiet.noise = problem.noise
        count = len(NAMES)
        right = np.diag(bound(slopes(quiet)))[:count]
        found = np.diag(covariances(problem, bias.replicates).floor)[:count]
        units = [problem.start[k] if k in LOGARITHMIC else 1.0 for k in problem.free]
        over.append(np.sqrt(found / right) / units)
    mean = dict(zip(NAMES, np.mean(over, axis=0), strict=True))
    for name in ("Mc", "Ms", "omega_sf", "sigma_2", "mu_c", "mu_2"):
        assert mean[name] == pytest.approx(1.0, abs=0.08)  # 1.15 and more by strokes alike
    # Noise moves the breakaways, where these are told: one course without it is not their mean.
    for name in ("J", "mu_s", "omega_sL"):
        assert 0.8 < mean[name] < 1.5
