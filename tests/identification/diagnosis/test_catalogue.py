"""Every effect is one entry in words and one term to compute, and both speak of the same
parameters.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from identification.diagnosis.catalogue import ENTRIES
from identification.diagnosis.fit.stack import Stack, stack_of
from identification.diagnosis.gas.terms import GAS_TERMS
from identification.diagnosis.rows.equations import EQUATIONS, equations
from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.view import views
from identification.diagnosis.terms import TERMS
from identification.diagnosis.terms.term import Context, Term

from .benches import honest

TRUE = {
    "Mc": 6.825,
    "Ms": 12.025,
    "omega_sf": 0.0557,
    "sigma_2": 5.3462,
    "J": 0.204,
    "mu_c": 0.052,
    "mu_s": 0.086,
    "omega_sL": 0.0326,
    "mu_2": 0.032,
}


@lru_cache
def bench() -> tuple[Context, Stack]:
    here = views([r for r in honest() if r.role == "fit"], 25.0)
    nominal = Nominal(TRUE, tuple(TRUE), 2.0)
    return Context(here, nominal), stack_of(equations(here, nominal, "N m"), nominal)


def test_entries_and_terms_are_of_the_same_effects() -> None:
    of_motion = [e.name for e in ENTRIES.values() if e.shows_in != "pressure"]
    assert sorted(t.name for t in TERMS) == sorted(of_motion)
    of_gas = [e for e in ENTRIES.values() if e.shows_in == "pressure"]
    assert [t.name for t in GAS_TERMS] == [e.name for e in of_gas]
    assert [list(t.sizes) for t in GAS_TERMS] == [[q.name for q in e.parameters] for e in of_gas]


@pytest.mark.parametrize("term", TERMS, ids=lambda t: t.name)
def test_a_term_speaks_of_its_entrys_parameters(term: Term) -> None:
    context, stack = bench()
    shapes = term.shapes(context)
    if term.name == "load_dependent_friction":
        assert not shapes
        return
    columns = stack.columns(term, shapes[0])
    assert columns
    assert set(term.columns) <= set(EQUATIONS)
    width = {c.shape[1] for c in columns.values()}
    assert len(width) == 1
    found = term.read(np.full(width.pop(), 0.5), shapes[0], context)
    assert set(found) == {q.name for q in ENTRIES[term.name].parameters}
    assert all(np.isfinite(v) for v in found.values())


@pytest.mark.parametrize("term", TERMS, ids=lambda t: t.name)
def test_a_term_shows_where_its_entry_says(term: Term) -> None:
    assert ENTRIES[term.name].shows_in in term.columns


def test_the_true_values_leave_only_noise() -> None:
    _, stack = bench()
    torque = stack.residual[stack.part("torque")]
    assert 0.7 < np.sqrt(np.mean(torque**2)) < 1.2
    assert np.max(np.abs(torque)) < 6.0
