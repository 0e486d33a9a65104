"""The Cramer-Rao floor on data of the fitted model itself, and scores that scatter."""

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate import searches
from identification.estimate.covariance import (
    _scatter,
    bound,
    covariances,
    not_below,
    replicate_bound,
    replicate_information,
)
from identification.estimate.inertia import Replicate, instruments
from identification.estimate.searches import Refined, refine_stages
from identification.filter.likelihood import Point
from identification.filter.segments import Noise, motion
from identification.model.parameters import INDEX, pack
from identification.numerics.compiled import compiled
from identification.numerics.least_squares import BlockArrow
from identification.recording import Array, Bench, Model, Recording

from .synthetic import TRUTH

SYSTEM = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
VALUES = {name: TRUTH[name] for name in SYSTEM}
COUNT_RAD = 2.0 * math.pi / 409600.0
NOISE_N_M = 0.1
PERIOD_S, FINE = 1e-3, 10
SEEDS = 5


@compiled
def run(rng_noise: Array, angle: Array, measured: Array, values: Array) -> None:
    """Fill in the angle and the mean torque of every period."""
    coulomb, static, omega_s, viscous, inertia = values
    theta = omega = wind = 0.0
    h = PERIOD_S / FINE
    for k in range(1, len(angle)):
        for j in range(FINE):
            speed = 0.4 * math.sin(2.0 * math.pi * 0.4 * (k - 1 + j / FINE) * PERIOD_S)
            wind += h * (speed - omega)
            held = 40.0 * (speed - omega) + 600.0 * wind
            measured[k] += held / FINE
            torque = held - rng_noise[k, j]
            if omega == 0.0 and abs(torque) <= static:
                continue
            side = math.copysign(1.0, omega if omega != 0.0 else torque)
            new = middle = omega
            for _ in range(2):
                fall = (static - coulomb) * math.exp(-((middle / omega_s) ** 2))
                friction = coulomb + fall + viscous * abs(middle)
                new = omega + h * (torque - side * friction) / inertia
                middle = 0.5 * (omega + new)
            if side * new < 0.0:
                new = 0.0
            theta += 0.5 * h * (omega + new)
            omega = new
        angle[k] = theta


def from_the_model(seed: int, duration: float = 10.0) -> Recording:
    rng = np.random.default_rng(seed)
    n = round(duration / PERIOD_S)
    angle, measured = np.zeros(n + 1), np.zeros(n + 1)
    noise = NOISE_N_M * math.sqrt(FINE) * rng.standard_normal((n + 1, FINE))
    run(noise, angle, measured, np.array([VALUES[name] for name in SYSTEM]))
    counts = np.floor(angle / COUNT_RAD + rng.uniform()) * COUNT_RAD
    return Recording(
        name=f"model{seed}",
        channels={"time": PERIOD_S * np.arange(n + 1), "angle": counts, "torque": measured},
        bench=Bench(),
        averaged=frozenset({"torque"}),
    )


@pytest.fixture(scope="module")
def estimates() -> list[Refined]:
    out = []
    with pytest.MonkeyPatch.context() as never_rejects:
        for limit in ("MOST_CHI2", "MOST_NOISE", "MOST_REPEATING"):
            never_rejects.setattr(searches, limit, math.inf)
        for seed in range(SEEDS):
            m = motion(from_the_model(seed))
            assert m is not None
            start = {name: 1.01 * v for name, v in VALUES.items()}
            out.append(refine_stages([m], [], start, Model()))
    return out


def test_an_estimate_reaches_the_floor_and_none_beats_it(estimates: list[Refined]) -> None:
    errors = np.array([[r.values[n] - VALUES[n] for n in r.names] for r in estimates])
    floors = np.array([np.sqrt(np.diag(r.floor)) for r in estimates])
    over = float(np.sqrt(np.mean((errors / floors) ** 2)))
    assert 0.6 < over < 1.4  # 25 errors over their floors, correlated within a seed


def test_intervals_are_as_wide_as_the_floor_where_the_noise_is_as_assumed(estimates):
    # Each comes from the scatter over a few stretches, so that it may fall below; their mean square
    # does not.
    over = np.array([np.diag(r.covariance) / np.diag(r.floor) for r in estimates])
    assert 0.85 < np.sqrt(np.mean(over)) < 1.5
    assert np.all(over > 0.25)


def test_the_noise_is_found(estimates: list[Refined]) -> None:
    assert np.median([r.noise.torque for r in estimates]) == pytest.approx(NOISE_N_M, rel=0.1)


def slopes_at_the_truth(seed: int) -> tuple[Point, BlockArrow]:
    """Return a recording of the fitted model at its true values, and its Jacobian there."""
    m = motion(from_the_model(seed, 5.0))
    assert m is not None
    point = Point.of(
        [m], pack(VALUES, 2.0), tuple(INDEX[n] for n in SYSTEM), Model(), Noise(NOISE_N_M)
    )
    held, x = point.weighted(), point.origin()
    return point, held.jacobian(x, held.residuals(x))


def replicate(point: Point, sensitivities: BlockArrow, noise: int) -> Replicate:
    """Return a replicate that goes as predicted."""
    return Replicate(point, sensitivities, np.zeros(len(point.owners)), noise)


def test_replicates_that_go_as_predicted_give_the_bound_itself() -> None:
    point, jacobian = slopes_at_the_truth(1)
    alike = [replicate(point, jacobian, k) for k in range(2)]
    found = replicate_bound(replicate_information(point, jacobian, alike))
    assert np.diag(found) == pytest.approx(np.diag(bound(jacobian))[: len(SYSTEM)], rel=0.02)


def test_instruments_hold_nothing_of_their_own_stretch() -> None:
    point, jacobian = slopes_at_the_truth(1)
    slopes, z = jacobian.parameters, instruments(point, jacobian).parameters
    mine = point.owners == 1
    inside = mine.copy()
    inside[-point.breakaways :] = False
    changed = replace(jacobian, parameters=np.where(inside[:, None], -3.0, 1.0) * slopes)
    moved = instruments(point, changed).parameters
    assert np.array_equal(moved[inside], z[inside])
    assert not np.array_equal(moved[point.owners == 0], z[point.owners == 0])
    alike = np.sum(z[inside, 0] * slopes[inside, 0])
    assert alike > 0.8 * np.linalg.norm(z[inside, 0]) * np.linalg.norm(slopes[inside, 0])


STRETCHES, ROWS = 12, 60
NOISE = Noise(NOISE_N_M)


def strokes(seed: int = 0) -> BlockArrow:
    """Return slopes of two parameters over strokes that all make the same motion."""
    table = np.tile(np.random.default_rng(seed).normal(size=(ROWS, 2)), (STRETCHES, 1))
    owners = np.repeat(np.arange(STRETCHES), ROWS)
    return BlockArrow(table, np.zeros(len(table)), owners, STRETCHES)


def pulled(jacobian: BlockArrow, pulls: Array) -> Array:
    """Return the residuals of strokes that each pull at the first parameter."""
    return 1e-3 * jacobian.parameters[:, 0] * pulls[jacobian.owners]


def test_scores_of_white_noise_scatter_as_foretold() -> None:
    jacobian = strokes()
    ratios = [
        _scatter(jacobian, np.random.default_rng(k).normal(size=STRETCHES * ROWS))[0]
        for k in range(200)
    ]
    assert np.mean(ratios, axis=0) == pytest.approx(1.0, abs=0.07)
    assert _scatter(jacobian, np.zeros(STRETCHES * ROWS))[1] == pytest.approx(STRETCHES)


def test_strokes_that_pull_apart_scatter_more() -> None:
    jacobian = strokes()
    pulls = np.random.default_rng(1).normal(size=STRETCHES)
    one = jacobian.parameters[:ROWS]
    told = 1.0 / float(np.linalg.inv(one.T @ one)[0, 0])
    found, _ = _scatter(jacobian, pulled(jacobian, pulls))
    # What a stroke would step by itself, over the deviation of that.
    assert found[0] == pytest.approx(1e-6 * float(np.var(pulls, ddof=1)) * told, rel=1e-9)


def test_a_doubted_stretch_widens_the_interval_and_not_the_floor() -> None:
    m = motion(from_the_model(1, 5.0))
    assert m is not None
    point = Point.of([m], pack(VALUES, 2.0), tuple(INDEX[n] for n in SYSTEM), Model(), NOISE)
    held, x = point.weighted(), point.origin()
    residual = held.residuals(x)
    jacobian = held.jacobian(x, residual)
    played = [Replicate(point, jacobian, residual, k) for k in range(2)]
    plain = covariances(point, played)
    inflation = np.where(np.arange(point.breakaways) < point.breakaways // 2, 30.0, 1.0)
    segment_inflation = covariances(replace(point, inflation=inflation), played)
    assert segment_inflation.floor == pytest.approx(plain.floor, rel=1e-6)
    ratio = np.diag(segment_inflation.achieved) / np.diag(plain.achieved)
    assert np.all(
        ratio[: SYSTEM.index("J")] > 1.3
    )  # half of them all but lost; J has an equation of its own


def test_no_stated_variance_is_below_its_bound() -> None:
    floor = np.array([[4.0, 1.0], [1.0, 9.0]])
    achieved = np.array([[1.0, -0.8], [-0.8, 16.0]])
    stated = not_below(achieved, floor)
    assert np.diag(stated) == pytest.approx([4.0, 16.0])
    # No combination of parameters is more certain than before.
    assert np.all(np.linalg.eigvalsh(stated - achieved) >= 0.0)
    assert np.array_equal(not_below(stated, floor), stated)
    assert np.diag(not_below(np.zeros((2, 2)), floor)) == pytest.approx([4.0, 9.0])
