"""What is wrong in a stretch of one recording is said with the recording, the time and the
place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.result import ResidualTrace
from identification.diagnosis.significance import (
    crowded_recordings,
    rests_under_torque,
    shortest,
)
from identification.recording import Recording
from identification.views.view import View, views

from .benches import campaign

FROM_S, TO_S = 7.0, 9.0


@pytest.fixture(scope="module")
def recordings() -> tuple[Recording, ...]:
    return campaign({"dwell_static_friction": {"growth_Nm": 3.0, "time_s": 1.0}}, 4)


def held(recording: Recording, torque_Nm: float) -> Recording:
    """Return a recording that stands for a while where it is, whatever the drive is asked for."""
    time, channels = recording.time, dict(recording.channels)
    where = (time >= FROM_S) & (time < TO_S)
    first = int(np.argmax(where))
    for name in ("angle", "motor_angle"):
        channels[name] = np.where(where, channels[name][first], channels[name])
    channels["current"] = np.where(where, torque_Nm / 3.0, channels["current"])
    return replace(recording, channels=channels)


def seen(recordings: tuple[Recording, ...]) -> tuple[View, ...]:
    return views(recordings, 25.0)


def test_a_joint_that_stands_under_a_torque_that_never_reached_it_is_told(
    recordings: tuple[Recording, ...],
) -> None:
    assert rests_under_torque(seen(recordings), "N m") == ()
    (line,) = rests_under_torque(seen((held(recordings[0], 150.0), *recordings[1:])), "N m")
    assert line.startswith(f"{recordings[0].name}: from 7.0")
    assert "to 9.0" in line
    assert "under a logged torque of 1.5e+02 N m" in line


def test_what_friction_holds_is_not_told(recordings: tuple[Recording, ...]) -> None:
    """Nor what the heaviest weight may hold, for which no other recording is a measure."""
    assert rests_under_torque(seen((held(recordings[0], 8.0), *recordings[1:])), "N m") == ()
    heaviest = max(range(len(recordings)), key=lambda k: recordings[k].contact_force)
    changed = tuple(held(r, 150.0) if k == heaviest else r for k, r in enumerate(recordings))
    assert rests_under_torque(seen(changed), "N m") == ()


def trace(name: str, after: np.ndarray) -> ResidualTrace:
    time = 0.1 * np.arange(len(after))
    return ResidualTrace(name, "fit", "torque", "N m", time, after, after)


def test_most_of_what_is_left_lies_in_one_recording_and_a_second_of_it() -> None:
    rng = np.random.default_rng(2)
    plain = [trace(f"r{k}", rng.standard_normal(100)) for k in range(5)]
    assert crowded_recordings(plain) == ()
    loud = rng.standard_normal(100) + np.where(
        (np.arange(100) >= 40) & (np.arange(100) < 50), 10.0, 0.0
    )
    (line,) = crowded_recordings([*plain, trace("loud", loud)])
    assert line.startswith("loud: ")
    assert "of the remaining torque mismatch" in line
    first, last = shortest(0.1 * np.arange(100), loud**2)
    assert first == pytest.approx(4.0, abs=0.25)
    assert last == pytest.approx(4.9, abs=0.25)
