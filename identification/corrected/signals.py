"""Computes the signals of one recording for the functions of the corrected model."""

from __future__ import annotations

from typing import Any

import numpy as np

from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.device import label_kg


def signals_of(view: View) -> dict[str, Any]:
    """Return the signals of a recording at the full sample rate, SI, at the joint unless stated
    otherwise; arrays of shape (m,).

    ``drive`` is the nominal torque of the current, including the torque against known loads;
    ``number`` counts recordings from 1.
    """
    nothing = np.zeros(len(view.time))
    return {
        "time": view.time,
        "run_time": view.run_time,
        "angle": view.angle,
        "velocity": view.velocity,
        "acceleration": view.acceleration,
        "sense": view.sense,
        "still": view.still,
        "rest_time": view.rest_time,
        "moment": view.moment,
        "mass": label_kg(view),
        "known": view.known,
        "hanging": view.hanging,
        "drive": view.torque - view.known,
        "current": nothing if view.current is None else view.current,
        "voltage": nothing if view.voltage is None else np.nan_to_num(view.voltage),
        "supply": nothing + 1.0 if view.supply is None else view.supply,
        "motor_angle": view.motor,
        "number": view.index + 1,
    }
