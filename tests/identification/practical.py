"""Recordings of the simulated practical bench as a drive would log them, without a bus."""

from dataclasses import replace

import numpy as np

from drivers.mock.plant.machine import simulate
from drivers.mock.plant.parts.constants import Machine
from identification.recording import Array, Bench, Recording

BENCH = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095)
COUNT_RAD = 2.0 * np.pi / 409600.0
CURRENT_QUANTUM_A = 0.015
DURATION_S = 20.0


def command(time: Array) -> Array:
    """20 deg at 0.2 Hz with a second to ramp in and out."""
    ends = np.clip(time, 0.0, 1.0), np.clip(DURATION_S - time, 0.0, 1.0)
    fade_in, fade_out = (0.5 - 0.5 * np.cos(np.pi * share) for share in ends)
    return np.asarray(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time) * fade_in * fade_out)


def simulated(seed: int, weight: float, machine: Machine | None = None) -> dict[str, Array]:
    """The exact channels."""
    machine = machine or Machine()
    return simulate(machine, command, DURATION_S, 1000.0, weight, rng=np.random.default_rng(seed))


def logged(out: dict[str, Array], weight: float, name: str = "") -> Recording:
    """Motor angle in counts, current in quanta and averaged over the period."""
    current = np.round(out["mean_current"] / CURRENT_QUANTUM_A) * CURRENT_QUANTUM_A
    return Recording(
        name=name or ("loaded" if weight else "unloaded"),
        channels={
            "time": out["time"],
            "motor_angle": np.floor(out["angle"] / COUNT_RAD) * COUNT_RAD * 100.0,
            "current": current,
        },
        bench=BENCH,
        stage="loaded" if weight else "unloaded",
        weight_mass=weight,
        averaged=frozenset({"current"}),
    )


def beginning(recording: Recording, seconds: float) -> Recording:
    """The first seconds alone, for what a few reversals show as well as many."""
    kept = recording.time < seconds
    return replace(
        recording, channels={name: values[kept] for name, values in recording.channels.items()}
    )


def with_ripple(recording: Recording, amplitude_N_m: float, periods: float) -> Recording:
    """Add a torque that depends on the joint angle and that no nominal parameter can take."""
    angle = recording.channels["motor_angle"] / 100.0
    current = recording.channels["current"] + amplitude_N_m / 3.0 * np.sin(periods * angle)
    return replace(recording, channels={**recording.channels, "current": current})
