"""Collects the samples of a motion until the units of the devices have been checked, and explains
trips that occur before this check.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from drivers.errors import ConfigurationError
from drivers.interfaces import Servo
from rig.common.sample import Sample
from rig.control.motion_factors import Motion
from rig.control.motion_proof import Proof, hint, prove, surer
from rig.control.motion_words import RATIO_TOLERANCE, SPEED, Contradiction
from rig.wiring.devices import Nominal

MOST: Final = 20_000
"""Number of samples after which further samples are dropped."""


class MotionWitness:
    """Collects samples under power.

    Args:
        servo: The drive, whose methods return remedies for wrong units.
        nominal: Constants of the bench file.
    """

    def __init__(self, servo: Servo, nominal: Nominal) -> None:
        self._servo = servo
        self._nominal = nominal
        self._rows = np.empty((MOST, 7))
        self._count = self._braking = 0
        self._said, self._of = "", (False, False)

    def take(self, sample: Sample, motor_torque: float) -> None:
        """Store a sample, and the motor torque that the drive reports with it, N m."""
        self._braking = 0
        self._count += self._store(sample, motor_torque)

    def take_braking(self, sample: Sample, motor_torque: float) -> None:
        """Store a sample while the drive brakes; these samples are used only to make the factor of
        the speed more accurate.
        """
        self._braking += self._store(sample, motor_torque)

    def _store(self, sample: Sample, motor_torque: float) -> bool:
        """Store a sample after the earlier samples; return False if the sample is not used."""
        at = self._count + self._braking
        if at == MOST or not sample.fresh:
            return False
        self._rows[at] = (
            sample.time,
            sample.motor_angle / self._nominal.gear_ratio,
            sample.angle,
            sample.velocity,
            sample.current,
            sample.voltage,
            motor_torque,
        )
        return True

    @property
    def motion(self) -> Motion:
        """The fresh samples that were collected so far."""
        return Motion.of(self._rows[: self._count])

    def prove(self, tolerance: float = RATIO_TOLERANCE) -> Proof:
        """Compare the devices' reports in the collected samples with each other and with the bench
        file; see :func:`rig.control.motion_proof.prove`.
        """
        return prove(self.motion, self._nominal, self._servo, tolerance)

    def require(self) -> Proof:
        """Compare the devices' reports as :meth:`prove` does, and raise an error on a
        contradiction.

        Raises:
            ConfigurationError: Reports contradict each other or the bench file.
        """
        proof = self.prove()
        if proof.contradictions:
            raise ConfigurationError(proof.words)
        return proof

    def hint(self, too_fast: bool = False, too_strong: bool = False) -> Contradiction | None:
        """Return the contradiction that explains a trip or a fault, or None; see
        :func:`rig.control.motion_proof.hint`.
        """
        found = hint(self.motion, self._nominal, self._servo, too_fast, too_strong)
        if found is None or found.what != SPEED or not self._braking:
            return found
        motion = Motion.of(self._rows[: self._count + self._braking])
        return surer(found, motion, self._servo)

    def explanation(self, too_fast: bool = False, too_strong: bool = False) -> str:
        """Return a text that explains a fault or a trip, or an empty text if the samples do not
        explain it.

        Args:
            too_fast: Whether the limit of the reported speed tripped.
            too_strong: Whether the limit of the torque tripped.
        """
        try:
            found = self.hint(too_fast, too_strong)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):
            # An error while the explanation is made must not prevent the stop.
            return ""
        self._said = "" if found is None else f"; {found.words}"
        self._of = (too_fast, too_strong)
        return self._said

    def after_braking(self, message: str) -> str:
        """Return a message in which the last explanation is replaced by the explanation after
        braking.
        """
        said = self._said
        if not said or said not in message:
            return message
        return message.replace(said, self.explanation(*self._of))
