"""Where the mismatch is said to be: over the coordinate that fixes it, for friction with its
sign.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.joint import Joint, fit, without_effect
from identification.diagnosis.linear import Added
from identification.diagnosis.locate import (
    Mismatch,
    best_map,
    maps,
    mismatch_of,
    parts,
    ranges,
)
from identification.diagnosis.result import Map
from identification.diagnosis.rows import (
    DIRECTION,
    FROM_TORQUE,
    MAPPED,
    at_rows,
    functions,
    shows,
    weight_of,
)
from identification.effects import MOTION
from identification.recording import Array, Dataset

from .benches import campaign, honest, nominal_fit
from .test_fits import begun_with

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


def test_its_own_coordinate_is_given_where_it_explains_as_much() -> None:
    joint = nominal_fit(honest())
    torque = joint.equations[0]
    rest = torque.sigma * joint.residual[joint.stack.part("torque")]
    made = maps(joint.stack, torque, rest, rest, np.random.default_rng(0))[0]
    best, own, poor = (
        replace(made, coordinate=name, share=share)
        for name, share in (("torque", 0.9), ("angle", 0.8), ("time", 0.3))
    )
    assert best_map([best, own, poor], "angle") is own
    assert best_map([best, own, poor], "time") is best
    assert best_map([], "time") is None


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
    assert found is not None
    assert (found.coordinate, found.share > 0.8) == (coordinate, True)


def test_the_measured_torque_locates_its_own_mismatch_only_if_it_is_the_stated_coordinate() -> None:
    joint = nominal_fit(campaign({"torque_saturation": {"knee_A": 15.0}}, 15, 8.0))
    torque, rng = joint.equations[0], np.random.default_rng(0)
    rest = torque.sigma * joint.residual[joint.stack.part("torque")]
    assert not {m.coordinate for m in maps(joint.stack, torque, rest, rest, rng)} & {*FROM_TORQUE}
    drawn = maps(joint.stack, torque, rest, rest, rng, "torque")
    assert drawn[0].coordinate == "torque"
    assert drawn[0].share > 0.9


def test_functions_of_a_coordinate() -> None:
    assert functions(np.full(50, 2.0)) == []
    (sides,) = functions(np.repeat([-1.0, 1.0], 25))
    assert np.array_equal(sides, np.repeat(np.eye(2), 25, axis=0))
    values = np.random.default_rng(0).normal(size=2000)
    for made in (np.abs(values), np.where(values > np.median(values), 1.0, 0.0)):
        basis = functions(values)[-1]
        rest = made - basis @ np.linalg.lstsq(basis, made)[0]
        assert rest @ rest < 0.01 * np.var(made) * len(made)


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


def test_a_slow_function_of_time_is_found_in_few_blocks() -> None:
    joint = nominal_fit(honest())
    block = joint.stack.block[joint.stack.part("torque")]
    time = np.arange(len(block), dtype=float)
    drift = 30.0 * (time / len(time)) ** 2
    noise = drift + np.random.default_rng(0).normal(size=len(time))
    assert of_noise("torque", noise, joint).explained(functions(time), np.ones(len(time))) > 0.8


def test_recordings_that_repeat_a_motion_lie_in_different_parts() -> None:
    part = parts(np.repeat(np.arange(60), 30))
    assert np.array_equal(np.bincount(part), np.full(10, 180))
    assert len(set(part[::300])) > 2
    assert np.array_equal(np.unique(parts(np.repeat([3, 13, 23], 5))), [0, 1, 2])


def test_a_rest_time_is_told_at_the_breakaways_themselves() -> None:
    joint = nominal_fit(honest())
    equation = next(e for e in joint.equations if e.name == "breakaway")
    weight = weight_of(equation)
    assert weight.min() < 0.5
    direction = at_rows(DIRECTION, equation, weight)
    assert set(direction) == {-1.0, 1.0}


def test_an_offset_of_the_current_lies_in_the_torque_equation() -> None:
    """The voltage equation, in which an offset shows less, has more rows."""
    recordings = campaign({"current_offset": {"current_A": 0.3}}, 18, 8.0)
    found = diagnose(Dataset(recordings), rng=np.random.default_rng(1))
    effect = found.effects[0]
    assert effect.name in ("current_offset", "asymmetric_coulomb")
    assert found.fit.equation == "torque"
    assert effect.where.coordinate == "direction"


def test_a_shape_that_the_nominal_model_takes_over_is_missing_without_it() -> None:
    first = nominal_fit(campaign({"stribeck_shape": {"alpha": 0.8}}, 19, 8.0))
    views = first.equations[0].views
    begun = begun_with(first, "stribeck_shape")
    joint = fit(views, "N m", begun.nominal, begun.effects, first)
    rows = joint.stack.part("torque")
    left, before = without_effect(joint, 0).residual[rows], first.residual[rows]
    assert left @ before / math.sqrt((left @ left) * (before @ before)) > 0.9
    assert left @ left > 2.0 * (joint.residual[rows] @ joint.residual[rows])


def test_the_motor_angle_needs_turns_and_an_origin() -> None:
    views = nominal_fit(honest()).equations[0].views
    motor = next(c for c in MAPPED if c.periodic)
    assert shows(motor, views)
    geared = [replace(v, motor=v.motor / 100.0) for v in views]
    assert not shows(motor, geared)
    assert shows(motor, geared, stated=True)
    speed_only = [
        replace(v, recording=replace(v.recording, channels={"time": v.time})) for v in views
    ]
    assert not shows(motor, speed_only)


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
        assert best is not None
        assert (best.coordinate, best.share > 0.9) == (coordinate, True)
        # A projection removes only what the nominal parameters and the other effect can take up.
        assert stack.residual @ stack.residual > 10.0 * joint.cost
        assert np.allclose(stack.effect_basis.T @ stack.residual, 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("centre", "outside", "found"),
    [
        ([-1.0, 1.0], [True, True], ((-1.0, 1.0),)),
        ([-1.0, 1.0], [False, True], ((0.0, 1.0),)),
        ([0.0, 1.0, 10.0, 11.0], [False, True, False, True], ((0.5, 5.5), (10.5, 11.0))),
    ],
)
def test_ranges_meet_between_bins_and_end_with_the_data(
    centre: list[float], outside: list[bool], found: tuple[tuple[float, float], ...]
) -> None:
    at, high = np.array(centre), np.where(outside, 2.0, 1.0)
    low = np.where(outside, 1.0, -1.0)
    zero = np.zeros(len(at))
    drawn = Map("torque", "direction", "1", "N m", at, zero, low, high, zero, 1.0)
    assert ranges(drawn) == found
