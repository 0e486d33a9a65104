"""Six effects as a user would write them, each with a function that injects it into the simulated
machine, for tests and for the proof in :mod:`benchmarks.own_effects`.
"""
# mypy: ignore-errors
# ruff: noqa: D102, D103, N805, RUF012 - the file of a user

import math

import numpy as np

from identification.effects.own import OwnEffect, effect


@effect(c=("N m s^1.5/rad^1.5", 0.0, 20.0))
def root_drag(s, p):
    """Drag with the power 1.5 of the speed."""
    return p.c * s.velocity * np.abs(s.velocity) ** 0.5


def inject_root_drag(angle, speed, motor_torque, load, state, dt, p):
    return math.copysign(p.c * abs(speed) ** 1.5, speed)


@effect(k=("N m/rad^3", 0.0, 500.0))
def cubic_spring(s, p):
    """Spring that stiffens with the angle."""
    return p.k * s.angle**3


def inject_cubic_spring(angle, speed, motor_torque, load, state, dt, p):
    return p.k * angle * angle * angle


@effect(torque=("N m", 0.0, 20.0), speed=("rad/s", 0.03, 1.0), width=("rad/s", 0.01, 0.1))
def speed_resonance(s, p):
    """Drag around one speed, where something vibrates."""
    off = (np.abs(s.velocity) - p.speed) / p.width
    return p.torque * s.direction * np.exp(-0.5 * off**2)


def inject_speed_resonance(angle, speed, motor_torque, load, state, dt, p):
    off = (abs(speed) - p.speed) / p.width
    side = 1.0 if speed > 0.0 else -1.0 if speed < 0.0 else 0.0
    return side * p.torque * math.exp(-0.5 * off * off)


@effect(c=("s^2/rad^2", 0.0, 1.0))
def loaded_drag(s, p):
    """Drag with the square of the speed, in proportion to the load on the lever."""
    return p.c * s.load * s.velocity * np.abs(s.velocity)


def inject_loaded_drag(angle, speed, motor_torque, load, state, dt, p):
    return p.c * load * speed * abs(speed)


class LaggedDrag(OwnEffect):
    """Drag of a fluid that follows the speed with a lag."""

    parameters = {"c": ("N m s/rad", 0.0, 40.0), "lag": ("s", 0.03, 3.0)}
    states = 1

    def torque(s, x, dt, p):
        x[0] += (s.velocity - x[0]) * (1.0 - math.exp(-dt / p.lag))
        return p.c * x[0]


def inject_lagged_drag(angle, speed, motor_torque, load, state, dt, p):
    state[0] += dt / p.lag * (speed - state[0])
    return p.c * state[0]


class SealDrag(OwnEffect):
    """Seal that deforms before it slides, beside the friction of the bearing."""

    parameters = {"torque": ("N m", 0.0, 20.0), "travel": ("rad", 0.01, 0.5)}
    states = 2

    def torque(s, x, dt, p):
        if x[1] == 0.0:
            x[1] = 1.0
            x[0] = s.angle
        x[0] = min(max(x[0], s.angle - p.travel), s.angle + p.travel)
        return p.torque * (s.angle - x[0]) / p.travel


def inject_seal_drag(angle, speed, motor_torque, load, state, dt, p):
    state[0] += speed * dt / p.travel
    state[0] = max(-1.0, min(1.0, state[0]))
    return p.torque * state[0]
