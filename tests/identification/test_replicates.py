"""By how much the likelihood is off and how sure an estimate is, by replicates of the recording."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.mock.plant.parts.constants import Joint, Machine, Sensing
from identification.estimate import replicates
from identification.estimate.covariance import bound, covariances
from identification.estimate.inertia import Equation, inflation_factors, least_variance, mean_curve
from identification.estimate.refinement import Found, _unbiased
from identification.estimate.replicates import Bias, likelihood_bias, logged_share
from identification.filter.experiment import Experiment, Filter
from identification.filter.likelihood import HUBER_THRESHOLD, Point, likeliest_noise, torque_noise
from identification.filter.segments import Noise, motion
from identification.model.parameters import INDEX, INERTIA, LOGARITHMIC, pack, unpack
from identification.numerics.least_squares import BlockArrow, minimise_deviance
from identification.numerics.spread import Spread
from identification.recording import Model, Recording

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


def chance(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def at(
    values: dict[str, float], recordings: list[Recording], names: tuple[str, ...] = NAMES
) -> Point:
    """Return the joint fit at these values, its breakaways and noise levels the likeliest."""
    motions = [m for r in recordings if (m := motion(r)) is not None]
    begun = Point.of(motions, pack(values, 2.0), [], Model(), Noise(torque_noise(motions)))
    point, _ = replace(begun, noise=likeliest_noise(begun)).weighted().with_best_breakaways()
    return point.freeing([INDEX[n] for n in names])


def bias_of_one_turn(point: Point, names: tuple[str, ...]) -> Bias:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(replicates, "TURNS", 1)
        bias = likelihood_bias(point, names, chance())
    assert bias is not None
    return bias


@cache
def sticky_with_bias(seed: int) -> tuple[Point, Bias]:
    """Return a sticky bench at the true values, and the likelihood's bias there."""
    point = at(STICKY, sticky(seed))
    # The true values are at hand.
    return point, bias_of_one_turn(point, NAMES)


SYSTEM = ("Mc", "Ms", "omega_sf", "sigma_2", "J")


def unloaded(seconds: float) -> list[Recording]:
    return [seen(beginning(logged(simulated(0, 0.0), 0.0), seconds))]


@pytest.fixture(scope="module")
def short() -> Point:
    """Return a fit of 3 s, for tests in which no replicate is simulated or all are short."""
    return at(TRUTH, unloaded(3.0), SYSTEM)


@pytest.fixture(scope="module")
def point() -> Point:
    return at(TRUTH, unloaded(8.0), SYSTEM)


@pytest.fixture(scope="module")
def bias(point: Point) -> Bias:
    found = likelihood_bias(point, SYSTEM, chance())
    assert found is not None
    return found


def unchanged(point: Point) -> Callable[[], bool]:
    """Return whether the point is then as it was now."""
    vector, times = point.vector.copy(), [b.copy() for b in point.breakaway_times]
    return lambda: (
        np.array_equal(point.vector, vector)
        and all(map(np.array_equal, point.breakaway_times, times))
    )


def slopes(point: Point) -> BlockArrow:
    held, x = point.weighted(), point.origin()
    return held.jacobian(x, held.residuals(x))


def likeliest(point: Point) -> dict[str, float]:
    """Return the likeliest of all but the inertia, from a point."""
    point = point.freeing([k for k in point.free if k != INERTIA])
    found = minimise_deviance(
        point.predictions,
        point.derivatives,
        point.origin(),
        threshold=HUBER_THRESHOLD,
        tolerance=0.05,
    )
    return unpack(point.parameters(found.x), [n for n in NAMES if n != "J"])


@pytest.mark.proof
def test_where_static_friction_is_high_the_likelihood_errs_as_foretold() -> None:
    errors, foretold = [], []
    for seed in range(2):
        point, bias = sticky_with_bias(seed)
        foretold.append(bias.shifts["mu_s"] / STICKY["mu_s"])
        errors.append(likeliest(point)["mu_s"] / STICKY["mu_s"] - 1.0)
    error, told = float(np.mean(errors)), float(np.mean(foretold))
    assert error > 0.004
    assert abs(error - told) < 0.5 * error


def test_replicates_are_the_same_each_time_and_change_nothing(point: Point, bias: Bias) -> None:
    same = unchanged(point)
    assert bias.shifts["J"] == bias.variances["J"] == 0.0
    assert all(v > 0.0 for n, v in bias.variances.items() if n != "J")
    assert all(abs(bias.shifts[n]) < 0.01 * TRUTH[n] for n in SYSTEM)
    heard: list[tuple[str, float]] = []
    again = likelihood_bias(point, SYSTEM, chance(), progress=lambda *step: heard.append(step))
    assert again == bias
    assert same()
    assert heard[0][0] == "simulated replicates, round 1"
    assert all(0.0 < share <= 1.0 for _, share in heard)
    other = likelihood_bias(point, SYSTEM, chance(1))
    assert all(other.shifts[n] != bias.shifts[n] for n in SYSTEM if n != "J")
    assert {r.noise for r in other.replicates}.isdisjoint({r.noise for r in bias.replicates})


@pytest.mark.parametrize("share", [0.0, 0.8])
def test_the_share_of_the_noise_that_is_logged_is_seen(point: Point, share: float) -> None:
    point = replace(point, noise=Noise(0.4))
    seen_loop = replicates._loop(point.motions)
    loop = replace(
        seen_loop, count=1e-6
    )  # of a finer encoder, whose steps the drive does not answer loudly
    noise = replicates._drawn(point, point.motions[0], np.random.default_rng(1), 1.0, share)
    played = replicates._replicate(point, point.motions[0], loop, noise)
    channels = {
        **played.recording.channels,
        "command": point.motions[0].recording.channels["command"],
    }
    heard = replace(played, recording=replace(played.recording, channels=channels))
    again = replace(point, filter=Filter(Experiment((heard,))))
    assert logged_share(again, loop, chance()) == pytest.approx(share, abs=0.1)


def test_where_the_drive_answers_louder_than_the_noise_half_of_it_is_logged(short: Point) -> None:
    loop = replicates._loop(short.motions)
    for quiet in (0.0, 1e-4):  # the drive answers to its encoder's steps too
        assert logged_share(replace(short, noise=Noise(quiet)), loop, chance()) == 0.5


def test_what_cannot_be_simulated_is_left_as_it_is() -> None:
    (known,) = unloaded(3.0)
    blind = replace(known, channels={k: v for k, v in known.channels.items() if k != "command"})
    for recording, names in ((blind, SYSTEM), (known, (*SYSTEM, "offset"))):
        assert likelihood_bias(at(TRUTH, [recording], names), SYSTEM, chance()) is None


def test_a_bias_that_would_turn_friction_over_is_not_taken_off() -> None:
    names = ("Mc", "Ms", "omega_sf")
    found = Found(
        {"Mc": 6.0, "Ms": 12.0, "omega_sf": 0.05}, Spread(names, 1e-4 * np.eye(3), np.inf)
    )
    small = Bias({"Mc": 0.1, "Ms": -0.1, "omega_sf": 0.001}, dict.fromkeys(names, 1e-6))
    corrected = _unbiased(found, small)
    assert corrected.values == pytest.approx({"Mc": 5.9, "Ms": 12.1, "omega_sf": 0.049})
    assert np.diag(corrected.spread.matrix) == pytest.approx(1.01e-4)
    for name, shift in (("Ms", 6.5), ("omega_sf", 0.06)):
        assert _unbiased(found, Bias({**small.shifts, name: shift}, small.variances)) is found


@given(
    arrays(np.float64, 6, elements=st.floats(-10.0, 10.0)),
    arrays(np.float64, 6, elements=st.floats(-10.0, 10.0)),
)
def test_the_mean_of_two_equations_has_no_more_variance_than_either(one, other):
    found = least_variance(Equation(one, 2.0 * one), Equation(other, 2.0 * other))
    assert found.influence @ found.influence <= min(one @ one, other @ other) * (1.0 + 1e-9) + 1e-12
    assert np.allclose(found.parts, 2.0 * found.influence)
    if np.array_equal(one, other):
        assert found.influence == pytest.approx(one)


def test_the_inertia_goes_to_where_the_replicates_solve_its_equation_and_the_others_follow():
    point = at(STICKY, [beginning(r, 12.0) for r in sticky(0)[:1]], SYSTEM)
    bias = bias_of_one_turn(point, SYSTEM)
    assert len({r.noise for r in bias.replicates}) >= 3
    j = point.free.index(INERTIA)
    plain, found = covariances(point), covariances(point, bias.replicates)
    assert found.achieved[j, j] < plain.achieved[j, j]
    x = point.origin()
    x[: len(found.step)] += found.step
    there = covariances(point.moved(x), bias.replicates)
    assert abs(there.step[j]) < 0.1 * abs(found.step[j])


@pytest.mark.proof
def test_the_floor_is_that_of_a_bench_without_noise() -> None:
    over, count = [], len(NAMES)
    joint = replace(Joint(), mu_c=STICKY["mu_c"], mu_s=STICKY["mu_s"])
    machine = replace(Machine(), joint=joint, sensing=replace(Sensing(), current_noise_A=0.0))
    quiet = at(STICKY, [seen(logged(simulated(9, w, machine), w)) for w in (0.0, 30.6)])
    for seed in range(2):
        point, bias = sticky_with_bias(seed)
        right = np.diag(bound(slopes(replace(quiet, noise=point.noise))))[:count]
        found = np.diag(covariances(point, bias.replicates).floor)[:count]
        units = [point.vector[k] if k in LOGARITHMIC else 1.0 for k in point.free]
        over.append(np.sqrt(found / right) / units)
    mean = dict(zip(NAMES, np.mean(over, axis=0), strict=True))
    for name in ("Mc", "Ms", "omega_sf", "sigma_2", "mu_c", "mu_2"):
        assert mean[name] == pytest.approx(1.0, abs=0.08)  # 1.15 and more by strokes alike
    # Noise moves the breakaways, where these are told: one course without it is not their mean.
    # From one noisy course to the next the bound of J and mu_s scatters by a tenth of itself, that
    # of omega_sL by 0.4.
    for name in ("J", "mu_s"):
        assert mean[name] == pytest.approx(1.0, abs=0.3)
    assert 1.0 / 2.5 < mean["omega_sL"] < 2.5


ALIKE = np.full(10, 1000, dtype=np.int64)
"""Samples of stretches of one length."""


def test_the_noise_of_a_stretch_that_says_far_more_is_taken_to_be_larger() -> None:
    stretches = np.array([np.diag([1.0, 1.0])] * 9 + [np.diag([1.0, 9991.0])])
    one = np.zeros(10, dtype=np.int64)
    doubt = inflation_factors(stretches, ALIKE, one, 3.0)
    assert doubt == pytest.approx([1.0] * 9 + [np.sqrt(9991.0 / 3.0)])
    believed = np.sum(stretches / doubt[:, None, None] ** 2, axis=0)
    assert believed == pytest.approx(np.diag([9.0 + 3.0 / 9991.0, 9.0 + 3.0]))
    assert inflation_factors(stretches[:9], ALIKE[:9], one[:9], 3.0) == pytest.approx(np.ones(9))


def test_recordings_are_judged_each_by_its_own_stretches() -> None:
    light, heavy = np.diag([1.0, 1.0, 1e-15]), np.diag([1.0, 100.0, 1.0])
    stretches = np.array([light] * 2 + [10.0 * light] + [heavy] * 3)
    doubt = inflation_factors(stretches, ALIKE[:6], np.repeat([0, 1], 3), 3.0)
    assert doubt == pytest.approx([1.0, 1.0, np.sqrt(10.0 / 3.0), 1.0, 1.0, 1.0])


def test_what_stretches_tell_is_the_schur_complement_of_their_breakaway_times() -> None:
    rng = np.random.default_rng(0)
    slopes = BlockArrow(
        rng.standard_normal((12, 3)), rng.standard_normal(12), np.repeat([0, 1, 2], 4), 3
    )
    told = slopes.information_by_block()
    weight = np.ones(12)
    assert np.sum(told, axis=0) == pytest.approx(slopes.eliminated(weight, weight).matrix)
    own, along = slopes.parameters[4:8], slopes.own[4:8]
    clear = own - np.outer(along, along @ own) / (along @ along)
    assert told[1] == pytest.approx(clear.T @ clear)


ONSETS = st.floats(-20.0, 60.0)


@given(
    lengths=st.lists(st.integers(1, 50), min_size=1, max_size=4),
    length=st.integers(1, 50),
    data=st.data(),
)
def test_straight_lines_from_breakaway_lie_on_one_another_where_there_are_any(
    lengths: list[int], length: int, data: st.DataObject
) -> None:
    onsets = [data.draw(ONSETS) for _ in lengths]
    onset = data.draw(ONSETS)
    lines = [
        np.outer(np.arange(n) - begun, [1.0, -2.0])
        for n, begun in zip(lengths, onsets, strict=True)
    ]
    mean, seen = mean_curve(lines, onsets, length, onset)
    assert mean.shape == (length, 2)
    for k in range(length):
        place = [np.floor(k + begun - onset) for begun in onsets]
        count = sum(0 <= at < n - 1 for at, n in zip(place, lengths, strict=True))
        edge = any(abs(k + begun - onset - round(k + begun - onset)) < 1e-9 for begun in onsets)
        assert edge or seen[k, 0] == count
        assert mean[k] == pytest.approx(
            [k - onset, 2.0 * (onset - k)] if seen[k, 0] else [0.0, 0.0], abs=1e-9
        )
