"""Computes the signals of a motion from plain arrays, for the corrected model that is exported as a
separate file.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from identification.numerics.arrays import Array


def rest_times(time: Array, velocity: Array) -> Array:
    """Return the duration of rest at each sample, s, shape (n,): at rest the time since the rest
    began, in motion the duration of the last rest.
    """
    out = np.zeros(len(time))
    began = -1
    for k in range(1, len(time)):
        if velocity[k] == 0.0 and began < 0:
            began = k
        out[k] = time[k] - time[began] if began >= 0 else out[k - 1]
        if velocity[k] != 0.0:
            began = -1
    return out


def signals(
    m: Any,
    time: Array,
    angle: Array,
    velocity: Array,
    acceleration: Array,
    contact_force: Any = 0.0,
    weight_mass: float = 0.0,
    current: Any = 0.0,
    voltage: Any = 0.0,
    supply: Any = 1.0,
    known: Any = 0.0,
    known_inertia: float = 0.0,
    run_start: float = 0.0,
    number: int = 1,
) -> dict[str, Any]:
    """Return the signals of one recording; arrays of shape (n,), SI, at the joint except current
    and voltage.

    Args:
        m: Nominal parameters and bench constants.
        time: s, increasing.
        angle: rad.
        velocity: rad/s; zero at rest.
        acceleration: rad/s^2.
        contact_force: F_P, N.
        weight_mass: Mass on the lever, or of the weight that turns with the joint, kg.
        current: Logged current, A.
        voltage: Logged voltage, V.
        supply: Supply voltage, V.
        known: Torque of a weight that turns with the joint, less its inertia torque, N m.
        known_inertia: Inertia of the weight that turns with the joint, kg m^2.
        run_start: Time from the start of the first recording to the start of this recording, s.
        number: Number of the recording, from 1.
    """
    one = np.ones(len(time))
    moving = np.maximum.accumulate(np.where(velocity != 0.0, np.arange(len(time)), 0))
    return {
        "time": time,
        "run_time": run_start + time - time[0],
        "angle": angle,
        "velocity": velocity,
        "acceleration": acceleration,
        "sense": np.sign(velocity)[moving],
        "still": velocity == 0.0,
        "rest_time": rest_times(time, velocity),
        "moment": contact_force * m["L1"] * one,
        "mass": weight_mass,
        "known": known * one,
        "hanging": (known + known_inertia * acceleration) * one,
        "drive": m["ampere_torque"] * current * one,
        "current": current * one,
        "voltage": voltage * one,
        "supply": supply * one,
        "motor_angle": m["i"] * angle,
        "number": number,
    }
