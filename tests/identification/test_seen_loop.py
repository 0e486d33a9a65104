"""The drive's loop found in what it did."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.model.parameters import NOMINAL
from identification.recording import Bench, Recording
from identification.simulate.drive_loop import Loop, drive_loop, respond

PERIOD = 1e-3
STEP = 2.0 * np.pi / 409600.0
BENCH = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095)


def recorded(loop: Loop, late: int = 1, noise: float = 0.06, seed: int = 0) -> Recording:
    """Return 20 s at 20 deg and 0.2 Hz."""
    rng = np.random.default_rng(seed)
    count = 20000
    time = PERIOD * np.arange(count)
    command = math.radians(20.0) * np.sin(2.0 * np.pi * 0.2 * time) * np.minimum(time, 1.0)
    given = np.concatenate([np.zeros(late), command[: count - late]])
    out = respond(given, PERIOD, NOMINAL, 0.0, 2.0, loop, noise * rng.standard_normal(count))
    channels = {
        "time": time,
        "command": command,
        "motor_angle": BENCH.gear_ratio * np.floor(out.angle / STEP) * STEP,
        "current": out.torque / 3.0,
    }
    return Recording(name="run", channels=channels, bench=BENCH, averaged=frozenset({"current"}))


@pytest.mark.parametrize(
    ("velocity", "position", "integral"), [(120.0, 60.0, 60.0), (60.0, 25.0, 50.0)]
)
def test_the_gains_are_those_of_the_drive(
    velocity: float, position: float, integral: float
) -> None:
    found = drive_loop(
        [recorded(Loop(position, velocity, integral, 400.0, 75.0, STEP))], 75.0, STEP
    )
    assert found.velocity_gain == pytest.approx(velocity, rel=0.08)
    assert found.position_gain + found.integral == pytest.approx(position + integral, rel=0.1)
    assert found.position_gain * found.integral == pytest.approx(position * integral, rel=0.1)


@pytest.mark.parametrize("lag", [0.0, 0.25e-3])
def test_how_late_the_torque_is_comes_from_the_delay(lag: float) -> None:
    found = drive_loop([recorded(Loop(60.0, 120.0, 60.0, 400.0, 75.0, STEP, lag))], 75.0, STEP)
    assert found.lag == pytest.approx(lag, abs=0.12e-3)


def test_what_is_no_such_loop_is_not_taken_for_one() -> None:
    recording = recorded(Loop(60.0, 120.0, 60.0, 400.0, 75.0, STEP))
    shuffled = np.random.default_rng(1).permutation(recording.channels["current"])
    other = replace(recording, channels={**recording.channels, "current": shuffled})
    assert drive_loop([other], 75.0, STEP) is None
    blind = replace(
        recording, channels={k: v for k, v in recording.channels.items() if k != "command"}
    )
    assert drive_loop([blind], 75.0, STEP) is None
    assert drive_loop([], 75.0, STEP) is None
