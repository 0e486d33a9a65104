"""A gap and a coupling's loop move alike; the torque of the crossing tells them apart."""

from __future__ import annotations

from functools import lru_cache

import pytest

from identification.diagnosis.comparison import Round
from identification.diagnosis.crossing import crossing_torque, gap_or_loop
from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.result import Verdict
from identification.diagnosis.rules import RULES
from identification.effects import MOTION
from identification.recording import Dataset, Model, Recording
from identification.views.nominal import Nominal
from identification.views.view import View, views

from .benches import campaign, nominal_fit

HALF_RAD, CLOSES_N_M = 0.003, 3.0
ROTOR_KG_M2 = 0.1
TERM = {t.name: t for t in MOTION}


@lru_cache
def recordings(name: str) -> tuple[Recording, ...]:
    effects = {
        "backlash": {"gap_rad": 2.0 * HALF_RAD},
        "coupling_hysteresis": {"deflection_rad": HALF_RAD, "torque_Nm": CLOSES_N_M},
    }
    return campaign({name: effects[name]}, 11, 8.0)


@lru_cache
def nominal(name: str) -> Nominal:
    return nominal_fit(recordings(name)).nominal


def valve_side(name: str) -> tuple[View, ...]:
    return views([r for r in recordings(name) if r.role == "fit"], 25.0, True)


def test_a_gap_is_crossed_without_torque() -> None:
    seen = crossing_torque(valve_side("backlash"), nominal("backlash"), 2.0 * HALF_RAD, ROTOR_KG_M2)
    assert seen.share < 0.5 * RULES.loop_share


def test_a_loop_closes_with_its_torque() -> None:
    seen = crossing_torque(
        valve_side("coupling_hysteresis"),
        nominal("coupling_hysteresis"),
        2.0 * HALF_RAD,
        ROTOR_KG_M2,
    )
    assert seen.torque == pytest.approx(CLOSES_N_M, rel=0.03)


@pytest.mark.parametrize(
    "name", [pytest.param("backlash", marks=pytest.mark.proof), "coupling_hysteresis"]
)
def test_each_is_named_and_the_other_rejected(name: str) -> None:
    found = diagnose(Dataset(recordings(name), Model()))
    assert found.verdict is Verdict.NAMED
    assert [e.name for e in found.effects] == [name]
    assert [
        r.why_not != ""
        for r in found.effects[0].rivals
        if r.name in ("backlash", "coupling_hysteresis")
    ] == [True]


@pytest.mark.parametrize(("name", "told"), [("backlash", True), ("coupling_hysteresis", False)])
def test_what_is_crossed_too_fast_to_see_is_a_gap_where_its_loop_closes_without_torque(
    name: str, told: bool
) -> None:
    """A loop that the angles give some torque stays open to both."""
    gap = 1e-4
    here = valve_side(name)
    assert crossing_torque(here, nominal(name), gap, ROTOR_KG_M2) is None
    start = nominal_fit(recordings(name))
    baseline = fit(here, "N m", start.nominal)
    own = Added(TERM["backlash"], (gap, 0.0, 0.0, ROTOR_KG_M2), (1.0,))
    named = Joint(baseline.nominal, (own,), baseline.equations, baseline.residual, baseline.stack)
    _, rounds = gap_or_loop(baseline, named, [Round("backlash", ())], MOTION, [])
    (rival,) = rounds[0].rivals
    assert rival.name == "coupling_hysteresis"
    assert (rival.preference > RULES.rejected) == told
    assert told or rival.preference == 0.0
