"""How sure an estimate is said to be: scores that scatter from stretch to stretch, in the recording
and in simulated replicates.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.covariance import (
    _scatter,
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
