"""Traps of signals and models: what is done here holds, and the way that looks as good leads
astray.

Each test builds the situation small, shows that the rule of this project gives the right answer,
and that the trapped variant gives a wrong one on the same data. Those of statistics are in
``test_traps_of_statistics``.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.significance import trial_candidates
from identification.diagnosis.stack import Candidate, Stack
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.views.view import View

from .benches import campaign, honest, nominal_fit, with_torque

TERM = {t.name: t for t in MOTION}
TRUE = {"Mc": 6.825, "sigma_2": 5.3462, "J": 0.204, "omega_sf": 0.0557}
SURE = 12.0
"""Surprise, -log of a chance, beyond which a single effect counts as found."""


@lru_cache
def plain() -> Joint:
    """The nominal model on a campaign that hides nothing."""
    return nominal_fit(honest())


@lru_cache
def timed() -> Joint:
    """The nominal model where a torque in no catalogue is hidden."""
    return nominal_fit(
        campaign({"x_timed_torque": {"torque_Nm": 1.0, "frequency_Hz": 3.7, "phase_rad": 0.0}}, 3)
    )


def best(stack: Stack, name: str, seen: tuple[View, ...]) -> Candidate | None:
    """Screen one effect."""
    trials = trial_candidates(stack, Context(seen, stack.nominal), [TERM[name]])
    return max(trials, key=lambda c: c.score, default=None)


def surprise(joint: Joint, name: str) -> float:
    found = best(joint.stack, name, joint.equations[0].views)
    return 0.0 if found is None else found.surprise


def test_no_regressor_of_the_torque_holds_the_measured_torque() -> None:
    joint = timed()
    torque = joint.equations[0]
    power = float(np.sum(joint.residual[joint.stack.part("torque")] ** 2))
    trapped = joint.stack.candidate("any", (), {"torque": torque.rows(lambda v: v.torque)})
    assert trapped.gain > 0.999 * power, "explains a torque that it knows nothing of"
    context = Context(torque.views, joint.nominal)
    view = torque.views[0]
    for term in (t for t in MOTION if "torque" in t.columns):
        # How loaded bristles begin, one number, is taken from presliding's first 20 ms.
        begun = 0.05 if term.name == "presliding" else -1.0
        later = (np.arange(len(view.torque)) * view.step > begun).astype(float)
        other = replace(view, torque=view.torque + later, raw_torque=view.raw_torque + later)
        for shape in term.shapes(context)[:1]:
            here, there = (term.columns["torque"](v, joint.nominal, shape) for v in (view, other))
            np.testing.assert_array_equal(here, there, err_msg=term.name)
            own = joint.stack.term(term, shape)
            assert own is None or own.gain < 0.05 * power


def test_rows_that_a_reversal_touched_imitate_presliding() -> None:
    assert surprise(plain(), "presliding") < SURE / 4.0
    held = best(plain().stack, "presliding", plain().equations[0].views)
    assert held is None or held.share < 0.01


def test_a_current_averaged_over_the_cycle_is_no_skew() -> None:
    assert surprise(plain(), "time_skew") < SURE / 4.0
    instants = tuple(replace(r, averaged=frozenset()) for r in honest())
    assert surprise(nominal_fit(instants), "time_skew") > SURE


def test_friction_that_bends_down_with_speed_is_a_negative_drag() -> None:
    """The range of the catalogue allows both signs."""
    bent = with_torque(honest(), lambda _angle, speed, _time: -0.5 * speed * np.abs(speed))
    found = nominal_fit(bent).stack.term(TERM["quadratic_drag"], ())
    assert found.coefficients[0] == pytest.approx(-0.5, rel=0.1)
    assert found.surprise > SURE


def test_what_the_nominal_parameters_swallow_is_given_back() -> None:
    drag = 0.5
    joint = nominal_fit(campaign({"quadratic_drag": {"coefficient_Nms2_rad2": drag}}, 6))
    torque, term = joint.equations[0], TERM["quadratic_drag"]
    column = torque.rows(lambda v: v.velocity * np.abs(v.velocity))[:, 0]
    swallowed = float(column @ torque.residual / (column @ column))
    assert abs(swallowed) < 0.1 * drag, "on the residual alone there is hardly any"
    screening = joint.stack.term(term, ())
    assert screening.coefficients[0] == pytest.approx(drag, rel=0.1)
    added = Added(term, (), (float(screening.coefficients[0]),))
    after = fit(torque.views, "N m", joint.nominal, (added,), joint)
    assert after.effects[0].coefficients[0] == pytest.approx(drag, rel=0.03)
    assert abs(joint.nominal.values["sigma_2"] / TRUE["sigma_2"] - 1.0) > 0.1
    for name, tolerance in (("sigma_2", 0.01), ("Mc", 0.005), ("J", 0.01)):
        assert after.nominal.values[name] == pytest.approx(TRUE[name], rel=tolerance)
