"""Where a recording moves: stretches between rests, and when they break away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.filter.segments import Motion, motion
from identification.recording import Recording

from .practical import simulated


@pytest.fixture
def free(practical_pair: tuple[Recording, Recording]) -> Motion:
    return motion_of(practical_pair[0])


def motion_of(recording: Recording) -> Motion:
    found = motion(recording)
    assert found is not None
    return found


def drop(recording: Recording, *names: str) -> Recording:
    return replace(
        recording, channels={k: v for k, v in recording.channels.items() if k not in names}
    )


def swap(recording: Recording, **channels: np.ndarray) -> Recording:
    return replace(recording, channels={**recording.channels, **channels})


def test_stretches_lie_between_the_true_rests(practical_pair: tuple[Recording, Recording]) -> None:
    truth = simulated(10, 30.6)
    found = motion_of(practical_pair[1])
    assert len(found.table) >= 8
    for (first, last, side, rise), seen in zip(found.table, found.seen, strict=True):
        window = truth["velocity"][int(seen) : int(last)]
        assert np.all(side * window > 0.0)
        assert truth["velocity"][int(first) - 1] == 0.0
        assert rise > 0.0
        assert first <= seen < last


@pytest.mark.parametrize(("case", "weight"), [(0, 0.0), (1, 30.6)])
def test_static_crossing_is_when_the_shaft_broke_away(
    practical_pair: tuple[Recording, Recording], case: int, weight: float
) -> None:
    truth = simulated(10 * case, weight)
    found = motion_of(practical_pair[case])
    static = 12.025 + 0.095 * 10.0 * weight * 9.80665 * 0.086
    crossings = found.static_crossing(static)
    for (first, _, _, _), when in zip(found.table, crossings, strict=True):
        moving = int(first) + int(np.flatnonzero(truth["velocity"][int(first) :])[0])
        assert when == pytest.approx(truth["time"][moving], abs=2e-3)


def test_the_speed_is_unsure_only_where_a_stretch_all_but_stops(
    practical_pair: tuple[Recording, Recording],
) -> None:
    recording = practical_pair[1]
    smooth = motion_of(recording)
    first, last, side, _ = smooth.table[3]
    k = int(0.5 * (first + last))
    assert not np.any(smooth.unsure[k - 50 : k + 50])
    channel = "motor_angle"
    angle = recording.channels[channel].copy()
    # Held for 6 samples, then on as before: too short a pause to count as rest.
    pause = side * (angle[k + 6] - angle[k])
    assert pause > 0.0
    angle[k + 6 :] -= side * pause
    angle[k : k + 6] = angle[k]
    found = motion_of(swap(recording, **{channel: angle}))
    marked = np.flatnonzero(found.unsure[k - 50 : k + 70]) + k - 50
    assert marked[0] >= k - 1
    assert marked[-1] <= k + 7
    assert len(marked) >= 5
    fastest = float(np.max(np.abs(simulated(10, 30.6)["velocity"])))
    assert found.unsure[k + 3] == pytest.approx((0.1 * fastest) ** 2, rel=0.1)


def test_no_stretches_without_an_encoder_a_torque_or_even_sampling(
    practical_pair: tuple[Recording, Recording],
) -> None:
    recording = practical_pair[0]
    exact = simulated(0, 0.0)["angle"] * 100.0
    jitter = recording.time + np.random.default_rng(0).uniform(0.0, 2e-4, len(recording.time))
    assert motion(recording) is not None
    assert motion(drop(recording, "motor_angle")) is None
    assert motion(drop(recording, "current")) is None
    assert motion(swap(recording, motor_angle=exact)) is None
    assert motion(swap(recording, time=jitter)) is None


def test_strokes_alike_are_those_of_one_motion_either_way(free: Motion) -> None:
    ends = np.isin(np.arange(len(free.table)), [0, len(free.table) - 1])
    assert np.array_equal(free.matching, ends[:, None] == ends)
