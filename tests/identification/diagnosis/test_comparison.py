"""How two fits are compared, what they cannot distinguish, and sizes that follow the machine."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.comparison import (
    Contender,
    Round,
    advantage,
    implausible,
    preference,
    simplest,
)
from identification.diagnosis.held_out import with_indistinct_effects
from identification.diagnosis.joint import Added, Joint
from identification.diagnosis.rows import gather_of
from identification.diagnosis.search import Search
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.effects.motor import change_at_zero
from identification.model.parameters import LINEAR
from identification.views.view import View, at_scale

from .benches import honest, nominal_fit

TERM = {t.name: t for t in MOTION}
DEAD_TIME = Added(TERM["inverter_dead_time"], (0.01, 0.0, 1.0), (1.0,))
STOP = Added(TERM["end_stop"], (0.0, 0.2, 0.3), (1.0,))
"""Effects with two fitted parameters and with three."""


def left(effect: Added, worse: float) -> Joint:
    """Return a fit with an effect whose squares exceed the noise by ``worse``, unevenly from block
    to block.
    """
    joint = nominal_fit(honest())
    block = joint.stack.block
    uneven = np.where(block % 2 == 0, 1.5, 0.5)
    rows = np.sqrt(1.0 + uneven * worse / np.sum(uneven))
    return replace(joint, residual=rows, effects=(effect,))


def log_rows() -> float:
    return math.log(len(left(STOP, 0.0).residual))


def test_fits_with_equally_many_parameters_are_compared_by_what_they_leave() -> None:
    better, worse = left(STOP, 1.0), left(STOP, 30.0)
    assert preference(better, worse) == advantage(better, worse) > 1.0
    assert preference(worse, better) == -preference(better, worse)


@pytest.mark.parametrize(
    ("preference", "beyond", "is_open"),
    [(0.0, "", True), (1.7, "", False), (0.0, "gap = 3, outside", False)],
)
def test_a_rival_is_open_if_neither_data_nor_ranges_reject_it(preference, beyond, is_open):
    rival = Contender("cogging", nominal_fit(honest()), preference, beyond)
    assert rival.open is is_open


def test_a_ripple_of_the_gear_without_a_torque_may_be_an_encoders() -> None:
    alike = [TERM["gear_mesh_ripple"].indistinct({"with_torque": w}, ()) for w in (0.0, 1.0)]
    assert alike == [("encoder_ripple",), ()]


def test_one_block_of_time_prefers_no_fit() -> None:
    one = []
    for joint in (left(STOP, 1.0), left(STOP, 30.0)):
        block = np.zeros_like(joint.stack.block)
        gather = gather_of(joint.equations, block, 1)
        stack = replace(joint.stack, block=block, blocks=1, gather=gather)
        one.append(replace(joint, stack=stack))
    assert preference(*one) == advantage(*one) == 0.0


@pytest.mark.parametrize(("gain", "sure"), [(0.5, False), (8.0, True)])
def test_a_parameter_more_must_explain_more_than_chance(gain: float, sure: bool) -> None:
    """In units of log n, Schwarz's price of a parameter."""
    richer, simple = left(STOP, 0.0), left(DEAD_TIME, gain * log_rows())
    assert advantage(richer, simple) > 0.0
    if sure:
        assert 0.0 < preference(richer, simple) < advantage(richer, simple)
    else:
        assert preference(richer, simple) == 0.0
    assert simplest([richer, simple], [3, 2]) == (0 if sure else 1)


@pytest.mark.parametrize(
    ("name", "kept", "alias"),
    [
        ("presliding", "motor_angle", ("compliance", "coupling_hysteresis")),
        ("presliding", "angle", ()),
        ("asymmetric_coulomb", "motor_angle", ()),
    ],
)
def test_a_spring_in_the_friction_and_a_twisted_shaft_are_alike_to_the_motors_encoder(
    name: str, kept: str, alias: tuple[str, ...]
) -> None:
    dropped = {"motor_angle", "angle"} - {kept}
    recordings = [
        replace(r, channels={k: v for k, v in r.channels.items() if k not in dropped})
        for r in honest()
    ]
    joint = nominal_fit(recordings)
    shape = (5e3,) if name == "presliding" else ()
    final = replace(joint, effects=(Added(TERM[name], shape, (1.0,)),))
    tested = Contender("stribeck_shape", joint, 4.0, "")
    found = Search(joint, final, (Round(name, (tested,)),), 1e-3, 1.0, "", ())
    (taken,) = with_indistinct_effects(found, ()).rounds
    assert tuple(r.name for r in taken.rivals) == ("stribeck_shape", *alias)
    assert all(r.preference == 0.0 for r in taken.rivals if r.name in alias)


@pytest.mark.parametrize(("samples", "alike"), [(2.0, False), (0.5, True)])
def test_a_brush_drop_within_one_sample_may_be_a_dead_time(samples: float, alike: bool) -> None:
    """Reached over as much current as changes within this number of samples."""
    joint = nominal_fit(honest())
    views = joint.equations[0].views
    greatest_A = float(np.max(np.abs(views[0].recording.channels["current"])))
    shape = (samples * change_at_zero(views) / greatest_A, 0.0, greatest_A)
    final = replace(joint, effects=(Added(TERM["brush_drop"], shape, (0.5,)),))
    found = Search(joint, final, (Round("brush_drop", ()),), 1e-3, 1.0, "", ())
    (taken,) = with_indistinct_effects(found, ()).rounds
    assert [r.name for r in taken.rivals] == ["inverter_dead_time"] * alike


def scaled(view: View, torque: float = 1.0, travel: float = 1.0, motion: str = "rotary") -> View:
    bench = replace(view.recording.bench, motion=motion)
    return replace(
        view,
        torque=torque * view.torque,
        angle=travel * view.angle,
        recording=replace(view.recording, bench=bench),
    )


@pytest.mark.parametrize(("torque", "travel"), [(0.05, 1.0), (1.0, 0.1), (0.02, 3.0)])
def test_the_trial_stiffnesses_of_presliding_are_those_of_the_machine(torque, travel):
    """A small servo's contact is softer than any trial value of the valve's."""
    joint = nominal_fit(honest())
    whole = Context(joint.equations[0].views, joint.nominal)
    small = replace(whole, views=tuple(scaled(v, torque, travel) for v in whole.views))
    usual, own = (
        np.array([s[0] for s in TERM["presliding"].shapes(context)]) for context in (whole, small)
    )
    assert own == pytest.approx(usual * torque / travel)


def test_gaps_of_a_linear_axis_are_a_share_of_its_travel() -> None:
    views = nominal_fit(honest()).equations[0].views
    rotary = [scaled(v, travel=0.2) for v in views]
    linear = [scaled(v, travel=0.2, motion=LINEAR) for v in views]
    twice = [scaled(v, travel=0.4, motion=LINEAR) for v in views]
    assert at_scale([1e-3], rotary) == [1e-3]
    (short,), (long,) = at_scale([1e-3], linear), at_scale([1e-3], twice)
    assert long == pytest.approx(2.0 * short)
    assert 0.0 < short < 1e-3


def reason(effect: Added, change: Callable[[View], View]) -> str:
    """Return why an effect is implausible with changed recordings; empty if it is not."""
    joint = nominal_fit(honest())
    views = tuple(map(change, joint.views))
    equations = tuple(replace(e, views=views) for e in joint.equations)
    return implausible(replace(joint, effects=(effect,), equations=equations))


def test_the_plausible_slope_over_the_angle_grows_as_the_travel_shrinks() -> None:
    """On a travel of a tenth, ten times the slope changes the friction by as much."""
    effect = Added(TERM["load_position_dependence"], (), (4.0,))
    wide = reason(effect, lambda v: v)
    assert wide.startswith("slope_per_rad = 4, outside the plausible range")
    assert reason(effect, lambda v: scaled(v, travel=0.1)) == ""


@pytest.mark.parametrize(("share", "possible"), [(-0.95, True), (1.05, False), (-1.05, False)])
def test_no_friction_drives_the_motion_in_one_direction(share: float, possible: bool) -> None:
    size = share * nominal_fit(honest()).nominal.get("Mc")
    found = reason(Added(TERM["asymmetric_coulomb"], (), (size,)), lambda v: v)
    assert (found == "friction that drives the motion in one direction") is not possible
    assert reason(Added(TERM["constant_torque"], (), (size,)), lambda v: v) == ""


@pytest.mark.parametrize(
    ("name", "power"),
    [("asymmetric_viscous", 1), ("quadratic_drag", 2), ("lever_pivot_friction", 0)],
)
@pytest.mark.parametrize(("share", "plausible"), [(0.4, True), (0.6, False)])
def test_friction_of_half_the_greatest_torque_is_plausible(name, power, share, plausible):
    views = nominal_fit(honest()).views
    torque = max(float(np.max(np.abs(v.torque))) for v in views)
    speed = max(float(np.max(np.abs(v.velocity))) for v in views)

    def fast(view: View) -> View:
        torques, speeds = 40.0 / torque * view.torque, 0.5 / speed * view.velocity
        return replace(view, torque=torques, velocity=speeds)

    effect = Added(TERM[name], (), (share * 40.0 / 0.5**power,))
    assert (reason(effect, fast) == "") is plausible
