"""What hides a second effect: noise taken too large, a delay to first order, a sign told by an
offset current.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.joint import LOWER_NOISE_RATIO, Joint, fit, with_lower_noise
from identification.diagnosis.removal import needed_share
from identification.diagnosis.rows import held_voltage
from identification.diagnosis.rules import RULES
from identification.effects.effect import CLOSE, EXACT, ROUGH
from identification.numerics.series import dahl, first_order_lag

from . import benches
from .benches import campaign, honest, nominal_fit
from .test_fits import TERM, begun_with, power


def after(joint: Joint, *names: str) -> Joint:
    """Fit effects one after another, the noise measured again after each."""
    views, base, found = joint.equations[0].views, joint, joint
    for name in names:
        added = begun_with(found, name).effects[-1]
        found = fit(views, "N m", found.nominal, (*found.effects, added), base)
        base, found = with_lower_noise(base, found)
    return found


def test_what_swings_as_noise_does_is_no_noise_once_it_is_named() -> None:
    cogs = {"torque_Nm": 2.3, "per_motor_turn": 7.0, "phase_rad": 1.0}
    joint = nominal_fit(campaign({"cogging": cogs}, 31, 8.0))
    named = after(joint, "cogging")
    assert named.equations[0].sigma < 0.5 * joint.equations[0].sigma
    assert named.equations[0].sigma == pytest.approx(
        nominal_fit(honest()).equations[0].sigma, rel=0.2
    )
    assert power(named, "torque") < 1.2
    own, before = named.equations[0].own, joint.equations[0].own
    assert set(own) == set(before)
    loudest = max(before, key=lambda index: before[index])
    assert own[loudest] < 1.1 < 1.5 < before[loudest]


def test_what_swings_as_noise_does_in_one_recording_is_no_noise_once_it_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In slow motion the wave is smooth from row to row, and the noise of most rows stays."""
    slow = [(0.0, 0.05), (10.0, 0.05), (30.6, 0.06)]
    plan = [(mass, ((22.0, Hz),), "fit") for mass, Hz in (*slow, (0.0, 0.45))]
    monkeypatch.setattr(benches, "PLAN", plan)
    cogs = {"torque_Nm": 0.3, "per_motor_turn": 1.0, "phase_rad": 1.0}
    joint = nominal_fit(campaign({"cogging": cogs}, 31, 12.0))
    named = after(joint, "cogging")
    torque, before = named.equations[0], joint.equations[0]
    assert torque.sigma > LOWER_NOISE_RATIO * before.sigma
    assert torque.own[3] < 1.5 < 10.0 < before.own[3]
    assert named.stack.equations[0].own == torque.own


def test_what_a_voltage_between_samples_may_differ_stays_noise() -> None:
    cogs = {"torque_Nm": 2.3, "per_motor_turn": 7.0, "phase_rad": 1.0}
    instants = [replace(r, averaged=frozenset()) for r in campaign({"cogging": cogs}, 31, 8.0)]
    named = after(nominal_fit(instants), "cogging")
    voltage = next(e for e in named.equations if e.name == "voltage")
    assert voltage.sigma >= held_voltage(voltage) > 0.0


def test_what_moves_slowly_leaves_the_noise_as_it_is() -> None:
    joint = nominal_fit(honest())
    slow = begun_with(joint, "asymmetric_coulomb")
    before, same = with_lower_noise(joint, slow)
    assert before is joint
    assert same is slow


def test_a_long_delay_leaves_nothing_that_another_effect_could_take_up() -> None:
    joint = nominal_fit(campaign({"transport_delay": {"time_s": 0.012}}, 32, 8.0))
    late = after(joint, "transport_delay")
    assert late.effects[0].shape[0] == pytest.approx(0.012, rel=0.005)
    assert power(late, "transmission") < 1.2
    assert "torque" in TERM["transport_delay"].on_the_joint().columns


def test_a_dead_time_steps_where_the_current_is_none_and_not_where_it_reads_none() -> None:
    hidden = {"inverter_dead_time": {"voltage_V": 1.0}, "current_offset": {"current_A": 0.3}}
    joint = nominal_fit(campaign(hidden, 33, 8.0))
    sharp, rounded = (
        after(joint, name, "current_offset") for name in ("inverter_dead_time", "brush_drop")
    )
    assert sharp.nominal.zero_A == pytest.approx(0.3, rel=0.02)
    assert sharp.effects[0].shape[1] == pytest.approx(0.3, rel=0.02)
    noise = [j.stack.equations[-1].sigma * math.sqrt(power(j, "voltage")) for j in (sharp, rounded)]
    assert noise[0] < noise[1]


def test_beside_what_is_the_physics_itself_less_makes_a_name() -> None:
    little = 0.5 * ROUGH
    assert math.isinf(needed_share(little))
    for error in (EXACT, CLOSE):
        assert math.isfinite(needed_share(little, error))
        assert math.isinf(needed_share(0.5 * error, error))
        assert (
            RULES.further_share
            == needed_share(2.0 * RULES.shape_errors * error, error)
            < needed_share(2.0 * error, error)
        )


def test_a_strong_ripple_leaves_nothing_of_its_own() -> None:
    ripple = {"fraction": 0.14, "per_motor_turn": 2.0, "phase_rad": 1.0}
    named = after(nominal_fit(campaign({"torque_ripple": ripple}, 34, 8.0)), "torque_ripple")
    assert math.hypot(*named.effects[0].coefficients) == pytest.approx(0.14, rel=0.005)
    assert power(named, "torque") < 1.2


def test_friction_that_is_late_and_springs_is_bristles_over_a_late_level() -> None:
    joint = nominal_fit(honest())
    view = next(v for v in joint.equations[0].views if not v.loaded)
    nominal, shape = TERM["presliding"].begin(joint.nominal, (2500.0,))
    springs, lags = (TERM[name].columns["torque"] for name in ("presliding", "friction_memory"))
    level = nominal.level(view) - nominal.get("sigma_2") * np.abs(view.velocity)
    found = (
        view.sense * level + springs(view, nominal, shape)[0] + lags(view, nominal, (0.02, 0.0))[0]
    )
    expected = dahl(view.angle, first_order_lag(level, view.step, 0.02), 2500.0)
    begun = len(level) // 2  # by then what it began with is forgotten
    assert found[begun:] == pytest.approx(expected[begun:], abs=1e-6)
    alone = lags(view, joint.nominal, (0.02, 0.0))[0]
    assert np.max(np.abs(alone - lags(view, nominal, (0.02, 0.0))[0])) > 0.1 * np.max(np.abs(alone))
