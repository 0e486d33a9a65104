"""A second effect is found in the current beside a first one that the encoders see a thousand times
more sharply.
"""

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.comparison import preference
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.observable import collinear_effects
from identification.diagnosis.removal import left_beyond_noise
from identification.diagnosis.significance import trial_candidates
from identification.diagnosis.stack import Candidate
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.recording import Pendulum
from identification.views.view import views

from .benches import campaign, honest, nominal_fit

BY_NAME = {t.name: t for t in MOTION}
NAMES = ("encoder_eccentricity", "encoder_slip", "asymmetric_coulomb", "cogging")


@pytest.fixture(scope="module")
def plain() -> Joint:
    """A gap and an asymmetry, neither of them in the model."""
    hidden = {"backlash": {"gap_rad": 0.003}, "asymmetric_coulomb": {"torque_Nm": 0.1}}
    return nominal_fit(campaign(hidden, 12, 6.0)[:3])


@pytest.fixture(scope="module")
def gap(plain: Joint) -> Joint:
    """The gap alone is in the model, and too narrow by a third."""
    fixed = BY_NAME["backlash"].modified(refine={})
    return fit(
        plain.equations[0].views,
        "N m",
        plain.nominal,
        (Added(fixed, (0.002, 0.0, 0.0, 0.1), (1.0,)),),
        plain,
    )


def ranked(joint: Joint) -> list[Candidate]:
    context = Context(joint.equations[0].views, joint.nominal)
    found: dict[str, Candidate] = {}
    for candidate in trial_candidates(joint.stack, context, [BY_NAME[n] for n in NAMES]):
        if candidate.name not in found or candidate.score > found[candidate.name].score:
            found[candidate.name] = candidate
    return sorted((c for c in found.values() if c.score > 0.0), key=lambda c: -c.score)


def test_what_a_gap_explains_is_not_looked_for_again(gap: Joint) -> None:
    rows = gap.stack.part("transmission")
    left = float(gap.residual[rows] @ gap.residual[rows])
    assert float(gap.stack.residual[rows] @ gap.stack.residual[rows]) <= left
    assert all(c.gain <= 1.01 * gap.cost for c in ranked(gap))


def test_what_a_candidate_promises_is_what_its_fit_is_preferred_by(plain, gap):
    asymmetry = next(c for c in ranked(gap) if c.name == "asymmetric_coulomb")
    added = Added(BY_NAME["asymmetric_coulomb"], (), tuple(asymmetry.coefficients))
    after = fit(gap.equations[0].views, "N m", gap.nominal, (*gap.effects, added), plain)
    assert gap.cost - after.cost == pytest.approx(asymmetry.gain, rel=0.05)
    assert preference(after, gap) == pytest.approx(asymmetry.preference, rel=0.1)


@pytest.mark.parametrize("name", ["cogging", "transport_delay", "gear_mesh_ripple"])
def test_rows_that_an_effect_does_not_touch_need_not_be_looked_at(name: str, gap: Joint) -> None:
    views_here = gap.equations[0].views
    context = Context(views_here, gap.nominal)
    ripple = BY_NAME["gear_mesh_ripple"]
    given = (
        Added(BY_NAME["asymmetric_coulomb"], (), (0.0,)),
        Added(BY_NAME["encoder_eccentricity"], (), (0.0, 0.0)),
    )
    mesh = Added(ripple, (33.0, 1.0), (0.0, 0.0))
    for effects in (given, (*given, mesh)):
        stack = fit(views_here, "N m", gap.nominal, effects, gap).stack
        term = BY_NAME[name]
        shapes = list(term.shapes(context))
        shape = shapes[len(shapes) // 2]
        columns = stack.columns(term, shape)
        short, full = stack.candidate(name, shape, columns), stack._scored(name, shape, columns, ())
        assert (short.gain, short.penalty) == pytest.approx((full.gain, full.penalty), rel=1e-9)
        assert short.statistic == pytest.approx(full.statistic, rel=1e-6)
        ties = mesh in effects or name == "gear_mesh_ripple"
        assert len(stack.only(columns.keys()).residual) < len(stack.residual)
        assert (
            {e.name for e in stack.only(columns.keys()).equations} >= {"torque", "transmission"}
        ) is ties


def test_a_loss_under_friction_alone_is_one_with_the_constants_and_under_a_weight_is_not() -> None:
    joint = nominal_fit(honest())
    assert collinear_effects(joint, MOTION) == ("transmission_efficiency",)
    hung = [
        replace(r, pendulum=Pendulum(mass=20.0, length=0.3, zero=0.5))
        for r in honest()
        if r.role == "fit"
    ]
    here = views(hung, 25.0)
    assert collinear_effects(fit(here, "N m", joint.nominal), MOTION) == ()


def test_a_gear_whose_ratio_swings_shows_in_the_torque_as_well() -> None:
    mesh = {"gear_mesh_ripple": {"amplitude_rad": 1.6e-3, "per_turn": 33.0, "phase_rad": 1.0}}
    plain = nominal_fit(campaign(mesh, 13, 6.0)[:3])
    here = views([e.recording for e in plain.equations[0].views], 25.0, True)
    before = fit(here, "N m", plain.nominal)
    added = Added(BY_NAME["gear_mesh_ripple"], (33.0, 1.0), (1e-3, 1e-3))
    after = fit(here, "N m", plain.nominal, (added,), before)
    power = [np.mean(j.residual[j.stack.part("torque")] ** 2) for j in (before, after)]
    assert power[1] < 0.1 * power[0]


def test_a_spring_that_was_named_is_part_of_what_saturates_the_motor() -> None:
    hidden = {
        "return_spring": {"stiffness_Nm_rad": 20.0, "rest_rad": 0.2},
        "torque_saturation": {"knee_A": 25.0},
    }
    plain = nominal_fit(campaign(hidden, 14, 6.0)[:3])
    added = (
        Added(BY_NAME["return_spring"], (), (20.0, 4.0)),
        Added(BY_NAME["torque_saturation"], (25.0, 0.0), (1.0,)),
    )
    after = fit(plain.equations[0].views, "N m", plain.nominal, added, plain)
    assert after.effects[0].coefficients[0] == pytest.approx(20.0, rel=0.01), (
        "without it some per cent"
    )
    assert np.mean(after.residual[after.stack.part("torque")] ** 2) < 2.0


def test_what_the_rotor_and_the_damping_take_does_not_twist_a_shaft() -> None:
    plain = nominal_fit(campaign({"compliance": {"stiffness_Nm_rad": 3000.0}}, 15, 6.0)[:3])
    here = views([e.recording for e in plain.equations[0].views], 25.0, True)
    before = fit(here, "N m", plain.nominal)
    after = fit(
        here, "N m", plain.nominal, (Added(BY_NAME["compliance"], (), (1.0, 0.0, 0.0)),), before
    )
    assert 1.0 / after.effects[0].coefficients[0] == pytest.approx(3000.0, rel=0.01)
    assert np.mean(after.residual[after.stack.part("transmission")] ** 2) < 2.0


def test_a_slip_in_one_short_recording_is_a_candidate() -> None:
    """The recording has fewer blocks than an effect of all recordings must be active in."""
    slip = {"encoder_slip": {"angle_rad": 2e-3, "at_s": 2.0, "recording": 2.0}}
    joint = nominal_fit(campaign(slip, 12, 6.0)[:3])
    context = Context(joint.equations[0].views, joint.nominal)
    found = list(trial_candidates(joint.stack, context, [BY_NAME["encoder_slip"]]))
    best = max(found, key=lambda c: c.score)
    assert best.shape[0] == 1.0
    assert abs(best.coefficients[0]) == pytest.approx(2e-3, rel=0.1)
    assert best.gain > 0.5 * left_beyond_noise(joint, BY_NAME["encoder_slip"])
