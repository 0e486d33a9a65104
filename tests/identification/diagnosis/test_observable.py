"""Which effects recordings can show, from which size on, and which they cannot distinguish."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose, observable_effects
from identification.diagnosis.observable import Observable
from identification.diagnosis.result import Verdict
from identification.recording import Bench, Dataset, Model, Recording

from .benches import campaign

TEETH = 18
RATE_HZ = 500.0


@lru_cache
def nothing_hidden() -> dict[str, Observable]:
    found = observable_effects(Dataset(campaign({}, 3, 6.0), Model()))
    return {o.name: o for o in found}


def one_way(role: str, seed: int, amplitude_A: float) -> Recording:
    """A motor that turns one way, at a speed that hardly varies, with cogging; in amperes."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(12.0 * RATE_HZ)) / RATE_HZ
    speed = 6.0 + 0.5 * np.sin(0.7 * time)
    angle = np.cumsum(speed) / RATE_HZ
    current = 0.05 + 2e-3 * speed + amplitude_A * np.sin(TEETH * angle + 0.4)
    channels = {
        "time": time,
        "angle": np.round(angle / 1e-4) * 1e-4,
        "current": current + 0.004 * rng.standard_normal(len(time)),
    }
    return Recording(f"turn {seed}", channels, Bench(gear_ratio=1.0), "unloaded", role=role)  # type: ignore[arg-type]


def test_effects_of_one_regressor_are_alike_and_others_are_not() -> None:
    found = nothing_hidden()
    assert "cogging" not in found["torque_ripple"].alike
    assert found["gravity_imbalance"].alike.keys() >= {"return_spring"}
    assert found["brush_drop"].alike.keys() >= {"inverter_dead_time"}


def test_an_effect_is_found_above_its_least_size_and_not_below() -> None:
    least = nothing_hidden()["gravity_imbalance"].sizes["torque_Nm"]
    for times, missing in ((0.1, False), (8.0, True)):
        hidden = {"gravity_imbalance": {"torque_Nm": times * least, "zero_rad": 0.0}}
        found = diagnose(Dataset(campaign(hidden, 3, 6.0), Model()))
        assert (found.verdict is not Verdict.NOTHING_MISSING) == missing


def test_a_turn_one_way_does_not_distinguish_cogging_from_ripple() -> None:
    dataset = Dataset(
        (one_way("fit", 1, 0.03), one_way("fit", 2, 0.03), one_way("validate", 3, 0.03)),
        Model(terms=("offset",)),
    )
    seen = {o.name: o for o in observable_effects(dataset)}
    assert seen["cogging"].alike["torque_ripple"] == pytest.approx(1.0, abs=0.01)
    found = diagnose(dataset)
    assert found.verdict is Verdict.AMBIGUOUS
    assert {"cogging", "torque_ripple"} <= set(found.effects[0].alias_group)
    assert found.effects[0].confidence <= 0.5
    assert seen["backlash"].sizes == {}
