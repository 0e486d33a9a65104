from __future__ import annotations

import numpy as np
import pytest

from identification.recording import Bench, Recording
from identification.signals import track, tracking_error

TIME = 1e-3 * np.arange(4000)


def recording(angle: np.ndarray, command: np.ndarray, current: float = 2.0) -> Recording:
    channels = {"time": TIME, "angle": angle, "command": command}
    return Recording(
        "r", {**channels, "voltage": np.full(4000, 3.0), "current": np.full(4000, current)}, Bench()
    )


def test_a_target_is_due_one_sample_later() -> None:
    command = 0.1 * TIME
    arrived = np.concatenate([[0.0], command[:-1]])
    assert not np.any(tracking_error(recording(arrived, command)))
    np.testing.assert_allclose(tracking_error(recording(arrived - 2e-3, command)), 2e-3)


def test_errors_and_energy_of_a_part() -> None:
    command = 0.1 * np.minimum(TIME, 2.0)
    angle = np.concatenate([[0.0], command[:-1]]) - np.where(TIME < 3.0, 1e-3, 4e-3)
    whole, early = track(recording(angle, command)), track(recording(angle, command), 1.0, 3.0)
    assert early.rms == pytest.approx(1e-3)
    assert whole.rms == pytest.approx(np.sqrt((3 * 1e-6 + 16e-6) / 4))
    assert (whole.largest, whole.at_end) == (pytest.approx(4e-3), pytest.approx(4e-3))
    assert early.energy == pytest.approx(3.0 * 2.0 * 2.0)
    with pytest.raises(ValueError, match="no sample from 9"):
        track(recording(angle, command), 9.0)


def test_waiting_counts_only_while_the_command_moves() -> None:
    """It stands for the first of two seconds of the ramp, then follows; afterwards command and
    joint both rest.
    """
    command = 0.1 * np.minimum(TIME, 2.0)
    angle = 0.1 * np.clip(TIME - 1.0, 0.0, 1.0)
    assert track(recording(angle, command)).waiting == pytest.approx(0.5, abs=0.03)
    assert track(recording(command, command)).waiting == pytest.approx(0.0, abs=0.03)
