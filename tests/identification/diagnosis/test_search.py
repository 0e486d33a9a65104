"""The test by sign flips holds its level on noise that is correlated within blocks."""

from __future__ import annotations

import numpy as np

from identification.diagnosis.search import chance
from identification.diagnosis.stack import Candidate, wald

BLOCKS, ROWS, CANDIDATES, STUDIES = 40, 25, 20, 100


def scored(regressor: np.ndarray, residual: np.ndarray) -> Candidate:
    unit = regressor / np.linalg.norm(regressor)
    sums = (unit * residual).reshape(BLOCKS, ROWS).sum(axis=1)[:, None]
    score = sums.sum(axis=0)
    weights = (unit**2).reshape(BLOCKS, ROWS).sum(axis=1)[:, None, None]
    gain = float(score @ score)
    return Candidate("any", (), score, gain, 1.0, wald(score, sums - weights @ score), sums, weights, gain)


def study(rng: np.random.Generator, hidden: float) -> float:
    level = np.repeat(rng.standard_normal(BLOCKS), ROWS)
    residual = rng.standard_normal(BLOCKS * ROWS) + 0.7 * level
    regressors = np.repeat(rng.standard_normal((CANDIDATES, BLOCKS)), ROWS, axis=1)
    residual = residual + hidden * regressors[0]
    return chance([scored(r, residual) for r in regressors], BLOCKS, rng)


def test_false_alarms_come_as_often_as_said() -> None:
    rng = np.random.default_rng(5)
    alarms = sum(study(rng, 0.0) <= 0.05 for _ in range(STUDIES))
    assert alarms <= 10, "more than 10 % at a level of 5 %"


def test_an_effect_is_seen() -> None:
    rng = np.random.default_rng(6)
    assert sum(study(rng, 0.8) <= 0.01 for _ in range(20)) >= 18
