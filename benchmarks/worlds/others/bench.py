"""What the plants of other packages share: friction and known loads of the joint, and the drive."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from benchmarks.worlds.loops import CASCADE, COUNT, LAST, STATES, SUM, asked, settings
from benchmarks.worlds.world import COMMAND_S, Signals, World

STEP_S = 6.5e-5
"""Longest step of the integration, s."""


def steps(world: World) -> int:
    """Return the number of integration steps in one period of the drive."""
    return math.ceil(1.0 / (world.drive.rate_Hz * STEP_S))


class Shaft:
    """Friction of the paper's nominal model and known loads of recording ``k``, at the joint.

    Attributes:
        inertia: Inertia of machine and known loads, kg m^2.
        viscous: Viscous friction, N m s/rad.
    """

    def __init__(self, world: World, k: int) -> None:
        planned, c = world.recordings[k], world.constants
        hung, gravity = planned.pendulum, world.gravity_m_s2
        self._c, self._moment = c, world.contact_N(k) * world.moment_arm_m
        self._steady = planned.steady_N_m(gravity)
        self._hung = self._zero = 0.0
        self.inertia = c.J + planned.hoisted_kg
        if hung is not None:
            self._hung, self._zero = hung.mass_kg * gravity * hung.length_m, hung.zero_rad
            self.inertia += hung.mass_kg * hung.length_m**2
        self.viscous = c.sigma_2 + self._moment * c.mu_2

    def load(self, angle: float) -> float:
        """Return the torque of the known loads, N m."""
        return self._steady - self._hung * math.sin(angle - self._zero)

    def friction(self, speed: float, free: float, inertia: float, step_s: float) -> float:
        """Return the dry friction of one explicit step, N m, which stops but never drives a body.

        Args:
            speed: Speed at the start of the step, rad/s.
            free: Torque on the body without dry friction, N m.
            inertia: Inertia of the body, kg m^2.
            step_s: Length of the step.
        """
        c = self._c
        level = c.Mc + (c.Ms - c.Mc) * math.exp(-((speed / c.omega_sf) ** 2))
        level += self._moment * (
            c.mu_c + (c.mu_s - c.mu_c) * math.exp(-((speed / c.omega_sL) ** 2))
        )
        return min(max(inertia * speed / step_s + free, -level), level)


class Machine(Protocol):
    """A machine that advances by one period of the drive at a time.

    Attributes:
        current: Current in the winding, A.
        shaft: Angle of the motor's shaft over the gear ratio, rad.
        angle: Angle of the joint, rad.
        mean_current: Mean current of the period before, A.
        terminal: Mean voltage at the motor in the period before, V.
        supply: Voltage of the supply in the period before, V.
    """

    current: float
    shaft: float
    angle: float
    mean_current: float
    terminal: float
    supply: float

    def advance(self, voltage: float) -> None:
        """Simulate one period of the drive, which commands this voltage, V."""
        ...


def played(world: World, machine_of: Callable[[World, int], Machine]) -> Iterator[Signals]:
    """Yield the signals of a machine in each recording, which begins at rest at zero.

    Args:
        world: The world.
        machine_of: Function that returns the machine of recording ``k``, with the current that
            holds its steady load.
    """
    session_s, rate = 0.0, world.drive.rate_Hz
    p, at_motor = settings(world), world.sensing.motor_bits is not None
    for k, planned in enumerate(world.recordings):
        session_s = session_s + planned.pause_s if world.log.clock else 0.0
        machine, s = machine_of(world, k), np.zeros(STATES)
        if p[CASCADE] > 0.0:
            s[SUM] = -planned.steady_N_m(world.gravity_m_s2)
        n = round(len(planned.command) * COMMAND_S * rate)
        command, torque = planned.sent(np.arange(n) / rate)
        noise = np.random.default_rng([*world.seed, 7, k]).standard_normal((2, n))
        noise[0] *= world.sensing.current_noise_A
        noise[1] *= world.sensing.flicker * p[COUNT]
        speed, sends = np.gradient(command, 1.0 / rate), world.host_sends(k, n)
        sent = np.column_stack((command, speed, torque, sends))
        before, during, volts = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
        s[LAST] = round(machine.angle / p[COUNT]) * p[COUNT]
        for row in range(n):
            before[row] = machine.current, machine.shaft, machine.angle
            seen = machine.shaft if at_motor else machine.angle
            volts[row] = asked(
                p, s, sent[row], seen + noise[1, row], machine.current + noise[0, row]
            )
            machine.advance(volts[row])
            during[row] = machine.mean_current, machine.terminal, machine.supply
        first = round(planned.lead_s * rate)
        yield Signals(
            current=before[first:, 0],
            voltage=volts[first:],
            terminal=during[first:, 1],
            supply=during[first:, 2],
            motor_angle=before[first:, 1] * world.motor.gear_ratio,
            angle=before[first:, 2],
            command=command[first:],
            start_s=session_s + planned.lead_s,
            mean_current=during[first:, 0],
        )
        session_s += len(planned.command) * COMMAND_S
