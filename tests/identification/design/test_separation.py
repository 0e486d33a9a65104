"""How far an experiment separates two fits: against a direct least-squares solution, and in the
cases that a bound must get right.
"""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from identification.design import separation
from identification.design.separation import (
    NOTHING,
    OUTSIDE,
    REJECTED,
    UNSEEN,
    Evidence,
    Hypothesis,
    Weighed,
    error_bound,
    information,
    least_squares_left,
    level,
    separations,
    visibility,
)
from identification.diagnosis.comparison import Round, preference
from identification.diagnosis.result import Verdict
from identification.diagnosis.search import Search
from identification.effects import MOTION
from identification.numerics.arrays import Array
from tests.identification.diagnosis.benches import FEW, campaign, nominal_fit


def said(left: Array, slopes: Array, shown: Array | None = None) -> Evidence:
    """What rows with this residual, derivatives and regressors of effects say."""
    columns = np.zeros((len(left), 0)) if shown is None else shown
    products = np.concatenate([np.sum(columns**2, axis=0)[:, None], columns.T @ slopes], axis=1)
    return Evidence(float(left @ left), slopes.T @ left, slopes.T @ slopes, products)


def test_a_further_fit_leaves_what_least_squares_leaves() -> None:
    rng = np.random.default_rng(1)
    old, new = rng.standard_normal((40, 3)), rng.standard_normal((25, 3))
    error = rng.standard_normal(25)
    before = said(np.zeros(40), old)
    left = least_squares_left(before, said(error, new))
    every, target = np.concatenate([old, new]), np.concatenate([np.zeros(40), error])
    step = np.linalg.lstsq(every, target, rcond=None)[0]
    assert left == pytest.approx(float(np.sum((target - every @ step) ** 2)), rel=1e-9)


def test_the_sum_of_parts_is_the_experiment() -> None:
    rng = np.random.default_rng(2)
    slopes, error = rng.standard_normal((30, 2)), rng.standard_normal(30)
    whole = said(error, slopes)
    parts = said(error[:11], slopes[:11]) + said(error[11:], slopes[11:])
    assert parts.square == pytest.approx(whole.square)
    np.testing.assert_allclose(parts.normal, whole.normal)
    np.testing.assert_allclose(parts.score, whole.score)


def test_a_difference_that_a_constant_explains_separates_nothing() -> None:
    """The model can take the difference up, unless the recordings so far hold its constant."""
    line = np.linspace(-1.0, 1.0, 50)[:, None]
    difference = 3.0 * line[:, 0]
    truth, wrong = said(np.zeros(50), line), said(difference, line)
    free, held = said(np.zeros(1), np.array([[1e-6]])), said(np.zeros(1), np.array([[1e3]]))
    added = {(0, 0): truth, (0, 1): wrong, (1, 0): wrong, (1, 1): truth}
    assert separations([free, free], added)[0, 1] == pytest.approx(0.0, abs=1e-4)
    expected = 0.5 * float(np.linalg.norm(difference))
    assert separations([held, held], added)[0, 1] == pytest.approx(expected, rel=1e-3)


def test_of_two_truths_the_one_that_is_hidden_better_counts() -> None:
    slopes = np.zeros((4, 1))
    near, far = np.full(4, 1.0), np.full(4, 5.0)
    none = np.zeros(4)
    added = {
        (0, 0): said(none, slopes),
        (0, 1): said(far, slopes),
        (1, 0): said(near, slopes),
        (1, 1): said(none, slopes),
    }
    before = [said(none, slopes + 1.0)] * 2
    assert separations(before, added)[0, 1] == pytest.approx(1.0)


def test_the_error_bound_falls_with_the_separation_of_likely_pairs_only() -> None:
    even = error_bound([0.5, 0.5], {(0, 1): 0.0})
    assert even == pytest.approx(0.5)
    assert error_bound([0.5, 0.5], {(0, 1): 2.0}) == pytest.approx(0.5 * math.exp(-2.0))
    apart = {(0, 1): 0.0, (0, 2): 0.0, (1, 2): 0.0}
    odds = [0.49, 0.49, 0.02]
    likely = error_bound(odds, {**apart, (0, 1): 3.0})
    unlikely = error_bound(odds, {**apart, (1, 2): 3.0})
    assert likely < unlikely < error_bound(odds, apart)


def test_an_effect_is_visible_where_the_constants_are_not() -> None:
    rows = np.eye(4)
    before = said(np.zeros(4), rows[:, :1], np.stack([rows[0], rows[1] + rows[0]], axis=1))
    np.testing.assert_allclose(visibility(before), [0.0, 1.0], atol=1e-9)
    after = before + said(np.zeros(4), np.zeros((4, 1)), np.stack([rows[2], 0 * rows[2]], axis=1))
    assert visibility(after)[0] > 0.4


def test_information_is_what_determinants_say() -> None:
    before, added = said(np.zeros(2), np.eye(2)), said(np.zeros(2), 3.0 * np.eye(2))
    assert information(before, added) == pytest.approx(0.5 * math.log(100.0), rel=1e-6)


def test_odds_sum_to_one_and_name_what_has_no_model() -> None:
    joint = cast(Any, SimpleNamespace())
    weighed = Weighed(
        (
            Hypothesis(("backlash",), joint, 0.0, 1.0),
            Hypothesis(("compliance", "cogging"), joint, 1.0, 0.2),
            Hypothesis((), joint, math.inf, 1e-6),
        ),
        0.05,
    )
    odds = weighed.odds
    assert list(odds) == ["backlash", "compliance + cogging", OUTSIDE, NOTHING, UNSEEN]
    assert sum(odds.values()) == pytest.approx(1.0)
    sure = replace(weighed.hypotheses[0], weight=1e6)
    assert Weighed((sure,), 0.0).odds["backlash"] == 1.0


def fitted(residual: Array, block: int = 1) -> Any:
    """A fit that leaves these whitened rows, in blocks of equal length."""
    return SimpleNamespace(
        residual=residual,
        cost=float(residual @ residual),
        effects=(),
        equations=[SimpleNamespace(white=False)],
        stack=SimpleNamespace(sums=lambda rows: rows.reshape(-1, block, rows.shape[1]).sum(axis=1)),
    )


def test_the_level_is_antisymmetric_and_never_more_than_the_squares_allow() -> None:
    noise = np.random.default_rng(5).standard_normal(400)
    best, near, far = fitted(noise), fitted(noise * (1.0 + 1e-4)), fitted(noise + 1.0)
    assert level(best, best) == 0.0
    assert level(best, far) == pytest.approx(-level(far, best))
    assert level(best, far) > REJECTED
    assert 0.0 < level(best, near) <= 0.5 * math.sqrt(near.cost - best.cost) < 0.5


def test_a_difference_that_few_blocks_show_counts_in_full() -> None:
    """Over many draws, the level is what is expected; by blocks, no draw reaches a rejection."""
    apart = np.zeros(4000)
    apart[:40] = 3.0
    expected, levels = 0.5 * math.sqrt(40 * 9.0), []
    for seed in range(200):
        noise = np.random.default_rng(seed).standard_normal(4000)
        best, rival = fitted(noise, 10), fitted(noise - apart, 10)
        levels.append(level(best, rival))
        assert preference(best, rival) < REJECTED
    # The noise of four blocks is estimated high as often as low, and counted at least as stated.
    assert 0.85 * expected < np.mean(levels) <= expected
    misfit = fitted(1.2 * noise, 10), fitted(1.2 * noise - apart, 10)
    assert level(*misfit) == preference(*misfit), "more than noise is left"


@pytest.mark.parametrize("correlated", [False, True])
def test_the_truth_is_rejected_as_rarely_as_stated(correlated: bool) -> None:
    rng, rejected = np.random.default_rng(7), 0
    for _ in range(1000):
        noise = rng.standard_normal((100, 10))
        if correlated:
            noise = np.sqrt(0.5) * (noise + rng.standard_normal((100, 1)))
        truth = noise.ravel()
        rival = truth + 0.1 * np.sin(np.arange(1000) / 3.0)
        rejected += level(fitted(rival, 10), fitted(truth, 10)) >= REJECTED
    assert rejected <= 20, "1 % of 1000 are expected at most"


@pytest.mark.parametrize("order", [1, -1])
def test_a_question_compares_only_its_effects_in_any_order(order: int) -> None:
    every = campaign({"asymmetric_coulomb": {"torque_Nm": 0.6}}, 2, 6.0, FEW)
    joint, known = nominal_fit(every), {t.name: t for t in MOTION}
    final = separation.fitted_with(joint, joint, known["asymmetric_coulomb"])
    assert final is not None
    rounds = (Round("asymmetric_coulomb", ()),)
    found = Search(joint, final, rounds, 1e-9, 1.0, "", ())
    wanted = ("asymmetric_viscous", "quadratic_drag")[::order]
    weighed = separation.weigh(found, Verdict.NAMED, MOTION, wanted)
    names = [h.name for h in weighed.hypotheses]
    assert sorted(names) == sorted([*wanted, separation.NOTHING])
    assert names[0] == "asymmetric_viscous"
    assert weighed.hypotheses[0].preference == 0.0
    assert "asymmetric_coulomb" not in weighed.odds
