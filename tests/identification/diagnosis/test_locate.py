"""Where the mismatch is said to be: over the coordinate that fixes it, for friction with its
sign.
"""

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.joint import Joint, fit, without_effect
from identification.diagnosis.linear import Added
from identification.diagnosis.locate import Mismatch, best_map, maps, mismatch_of, ranges
from identification.diagnosis.rows import FROM_TORQUE, functions
from identification.effects import MOTION
from identification.recording import Array, Dataset

from .benches import campaign, honest, nominal_fit

CENTER_RAD, WIDTH_RAD = 0.1, 0.06
TERM = {term.name: term for term in MOTION}


def test_a_worn_patch_lies_where_it_is_though_its_torque_turns_with_the_motion() -> None:
    patch = {"torque_Nm": 2.0, "center_rad": CENTER_RAD, "width_rad": WIDTH_RAD}
    joint = nominal_fit(campaign({"position_dependent_friction": patch}, 12, 8.0))
    torque = joint.equations[0]
    before = torque.sigma * joint.residual[joint.stack.part("torque")]
    drawn = maps(joint.stack, torque, before, np.zeros_like(before), np.random.default_rng(0))
    angle = next(m for m in drawn if m.coordinate == "angle")
    assert angle.against_motion
    assert angle.share > 0.5
    assert any(low < CENTER_RAD < high for low, high in ranges(angle))
    assert angle.mean[np.argmin(np.abs(angle.centre - CENTER_RAD))] > 0.5


HIDDEN = {
    "angle": {"load_position_dependence": {"slope_per_rad": 0.5}},
    "motor angle": {"cogging": {"torque_Nm": 2.0, "per_motor_turn": 6.0, "phase_rad": 0.4}},
    "load": {"lever_pivot_friction": {"torque_Nm": 3.0}},
    "current direction": {"brush_drop": {"voltage_V": 1.0, "current_A": 0.3}},
}


@pytest.mark.parametrize("coordinate", HIDDEN)
def test_a_mismatch_lies_over_the_coordinate_that_it_is_a_function_of(coordinate: str) -> None:
    joint = nominal_fit(campaign(HIDDEN[coordinate], 14, 8.0))
    name = "voltage" if coordinate == "current direction" else "torque"
    equation = next(e for e in joint.equations if e.name == name)
    before = equation.sigma * joint.residual[joint.stack.part(name)]
    drawn = maps(joint.stack, equation, before, before, np.random.default_rng(0))
    found = best_map(drawn, coordinate)
    assert (found.coordinate, found.share > 0.8) == (coordinate, True)


def test_the_measured_torque_locates_its_own_mismatch_only_if_it_is_the_stated_coordinate() -> None:
    joint = nominal_fit(campaign({"torque_saturation": {"knee_A": 15.0}}, 15, 8.0))
    torque, rng = joint.equations[0], np.random.default_rng(0)
    rest = torque.sigma * joint.residual[joint.stack.part("torque")]
    assert not {m.coordinate for m in maps(joint.stack, torque, rest, rest, rng)} & {*FROM_TORQUE}
    drawn = maps(joint.stack, torque, rest, rest, rng, "torque")
    assert drawn[0].coordinate == "torque"
    assert drawn[0].share > 0.9


def of_noise(equation: str, noise: Array, joint: Joint) -> Mismatch:
    residual = joint.residual.copy()
    residual[joint.stack.part(equation)] = noise
    left = joint.stack.projected(residual[:, None])[:, 0]
    return mismatch_of(replace(joint.stack, residual=left), equation)


@pytest.mark.parametrize("equation", ["torque", "transmission"])
def test_chance_explains_nothing(equation: str) -> None:
    """The noise is constant within each block: the worst that the blocks allow."""
    joint = nominal_fit(honest())
    block = joint.stack.block[joint.stack.part(equation)]
    time = np.arange(len(block), dtype=float)
    shares = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        noise = rng.normal(size=joint.stack.blocks)[block] + 0.3 * rng.normal(size=len(block))
        made = of_noise(equation, noise, joint)
        shares.append(made.explained(functions(time), np.ones(len(time))))
        assert made.explained(functions(time), np.zeros(len(time))) == 0.0
    assert np.median(shares) < 0.05
    assert max(shares) < 0.35


@pytest.mark.proof
def test_an_offset_of_the_current_lies_in_the_torque_equation() -> None:
    """The voltage equation, in which an offset shows less, has more rows."""
    recordings = campaign({"current_offset": {"current_A": 0.3}}, 18, 8.0)
    found = diagnose(Dataset(recordings), rng=np.random.default_rng(1))
    effect = found.effects[0]
    assert effect.name in ("current_offset", "asymmetric_coulomb")
    assert found.fit.equation == "torque"
    assert effect.where.coordinate == "direction"


def test_an_effect_is_located_beside_the_other_effects() -> None:
    hidden = {
        "lever_pivot_friction": {"torque_Nm": 3.0},
        "return_spring": {"stiffness_Nm_rad": 20.0, "rest_rad": 0.0},
    }
    first = nominal_fit(campaign(hidden, 17, 8.0))
    added = [
        Added(TERM["lever_pivot_friction"], (), (0.0,)),
        Added(TERM["return_spring"], (), (0.0,) * 2),
    ]
    joint = fit(first.equations[0].views, "N m", first.nominal, added, first)
    torque = joint.equations[0]
    for k, coordinate in enumerate(("load", "angle")):
        stack = without_effect(joint, k)
        rest = torque.sigma * stack.residual[stack.part("torque")]
        best = best_map(maps(stack, torque, rest, rest, np.random.default_rng(0)), coordinate)
        assert (best.coordinate, best.share > 0.9) == (coordinate, True)
        # A projection removes only what the nominal parameters and the other effect can take up.
        assert stack.residual @ stack.residual > 10.0 * joint.cost
        assert np.allclose(stack.effect_basis.T @ stack.residual, 0.0, atol=1e-6)
