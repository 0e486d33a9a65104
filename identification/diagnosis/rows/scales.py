"""Computes torque, speed and travel of a bench relative to those of the practical bench, for which
trial values and plausible ranges are stated. Torque and travel of a bench that can be diagnosed are
not zero.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.diagnosis.rows.view import View
from identification.model.parameters import LINEAR

USUAL_TORQUE_N_M, USUAL_SPEED_RAD_S, USUAL_TRAVEL_RAD = 40.0, 0.5, 0.8
"""Greatest torque and speed, and the travel, on the practical bench."""


def torque_scale(views: Sequence[View]) -> float:
    """Return the greatest torque over that of the practical bench."""
    return max(float(np.max(np.abs(v.torque))) for v in views) / USUAL_TORQUE_N_M


def speed_scale(views: Sequence[View]) -> float:
    """Return the greatest speed over that of the practical bench."""
    return max(float(np.max(np.abs(v.velocity))) for v in views) / USUAL_SPEED_RAD_S


def travel_scale(views: Sequence[View]) -> float:
    """Return the travel over that of the practical bench."""
    return max(float(np.ptp(v.angle)) for v in views) / USUAL_TRAVEL_RAD


def at_scale(angles_rad: Sequence[float], views: Sequence[View]) -> list[float]:
    """Return trial values of angles of the transmission at the joint: in rad, the same for benches
    of any size; on a linear axis in m, in proportion to the travel.
    """
    scale = travel_scale(views) if views[0].recording.bench.motion == LINEAR else 1.0
    return [scale * angle for angle in angles_rad]
