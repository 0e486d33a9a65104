"""Describes one drawn world: machine, drive, encoders, logger and recordings.

Angles and torques are at the joint unless a name says otherwise. All units are those of a rotary
machine. On a linear machine the joint is a carriage: m replaces rad, N replaces N m, kg replaces
kg m^2, and the gear ratio is in rad of the motor per m.
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
LoopKind = Literal["cascade", "pd", "torque", "host"]
Motion = Literal["rotary", "linear"]
LINES_PER_TURN, LINE_M = 4096, 2e-5
"""Lines of an interpolating encoder: lines per turn of a rotary encoder, and distance between the
lines of a linear encoder, m.
"""
SCALE_M = 1.0
"""Length to which the number of counts of a linear encoder refers, m."""
HOST_JITTER = 0.3
"""Greatest deviation of the interval between two torques of the host, as a share of the mean
interval: the host is a computer without real time, and its torques have no fixed phase to the
samples of the log.
"""
HOST_SAMPLES = 25.0
"""Least number of the host's samples in one oscillation of its position loop."""
HOST_DAMPING, CENTRING_DAMPING = 0.8, 0.5
"""Damping ratios of a host's position loop, and of a host's weak spring."""


@dataclass(frozen=True)
class Constants:
    """The nine parameters of the nominal model, by the paper's symbols, SI units."""

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
        constant: Torque constant in N m/A, and back-EMF constant in V s/rad, which has the same
            value.
        gear_ratio: Motor turns per joint turn; on a linear machine rad per m, 2 pi over the lead of
            the screw or over the travel of the belt per turn.
        supply_V: Supply voltage of the power stage, which limits the motor voltage.
        limit_A: Current limit of the drive.
        rotor_share: Share of the rotor in the inertia J.
        friction_share: Share of Mc, Ms and sigma_2 that acts on the motor's side of the gear.
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
            give the current; ``host``: a slow host computes position P and velocity D, and sends a
            torque to the drive; ``torque``: the host sends a torque of a given course, to which it
            adds a weak spring about zero and a damping.
        rate_Hz: Rate of all loops of the drive.
        position_Hz: Bandwidth of the position loop.
        velocity_Hz: Bandwidth of the velocity loop, or of the damping of ``pd``.
        current_Hz: Bandwidth of the current loop.
        feedforward: Share of the command's speed that is added to the speed command.
        host_Hz: Mean rate at which the host sends torques; 0 without a host.
        centring_N_m_rad: Stiffness of the spring of ``torque``.
    """

    kind: LoopKind
    rate_Hz: int
    position_Hz: float
    velocity_Hz: float
    current_Hz: float
    feedforward: float
    host_Hz: int = 0
    centring_N_m_rad: float = 0.0


@dataclass(frozen=True)
class Sensing:
    """Encoders and the current sensor.

    Attributes:
        motor_bits: Counts per motor turn, as a power of two; None without a motor encoder.
        joint_bits: Counts per joint turn, on a linear machine per m, as a power of two; None
            without a joint encoder.
        flicker: Noise before the count is taken, rms, counts.
        lines_error: Interpolation error of the joint encoder within one line, share of the line.
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
        rate_Hz: Rate of the rows of the log.
        current: ``sampled``, ``averaged`` over the period that ends at the stamp, or ``filtered``
            by a first-order low-pass and then sampled.
        filter_Hz: Corner frequency of the low-pass filter of the current.
        voltage: ``commanded`` at the stamp, ``measured`` at the motor as a mean over the period, or
            ``absent``.
        supply: Whether the supply voltage is logged.
        jitter: Error of the stamps, rms, share of the period.
        clock: Whether the stamps are session times; if not, each recording begins at zero with a
            cold machine.
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
        name: Name of the recording's file.
        role: Role of the recording, as in a campaign file.
        motion: Kind of the excitation.
        command: Joint angle sent, rad, every :data:`COMMAND_S`; if a torque is sent, the angle
            that is expected of the machine without effects.
        lead_s: Duration of the command before the log begins, s; the log begins in motion.
        weight_kg: Label of the weight on the lever.
        pendulum: The weight on the joint, or None.
        pause_s: Time without power before the recording.
        hoisted_kg: Known mass that the carriage of a linear machine lifts: force -m g, inertia m.
        pull_N_m: Known constant torque on the joint, positive if it drives the joint forward.
        torque: Torque sent, N m, every :data:`COMMAND_S`, or None if an angle is sent.
    """

    name: str
    role: Literal["fit", "validate"]
    motion: str
    command: Array
    lead_s: float
    weight_kg: float = 0.0
    pendulum: Pendulum | None = None
    pause_s: float = 0.0
    hoisted_kg: float = 0.0
    pull_N_m: float = 0.0
    torque: Array | None = None

    def sent(self, at_s: Array) -> tuple[Array, Array]:
        """Return the angle, rad, and the torque, N m, that are sent at the times ``at_s``."""
        times = np.arange(len(self.command)) * COMMAND_S
        if self.torque is None:
            return np.interp(at_s, times, self.command), np.zeros(len(at_s))
        return np.zeros(len(at_s)), np.interp(at_s, times, self.torque)

    def steady_N_m(self, gravity_m_s2: float) -> float:
        """Return the known torque that does not depend on the angle, N m."""
        return self.pull_N_m - self.hoisted_kg * gravity_m_s2

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
        drive: Loops of the drive.
        sensing: Encoders and current sensor.
        log: The logger.
        recordings: Recordings in the order in which they are made.
        moment_arm_m: Radius L1 of the contact force.
        lever_ratio: L3/L4 of the lever.
        gravity_m_s2: Local gravity.
        axes: Value of the world on each axis.
        seed: Entropy of all noise.
        motion: Whether the joint turns or is a carriage on a linear axis.
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
    motion: Motion = "rotary"

    @property
    def holding_N_m(self) -> float:
        """Return the greatest torque that a position loop must hold: static friction plus the
        torque of the known loads.
        """
        hung = (r.pendulum for r in self.recordings if r.pendulum is not None)
        turning = self.gravity_m_s2 * max((p.mass_kg * p.length_m for p in hung), default=0.0)
        steady = max(abs(r.steady_N_m(self.gravity_m_s2)) for r in self.recordings)
        return self.constants.Ms + turning + steady

    @property
    def smallest_rad(self) -> float:
        """Return the amplitude of the smallest motion, at least a twentieth of the largest motion's
        amplitude.
        """
        most = [float(np.abs(r.command).max()) for r in self.recordings]
        return max(min(most), max(most) / 20.0, 1e-3)

    @property
    def host_law(self) -> tuple[float, float]:
        """Return stiffness, N m/rad, and damping, N m s/rad, of the law that the host computes.

        A position loop needs an angle error to overcome the static friction. This angle error is
        inversely proportional to the gain of the position loop; the gain is chosen so that the
        angle error is a third of the
        amplitude of the smallest motion if the bandwidth of the loop is 1 Hz. The rate of the host
        limits the gain.
        """
        drive, J = self.drive, self.constants.J
        if drive.kind == "torque":
            stiffness, ratio = drive.centring_N_m_rad, CENTRING_DAMPING
        else:
            fastest = 2.0 * np.pi * drive.host_Hz / HOST_SAMPLES
            stiffness = 3.0 * drive.position_Hz * self.holding_N_m / self.smallest_rad
            stiffness, ratio = min(stiffness, J * fastest**2), HOST_DAMPING
        return stiffness, 2.0 * ratio * float(np.sqrt(stiffness * J))

    def host_sends(self, k: int, ticks: int) -> Array:
        """Return 1 at each tick of the drive in recording ``k`` at which the host sends a torque,
        else 0.
        """
        out = np.zeros(ticks)
        if self.drive.host_Hz:
            rng = np.random.default_rng([*self.seed, 8, k])
            count = round(1.2 * ticks * self.drive.host_Hz / self.drive.rate_Hz) + 9
            waits = 1.0 + HOST_JITTER * rng.uniform(-1.0, 1.0, count)
            at = np.cumsum(waits) * self.drive.rate_Hz / self.drive.host_Hz
            out[[0, *(row for row in np.round(at).astype(int) if row < ticks)]] = 1.0
        return out

    @property
    def motor_count_rad(self) -> float | None:
        """Return the step of the motor encoder, rad, or None without a motor encoder."""
        bits = self.sensing.motor_bits
        return None if bits is None else 2.0 * np.pi / 2.0**bits

    @property
    def joint_count_rad(self) -> float | None:
        """Return the step of the joint encoder, rad, or None without a joint encoder."""
        bits, whole = self.sensing.joint_bits, 2.0 * np.pi if self.motion == "rotary" else SCALE_M
        return None if bits is None else whole / 2.0**bits

    @property
    def loop_count_rad(self) -> float:
        """Return the step, at the joint, of the encoder that closes the loop: the motor encoder if
        there is one.
        """
        motor, joint = self.motor_count_rad, self.joint_count_rad
        if motor is not None:
            return motor / self.motor.gear_ratio
        assert joint is not None
        return joint

    def contact_N(self, k: int) -> float:
        """Return the contact force of recording ``k``, N, from the true weight, which may differ
        from the label.
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
        command: Joint angle sent, rad; zero where a torque is sent.
        start_s: Time of the first sample since the session began.
        mean_current: Mean current from each sample to the next, A; None if the current varies
            linearly between samples.
    """

    current: Array
    voltage: Array
    terminal: Array
    supply: Array
    motor_angle: Array
    angle: Array
    command: Array
    start_s: float
    mean_current: Array | None = None
