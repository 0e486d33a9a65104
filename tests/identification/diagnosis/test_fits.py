"""What a joint fit makes of starts far off, falling friction, and a second effect beside one."""

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.joint import Added, Joint, fit, with_lower_noise
from identification.diagnosis.significance import size_p_value, trial_candidates
from identification.diagnosis.stack import Candidate
from identification.diagnosis.within_limits import (
    feasible_or_first,
    infeasible,
    infeasible_as_fitted,
)
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.recording import Recording
from identification.signals import noise, without_tones
from identification.views.nominal import Nominal
from identification.views.view import View, views

from .benches import BENCH, CYCLE_S, campaign, honest, nominal_fit

TERM = {t.name: t for t in MOTION}
COUNT_RAD = 2.0 * math.pi / 4096 / 100


def begun_with(joint: Joint, name: str) -> Joint:
    """Fit one effect from the trial shape that explains most."""
    here = joint.equations[0].views
    trials = trial_candidates(joint.stack, Context(here, joint.nominal), [TERM[name]])
    best: Candidate = max(trials, key=lambda c: c.score)
    added = Added(TERM[name], best.shape, tuple(float(c) for c in best.coefficients))
    return fit(here, "N m", joint.nominal, (added,), joint)


def with_falling_friction(recording: Recording) -> Recording:
    """Return a recording whose torque falls by 10 N m s/rad more with speed than measured."""
    speed = np.gradient(recording.channels["angle"], CYCLE_S)
    less = 10.0 * speed / (BENCH.torque_constant * BENCH.gear_ratio)
    current = recording.channels["current"] - less
    return replace(recording, channels={**recording.channels, "current": current})


def power(joint: Joint, equation: str) -> float:
    """Return the mean square of an equation's mismatch over the noise's."""
    return float(np.mean(joint.residual[joint.stack.part(equation)] ** 2))


@pytest.mark.parametrize("factor", [0.5, 1.6])
def test_a_fit_finds_its_way_from_a_speed_that_is_far_off(factor: float) -> None:
    joint = nominal_fit(honest())
    values = {n: v * (factor if n == "omega_sf" else 1.0) for n, v in joint.nominal.values.items()}
    again = fit(joint.equations[0].views, "N m", replace(joint.nominal, values=values), (), joint)
    assert again.nominal.values["omega_sf"] == pytest.approx(
        joint.nominal.values["omega_sf"], rel=0.02
    )
    assert again.nominal.values["Ms"] == pytest.approx(joint.nominal.values["Ms"], rel=0.02)


def test_an_exponent_is_found_beside_speeds_that_suit_another() -> None:
    alpha = 0.9
    joint = nominal_fit(campaign({"stribeck_shape": {"alpha": alpha}}, 21))
    after = begun_with(joint, "stribeck_shape")
    assert after.effects[0].shape[0] == pytest.approx(alpha, rel=0.05)
    assert after.nominal.values["omega_sf"] == pytest.approx(0.0557, rel=0.05)
    assert power(joint, "torque") > 1.5
    assert power(after, "torque") < 1.2


def test_a_dead_time_is_sharper_than_a_brush_drop() -> None:
    hidden = {
        "inverter_dead_time": {"voltage_V": 1.7},
        "brush_drop": {"voltage_V": 1.0, "current_A": 0.4},
    }
    for name, other in (("inverter_dead_time", "brush_drop"), ("brush_drop", "inverter_dead_time")):
        joint = nominal_fit(campaign({name: hidden[name]}, 22, 8.0))
        assert power(begun_with(joint, name), "voltage") < power(
            begun_with(joint, other), "voltage"
        )


def test_much_in_one_recording_is_noticed_and_a_little_in_all_is_not() -> None:
    joint = nominal_fit(honest())
    torque = joint.equations[0]
    rows = np.zeros(len(joint.residual), dtype=bool)
    mine = np.flatnonzero(torque.owner == torque.views[0].index)
    rows[mine[: len(mine) // 8]] = True
    assert size_p_value(joint) > 0.5
    assert size_p_value(replace(joint, residual=joint.residual + 6.0 * rows)) < 1e-3
    assert size_p_value(replace(joint, residual=1.1 * joint.residual)) > 0.5


def test_a_fit_that_needs_impossible_constants_is_infeasible() -> None:
    """Friction that falls with speed all the way up, as only a negative viscous one does."""
    joint = nominal_fit([with_falling_friction(r) for r in honest()])
    assert infeasible_as_fitted(joint)
    assert infeasible(joint)


def test_a_fall_that_ran_off_is_supposed_anew() -> None:
    """Friction of the system ends at its limit, by a speed that no step of the fit leaves."""
    joint = nominal_fit(honest())
    here = joint.equations[0].views
    values = {**joint.nominal.values, "omega_sf": 0.02, "omega_sL": 0.02}
    values |= {"Ms": values["Mc"], "mu_s": values["mu_c"]}
    lost = fit(here, "N m", replace(joint.nominal, values=values), (), joint)
    assert infeasible_as_fitted(lost)
    found = feasible_or_first(lost)
    assert not infeasible_as_fitted(found)
    assert found.nominal.values["Ms"] == pytest.approx(joint.nominal.values["Ms"], rel=0.02)
    assert feasible_or_first(joint) is joint


def test_a_tone_is_no_noise() -> None:
    """14 Hz passes for noise in differences from row to row."""
    low_pass = nominal_fit(honest()).equations[0].views[0].low_pass
    rng = np.random.default_rng(2)
    step = 0.001 * low_pass.factor
    count = 1200
    half = low_pass.half
    raw = rng.standard_normal(count * low_pass.factor + 2 * half + 1)
    quiet = low_pass(raw[None])[0][:count]
    time = np.arange(len(quiet)) * step
    kept = rng.uniform(size=len(quiet)) > 0.3
    owner = np.zeros(int(kept.sum()))
    loud = quiet + 50.0 * quiet.std() * np.sin(2.0 * np.pi * 14.03 * time + 1.0)
    floor = noise(quiet[kept], owner, low_pass)
    assert noise(loud[kept], owner, low_pass) > 10.0 * floor
    assert noise(without_tones(loud[kept], owner, time[kept]), owner, low_pass) == pytest.approx(
        floor, rel=0.1
    )
    assert noise(without_tones(quiet[kept], owner, time[kept]), owner, low_pass) == pytest.approx(
        floor, rel=0.03
    )


def _ramp(hunting_rad_s: float) -> View:
    """Return the view of a slow ramp during whose second half the drive hunts at 80 Hz."""
    time = np.arange(6000) * CYCLE_S
    swing = hunting_rad_s / (2.0 * np.pi * 80.0) * np.sin(2.0 * np.pi * 80.0 * time) * (time > 3.0)
    angle = np.round((0.05 * time + swing) / COUNT_RAD) * COUNT_RAD
    channels = {"time": time, "motor_angle": 100.0 * angle, "current": np.ones(len(time))}
    recording = Recording(
        name="ramp", channels=channels, bench=BENCH, averaged=frozenset({"current"})
    )
    return views([recording], 25.0)[0]


def test_rows_in_which_the_drive_hunts_unseen_by_the_filter_are_left_out() -> None:
    late = _ramp(0.0).kept_times > 3.2
    assert np.mean(_ramp(0.0).moving) > 0.9, "an encoder's counts are no hunting"
    hunting = _ramp(0.03)
    assert not np.any(hunting.moving[late])
    assert np.mean(hunting.moving[hunting.kept_times < 2.8]) > 0.9


def test_static_friction_stays_below_the_torque_that_overcame_it() -> None:
    nominal = Nominal(
        {"Mc": 5.0, "Ms": 8.0, "omega_sf": 0.05}, ("Mc", "Ms", "omega_sf"), 2.0, most={"Ms": 8.0}
    )
    up, down, still = np.array([0.0, 3.0, 0.0]), np.array([0.0, -3.0, 0.0]), np.zeros(3)
    assert nominal.at_most(up) == {"Ms"}
    assert nominal.at_most(down) == set()
    assert nominal.moved(up, still).values["Ms"] == 8.0
    assert nominal.moved(down, still).values["Ms"] == pytest.approx(5.0, rel=1e-5)
    assert replace(nominal, most={}).moved(up, still).values["Ms"] == 11.0


def test_a_joint_encoder_that_slipped_does_not_turn_the_joint() -> None:
    """The zero of the first recording holds for all, unless the motor's origin was lost."""
    first, second = honest()[:2]
    slip = 0.01

    def slipped(recording: Recording, share: float, size: float) -> Recording:
        angle = recording.channels["angle"].copy()
        angle[int(share * len(angle)) :] += size
        return replace(recording, channels={**recording.channels, "angle": angle})

    (_, plain), (_, after), (_, lost) = (
        views(pair, 25.0)
        for pair in (
            (first, second),
            (slipped(first, 0.75, slip), slipped(second, 0.0, slip)),
            (first, slipped(second, 0.0, slip)),
        )
    )
    noise = 1e-4
    assert np.max(np.abs(after.angle - plain.angle)) < noise
    assert np.max(np.abs(lost.angle - plain.angle - slip)) < noise


def test_the_campaign_shows_whether_the_motor_lost_its_origin() -> None:
    """A recording alone has the motor angle that it has beside the others."""
    first, second = (
        replace(r, channels={**r.channels, "motor_angle": r.channels["motor_angle"] + zero})
        for r, zero in zip(honest()[:2], (0.0, 2.0), strict=True)
    )
    together = views((first, second), 25.0)
    for recording, beside in zip((first, second), together, strict=True):
        (alone,) = views((recording,), 25.0, campaign=(first, second))
        assert np.array_equal(alone.motor, beside.motor)
    (apart,) = views((second,), 25.0)
    assert np.max(np.abs(apart.motor - together[1].motor)) > 0.1


def test_friction_of_the_rotor_does_not_twist_the_shaft() -> None:
    """A part of the friction may be on the motor's side, before the shaft."""
    stiffness, friction = 900.0, 3.0
    soft = []
    for recording in honest()[:3]:
        (view,) = views([recording], 25.0)
        twist = (view.transmitted - friction * view.sense) / stiffness
        angle = recording.channels["motor_angle"] / BENCH.gear_ratio - twist
        soft.append(replace(recording, channels={**recording.channels, "angle": angle}))
    joint = nominal_fit(soft)
    (term,) = (t for t in MOTION if t.name == "compliance")
    found = joint.stack.term(term, ())
    assert 1.0 / found.coefficients[0] == pytest.approx(stiffness, rel=0.01)
    assert found.coefficients[3] * stiffness == pytest.approx(friction, rel=0.02)


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
