"""A lever under a voltage-driven position loop, integrated on its own: not the model's integrator.

Explicit Euler at 0.1 ms; friction stops the joint where it would reverse it within a step.
"""

import math
from collections.abc import Mapping
from typing import Literal

import numpy as np

from identification.recording import Bench, Controller, Pendulum, Recording

DECLARED = Bench(torque_constant=0.5, back_emf_constant=0.5, resistance=4.0)
TRUE_KM, TRUE_R = 0.5, 3.2
"""The motor has a quarter more torque per volt than declared."""
TRUTH: Mapping[str, float] = {
    "Mc": 0.02,
    "Ms": 0.05,
    "omega_sf": 0.6,
    "sigma_2": 0.01,
    "J": 1.5e-3,
    "mu_gc": 0.12,
    "mu_gs": 0.22,
    "mu_gd": 1.0,
}
LATENESS = 0.012
GAIN, LIMIT, SUPPLY = 2.0, 0.95, 6.0
_STEP = 1e-4


def lever(
    mass: float,
    length: float,
    *,
    role: Literal["fit", "validate"] = "fit",
    seed: int = 0,
    truth: Mapping[str, float] = TRUTH,
    closed: bool = True,
    duration: float = 3.0,
    noise: float = 1e-3,
) -> Recording:
    """Return a recording of the loop, unevenly sampled at about 120 Hz.

    Args:
        mass: At the end of the lever, kg.
        length: Of the lever, m.
        role: Role of the recording.
        seed: Of noise, sampling and command.
        truth: Parameters.
        closed: Whether command, supply and controller are known; else only the motor voltage is.
        duration: s.
        noise: Of the angle, rad rms.
    """
    rng = np.random.default_rng(seed)
    count = int(duration / _STEP)
    clock = _STEP * np.arange(count)
    phase = rng.uniform(0.0, 1.0, 2)
    command = 0.9 * np.sin(2.0 * math.pi * (0.5 * clock + phase[0])) + 0.5 * np.sin(
        2.0 * math.pi * (1.3 * clock + phase[1])
    )
    angle, volts = _moved(clock, command, mass, length, truth)
    picked = np.cumsum(rng.integers(70, 97, size=count))
    picked = np.concatenate([[0], picked[picked < count]])
    channels = {"time": clock[picked]}
    channels["angle"] = angle[picked] + noise * rng.standard_normal(len(picked))
    if closed:
        channels["command"] = command[picked]
        channels["supply_voltage"] = np.full(len(picked), SUPPLY)
    channels["voltage"] = volts[picked]
    return Recording(
        name=f"{mass:g}kg_{length:g}m_{seed}",
        channels=channels,
        bench=DECLARED,
        pendulum=Pendulum(mass, length, 0.1),
        controller=Controller("duty", GAIN, limit=LIMIT) if closed else None,
        role=role,
    )


def _moved(
    clock: np.ndarray, command: np.ndarray, mass: float, length: float, truth: Mapping[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    late = round(LATENESS / _STEP)
    q, w = float(command[0]), 0.0
    angles, volts = np.empty(len(clock)), np.empty(len(clock))
    inertia = truth["J"] + mass * length**2
    for k in range(len(clock)):
        angles[k] = q
        duty = min(max(GAIN * (command[max(k - late, 0)] - q), -LIMIT), LIMIT)
        volts[k] = SUPPLY * duty
        motor = TRUE_KM / TRUE_R * (volts[k] - TRUE_KM * w)
        external = -mass * 9.80665 * length * math.sin(q - 0.1)
        load = abs(external - truth["mu_gd"] * motor)
        falling = math.exp(-((w / truth["omega_sf"]) ** 2))
        level = truth["Mc"] + (truth["Ms"] - truth["Mc"]) * falling
        level += load * (truth["mu_gc"] + (truth["mu_gs"] - truth["mu_gc"]) * falling)
        level += truth["sigma_2"] * abs(w)
        stopping = inertia * w / _STEP + motor + external
        w += (
            _STEP
            / inertia
            * (motor + external - math.copysign(min(abs(stopping), level), stopping))
        )
        q += _STEP * w
    return angles, volts
