"""Simulates a machine and samples its exact signals in every period of the drive's loops.

In place of the drive's own loops, a host may close the position loop or send a course of torque:
torques arrive in given loop periods, and the drive produces each torque until the next one arrives.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plant.effects.kernel import (
    CONSTANTS_AT,
    Histories,
    dead_time_voltage,
    mesh_error,
    read_rotor,
)
from drivers.mock.plant.effects.table import (
    HEAT,
    JOINT,
    NOMINAL_SUPPLY,
    RUN,
    STEADY_LOAD,
    SUPPLY,
    TORQUE_CURRENT,
)
from drivers.mock.plant.gas import advance_loaded
from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts import constants, loops
from drivers.mock.plant.parts.compiled import Vector, compiled

(
    SENT_ANGLE,
    SENT_TORQUE,
    SENDS,
    ENCODER_ERROR,
) = range(4)
(
    CURRENT,
    MEAN_CURRENT,
    VOLTAGE,
    TERMINAL,
    LINK,
    ROTOR_ANGLE,
    JOINT_ANGLE,
    SAMPLED,
) = range(8)


class Sent(NamedTuple):
    """Inputs in every loop period, arrays of shape (n,).

    Attributes:
        angle_rad: Commanded joint angle.
        torque_N_m: Torque that a host plans, in addition to the torque of its control law.
        sends: 1 in periods in which the host sends a torque, else 0.
        encoder_error_rad: Error of the drive's encoder before quantisation, at the joint.
    """

    angle_rad: NDArray[np.float64]
    torque_N_m: NDArray[np.float64]
    sends: NDArray[np.float64]
    encoder_error_rad: NDArray[np.float64]


class Sampled(NamedTuple):
    """Exact signals at the start of every loop period, arrays of shape (n,).

    Attributes:
        current_A: Current in the winding.
        mean_current_A: Mean current in the period.
        voltage_V: Voltage that the drive commands for the period.
        terminal_V: Mean voltage at the motor in the period, less the drop of the supply and the
            dead time, which opposes the mean current.
        supply_V: Voltage of the supply in the period.
        rotor_rad: Angle of the motor's shaft over the gear ratio.
        joint_rad: Angle of the joint.
    """

    current_A: NDArray[np.float64]
    mean_current_A: NDArray[np.float64]
    voltage_V: NDArray[np.float64]
    terminal_V: NDArray[np.float64]
    supply_V: NDArray[np.float64]
    rotor_rad: NDArray[np.float64]
    joint_rad: NDArray[np.float64]


class SampledMachine(SimulatedMachine):
    """The simulated machine, sampled in every loop period, with effects of any size.

    The machine starts at rest with the joint at angle 0, the power off and no load.
    """

    def __init__(
        self,
        machine: constants.Machine,
        rng: np.random.Generator,
        count_rad: float,
        run_s: float = 0.0,
        heat_K: float = 0.0,
    ) -> None:
        """Build a machine.

        Args:
            machine: Constants of the machine.
            rng: Random generator of the noise of the current sensor.
            count_rad: Step of the encoder with which the drive closes its loops, at the joint; 0
                for an exact encoder.
            run_s: Running time before the simulation, on which drifts of friction depend.
            heat_K: Temperature of the winding above ambient.
        """
        super().__init__(machine, rng, any_size=True)
        self._d[loops.COUNT] = count_rad
        self._x[RUN], self._x[HEAT] = run_s, heat_K
        self._s[loops.THETA] = self._s[loops.MEASURED] = mesh_error(0.0, self._e)[0]

    @property
    def heat_K(self) -> float:
        """Return the temperature of the winding above ambient."""
        return float(self._x[HEAT])

    def carry(self, torque_N_m: float, inertia_kg_m2: float) -> None:
        """Load the joint with a torque that is the same at every angle, and with an inertia."""
        self._e[CONSTANTS_AT + STEADY_LOAD] = torque_N_m
        self._fixed_inertia += inertia_kg_m2
        self._load()

    def hold(self, torque_N_m: float) -> None:
        """Set current and integrals of the loops to those of a motor that holds this torque at
        rest.
        """
        s, d = self._s, self._d
        current = torque_N_m / d[loops.TORQUE_PER_AMPERE]
        s[loops.CURRENT] = self._x[TORQUE_CURRENT] = current
        s[loops.VOLTAGE_INTEGRAL] = d[loops.RESISTANCE] * current
        if d[loops.VELOCITY_INTEGRAL_GAIN] > 0.0:
            s[loops.VELOCITY_INTEGRAL] = torque_N_m / d[loops.VELOCITY_GAIN]

    def sample(self, sent: Sent, law: tuple[float, float] | None = None) -> Sampled:
        """Simulate one loop period for each input, and return the signals.

        Args:
            sent: The inputs.
            law: Stiffness, N m/rad, and damping, N m s/rad, with which a host computes its torque
                from the commanded angle and from angle and speed that the drive measured one loop
                period before; None if the drive closes its own loops.
        """
        out = np.zeros((SAMPLED, len(sent.angle_rad)))
        noise = self._take_noise(len(sent.angle_rad))
        vectors = _Vectors(
            self._s, self._x, self._histories, self._d, self._p, self._e, self._y, self._g
        )
        _sample(vectors, noise, np.vstack(sent), np.asarray(law or (), dtype=np.float64), out)
        return Sampled(*out)


class _Vectors(NamedTuple):
    """Vectors of a machine, the arguments of :func:`drivers.mock.plant.gas.advance_loaded`."""

    s: Vector
    x: Vector
    histories: Histories
    d: Vector
    p: Vector
    e: Vector
    y: Vector
    g: Vector


@compiled
def _sample(v: _Vectors, noise: Vector, sent: Histories, law: Vector, out: Histories) -> None:
    """Advance one loop period for each column of ``sent``; write the signals into ``out``."""
    s, x, d, e = v.s, v.x, v.d, v.e
    period = d[loops.LOOP_S]
    for k in range(sent.shape[1]):
        if len(law) > 0 and sent[SENDS, k] > 0.0:
            torque = sent[SENT_TORQUE, k] + law[0] * (sent[SENT_ANGLE, k] - s[loops.MEASURED])
            torque -= law[1] * s[loops.VELOCITY_ESTIMATE]
            s[loops.OFFSET] = torque / d[loops.TORQUE_PER_AMPERE]
        s[loops.FLICKER] = sent[ENCODER_ERROR, k]
        out[CURRENT, k] = s[loops.CURRENT]
        out[ROTOR_ANGLE, k] = read_rotor(s[loops.THETA], e)
        out[JOINT_ANGLE, k] = x[JOINT]
        path = sent[SENT_ANGLE, k : k + 1]
        advance_loaded(1, s, x, v.histories, d, v.p, e, v.y, v.g, noise[k : k + 1], path)
        out[MEAN_CURRENT, k] = s[loops.SUM_CURRENT] / period
        out[VOLTAGE, k] = out[TERMINAL, k] = s[loops.SUM_VOLTAGE] / period
        out[LINK, k] = x[SUPPLY]
        nominal = e[CONSTANTS_AT + NOMINAL_SUPPLY]
        out[TERMINAL, k] *= x[SUPPLY] / nominal
        dead = dead_time_voltage(x[SUPPLY], nominal, e)
        out[TERMINAL, k] -= dead * np.sign(s[loops.SUM_CURRENT])
        s[loops.SUM_CURRENT] = s[loops.SUM_VOLTAGE] = s[loops.SUM_NOISE] = s[loops.SUM_LOOPS] = 0.0
