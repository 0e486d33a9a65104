"""Values that cannot be, rows that do not follow each other, sizes that suggest another unit."""

from __future__ import annotations

import numpy as np
import pytest

from identification.recording import Array
from rig.sources.plausible import LARGEST, SMALLEST, STILL_LEVELS, unit_hints, value_errors

TIME = np.arange(2000) * 1e-3


def channels(**replaced: Array) -> dict[str, Array]:
    swing = np.sin(2.0 * np.pi * TIME)
    return {"time": TIME + 1.7e9, "angle": 0.3 * swing, "current": 2.0 * swing, **replaced}


def test_a_plain_recording_passes() -> None:
    assert (
        list(value_errors(channels(pressure=np.full(2000, 6e6), temperature=np.full(2000, 1e-300))))
        == []
    )
    assert list(unit_hints(channels(), 100.0, has_lever=True)) == []


@pytest.mark.parametrize(
    ("top", "bad"), [(LARGEST, False), (1.01 * LARGEST, True), (SMALLEST, False), (1e-300, True)]
)
def test_impossible_size(top: float, bad: bool) -> None:
    found = list(value_errors(channels(current=np.where(TIME > 1.0, top, np.nan))))
    assert [("`current` has its peak at" in text) for text in found] == [True] * bad


def test_a_channel_of_zeros_has_no_impossible_size() -> None:
    assert list(value_errors(channels(current=np.zeros(2000)))) == []


def test_rows_out_of_order_and_noise_are_refused() -> None:
    rng = np.random.default_rng(0)
    for position in (rng.permutation(channels()["angle"]), rng.standard_normal(2000)):
        (found,) = value_errors(channels(angle=position))
        assert found.startswith("`angle` jumps from sample to sample")


@pytest.mark.parametrize(("share_of_rate", "bad"), [(0.15, False), (0.19, True)])
def test_both_sides_of_the_fastest_sine(share_of_rate: float, bad: bool) -> None:
    fast = np.sin(2.0 * np.pi * share_of_rate * np.arange(2000))
    assert bool(list(value_errors(channels(angle=fast)))) is bad


def test_a_position_at_rest_is_left_to_the_fit() -> None:
    assert list(value_errors(channels(angle=np.full(2000, 0.1)))) == []


@pytest.mark.parametrize(("levels", "bad"), [(2, False), (STILL_LEVELS, False), (9, True)])
def test_an_encoder_that_flickers_at_rest_is_no_noise(levels: int, bad: bool) -> None:
    counts = np.random.default_rng(0).integers(0, levels, 2000)
    assert bool(list(value_errors(channels(angle=0.1 + 1e-3 * counts)))) is bad


def test_units_are_asked_for() -> None:
    (mA,) = unit_hints(channels(current=np.full(2000, -501.0)), 1.0, has_lever=False)
    assert "reaches 501 A: if it is in mA, set its scale to 0.001" in mA
    (mV,) = unit_hints({"voltage": np.array([np.nan, 2001.0])}, 1.0, has_lever=False)
    assert "if it is in mV" in mV
    assert list(unit_hints({"voltage": np.array([np.nan, np.nan])}, 1.0, has_lever=False)) == []


def test_a_lever_does_not_turn_round() -> None:
    turning = {"motor_angle": np.linspace(0.0, 2.02 * np.pi * 50.0, 100)}
    (found,) = unit_hints(turning, 50.0, has_lever=True)
    assert "turns the joint 1.01 times" in found
    assert list(unit_hints(turning, 51.0, has_lever=True)) == []
    assert list(unit_hints(turning, 50.0, has_lever=False)) == []
