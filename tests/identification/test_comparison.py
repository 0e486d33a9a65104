"""All estimators on one problem: the same optimum where there is one, and the default method
ahead.
"""

from __future__ import annotations

import numpy as np
import pytest

from identification.estimate.default import identify
from identification.estimate.paper_method import (
    DEFAULT,
    OPTIMISERS,
    StageProblem,
    compare,
    variable_projection,
)
from identification.prepare import prepare
from identification.recording import Dataset, Model, Recording, RecordingError
from identification.result import Identification

from .synthetic import SYSTEM, TRUTH, sine


@pytest.fixture(scope="module")
def exact() -> StageProblem:
    return StageProblem("unloaded", [prepare(sine(rate=200.0), 100.0)], {}, 2.0)


def test_cost_is_the_norm_of_the_residuals(exact: StageProblem) -> None:
    points = np.random.default_rng(0).uniform(size=(4, exact.size))
    norms = [np.linalg.norm(exact.residuals(x)) for x in points]
    assert exact.costs(points) == pytest.approx(norms, rel=1e-9)


def test_every_evaluation_is_counted(exact: StageProblem) -> None:
    before = exact.evaluations
    exact.costs(np.full((7, exact.size), 0.5))
    exact.residuals(np.full(exact.size, 0.5))
    exact.design(0.05)
    assert exact.evaluations - before == 9


def test_variable_projection_finds_the_truth_in_this_box(exact: StageProblem) -> None:
    found = exact.named(variable_projection(exact, np.random.default_rng(0)))
    assert found == pytest.approx({n: TRUTH[n] for n in SYSTEM}, rel=1e-4)


@pytest.mark.parametrize("name", ["CMA-ES", "multi-start least squares", "differential evolution"])
def test_other_searches_come_near_it(exact: StageProblem, name: str) -> None:
    x = OPTIMISERS[name](exact, np.random.default_rng(1))
    assert np.all((x >= 0.0) & (x <= 1.0))
    scale = float(np.linalg.norm(exact.samples.torque))
    assert float(exact.costs(x[None, :])[0]) < 0.02 * scale


@pytest.mark.parametrize("name", list(OPTIMISERS))
def test_a_seed_repeats(exact: StageProblem, name: str) -> None:
    one, two = (OPTIMISERS[name](exact, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(one, two)


@pytest.mark.proof
def test_the_default_method_wins_on_the_practical_bench(
    practical_pair: tuple[Recording, Recording], practical_result: Identification
) -> None:
    table = {c.name: c for c in compare(Dataset(practical_pair), practical_result, truth=TRUTH)}
    default = table.pop(DEFAULT)
    assert default.true_error is not None
    for rival in table.values():
        assert rival.true_error is not None
        assert default.true_error < 0.5 * rival.true_error, rival.name
    projection = table.pop("variable projection")
    assert projection.failures == 0
    for rival in table.values():
        assert projection.evaluations < 0.1 * rival.evaluations
        assert rival.excess is not None
        assert projection.excess is not None
        assert projection.excess <= rival.excess + 1e-12


def test_declared_terms_are_refused() -> None:
    dataset = Dataset((sine(offset=0.3),), Model(terms=("offset",)))
    with pytest.raises(RecordingError, match=r"needs the nominal model; .*\(offset\)"):
        compare(dataset, identify(dataset))
