"""The test by sign flips holds its level on noise that is correlated within blocks; how effects are added and kept."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.begin import started
from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.joint import Added, fit
from identification.diagnosis.kept import needed_share
from identification.diagnosis.result import Verdict
from identification.diagnosis.search import chance
from identification.diagnosis.stack import Candidate, wald
from identification.diagnosis.terms import TERMS
from identification.recording import Dataset, Model

from .benches import campaign, nominal_fit

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


def test_a_gap_is_followed_from_wherever_a_recording_begins_in_it() -> None:
    """A recording that begins on a flank, and takes seconds to leave it, is explained as well as any other."""
    gap = 0.004
    recordings = campaign({"backlash": {"gap_rad": gap}}, 8, 6.0)
    joint = nominal_fit(recordings[:3])
    rows = joint.stack.part("transmission")
    term = next(t for t in TERMS if t.name == "backlash")
    after = fit(joint.equations[0].views, "N m", joint.nominal, (Added(term, (0.003,), (1.0,)),), joint)
    assert after.effects[0].shape[0] == pytest.approx(gap, rel=0.03)
    assert np.mean(joint.residual[rows] ** 2) > 1e4
    assert np.mean(after.residual[rows] ** 2) < 10.0


def test_friction_that_falls_is_found_from_an_estimate_without_a_fall() -> None:
    recordings = campaign({"presliding": {"stiffness_Nm_rad": 2e4}}, 9, 8.0)
    flat = nominal_fit(recordings)
    values = {**flat.nominal.values, "Ms": flat.nominal.values["Mc"], "mu_s": flat.nominal.values["mu_c"]}
    absent = {"Ms", "mu_s", "omega_sf", "omega_sL"}
    stuck = replace(flat.nominal, values=values, free=tuple(n for n in values if n not in absent))
    here = flat.equations[0].views
    begun = started(here, "N m", stuck, Model())
    assert begun.cost < 0.9 * fit(here, "N m", stuck).cost
    assert begun.nominal.values["Ms"] > 1.1 * begun.nominal.values["Mc"]
    assert stuck.flat
    assert not begun.nominal.flat
    raised = stuck.raised(0.05, {"Ms"})
    assert raised.values["Ms"] == values["Ms"], "what is fixed stays"
    assert "Ms" not in raised.free
    assert raised.values["mu_s"] > raised.values["mu_c"]


def test_two_effects_are_named_and_a_look_alike_of_the_first_is_taken_out_again() -> None:
    """The gap is worth a thousand times the drag, and is seen by other encoders."""
    both = {"backlash": {"gap_rad": 0.002}, "asymmetric_coulomb": {"torque_Nm": 0.6}}
    found = diagnose(Dataset(campaign(both, 10), Model()))
    assert found.verdict is Verdict.NAMED
    assert {e.name for e in found.effects} == set(both)


@pytest.mark.parametrize(("others", "needed"), [(0.1, 0.4), (0.005, 0.8), (0.0005, math.inf)])
def test_what_one_more_name_must_explain(others: float, needed: float) -> None:
    assert needed_share(others) == needed
