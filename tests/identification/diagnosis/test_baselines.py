"""The baselines are good at what they claim, and the oracle gains what the true structure can."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from identification.diagnosis.joint import Joint
from identification.diagnosis.oracle import (
    FOLDS,
    Group,
    Library,
    greedy_bic,
    library,
    oracle,
    sparse,
)
from identification.effects import MOTION
from identification.recording import Array, Dataset, Recording

from .benches import campaign, nominal_fit

Method = Callable[[Library], tuple[str, ...]]
ROWS = 4000
VISCOUS = {"coefficient_Nms_rad": 0.4}


@pytest.fixture(scope="module")
def lopsided() -> tuple[Recording, ...]:
    return campaign({"asymmetric_viscous": VISCOUS}, 2, 6.0)


@pytest.fixture(scope="module")
def first(lopsided: tuple[Recording, ...]) -> Joint:
    return nominal_fit(lopsided)


def made(coefficients: dict[str, float], seed: int = 4, positive: tuple[int, ...] = ()) -> Library:
    """Return a library of ten white regressors, on white noise and these of them."""
    rng = np.random.default_rng(seed)
    names = [f"effect {k}" for k in range(10)]
    columns = rng.standard_normal((ROWS, len(names))) / np.sqrt(ROWS)
    residual = rng.standard_normal(ROWS) + columns @ [coefficients.get(n, 0.0) for n in names]
    groups = tuple(Group(n, (), slice(k, k + 1), positive) for k, n in enumerate(names))
    parts: list[tuple[Array, Array]] = list(
        zip(np.split(columns, FOLDS), np.split(residual, FOLDS), strict=True)
    )
    return Library(
        groups,
        np.stack([x.T @ x for x, _ in parts]),
        np.stack([x.T @ y for x, y in parts]),
        np.array([y @ y for _, y in parts]),
        ROWS,
    )


@pytest.mark.parametrize("method", [greedy_bic, sparse])
def test_on_white_noise_they_name_what_is_there_and_nothing_else(method: Method) -> None:
    assert method(made({})) == ()
    assert method(made({"effect 3": 12.0, "effect 7": -30.0})) == ("effect 7", "effect 3")


def test_on_a_rig_they_see_what_the_search_sees(first: Joint) -> None:
    given = library(first, [e for e in MOTION if e.group in ("friction", "device")])
    assert np.allclose(np.einsum("fpp->p", given.gram), 1.0)
    assert greedy_bic(given)[0] == "asymmetric_viscous"
    assert sparse(given)[0] == "asymmetric_viscous"


def test_the_oracle_gains_what_is_there(lopsided: tuple[Recording, ...], first: Joint) -> None:
    found = oracle(Dataset(lopsided), first, ["asymmetric_viscous"], 25.0)
    assert found.equation == "torque"
    assert found.oracle_rms < 1.3 * found.noise_rms < 0.3 * found.baseline_rms
    assert found.remaining_strength["asymmetric_viscous"] > 3.0
    both = oracle(Dataset(lopsided), first, ["asymmetric_viscous", "torque_ripple"], 25.0)
    assert both.remaining_strength["torque_ripple"] < 0.3  # which is not there
    assert both.remaining_strength["asymmetric_viscous"] == pytest.approx(
        found.remaining_strength["asymmetric_viscous"], rel=0.05
    )
    wrong = oracle(Dataset(lopsided), first, ["cogging"], 25.0)
    assert wrong is None or wrong.baseline_rms - wrong.oracle_rms < 0.1 * (
        found.baseline_rms - found.oracle_rms
    )


def test_without_recordings_set_aside_there_is_no_oracle(
    lopsided: tuple[Recording, ...], first: Joint
) -> None:
    fitted = tuple(r for r in lopsided if r.role == "fit")
    assert oracle(Dataset(fitted), first, ["asymmetric_viscous"], 25.0) is None
