"""A machine that hides something, followed on its exact channels, for tests."""

from dataclasses import replace

import numpy as np

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Machine, Sensing

EXACT = Machine(sensing=Sensing(0, 0, 0.0))
RATE_HZ = 20000.0
PER_AMPERE = 3.0
Effects = dict[str, dict[str, float]]


class Track:
    """A machine's exact channels under a command, one row a millisecond."""

    def __init__(
        self,
        effects: Effects,
        path: np.ndarray,
        weight_kg: float = 0.0,
        machine: Machine = EXACT,
        on: int = 1,
        pause_s: float = 0.0,
    ) -> None:
        self.machine = SimulatedMachine(replace(machine, effects=effects), np.random.default_rng(0))
        self.machine.hang(weight_kg)
        for _ in range(on):
            self.machine.power(False)
            self.machine.power(True)
        self.machine.rest(pause_s)
        rows = []
        for k in range(0, len(path), 20):
            self.machine.follow(path[k : k + 20])
            truth, seen = self.machine.truth(), self.machine.latch()
            rows.append(
                (
                    *truth[:4],
                    seen.motor_counts * 1e-6,
                    seen.joint_counts * self.machine.joint_count_rad,
                    *seen[3:6],
                )
            )
        (
            self.angle,
            self.speed,
            self.now_A,
            self.work,
            self.motor,
            self.seen,
            self.current,
            self.voltage,
            self.supply,
        ) = np.array(rows).T
        self.time = (np.arange(len(rows)) + 1) * 1e-3


def clock(duration_s: float) -> np.ndarray:
    return np.arange(1, round(duration_s * RATE_HZ) + 1) / RATE_HZ


def sine(duration_s: float = 2.0, amplitude: float = 0.2, frequency: float = 1.0) -> np.ndarray:
    t = clock(duration_s)
    return amplitude * np.sin(2.0 * np.pi * frequency * t) * np.clip(2.0 * t, 0.0, 1.0) ** 2


def cruise(speed: float, duration_s: float = 1.0) -> np.ndarray:
    t = clock(duration_s)
    return speed * np.where(t < 0.2, 0.5 * t * t / 0.2, t - 0.1)


def steady_torque(
    effects: Effects, speed: float, weight_kg: float = 0.0, machine: Machine = EXACT
) -> float:
    """Return the mean motor torque at the joint over the last fifth of a cruise."""
    track = Track(effects, cruise(speed), weight_kg, machine)
    return PER_AMPERE * float(np.mean(track.current[-200:]))
