"""Priors of parameters against the least squares with one more row each."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.covariance import with_priors
from identification.estimate.default import identify
from identification.numerics.spread import Spread
from identification.recording import Dataset, Model

from .synthetic import TRUTH, sine

NAMES = ("Mc", "sigma_2", "J")


def solved(rows: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares with unit variance: estimate and covariance."""
    information = rows.T @ rows
    return np.linalg.solve(information, rows.T @ wanted), np.linalg.inv(information)


def test_they_are_one_more_row_each() -> None:
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(40, 3)) @ np.array([[1.0, 0.9, 0.0], [0.0, 0.3, 0.1], [0.0, 0.0, 1.0]])
    wanted = rows @ np.array([5.0, 2.0, 3.0]) + rng.normal(size=40)
    x, covariance = solved(rows, wanted)
    known = {"Mc": (5.5, 0.2), "J": (2.5, 0.1)}
    found, spread, used, warnings = with_priors(
        dict(zip(NAMES, map(float, x), strict=True)), Spread(NAMES, covariance, 37.0), known
    )
    more = np.array([[1.0 / 0.2, 0.0, 0.0], [0.0, 0.0, 1.0 / 0.1]])
    both, joint = solved(np.vstack([rows, more]), np.append(wanted, [5.5 / 0.2, 2.5 / 0.1]))
    assert [found[n] for n in NAMES] == pytest.approx(both)
    assert spread.covariance == pytest.approx(joint)
    assert [p.name for p in used] == ["Mc", "J"]
    assert used[0].alone == pytest.approx(x[0])
    assert used[0].posterior_uncertainty == pytest.approx(math.sqrt(joint[0, 0]))
    assert not [w for w in warnings if "has no effect" in w]


def test_what_the_recordings_leave_open_is_the_priors() -> None:
    covariance = np.diag([0.01, math.inf, 0.04])
    values = {"Mc": 5.0, "sigma_2": 0.0, "J": 3.0}
    found, spread, (prior,), warnings = with_priors(
        values, Spread(NAMES, covariance, 30.0), {"sigma_2": (2.0, 0.5)}
    )
    assert found == pytest.approx({**values, "sigma_2": 2.0})
    assert math.sqrt(spread.covariance[1, 1]) == pytest.approx(0.5)
    assert prior.posterior_uncertainty == pytest.approx(0.5)
    assert warnings == ()
    untouched = with_priors(values, Spread(NAMES, covariance, 30.0), {"J": (3.1, 0.2)})[1]
    assert untouched.covariance[1, 1] == math.inf


def test_contradictions_and_priors_of_what_is_absent_are_told() -> None:
    spread = Spread(NAMES, np.diag([0.01, 0.01, 0.01]), 30.0)
    *_, warnings = with_priors(
        {"Mc": 5.0, "sigma_2": 2.0, "J": 3.0}, spread, {"Mc": (7.0, 0.1), "mu_c": (0.1, 0.01)}
    )
    assert any("the prior of mu_c has no effect" in w for w in warnings)
    assert any("14.1 standard deviations apart" in w for w in warnings)
    found, _, _, warnings = with_priors(
        {"Mc": 5.0, "Ms": 5.1}, Spread(("Mc", "Ms"), np.eye(2), 30.0), {"Mc": (6.0, 1e-3)}
    )
    assert found["Ms"] == found["Mc"] == pytest.approx(6.0, abs=1e-3)
    assert any("Ms is set to the limit of its range" in w for w in warnings)


def test_an_identification_follows_its_priors() -> None:
    def noise(n: int) -> np.ndarray:
        return np.asarray(np.random.default_rng(n).normal(0.0, 0.3, n))

    dataset = Dataset((sine(noise=noise),))
    alone = identify(dataset, bandwidth_Hz=100.0)
    wished = replace(dataset, model=Model(priors={"J": (0.3, 1e-4), "Mc": (6.0, 1e3)}))
    found = identify(wished, bandwidth_Hz=100.0)
    j, mc = found.priors
    assert found.parameters["J"].value == pytest.approx(0.3, abs=1e-3)
    assert j.alone == alone.fitted["J"] == pytest.approx(TRUTH["J"], rel=0.3)
    assert mc.posterior_uncertainty <= mc.alone_uncertainty
    assert found.fit.train_rms > alone.fit.train_rms
    assert alone.priors == ()
