"""What is wrong in a stretch of one recording is said with the recording, the time and the
place.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.significance import (
    rests_under_torque,
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
