"""The devices of a run: link, servo, encoder and optional others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.clock import Clock, Suspension
from drivers.interfaces import Encoder, Link, PressureTransmitter, Servo
from rig.common.locks import Lock
from rig.common.sample import Phase
from rig.planning.limits import Limits
from rig.wiring.guard import Guard
from rig.wiring.off import OffProof


@dataclass(frozen=True)
class Nominal:
    """Constants of the machine in the bench file, with which the first motion is compared.

    Attributes:
        torque_constant_N_m_A: Motor torque per ampere.
        gear_ratio: Motor turns per joint turn.
        rated_current_A: Rated motor current from the file or from the drive, or None if unknown.
        rated_torque_N_m: Rated motor torque from the file or from the drive, or None if unknown.
        encoder_sign: Sign of the joint encoder.
        back_emf_constant_V_s_rad: Voltage per rad/s of the motor, or None if it is not stated.
    """

    torque_constant_N_m_A: float
    gear_ratio: float
    rated_current_A: float | None = None
    rated_torque_N_m: float | None = None
    encoder_sign: int = 1
    back_emf_constant_V_s_rad: float | None = None


@dataclass(frozen=True)
class Devices:
    """The devices of a run.

    Attributes:
        link: The opened bus.
        servo: The drive.
        encoder: The joint encoder.
        hang: Function that puts a mass in kg on a simulated lever, or None if a person does.
        pacer: Real clock that slows simulated time to real time; None to run on the link's clock
            alone.
        observer: Called with stage name and phase at the start of every phase.
        pressure: The transmitter on the gas generator's chamber, or None if there is none.
        ignite: Function that ignites a simulated gas generator, or None if a person does.
        guard: Process that stops a drive without a watchdog when this program dies, or None if
            there is none.
        lock: Lock that prevents other programs from using the bench, or None for a simulated bench.
        nominal: Constants of the bench file with which motions are compared, or None for no
            comparison.
        suspension: Detects that this computer slept; None in simulated time.
        awake: Why this computer may sleep during the run; empty if it does not.
    """

    link: Link
    servo: Servo
    encoder: Encoder
    hang: Callable[[float], None] | None = None
    pacer: Clock | None = None
    observer: Callable[[str, Phase], None] | None = None
    guard: Guard | None = None
    pressure: PressureTransmitter | None = None
    ignite: Callable[[], None] | None = None
    lock: Lock | None = None
    nominal: Nominal | None = None
    suspension: Suspension | None = None
    awake: str = ""

    def off_proof(self, limits: Limits) -> OffProof:
        """Return an observer that proves that the drive of a bench with these limits is off."""
        clock = self.link.clock
        return OffProof(self.servo, clock, self.encoder, limits.speed, limits.current)

    def prepare(self, cycle_s: float) -> None:
        """Check every device against the bench file and map its process data; nothing is energised.

        Raises:
            DeviceError: A device differs from the bench file, or does not answer.
        """
        self.servo.prepare(cycle_s)
        self.encoder.prepare(cycle_s)
        if self.pressure is not None:
            self.pressure.prepare(cycle_s)
