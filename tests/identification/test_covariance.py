"""How sure an estimate is said to be: scores that scatter from stretch to stretch, in the recording
and in simulated replicates.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.estimate import covariance
from identification.estimate.covariance import (
    _REPLICATE_PRIOR,
    _scatter,
    _spread,
    covariances,
    not_below,
)
from identification.estimate.inertia import Replicate
from identification.filter.likelihood import Point
from identification.filter.segments import Noise, motion
from identification.model.parameters import INDEX, pack
from identification.numerics.least_squares import BlockArrow
from identification.recording import Array, Model

from .test_cramer_rao import NOISE_N_M, SYSTEM, VALUES, from_the_model

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


def test_an_estimate_beside_the_likeliest_is_no_scatter() -> None:
    jacobian = strokes()
    residual = pulled(jacobian, np.random.default_rng(2).normal(size=STRETCHES))
    beside = residual + jacobian.along(np.concatenate([[3e-3, -2e-3], np.zeros(STRETCHES)]))
    assert _scatter(jacobian, beside)[0] == pytest.approx(_scatter(jacobian, residual)[0], rel=1e-9)


def test_scatter_is_drawn_toward_that_of_replicates() -> None:
    jacobian = strokes()
    calm = np.zeros(STRETCHES * ROWS)
    pulls = np.random.default_rng(3).normal(size=(2, STRETCHES))
    played = [(jacobian, pulled(jacobian, p)) for p in 1e3 * pulls / np.sqrt(ROWS)]
    foretold = np.mean([_scatter(*r)[0] for r in played], axis=0)
    share = _REPLICATE_PRIOR / (_REPLICATE_PRIOR + STRETCHES)
    assert _spread(jacobian, calm, played) == pytest.approx(np.sqrt(share * foretold))
    assert _spread(jacobian, calm, []) == pytest.approx(np.sqrt(1.0 / (1.0 + STRETCHES)))


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


def test_what_nothing_tells_does_not_follow_the_inertia(monkeypatch: pytest.MonkeyPatch) -> None:
    """A Stribeck speed that no sample resolved was taken 400 times up by a straight line in its
    logarithm.
    """
    m = motion(from_the_model(1, 5.0))
    assert m is not None
    point = Point.of(
        [m],
        pack({**VALUES, "J": 1.05 * VALUES["J"]}, 2.0),
        tuple(INDEX[n] for n in SYSTEM),
        Model(),
        NOISE,
    )
    plain = covariances(point).step
    loose = np.ones(len(SYSTEM))
    loose[SYSTEM.index("omega_sf")] = 1e6
    bound = covariance.bound

    def untold(alike: BlockArrow) -> Array:
        found = bound(alike)
        found[: len(loose), : len(loose)] *= np.outer(loose, loose)
        return found

    monkeypatch.setattr(covariance, "bound", untold)
    step = covariances(point).step
    assert abs(plain[SYSTEM.index("omega_sf")]) > 1e-5
    assert step[SYSTEM.index("omega_sf")] == 0.0
    others = [k for k, name in enumerate(SYSTEM) if name != "omega_sf"]
    assert step[others] == pytest.approx(plain[others])


def test_no_stated_variance_is_below_its_bound() -> None:
    floor = np.array([[4.0, 1.0], [1.0, 9.0]])
    achieved = np.array([[1.0, -0.8], [-0.8, 16.0]])
    stated = not_below(achieved, floor)
    assert np.diag(stated) == pytest.approx([4.0, 16.0])
    # No combination of parameters is more certain than before.
    assert np.all(np.linalg.eigvalsh(stated - achieved) >= 0.0)
    assert np.array_equal(not_below(stated, floor), stated)
    assert np.diag(not_below(np.zeros((2, 2)), floor)) == pytest.approx([4.0, 9.0])
