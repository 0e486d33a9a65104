"""Traps of statistics: tests that count samples alarm on noise that is correlated in time; blocks
do not.

Each trapped rule gets the same studies as the rule of this project: noise alone, 20 candidates,
wanted 5 %.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
from scipy import stats

from identification.diagnosis.oracle import greedy_bic, library
from identification.diagnosis.significance import (
    generic_candidates,
    sign_flip_p_value,
    size_p_value,
    trial_candidates,
)
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.recording import Array

from .benches import honest, nominal_fit
from .test_search import BLOCKS, CANDIDATES, ROWS, scored

STUDIES = 40
WANTED = 0.05
LAGS = 8
"""Of the HAC variance, in samples: 4 (n/100)^(2/9), the usual rule."""


@lru_cache
def studies() -> tuple[tuple[Array, Array], ...]:
    """Return residuals, shape (n,), that share their level within blocks, and regressors of unit
    norm, shape (c, n).
    """
    rng = np.random.default_rng(11)
    made = []
    for _ in range(STUDIES):
        residual = rng.standard_normal(BLOCKS * ROWS) + 0.7 * np.repeat(
            rng.standard_normal(BLOCKS), ROWS
        )
        regressors = np.repeat(rng.standard_normal((CANDIDATES, BLOCKS)), ROWS, axis=1)
        made.append((residual, regressors / np.linalg.norm(regressors, axis=1, keepdims=True)))
    return tuple(made)


def by_blocks(residual: Array, regressors: Array) -> bool:
    return (
        sign_flip_p_value(
            [scored(r, residual) for r in regressors], BLOCKS, np.random.default_rng(1)
        )
        <= WANTED
    )


def by_f_test(residual: Array, regressors: Array) -> bool:
    score = regressors @ residual
    noise = (residual @ residual - score**2) / (len(residual) - 1)
    return bool(stats.f.sf(np.max(score**2 / noise), 1, len(residual) - 1) * CANDIDATES <= WANTED)


def by_held_out_error(residual: Array, regressors: Array) -> bool:
    half = len(residual) // 2
    fitted = regressors[:, :half] @ residual[:half] / np.sum(regressors[:, :half] ** 2, axis=1)
    rest = residual[half:] - fitted[:, None] * regressors[:, half:]
    return bool(np.min(np.sum(rest**2, axis=1)) < np.sum(residual[half:] ** 2))


def by_hac_errors(residual: Array, regressors: Array) -> bool:
    score = regressors @ residual
    terms = regressors * (residual - score[:, None] * regressors)
    variance = np.sum(terms**2, axis=1)
    for lag in range(1, LAGS):
        variance += 2.0 * (1.0 - lag / LAGS) * np.sum(terms[:, lag:] * terms[:, :-lag], axis=1)
    return bool(
        np.min(2.0 * stats.norm.sf(np.abs(score) / np.sqrt(variance))) * CANDIDATES <= WANTED
    )


@pytest.mark.parametrize(
    ("rule", "least", "most"),
    [
        (by_blocks, 0.0, 0.12),
        (by_f_test, 0.9, 1.0),
        (by_held_out_error, 0.9, 1.0),
        (by_hac_errors, 0.5, 1.0),
    ],
)
def test_false_alarms_on_correlated_noise(
    rule: Callable[[Array, Array], bool], least: float, most: float
) -> None:
    alarms = [rule(*study) for study in studies()]
    assert least <= np.mean(alarms) <= most


def test_few_blocks_prove_nothing_however_large_the_effect() -> None:
    """A sign-flip p-value of one effect cannot go below 2^(1 - k) with k blocks; a t test knows no
    such limit.
    """
    rng = np.random.default_rng(2)
    active = 4
    regressor = np.repeat(np.where(np.arange(BLOCKS) < active, 1.0, 0.0), ROWS)
    residual = rng.standard_normal(BLOCKS * ROWS) + 3.0 * regressor
    assert by_f_test(residual, regressor[None] / np.linalg.norm(regressor))
    assert sign_flip_p_value([scored(regressor, residual)], BLOCKS, rng) >= 0.8 * 2.0 ** (
        1 - active
    )


def test_an_honest_bench_alarms_by_bic_and_not_by_blocks() -> None:
    joint = nominal_fit(honest())
    terms = [e for e in MOTION if e.group == "friction"]
    assert greedy_bic(library(joint, terms)) != ()
    trials = list(
        trial_candidates(joint.stack, Context(joint.equations[0].views, joint.nominal), terms)
    )
    assert (
        sign_flip_p_value(
            [*trials, *generic_candidates(joint.stack)],
            joint.stack.blocks,
            np.random.default_rng(1),
        )
        > 0.05
    )
    assert size_p_value(joint) > 0.05
