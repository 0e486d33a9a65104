"""A second effect is found in the current beside a first one that the encoders see a thousand times
more sharply.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.comparison import preference
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.observable import collinear_effects
from identification.diagnosis.removal import (
    left_beyond_noise,
    share_equation,
    would_be_removed,
)
from identification.diagnosis.search import (
    TRIALS,
    best_of_each,
    finalist_groups,
    unscored,
)
from identification.diagnosis.significance import (
    sign_flip_p_value,
    size_p_value,
    trial_candidates,
)
from identification.diagnosis.stack import Candidate
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.recording import Pendulum
from identification.views.view import views

from .benches import campaign, honest, nominal_fit

BY_NAME = {t.name: t for t in MOTION}
COGGING = {"torque_Nm": 1.0, "per_motor_turn": 7.0, "phase_rad": 0.0}
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
    """Its size is no direction of the fit, so that projecting alone would leave it in the
    residual.
    """
    rows = gap.stack.part("transmission")
    left = float(gap.residual[rows] @ gap.residual[rows])
    assert float(gap.stack.residual[rows] @ gap.stack.residual[rows]) <= left
    assert all(c.gain <= 1.01 * gap.cost for c in ranked(gap))


def test_the_effect_that_explains_its_own_equation_is_tried_first(plain: Joint, gap: Joint) -> None:
    asymmetry = next(c for c in ranked(gap) if c.name == "asymmetric_coulomb")
    tenth = 0.1 * left_beyond_noise(gap, BY_NAME["encoder_slip"])
    assert tenth > asymmetry.gain, "in squares a tenth of the encoders' is more"
    slip = replace(asymmetry, name="encoder_slip", gain=tenth)
    first, rest = list(finalist_groups(plain, gap, BY_NAME, [slip, asymmetry], lambda _name: True))
    assert [c.name for c in first] == ["asymmetric_coulomb"]
    assert [c.name for c in rest] == ["encoder_slip"]


def test_where_nothing_is_missing_nothing_is_tried(plain: Joint, gap: Joint) -> None:
    tried = finalist_groups(plain, gap, BY_NAME, ranked(gap), lambda name: name == "transmission")
    assert {c.name for group in tried for c in group} <= {"encoder_eccentricity", "encoder_slip"}


def test_what_could_not_be_kept_is_not_tried(plain: Joint, gap: Joint) -> None:
    """As one block shows it, or as less than the gap's own error; unless something is left that it
    may complete.
    """
    asymmetry, slip = (
        next(c for c in ranked(gap) if c.name == "asymmetric_coulomb"),
        BY_NAME["encoder_slip"],
    )
    rows = gap.stack.part("transmission")
    silent = gap.residual.copy()
    silent[rows] *= 0.5 * math.sqrt((rows.stop - rows.start) / float(silent[rows] @ silent[rows]))
    whole = replace(gap, residual=silent)
    steady = np.tile([[1.9], [2.1]], (20, 1)), np.full((40, 1, 1), 1.0 / 40)
    lone = np.zeros((40, 1)), np.zeros((40, 1, 1))
    lone[0][0], lone[1][0] = 80.0, 1.0
    sure, one_block = (
        replace(asymmetry, gain=6400.0, blocks=s, weights=w) for s, w in (steady, lone)
    )
    assert one_block.preference == pytest.approx(1.0, rel=0.05)
    assert sure.preference > 50.0
    assert not would_be_removed(plain, whole, slip, replace(sure, gain=0.1 * plain.cost))
    assert would_be_removed(plain, whole, slip, replace(sure, gain=1e-6 * plain.cost))
    assert would_be_removed(plain, whole, slip, replace(one_block, gain=0.1 * plain.cost))
    assert not would_be_removed(plain, gap, slip, replace(one_block, gain=1e-6 * plain.cost))
    first, rest = list(
        finalist_groups(
            plain,
            whole,
            BY_NAME,
            [replace(one_block, name="encoder_slip"), asymmetry],
            lambda _: True,
        )
    )
    assert ([c.name for c in first], rest) == (["asymmetric_coulomb"], [])


def test_what_a_candidate_promises_is_what_its_fit_is_preferred_by(
    plain: Joint, gap: Joint
) -> None:
    asymmetry = next(c for c in ranked(gap) if c.name == "asymmetric_coulomb")
    added = Added(BY_NAME["asymmetric_coulomb"], (), tuple(asymmetry.coefficients))
    after = fit(gap.equations[0].views, "N m", gap.nominal, (*gap.effects, added), plain)
    assert gap.cost - after.cost == pytest.approx(asymmetry.gain, rel=0.05)
    assert preference(after, gap) == pytest.approx(asymmetry.preference, rel=0.1)


def test_what_shows_at_breakaways_alone_is_judged_by_them_and_nothing_else_is(
    plain: Joint, gap: Joint
) -> None:
    asymmetry = next(c for c in ranked(gap) if c.name == "asymmetric_coulomb")
    dwell = replace(asymmetry, name="dwell_static_friction")
    rests = replace(gap, equations=(*gap.equations, replace(gap.equations[0], name="breakaway")))
    tried = [
        c.name
        for g in finalist_groups(
            plain, rests, BY_NAME, [asymmetry, dwell], lambda name: name == "breakaway"
        )
        for c in g
    ]
    assert tried == ["dwell_static_friction"]
    assert size_p_value(rests, "breakaway") == 1.0, "their size says nothing"


@pytest.mark.parametrize("name", ["cogging", "transport_delay", "gear_mesh_ripple"])
def test_rows_that_an_effect_does_not_touch_need_not_be_looked_at(name: str, gap: Joint) -> None:
    """With something granted in the current, something in the encoders, and something that ties
    both together.
    """
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
        assert short is not None
        assert full is not None
        assert (short.gain, short.penalty) == pytest.approx((full.gain, full.penalty), rel=1e-9)
        assert short.statistic == pytest.approx(full.statistic, rel=1e-6)
        ties = mesh in effects or name == "gear_mesh_ripple"
        assert len(stack.only(columns.keys()).residual) < len(stack.residual)
        assert (
            {e.name for e in stack.only(columns.keys()).equations} >= {"torque", "transmission"}
        ) is ties


def test_effects_of_different_equations_are_no_rivals() -> None:
    assert not share_equation(BY_NAME["return_spring"], BY_NAME["encoder_slip"])
    assert share_equation(BY_NAME["return_spring"], BY_NAME["gravity_imbalance"])


def test_the_transmission_carries_the_declared_weight_too() -> None:
    hung = replace(honest()[0], pendulum=Pendulum(mass=5.0, length=0.2, zero=0.0))
    bare, loaded = (views([r], 25.0)[0] for r in (honest()[0], hung))
    assert np.ptp(loaded.torque - bare.torque) > 1.0
    assert loaded.transmitted == pytest.approx(bare.transmitted, abs=1e-9)


def test_a_loss_is_built_exactly_however_large() -> None:
    """Driving, 1 / eta of the torque is asked for; driven back, eta of it comes through."""
    hung = replace(honest()[0], pendulum=Pendulum(mass=20.0, length=0.3, zero=0.5))
    view, eta = views([hung], 25.0)[0], 0.7
    nominal = replace(nominal_fit(honest()).nominal, efficiency=eta)
    torque = nominal.drive(view)
    added = (1.0 / eta - 1.0) * BY_NAME["transmission_efficiency"].columns["torque"](
        view, nominal, ()
    )[0]
    driving = torque * view.velocity > 0.0
    back = torque * view.velocity < 0.0
    moving = added != 0.0
    assert np.sum(back & moving) > 1000
    assert (torque + added)[driving & moving] == pytest.approx(torque[driving & moving] / eta)
    assert (torque + added)[back & moving] == pytest.approx(torque[back & moving] * eta)


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
    """The torque goes with the ratio as the speed does: without it the torque is off by a twentieth
    of itself.
    """
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


def test_effects_without_a_score_are_tried_if_a_nonlinear_parameter_gives_their_size() -> None:
    assert not unscored(nominal_fit(honest()), BY_NAME, [])
    joint = nominal_fit(campaign({"cogging": COGGING}, 5, 6.0))
    found = unscored(joint, BY_NAME, [])
    names = {c.name for c in found}
    assert {"presliding", "friction_memory", "stribeck_shape"} <= names
    assert not names & {"asymmetric_coulomb", "transport_delay"}
    stiff = [c.shape[0] for c in found if c.name == "presliding"]
    assert len(stiff) == TRIALS
    assert stiff == sorted(stiff)
    scored = [c for c in found if c.name == "presliding"][:1]
    assert "presliding" not in {c.name for c in unscored(joint, BY_NAME, scored)}


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


def test_a_slip_in_a_recording_of_one_block_does_not_hide_what_the_signs_show() -> None:
    """A single block has no statistic by blocks, so that its effects take no part in the flips."""
    hidden = {"encoder_eccentricity": {"amplitude_rad": 5e-5, "phase_rad": 0.3}}
    first, second, *rest = campaign(hidden, 12, 6.0)[:4]
    short = replace(second, channels={k: v[:1400] for k, v in second.channels.items()})
    joint = nominal_fit((first, short, *rest))
    context = Context(joint.equations[0].views, joint.nominal)
    terms = [BY_NAME[n] for n in ("encoder_eccentricity", "encoder_slip")]
    every = list(trial_candidates(joint.stack, context, terms))
    tested = [c for c in every if c.tested]
    assert {c.name for c in every if not c.tested} == {"encoder_slip"}
    assert all(c.penalty >= 1.0 for c in every if not c.tested)
    rng = np.random.default_rng(0)
    assert sign_flip_p_value(tested, joint.stack.blocks, rng) < 0.01
    assert sign_flip_p_value(every, joint.stack.blocks, rng) > 0.5, "what the rule is for"


def test_a_slip_in_one_of_many_recordings_is_found_by_its_size() -> None:
    """Over all recordings the mismatch is within the noise's bound, in one far above it."""
    joint = nominal_fit(honest())
    (transmission,) = (e for e in joint.equations if e.name == "transmission")
    residual = joint.residual.copy()
    rows = residual[joint.stack.part("transmission")]
    rows[:] = np.sqrt(transmission.allowed())
    rows[transmission.owner == 1] *= math.sqrt(3.0)
    assert size_p_value(replace(joint, residual=residual), "transmission") < 1e-3
    rows[transmission.owner == 1] *= math.sqrt(1.8 / 3.0)
    assert size_p_value(replace(joint, residual=residual), "transmission") > 0.01


def test_the_trial_of_an_effect_has_the_size_that_its_coefficient_states() -> None:
    """Delays far below the time of the motion score alike, and a fit searches near its trial."""
    joint = nominal_fit(honest())
    context = Context(joint.equations[0].views, joint.nominal)
    term = BY_NAME["time_skew"]
    alike = [
        Candidate(
            "time_skew",
            shape,
            np.array([0.002 / shape[0]]),
            gain=1000.0 + shape[0],
            penalty=1.0,
            statistic=50.0,
            blocks=np.zeros((0, 1)),
            weights=np.zeros((0, 1, 1)),
            share=1.0,
        )
        for shape in term.shapes(context)
        if shape[0] > 0.0
    ]
    (best,) = best_of_each(alike, {"time_skew": term})
    assert best.shape[0] == pytest.approx(0.002, rel=0.5)
    (longest,) = best_of_each(alike, {"time_skew": term.modified(size=None)})
    assert longest.shape[0] == max(c.shape[0] for c in alike)
