"""Signals of one recording as a file of plain Python computes them from arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from identification.numerics.arrays import Array


class _Namespace:
    """Attributes by name."""

    def __init__(self, **given: Any) -> None:
        self.__dict__.update(given)


class Signals:
    """Signals of one recording with the names of :class:`identification.views.view.View`, SI, at
    the joint except those of the motor; arrays of shape (n,).
    """

    def __init__(
        self,
        m: Any,
        time: Array,
        angle: Array,
        velocity: Array,
        acceleration: Array,
        contact_force: Any = 0.0,
        weight_mass: float = 0.0,
        current: Any = 0.0,
        voltage: Any = 0.0,
        supply: Any = None,
        known: Any = 0.0,
        known_inertia: float = 0.0,
        run_start: float = 0.0,
        number: int = 1,
    ) -> None:
        """Compute the signals.

        Args:
            m: Nominal parameters and bench constants.
            time: s, evenly spaced.
            angle: rad.
            velocity: rad/s; zero at rest.
            acceleration: rad/s^2.
            contact_force: F_P, N.
            weight_mass: Mass on the lever, or of the weight that turns with the joint, kg.
            current: Logged current, A.
            voltage: Logged voltage, V.
            supply: Supply voltage, V; without it the greatest voltage is used.
            known: Torque of a weight that turns with the joint, less its inertia torque, N m.
            known_inertia: Inertia of the weight that turns with the joint, kg m^2.
            run_start: Time from the start of the first recording to the start of this recording, s.
            number: Number of the recording, from 1.

        Raises:
            ValueError: The times are not evenly spaced.
        """
        steps = np.diff(time)
        if np.max(steps) > 1.5 * np.median(steps):
            raise ValueError(
                f"time: samples must be evenly spaced, but the longest step is {np.max(steps):g} s "
                f"and the median step {np.median(steps):g} s; interpolate all signals to an even "
                "grid first"
            )
        one = np.ones(len(time))
        moving = np.maximum.accumulate(np.where(velocity != 0.0, np.arange(len(time)), 0))
        self.time, self.run_time = time, run_start + time - time[0]
        self.step = float(time[-1] - time[0]) / (len(time) - 1)
        self.angle, self.velocity, self.acceleration = angle, velocity, acceleration
        self.sense, self.still = np.sign(velocity)[moving], velocity == 0.0
        self.rest_time = rest_times(time, velocity)
        self.moment, self.known = contact_force * m["L1"] * one, known * one
        self.hanging = (known + known_inertia * acceleration) * one
        self.loaded = bool(np.any(self.moment != 0.0))
        self.burdened = bool(np.any(self.known))
        self.current, self.voltage = current * one, voltage * one
        self.supply = None if supply is None else supply * one
        self.transmitted = m["ampere_torque"] * self.current
        self.torque = self.transmitted + self.known
        self.motor, self.drive_angle, self.lag = m["i"] * angle, angle, None
        self.motor_speed = m["i"] * velocity
        self.rotor_acceleration = np.gradient(velocity, self.step)
        self.index, self.voltage_is_computed = number - 1, False
        bench = _Namespace(
            resistance=m["R"],
            inductance=m["L"],
            back_emf_constant=m["Ke"],
            moment_arm=m["L1"],
            gear_ratio=m["i"],
            ampere_torque=m["ampere_torque"],
        )
        self.recording = _Namespace(
            bench=bench,
            pendulum=None,
            weight_mass=weight_mass,
            time=time,
            period=self.step,
            channels={"current": self.current},
            averaged=(),
        )

    def with_velocity(self, velocity: Array) -> Signals:
        """Return the signals with another velocity of the joint."""
        other = Signals.__new__(Signals)
        other.__dict__.update({**self.__dict__, "velocity": velocity})
        return other

    def __getitem__(self, name: str) -> Any:
        """Return a signal by its name."""
        return getattr(self, name)


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
