"""Where the torque's samples are late, what is at an angle is met where the joint then was."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.stack import stack_of, view_regressors
from identification.effects import MOTION
from identification.effects.effect import Effect
from identification.numerics.series import delayed_series

from .benches import campaign, honest, nominal_fit

LATE_S = 0.008
TERM = {t.name: t for t in MOTION}
COGGING = (7.0,)


def with_skew(joint: Joint, ripple: Effect, fraction: tuple[float, float]) -> float:
    """Return the torque's mean square over the noise's with a skew and a ripple fitted."""
    effects = (Added(TERM["time_skew"], (LATE_S,), (1.0,)), Added(ripple, (4.0,), fraction))
    found = fit(joint.equations[0].views, "N m", joint.nominal, effects, joint)
    return float(np.mean(found.residual[found.stack.part("torque")] ** 2))


@pytest.mark.parametrize(
    "name", ["cogging", "torque_ripple", "gear_mesh_ripple", "position_dependent_friction"]
)
def test_a_regressor_at_an_angle_is_late_where_the_torque_is(name: str) -> None:
    joint = nominal_fit(honest())
    view, term = joint.equations[0].views[1], TERM[name]
    shape = {"gear_mesh_ripple": (20.0, 1.0), "position_dependent_friction": (0.1, 0.05)}.get(
        name, COGGING
    )
    prompt = view_regressors(term, "torque", joint.nominal, shape)(view)
    late = view_regressors(term, "torque", replace(joint.nominal, late_s=LATE_S), shape)(view)
    steady = (
        np.abs(view.velocity) > 0.1
    )  # friction jumps at a reversal, which no interpolation follows
    expected = np.stack([delayed_series(row, view.step, LATE_S) for row in prompt])
    assert np.max(np.abs(late - expected)[:, steady]) < 5e-3 * np.max(np.abs(expected))
    assert np.max(np.abs(prompt - expected)[:, steady]) > 0.02 * np.max(np.abs(expected))


def test_rows_kept_from_a_prompt_torque_are_not_taken_for_late_ones() -> None:
    joint = nominal_fit(honest())
    prompt = joint.stack.columns(TERM["cogging"], COGGING)["torque"]
    late = stack_of(joint.equations, replace(joint.nominal, late_s=LATE_S), joint.stack)
    assert not np.allclose(late.columns(TERM["cogging"], COGGING)["torque"], prompt)
    assert joint.stack.columns(TERM["cogging"], COGGING)["torque"] is prompt


def test_a_ripple_beside_a_late_current_leaves_far_less() -> None:
    """Each way its phase is another, where its angle is not late as well."""
    hidden = {
        "time_skew": {"time_s": LATE_S},
        "torque_ripple": {"fraction": 0.1, "per_motor_turn": 4.0, "phase_rad": 0.0},
    }
    joint = nominal_fit(campaign(hidden, 3, 6.0))
    ripple = TERM["torque_ripple"]
    prompt = with_skew(joint, ripple.modified(at_angle=False), (0.1, 0.0))
    assert with_skew(joint, ripple, (0.1, 0.0)) < 0.01 * prompt
