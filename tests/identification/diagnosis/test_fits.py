"""What a joint fit makes of starts far off, of falling friction, and of rows that are no
equations.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from identification.diagnosis import joint as fitting
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.linear import predicted_and_attained
from identification.diagnosis.rows import equations, noise, without_tones
from identification.diagnosis.significance import size_p_value, trial_candidates
from identification.diagnosis.stack import Candidate, stack_of
from identification.diagnosis.within_limits import (
    feasible_or_first,
    infeasible,
    infeasible_as_fitted,
)
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.recording import Pendulum, Recording
from identification.signals import smooth
from identification.views.nominal import STATICS, Nominal
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


def test_a_speed_moves_by_the_rise_that_was_found() -> None:
    nominal = Nominal({"Mc": 5.0, "Ms": 6.0, "omega_sf": 0.05}, ("Mc", "Ms", "omega_sf"), 2.0)
    after = nominal.moved(np.array([0.0, 1.0, 9.0]), np.array([9.0, 9.0, 0.2]))
    assert after.values["Ms"] == pytest.approx(7.0)
    assert after.values["omega_sf"] == pytest.approx(0.05 * math.exp(0.2 / 2.0))
    gone = nominal.moved(np.array([0.0, -3.0, 0.0]), np.array([0.0, 0.0, 0.2]))
    assert gone.values["Ms"] == pytest.approx(5.0, rel=1e-5)
    assert gone.values["omega_sf"] == 0.05, "without a fall nothing tells its speed"


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


def test_large_errors_of_a_few_rows_are_noticed_where_they_recur() -> None:
    """After every reversal a joint that springs leaves a row or two of 20 times the noise, and none
    anywhere else.
    """
    joint = nominal_fit(honest())
    rows = joint.stack.part("torque")
    block = joint.stack.block[rows]
    _, first = np.unique(block, return_index=True)
    few, many = joint.residual.copy(), joint.residual.copy()
    few[rows][first[:1]] += 60.0
    many[rows][first[::2]] += 20.0
    assert size_p_value(replace(joint, residual=few)) > 0.5
    assert size_p_value(replace(joint, residual=many)) < 1e-6


def test_constants_that_a_fit_cannot_keep_make_it_no_model() -> None:
    """Friction that rises with the speed, from a bench whose static friction may not be below its
    Coulomb friction.
    """
    joint = nominal_fit(honest())
    assert not infeasible(joint)
    promised, kept = predicted_and_attained(joint.stack, (), joint.residual)
    assert kept == pytest.approx(promised, rel=0.05)
    values = {**joint.nominal.values, "Mc": joint.nominal.values["Ms"]}
    flat = replace(joint.nominal, values=values)
    rows = equations(joint.equations[0].views, flat, "N m", joint.equations)
    beyond = replace(joint, nominal=flat, equations=rows, stack=stack_of(rows, flat, joint.stack))
    assert infeasible_as_fitted(beyond)
    beside = replace(beyond, effects=(Added(TERM["asymmetric_coulomb"], (), (0.0,)),))
    assert infeasible_as_fitted(beside)
    assert not infeasible(beside), "constants within their limits leave as little"
    assert not infeasible_as_fitted(
        replace(beyond, effects=(Added(TERM["compliance"], (), (0.0,)),))
    ), "encoders alone see it"


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
    """14 Hz passes for noise in differences from row to row; at 50 times the noise it was not
    noticed at all.
    """
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
    recording = Recording("ramp", channels, BENCH, "unloaded", 0.0, averaged=frozenset({"current"}))
    return views([recording], 25.0)[0]


def test_rows_in_which_the_drive_hunts_unseen_by_the_filter_are_left_out() -> None:
    late = _ramp(0.0).kept_times > 3.2
    assert np.mean(_ramp(0.0).moving) > 0.9, "an encoder's counts are no hunting"
    hunting = _ramp(0.03)
    assert not np.any(hunting.moving[late])
    assert np.mean(hunting.moving[hunting.kept_times < 2.8]) > 0.9


def test_a_weights_inertia_loads_no_gear() -> None:
    """Nor does it in the ladder's terms: a tenth of the load's torque as friction left 20 times the
    noise otherwise.
    """
    time = np.arange(4000) * CYCLE_S
    channels = {
        "time": time,
        "motor_angle": 100.0 * 0.3 * np.sin(9.0 * time),
        "current": np.ones(len(time)),
    }
    weight = Pendulum(2.0, 0.25, 0.4)
    view = views(
        [replace(Recording("swing", channels, BENCH, "unloaded", 0.0), pendulum=weight)], 25.0
    )[0]
    nominal = Nominal({"Mc": 5.0}, ("Mc",), 2.0)
    assert nominal.borne(view) == pytest.approx(np.abs(weight.torque(view.angle, BENCH.gravity)))
    assert nominal.helping(view) == pytest.approx(
        weight.torque(view.angle, BENCH.gravity) - 0.125 * view.acceleration
    )
    beside = replace(nominal, undeclared=(0.0, 0.0, 0.0, 1.0))
    assert beside.borne(view) == pytest.approx(
        np.abs(weight.torque(view.angle, BENCH.gravity) - 1.0)
    )


def test_a_joint_that_moves_against_its_torque_has_not_broken_away() -> None:
    """A shaft that springs back under a torque the other way was taken for a breakaway of minus
    that torque.
    """
    time = np.arange(4000) * CYCLE_S
    back = np.clip((time - 1.0) / 0.02, 0.0, 1.0) * 40.0 * COUNT_RAD
    angle = np.maximum(0.1 * (time - 2.0), 0.0) - back
    angle = COUNT_RAD * np.round(angle / COUNT_RAD)
    channels = {"time": time, "motor_angle": 100.0 * angle, "current": 1.0 + time}
    recording = Recording("rest", channels, BENCH, "unloaded", 0.0, averaged=frozenset({"current"}))
    (view,) = views([recording], 25.0)
    assert np.all(view.sense[view.breakaways] > 0.0)
    assert np.any(np.abs(view.time[view.breakaways] - 2.0) < 0.01)


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


@pytest.mark.parametrize(
    ("greatest", "shares"), [(1.0, [1.0]), (0.5, [1.0, 0.5]), (0.0, [1.0, 0.5, 0.0])]
)
def test_a_closing_step_is_shortened_until_the_mismatch_falls(
    greatest: float, shares: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """If no share of the step lowers it, the step without static friction is taken.

    A static level that no row determines raises the error on unused recordings.
    """
    best, after = (SimpleNamespace(stack=stack, effects=(), residual=None) for stack in (None, 1))
    mismatches = {None: (1.0, 400.0), 1: (1.0, 1.0)}
    tried: list[float] = []

    def fit_after_step(_best: object, step: np.ndarray, enough: float) -> object:
        assert 1.0 < enough < 400.0, (
            "a step that lowers the mismatch by next to nothing is not taken"
        )
        tried.append(float(step[0]))
        return (after, "done") if step[0] <= greatest else None

    def solve(_stack: object, _effects: object, without: object = ()) -> SimpleNamespace:
        assert without is STATICS
        return SimpleNamespace(linear_step=np.zeros(1))

    monkeypatch.setattr(
        fitting, "predicted_and_attained", lambda stack, _effects, _residual: mismatches[stack]
    )
    monkeypatch.setattr(fitting, "_fit_after_step", fit_after_step)
    monkeypatch.setattr(fitting, "solve", solve)
    assert fitting._closing_steps(best, SimpleNamespace(linear_step=np.ones(1))) is after
    assert tried == shares


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


def test_a_swing_may_begin_otherwise_in_each_recording() -> None:
    """Its frequency and decay are one; size and phase are each recording's own."""
    fraction, frequency_Hz, decay_s = 0.2, 1.1, 6.0

    def swinging(recording: Recording, phase: float) -> Recording:
        time = recording.channels["time"] - recording.channels["time"][0]
        load = recording.bench.moment_arm * recording.contact_force * 0.05
        swing = np.exp(-time / decay_s) * np.sin(2.0 * np.pi * frequency_Hz * time + phase)
        speed = np.gradient(smooth(recording.channels["motor_angle"], 1e3, 30.0), 1e-3)
        torque = fraction * load * swing * np.sign(speed)
        current = recording.channels["current"] + torque / recording.bench.ampere_torque
        channels = {n: c for n, c in recording.channels.items() if n != "voltage"}
        return replace(recording, channels={**channels, "current": current})

    hidden = [swinging(r, 2.0 * k) if r.weight_mass else r for k, r in enumerate(honest()[:5])]
    joint = nominal_fit(hidden)
    context = Context(joint.equations[0].views, joint.nominal)
    (term,) = (t for t in MOTION if t.name == "load_swing")
    best = max(trial_candidates(joint.stack, context, [term]), key=lambda c: c.score)
    assert best.shape[2] != 0.0
    start = Added(term, best.shape, tuple(best.coefficients))
    found = fit(context.views, "N m", joint.nominal, (start,), joint).effects[0]
    read, sizes = found.parameters(context), np.hypot(*np.reshape(found.coefficients, (-1, 2)).T)
    assert np.all(sizes[:2] < 1e-9)
    # The hidden torque is a share of 0.05 of the moment, the effect a share of the friction.
    friction = [np.abs(joint.nominal.coefficient(v))[~v.still] for v in context.views if v.loaded]
    expected = [fraction * 0.05 / float(np.mean(each)) for each in friction]
    assert sizes[2:] == pytest.approx(expected, rel=0.15)
    assert read["fraction"] == np.median(sizes[2:])
    assert read["frequency_Hz"] == pytest.approx(frequency_Hz, rel=0.02)
    assert read["decay_s"] == pytest.approx(decay_s, rel=0.2)


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
    assert found is not None
    assert 1.0 / found.coefficients[0] == pytest.approx(stiffness, rel=0.01)
    assert found.coefficients[3] * stiffness == pytest.approx(friction, rel=0.02)
