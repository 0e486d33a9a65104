"""Bench file section of the limits on angles, speed, torque, current and other values."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from rig.config.configuration import NonNegative, Positive, Schema


class LimitsSection(Schema):
    """Limits that the program checks on every sample; a limit for which the drive has an object is
    also checked by the drive.

    Attributes:
        angle_min_deg: Lowest joint angle, commanded or measured.
        angle_max_deg: Highest joint angle, commanded or measured.
        speed_deg_s: Highest joint speed.
        torque_N_m: Highest torque of the drive, at the joint after the gear.
        current_A: Highest motor current.
        following_error_deg: Largest difference between commanded and measured joint angle.
        encoder_disagreement_deg: Largest difference between joint encoder and motor encoder, at the
            joint.
        weight_kg: Heaviest weight that a sequence may hang.
        contact_force_N: Highest contact force, of a weight or of the gas generator's pressure.
        pressure_MPa: Highest chamber pressure; needed if there is a pressure transmitter.
        temperature_C: Highest temperature that the drive may report.
        supply_min_V: Lowest supply voltage.
        supply_max_V: Highest supply voltage.
        sample_age_ms: Greatest age of a sample with which a cycle may continue.
        lateness_ms: Greatest delay of the start of a cycle; at most half of the time after which
            the drive's watchdog acts.
    """

    angle_min_deg: float
    angle_max_deg: float
    speed_deg_s: Positive
    torque_N_m: Positive
    current_A: Positive
    following_error_deg: Positive
    encoder_disagreement_deg: Positive
    weight_kg: NonNegative
    contact_force_N: NonNegative
    pressure_MPa: Positive | None = None
    temperature_C: float = 80.0
    supply_min_V: NonNegative = 0.0
    supply_max_V: Positive = 1000.0
    sample_age_ms: Positive = 5.0
    lateness_ms: Annotated[float, Field(gt=0, le=50)] = 25.0

    @property
    def middle_rad(self) -> float:
        """Middle of the joint's travel, rad."""
        return math.radians(0.5 * (self.angle_min_deg + self.angle_max_deg))

    @model_validator(mode="after")
    def _range_is_open(self) -> Self:
        if not self.supply_min_V < self.supply_max_V:
            raise ValueError(
                f"supply_min_V {self.supply_min_V:g} must be below supply_max_V "
                f"{self.supply_max_V:g}; exchange the two values"
            )
        if not self.angle_min_deg < self.angle_max_deg:
            raise ValueError(
                f"angle_min_deg {self.angle_min_deg:g} must be below angle_max_deg "
                f"{self.angle_max_deg:g}; exchange the two values"
            )
        return self
