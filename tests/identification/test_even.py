"""Lost and late samples filled on an even grid, and what that does to an estimate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.default import identify, solve_stages
from identification.filter.segments import motion
from identification.prepare import evened, prepare
from identification.recording import Array, Bench, Dataset, Model, Recording
from identification.signals import quantum

from .synthetic import TRUTH

STEP = 1e-4


def recording(time: Array) -> Recording:
    angle = np.floor(0.3 * np.sin(3.0 * time) / STEP) * STEP
    return Recording("r", {"time": time, "angle": angle, "torque": np.cos(3.0 * time)}, Bench())


def lost(whole: Recording, share: float, seed: int, hole: slice | None = None) -> Recording:
    keep = np.random.default_rng(seed).uniform(size=len(whole.time)) > share
    keep[0] = True
    if hole is not None:
        keep[hole] = False
    return replace(whole, channels={name: values[keep] for name, values in whole.channels.items()})


def test_even_recordings_are_left_alone() -> None:
    whole = recording(1e-3 * np.arange(5000))
    found = evened(whole)
    assert found[0] is whole
    assert not found[1].any()


@pytest.mark.parametrize("ppm", [0.0, 37.0, -80.0])
def test_lost_samples_are_filled_and_the_others_kept(ppm: float) -> None:
    true = 1e-3 * (1.0 + 1e-6 * ppm) * np.arange(30_000)
    whole = recording(np.round(true, 6))
    found = evened(lost(whole, 0.02, 1))
    assert found is not None
    even, holes = found
    assert not holes.any()
    assert even.time == pytest.approx(true, abs=2e-6)
    here = np.isin(np.arange(30_000), np.searchsorted(whole.time, lost(whole, 0.02, 1).time))
    assert np.array_equal(even.channels["torque"][here], whole.channels["torque"][here])
    assert np.max(np.abs(even.channels["angle"] - whole.channels["angle"])) < 1.5 * STEP
    assert quantum(even.channels["angle"]) == pytest.approx(STEP)


def test_long_holes_are_marked_and_their_stretch_is_left_out(
    practical_pair: tuple[Recording, Recording],
) -> None:
    whole = practical_pair[0]
    holed = lost(whole, 0.0, 0, slice(7000, 7060))
    found = evened(holed)
    assert np.array_equal(np.flatnonzero(found[1]), np.arange(7000, 7060))
    before, after = motion(whole), motion(holed)
    assert len(after.table) == len(before.table) - 1


def test_what_is_uneven_throughout_is_refused() -> None:
    rng = np.random.default_rng(0)
    assert evened(recording(np.cumsum(1e-3 * rng.uniform(0.5, 1.5, 3000)))) is None
    assert evened(lost(recording(1e-3 * np.arange(5000)), 0.3, 2)) is None


@pytest.mark.proof
def test_lost_cycles_no_longer_cost_the_rise_of_load_friction(
    practical_pair: tuple[Recording, Recording],
) -> None:
    pair = [lost(r, 0.01, k) for k, r in enumerate(practical_pair)]
    prepared = [prepare(r, 40.0) for r in pair]
    before, _ = solve_stages(prepared[:1], prepared[1:], Model(), lambda _stage, _share: None)
    assert abs(before["mu_s"] / TRUTH["mu_s"] - 1.0) > 0.5
    result = identify(Dataset(tuple(pair)))
    assert result.warnings == ()
    for name, value in TRUTH.items():
        limit = {"omega_sL": 0.03, "J": 0.01}.get(name, 0.004)
        assert result.values()[name] == pytest.approx(value, rel=limit), name
