"""Trial values follow the size of the machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.comparison import implausible
from identification.diagnosis.joint import Added
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.model.parameters import LINEAR
from identification.views.view import View, at_scale

from .benches import honest, nominal_fit

TERM = {t.name: t for t in MOTION}


def scaled(view: View, torque: float = 1.0, travel: float = 1.0, motion: str = "rotary") -> View:
    bench = replace(view.recording.bench, motion=motion)
    return replace(
        view,
        torque=torque * view.torque,
        angle=travel * view.angle,
        recording=replace(view.recording, bench=bench),
    )


@pytest.mark.parametrize(("torque", "travel"), [(0.05, 1.0), (1.0, 0.1), (0.02, 3.0)])
def test_the_trial_stiffnesses_of_presliding_are_those_of_the_machine(
    torque: float, travel: float
) -> None:
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


@pytest.mark.parametrize(
    ("name", "power"), [("asymmetric_viscous", 1), ("quadratic_drag", 2), ("asymmetric_coulomb", 0)]
)
@pytest.mark.parametrize(("share", "plausible"), [(0.4, True), (0.6, False)])
def test_friction_of_half_the_greatest_torque_is_plausible(
    name: str, power: int, share: float, plausible: bool
) -> None:
    views = nominal_fit(honest()).views
    torque = max(float(np.max(np.abs(v.torque))) for v in views)
    speed = max(float(np.max(np.abs(v.velocity))) for v in views)

    def fast(view: View) -> View:
        torques, speeds = 40.0 / torque * view.torque, 0.5 / speed * view.velocity
        return replace(view, torque=torques, velocity=speeds)

    effect = Added(TERM[name], (), (share * 40.0 / 0.5**power,))
    assert (reason(effect, fast) == "") is plausible
