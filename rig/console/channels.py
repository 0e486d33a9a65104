"""Channels that the page of the console shows, with their units of display."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from identification.recording import Array

DEG = 180.0 / math.pi


class Channel(NamedTuple):
    """Channel of one chart.

    Attributes:
        name: Name of the channel in the recording, or name of a derived value.
        label: Title.
        unit: Unit of display.
        scale: Factor from SI to the unit of display.
    """

    name: str
    label: str
    unit: str
    scale: float = 1.0


CHANNELS = (
    Channel("angle", "Joint angle", "deg", DEG),
    Channel("command", "Commanded angle", "deg", DEG),
    Channel("error", "Tracking error", "deg", DEG),
    Channel("velocity", "Joint speed", "deg/s", DEG),
    Channel("torque", "Joint torque", "N m"),
    Channel("current", "Motor current", "A"),
    Channel("following_error", "Following error of the drive", "deg", DEG),
    Channel("disagreement", "Encoder against drive", "deg", DEG),
    Channel("voltage", "Motor voltage", "V"),
    Channel("supply_voltage", "Supply voltage", "V"),
    Channel("temperature", "Temperature of the drive", "deg C"),
    Channel("pressure", "Chamber pressure", "MPa", 1e-6),
)
"""Channels in the order in which the page shows them."""


def shown(samples: Mapping[str, Array], about: Mapping[str, Any]) -> Array:
    """Return the values of the channels in their units of display, shape (channels, n).

    Args:
        samples: Arrays of shape (n,), by field.
        about: Description of the run, with gear ratio and torque constant.
    """
    derived = {
        "error": samples["angle"] - samples["command"],
        "torque": samples["current"] * about["torque_per_ampere"],
        "disagreement": samples["motor_angle"] / about["gear_ratio"] - samples["angle"],
    }
    return np.stack([(derived | {**samples})[c.name] * c.scale for c in CHANNELS])


def channel_records(about: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the channels with their limits in the units of display, as JSON values."""
    limits = {row["channel"]: row for row in about["limits"]}
    return [
        {
            "name": channel.name,
            "label": channel.label,
            "unit": channel.unit,
            "low": _scaled(limits.get(channel.name, {}).get("low"), channel.scale),
            "high": _scaled(limits.get(channel.name, {}).get("high"), channel.scale),
        }
        for channel in CHANNELS
    ]


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else value * scale
