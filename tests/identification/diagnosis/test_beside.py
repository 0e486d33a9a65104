"""What hides a second effect: noise taken too large, a delay to first order, a sign told by an
offset current.
"""

from __future__ import annotations

import math

import pytest

from identification.diagnosis.joint import Joint, fit, with_lower_noise

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


def test_a_strong_ripple_leaves_nothing_of_its_own() -> None:
    ripple = {"fraction": 0.14, "per_motor_turn": 2.0, "phase_rad": 1.0}
    named = after(nominal_fit(campaign({"torque_ripple": ripple}, 34, 8.0)), "torque_ripple")
    assert math.hypot(*named.effects[0].coefficients) == pytest.approx(0.14, rel=0.005)
    assert power(named, "torque") < 1.2
