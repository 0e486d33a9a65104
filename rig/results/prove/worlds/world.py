"""Describes one drawn world: a machine, the drive, encoders and logger around it, and its
recordings.

Angles and torques are at the joint unless a name says otherwise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rig.results.prove.draw import Kind
from rig.results.prove.truth import Axis

Array = NDArray[np.float64]
COMMAND_S = 1e-3
"""Time between the samples of the command, s; the drive interpolates between them."""


@dataclass(frozen=True)
class Constants:
    """The nine constants of the nominal model, by the paper's symbols, SI."""

    J: float
    Mc: float
    Ms: float
    omega_sf: float
    sigma_2: float
    mu_c: float
    mu_s: float
    omega_sL: float
    mu_2: float


@dataclass(frozen=True)
class Motor:
    """Motor, gear and power stage.

    Attributes:
        resistance_ohm: Resistance of the winding.
        inductance_H: Inductance of the winding.
        constant: Torque constant in N m/A and back-EMF constant in V s/rad, which are one in SI.
        gear_ratio: Motor turns per joint turn.
        supply_V: Supply voltage of the power stage, which limits the motor voltage.
        limit_A: Current limit of the drive.
        rotor_share: Share of the inertia J that is the rotor's.
        friction_share: Share of Mc, Ms and sigma_2 that rubs on the motor's side of the gear.
    """

    resistance_ohm: float
    inductance_H: float
    constant: float
    gear_ratio: float
    supply_V: float
    limit_A: float
    rotor_share: float
    friction_share: float

    @property
    def torque_per_A(self) -> float:
        """Return the torque at the joint per ampere, N m/A."""
        return self.constant * self.gear_ratio


@dataclass(frozen=True)
class Drive:
    """Loops of the drive.

    Attributes:
        kind: ``cascade``: position P, velocity PI, current PI; ``pd``: position P and velocity D
            straight to the current.
        rate_Hz: Rate of all loops.
        position_Hz: Bandwidth of the position loop.
        velocity_Hz: Bandwidth of the velocity loop, or of the damping of ``pd``.
        current_Hz: Bandwidth of the current loop.
        feedforward: Share of the command's speed that is fed forward.
    """

    kind: Literal["cascade", "pd"]
    rate_Hz: int
    position_Hz: float
    velocity_Hz: float
    current_Hz: float
    feedforward: float


@dataclass(frozen=True)
class Sensing:
    """Encoders and the current sensor.

    Attributes:
        motor_bits: Counts per motor turn, as a power of two; None without a motor encoder.
        joint_bits: Counts per joint turn, as a power of two; None without a joint encoder.
        flicker: Noise before the count is taken, rms, counts.
        lines_error: Interpolation error of the joint encoder within one of 4096 lines, share of
            the line.
        current_noise_A: Noise of one sample, rms.
        current_quantum_A: Step of the current's digits.
        voltage_noise_V: Noise of a measured voltage, rms.
    """

    motor_bits: int | None
    joint_bits: int | None
    flicker: float
    lines_error: float
    current_noise_A: float
    current_quantum_A: float
    voltage_noise_V: float


@dataclass(frozen=True)
class Log:
    """Sampling and channels of the logger.

    Attributes:
        rate_Hz: Rate of its rows.
        current: ``sampled``, ``averaged`` over the period that ends at the stamp, or ``filtered``
            by a first-order low-pass and then sampled.
        filter_Hz: Corner of that filter.
        voltage: ``commanded`` at the stamp, ``measured`` at the motor as a mean over the period, or
            ``absent``.
        supply: Whether the supply's voltage is logged.
        jitter: Error of the stamps, rms, share of the period.
        clock: Whether stamps run through the session; else each recording begins at zero, cold.
        packed: Whether recordings are written as NPZ; else as gzipped CSV.
    """

    rate_Hz: int
    current: Literal["sampled", "averaged", "filtered"]
    filter_Hz: float
    voltage: Literal["commanded", "measured", "absent"]
    supply: bool
    jitter: float
    clock: bool
    packed: bool


@dataclass(frozen=True)
class Pendulum:
    """A known weight that turns with the joint: torque -m g l sin(theta - zero), inertia m l^2."""

    mass_kg: float
    length_m: float
    zero_rad: float


@dataclass(frozen=True)
class Planned:
    """Plan of one recording.

    Attributes:
        name: Name of its file.
        role: As in a campaign file.
        motion: Kind of its excitation.
        command: Joint angle sent, rad, every :data:`COMMAND_S`.
        lead_s: Part of the command that passes before the log begins: it begins in motion.
        weight_kg: Label of the weight on the lever.
        pendulum: The weight on the joint, or None.
        pause_s: Time without power before it.
    """

    name: str
    role: Literal["fit", "validate"]
    motion: str
    command: Array
    lead_s: float
    weight_kg: float = 0.0
    pendulum: Pendulum | None = None
    pause_s: float = 0.0

    @property
    def duration_s(self) -> float:
        """Return the length of the log."""
        return len(self.command) * COMMAND_S - self.lead_s


@dataclass(frozen=True)
class World:
    """All drawn data of one trial; a plant turns them into signals.

    Attributes:
        kind: Kind of trial.
        effects: Injected effects by the catalogue's names, or names of effects outside it.
        constants: True constants of the nominal model.
        motor: Motor and gear.
        drive: Its loops.
        sensing: Encoders and current sensor.
        log: The logger.
        recordings: In the order in which they are made.
        moment_arm_m: Radius L1 of the contact force.
        lever_ratio: L3/L4 of the lever.
        gravity_m_s2: Local gravity.
        axes: The place in the world, axis to value.
        seed: Entropy of all noise.
    """

    kind: Kind
    effects: Mapping[str, Mapping[str, float]]
    constants: Constants
    motor: Motor
    drive: Drive
    sensing: Sensing
    log: Log
    recordings: tuple[Planned, ...]
    moment_arm_m: float
    lever_ratio: float
    gravity_m_s2: float
    axes: Mapping[str, Axis]
    seed: tuple[int, ...]

    @property
    def holding_N_m(self) -> float:
        """Return the greatest torque that a position loop must hold: static friction plus the
        torque of a weight on the joint.
        """
        hung = (r.pendulum for r in self.recordings if r.pendulum is not None)
        return self.constants.Ms + self.gravity_m_s2 * max(
            (p.mass_kg * p.length_m for p in hung), default=0.0
        )

    @property
    def smallest_rad(self) -> float:
        """Return the amplitude of the smallest motion, at least a twentieth of the largest motion's
        amplitude.
        """
        most = [float(np.abs(r.command).max()) for r in self.recordings]
        return max(min(most), max(most) / 20.0, 1e-3)

    def contact_N(self, k: int) -> float:
        """Return the contact force of recording ``k``; its true weight may differ from the
        label.
        """
        mass = self.recordings[k].weight_kg
        wrong = self.effects.get("wrong_weight")
        if wrong is not None and round(wrong["recording"]) == k + 1:
            mass = wrong["mass_kg"]
        return self.lever_ratio * mass * self.gravity_m_s2


@dataclass(frozen=True)
class Signals:
    """Signals of a plant in one recording, at the rate of its loops, from the first row of the log.

    Attributes:
        current: Current in the winding, A, shape (n,).
        voltage: Voltage that the drive commands, V.
        terminal: Voltage at the motor, V.
        supply: Voltage of the supply, V.
        motor_angle: True angle of the motor's shaft, rad.
        angle: True angle of the joint, rad.
        command: Joint angle sent, rad.
        start_s: Time of the first sample since the session began.
    """

    current: Array
    voltage: Array
    terminal: Array
    supply: Array
    motor_angle: Array
    angle: Array
    command: Array
    start_s: float
