"""The power map: one axis at a time, sizes that grow with their effects, and effects that are not
shown.
"""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from benchmarks.power.axes import AXES, BASE, base_world, worlds
from benchmarks.power.check import place_of, predicted
from benchmarks.power.page import sentence
from benchmarks.power.sizes import PARAMETER, injected, strength
from benchmarks.power.table import Key, Spread, decisive, spread
from identification.effects import EFFECTS
from rig.results.prove.worlds.world import World


@pytest.fixture(scope="module")
def base() -> World:
    return base_world(3, 1)


def test_every_effect_of_the_motion_has_a_size() -> None:
    motion = {e.name: e for e in EFFECTS.values() if e.group != "gas generator"}
    assert PARAMETER.keys() == motion.keys()
    for name, parameter in PARAMETER.items():
        assert parameter in [p.name for p in motion[name].parameters]


def test_worlds_differ_from_the_base_in_one_axis(base: World) -> None:
    parts = {
        "rate": {"log"},
        "voltage": {"log"},
        "bits": {"sensing"},
        "encoders": {"sensing"},
        "loads": {"recordings"},
        "excitation": {"recordings"},
    }
    seen = list(worlds(base))
    assert len(seen) == 1 + sum(len(values) - 1 for values in AXES.values())
    for axis, value, world in seen[1:]:
        assert value != BASE[axis]
        changed = {f.name for f in fields(World) if not same(world, base, f.name)}
        assert changed == parts[axis], (axis, value)


def same(a: World, b: World, name: str) -> bool:
    if name != "recordings":
        return bool(getattr(a, name) == getattr(b, name))
    return all(
        np.array_equal(p.command, q.command)
        and (p.weight_kg, p.pendulum) == (q.weight_kg, q.pendulum)
        for p, q in zip(a.recordings, b.recordings, strict=True)
    )


def test_a_size_grows_with_its_effect() -> None:
    for effect, weak, strong in (
        ("cogging", 0.1, -0.3),
        ("compliance", 900.0, 300.0),
        ("transmission_efficiency", 0.95, 0.8),
        ("stribeck_shape", 1.9, 1.2),
        ("load_exponent", 1.05, 0.7),
    ):
        sizes = [strength(effect, {PARAMETER[effect]: v}) for v in (weak, strong)]
        assert 0.0 < sizes[0] < sizes[1], effect
    assert strength("wrong_weight", {"mass_kg": 11.0}, [10.0, 20.0]) == pytest.approx(0.1)


def test_injected_sizes_are_those_of_the_proof(base: World) -> None:
    low, middle, high = injected(base, ["cogging"])["cogging"]["value"]
    assert 0.03 * base.constants.Mc < low < middle < high < 0.3 * base.constants.Mc


def test_quartiles_count_machines_that_show_nothing() -> None:
    assert spread([1.0, math.inf, 2.0, 3.0]) == (1.0, 2.0, 3.0)
    assert spread([1.0, math.inf, math.inf]).middle == math.inf


def cells_with(**medians: float) -> dict[Key, Spread]:
    found = {(a, v): Spread(0.1, 0.1, 0.1) for a, vs in AXES.items() for v in vs}
    found[("base", "base")] = Spread(0.1, 0.1, 0.1)
    given = {tuple(key.split("_", 1)): Spread(x, x, x) for key, x in medians.items()}
    return found | given  # type: ignore[operator]


def test_the_axis_that_decides_is_said_and_where_nothing_is_shown() -> None:
    cells = cells_with(encoders_motor=math.inf, excitation_steps=0.5)
    assert decisive(cells) == ("excitation", 5.0)
    cell: dict[str, Any] = {"least": {"backlash": {"gap_rad": 0.001}}}
    machine = {"cells": [cell], "injected": {"backlash": {"value": [0.01, 0.01, 0.01]}}}
    words = sentence([machine], "backlash", cells)
    assert words == (
        "`backlash` is shown from `gap_rad` = 0.001 rad (10 % of the injected size), but not "
        "with the motor's encoder alone. The excitation changes the least size of `backlash` most: "
        "with steps it is 5 times as great as with mixed motion."
    )


def test_a_place_in_the_world_is_the_base_times_the_factor_of_each_axis() -> None:
    axes = {
        "log_Hz": 200.0,
        "encoders": "motor 13 bit and joint 23 bit",
        "two_encoders": True,
        "load": "lever",
        "loads": 3.0,
        "motion": "sine, steps",
        "voltage": "absent",
    }
    assert place_of(axes) == {
        "rate": ["250 Hz"],
        "bits": ["24 bit"],
        "encoders": ["both"],
        "loads": ["2 weights"],
        "excitation": ["sine", "steps"],
        "voltage": ["absent"],
    }
    cells = cells_with(voltage_absent=0.3, excitation_steps=0.4)
    assert predicted(cells, axes) == pytest.approx(0.1 * 3.0 * 2.0)
    assert predicted(cells_with(voltage_absent=math.inf), axes) > 100.0
