"""A name must pay on recordings that took no part in its fit."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from identification.diagnosis import held_out
from identification.diagnosis.comparison import Contender, Round
from identification.diagnosis.held_out import (
    DROPPED,
    _Case,
    _with_rivals_judged,
    dropped_effects,
    validated_effects,
    validation_rms,
)
from identification.diagnosis.joint import Added, Joint, estimates, fit, undetermined_size
from identification.diagnosis.result import Step
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import Search
from identification.effects import MOTION
from identification.recording import Recording
from identification.views.view import View, views

from .benches import campaign, honest, nominal_fit

TERM = {t.name: t for t in MOTION}
SIDE = {"asymmetric_coulomb": {"torque_Nm": 0.5}}


@lru_cache
def hidden() -> tuple[Recording, ...]:
    return campaign(SIDE, 5, 6.0)


@lru_cache
def nominal() -> Joint:
    return nominal_fit(hidden())


def here() -> tuple[View, ...]:
    return nominal().equations[0].views


def aside() -> tuple[View, ...]:
    fitted = [r for r in hidden() if r.role == "fit"]
    held = [r for r in hidden() if r.role == "validate"]
    return views((*fitted, *held), 25.0, False, hidden())[len(fitted) :]


def search(*effects: Added) -> Search:
    final = fit(here(), "N m", nominal().nominal, effects, nominal())
    rounds = tuple(Round(e.term.name, ()) for e in effects)
    return Search(nominal(), final, rounds, 1e-3, 1.0, "", ())


RIGHT = Added(TERM["asymmetric_coulomb"], (), (0.0,))
WRONG = Added(TERM["position_dependent_friction"], (0.2, 0.02), (0.0,))


def test_an_effect_beside_another_is_dropped_if_its_interval_contains_zero(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Any effect passes the test on unused recordings.
    monkeypatch.setattr(held_out, "_error_reduction", lambda *_: 9.0)
    absent = Added(TERM["asymmetric_viscous"], (), (0.0,))
    found = validated_effects(search(RIGHT, absent), ())
    assert [e.term.name for e in found.final.effects] == ["asymmetric_coulomb"]
    (step,) = (s for s in found.steps if s.action == DROPPED)
    assert step.name == "asymmetric_viscous"
    (warning,) = dropped_effects(found)
    assert "contains zero" in warning
    alone = validated_effects(search(absent), ())
    assert [e.term.name for e in alone.final.effects] == ["asymmetric_viscous"]


def test_a_weight_that_was_not_hung_is_no_size_of_zero() -> None:
    """Its true mass is zero, and its interval holds zero, however surely the label is wrong."""
    missing = replace(hidden()[0], name="missing", weight_mass=10.0, stage="loaded", role="fit")
    joint = nominal_fit((*hidden()[:2], missing, *hidden()[3:5]))
    weight = Added(TERM["wrong_weight"], (2.0,), (0.0,))
    found = fit(joint.equations[0].views, "N m", joint.nominal, (RIGHT, weight), joint)
    mass = estimates(found)[1]["mass_kg"]
    assert mass.low < 0.0 < mass.high < 0.1
    assert undetermined_size(found, 1) is None


@pytest.mark.parametrize("set_aside", [True, False])
def test_what_is_there_pays_and_what_is_not_does_not(set_aside: bool) -> None:
    unseen = aside() if set_aside else ()
    found = validated_effects(search(RIGHT, WRONG), unseen)
    assert [e.term.name for e in found.final.effects] == ["asymmetric_coulomb"]
    assert [r.name for r in found.rounds] == ["asymmetric_coulomb"]
    if set_aside:
        assert found.unseen_share > 0.95
    else:
        assert found.unseen_share is None
    assert [s.name for s in found.steps if s.action == DROPPED] == ["position_dependent_friction"]
    assert found.final.effects[0].coefficients[0] == pytest.approx(0.5, rel=0.1)
    (words,) = dropped_effects(found)
    assert "standard errors" in words
    assert ("set aside" if set_aside else "predicted from the other parts") in words


def test_what_is_held_out_is_scored_by_the_reported_constants() -> None:
    found = validated_effects(search(RIGHT), aside())
    before, after = (validation_rms(j, aside())["torque"] for j in (found.baseline, found.final))
    assert after < 0.5 * before
    sigma = next(e.sigma for e in found.final.equations if e.name == "torque")
    assert after == pytest.approx(sigma, rel=0.25)


def test_what_one_recording_alone_shows_need_not_pay_on_another() -> None:
    weight = Added(TERM["wrong_weight"], (3.0,), (0.0,))
    assert weight.term.place is not None
    found = validated_effects(search(RIGHT, weight), aside())
    assert {e.term.name for e in found.final.effects} == {"asymmetric_coulomb", "wrong_weight"}


def test_recordings_set_aside_reject_a_rival_that_fits_as_well() -> None:
    rival = Contender(WRONG.term.name, search(WRONG).final, 0.0, "")
    found = search(RIGHT)
    found = replace(found, rounds=(Round(RIGHT.term.name, (rival,)),))
    (judged,) = validated_effects(found, aside()).rounds
    assert judged.rivals[0].preference >= RULES.rejected


@pytest.mark.parametrize("preference", [0.0, 5.0])
def test_recordings_set_aside_choose_between_effects_that_fit_alike(preference: float) -> None:
    """A rival that the fit rejected does not take the place; the effect is then ambiguous."""
    rival = Contender(RIGHT.term.name, search(RIGHT).final, preference, "")
    steps: list[Step] = []
    joint, taken = _with_rivals_judged(
        _Case(aside(), nominal()),
        search(WRONG).final,
        Round(WRONG.term.name, (rival,)),
        steps,
    )
    swapped = preference < RULES.rejected
    assert taken.name == joint.effects[-1].term.name == (RIGHT if swapped else WRONG).term.name
    assert [s.action for s in steps] == ["swap"] * swapped
    if swapped:
        assert taken.rivals[0].preference >= RULES.rejected
    else:
        assert taken.rivals[0].preference <= 0.0


def test_friction_of_one_recording_is_no_drift() -> None:
    """An unknown start is a free constant there, which the fit without the drift has as well."""
    recordings = [
        r
        if r.role == "fit"
        else replace(
            r,
            channels={
                **r.channels,
                "current": r.channels["current"]
                + 0.3 * np.sign(np.gradient(r.channels["command"])) / r.bench.ampere_torque,
            },
        )
        for r in honest()
    ]
    fitted = [r for r in recordings if r.role == "fit"]
    joint = nominal_fit(honest())
    unseen = views(recordings, 25.0, False, recordings)[len(fitted) :]
    drift = fit(
        joint.equations[0].views,
        "N m",
        joint.nominal,
        (Added(TERM["coulomb_drift"], (1e6,), (0.0,)),),
        joint,
    )
    found = Search(joint, drift, (Round("coulomb_drift", ()),), 1e-3, 1.0, "", ())
    kept = validated_effects(found, unseen).final.effects
    assert not kept
