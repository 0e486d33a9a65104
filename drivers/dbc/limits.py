"""Converts, writes and verifies the limits of a drive with its own CAN frames.

Limits are written over the bus, or set with the maker's tool and stated in the bench file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from drivers.dbc.codec import BoundLimit, BoundQuantity, Images, Wiring
from drivers.errors import ConfigurationError, LimitError
from drivers.interfaces import Identity, LimitSteps, ServoLimits

FIELDS: Final[Mapping[str, tuple[str, ...]]] = {
    "angle_min": ("angle_min_rad",),
    "angle_max": ("angle_max_rad",),
    "speed": ("speed_rad_s",),
    "current": ("torque_N_m", "current_A"),
    "following_error": ("following_error_rad",),
}
"""Name of each limit in the map to the fields of :class:`~drivers.interfaces.ServoLimits`."""
_HELD: Final = {
    "angle_min_rad": "angle_min_deg",
    "angle_max_rad": "angle_max_deg",
    "speed_rad_s": "speed_deg_s",
    "torque_N_m": "torque_N_m",
    "current_A": "current_A",
    "following_error_rad": "following_error_deg",
    "quick_stop_option": "quick_stop_option",
    "quick_stop_deceleration_rad_s2": "quick_stop_deceleration_deg_s2",
}
_LOWER: Final = frozenset({"angle_min"})
_ROUNDING: Final = 1e-6


@dataclass(frozen=True)
class DbcDrive:
    """Data of the bench file about a drive, without its signals."""

    # Identity of the drive; if the map has signals of serial number and revision, their values
    # replace `serial_number` and `revision`.
    identity: Identity
    # Limits that are set in the drive with the maker's tool; limits that the drive reports over the
    # bus replace these limits.
    held: ServoLimits
    gear_ratio: float  # motor turns per joint turn
    # Torque constant, N m/A, which converts a torque signal into a current.
    torque_constant_N_m_A: float
    offset_rad: float  # joint angle at position 0
    # Time without a command after which the drive stops by itself, s, or None if the drive has no
    # watchdog.
    watchdog_s: float | None


def taken(wiring: Wiring) -> frozenset[str]:
    """Return the fields of the limits that can be written and that the drive reports."""
    return frozenset(field for name in wiring.reported for field in FIELDS[name])


def places(wiring: Wiring) -> dict[str, str]:
    """Return where the value of each limit is: its signal, or its key under ``servo.held``."""
    found = {field: f"servo.held.{key}" for field, key in _HELD.items()}
    for name, limit in wiring.limits.items():
        quantity = limit.held or limit.set
        note = ", written but not reported" if limit.held is None else ""
        signal = f"{quantity.message}.{quantity.signal.name}{note}"
        found |= dict.fromkeys(FIELDS[name], signal)
    return found


def encode(limits: ServoLimits, drive: DbcDrive) -> dict[str, float]:
    """Return limits in the quantities of the map, at the motor; the torque as a current."""
    gear, window = drive.gear_ratio, limits.following_error_rad
    return {
        "angle_min": (limits.angle_min_rad - drive.offset_rad) * gear,
        "angle_max": (limits.angle_max_rad - drive.offset_rad) * gear,
        "speed": limits.speed_rad_s * gear,
        "current": min(limits.current_A, limits.torque_N_m / (drive.torque_constant_N_m_A * gear)),
        "following_error": math.inf if window is None else window * gear,
    }


def decode(told: Mapping[str, float], drive: DbcDrive) -> ServoLimits:
    """Return the limits at the joint: those reported, else those of the bench file."""
    gear, found = drive.gear_ratio, dict[str, Any]()
    for name, value in told.items():
        if name == "current":
            found |= {"current_A": value, "torque_N_m": value * drive.torque_constant_N_m_A * gear}
        else:
            offset = drive.offset_rad if name.startswith("angle") else 0.0
            found[FIELDS[name][0]] = value / gear + offset
    return replace(drive.held, **found)


def steps(wiring: Wiring, drive: DbcDrive) -> LimitSteps:
    """Return the resolution of each reported limit at the joint; zero for none, or a float."""
    gear, reported = drive.gear_ratio, wiring.reported

    def unit(name: str) -> float:
        real = name not in reported or reported[name].signal.real
        return 0.0 if real else abs(reported[name].gain)

    return LimitSteps(
        angle_rad=max(unit("angle_min"), unit("angle_max")) / gear,
        speed_rad_s=unit("speed") / gear,
        torque_N_m=unit("current") * drive.torque_constant_N_m_A * gear,
        current_A=unit("current"),
        following_error_rad=unit("following_error") / gear,
        quick_stop_deceleration_rad_s2=0.0,
    )


def images(wiring: Wiring, wanted: Mapping[str, float]) -> Images:
    """Return the frames that contain the limits, each rounded to the drive's unit so that no limit
    becomes wider.

    Raises:
        LimitError: A limit does not fit into its signal.
    """
    frames = {name: bytes(message.size) for name, message in wiring.settings.items()}
    for name, limit in wiring.limits.items():
        quantity = limit.set
        try:
            bits = quantity.signal.pack(_tighter(name, quantity, wanted[name]))
        except (ValueError, OverflowError) as error:
            raise LimitError(
                (*_keys(name), "machine.gear_ratio"),
                f"limit {name}: {error}; change {' or '.join(_keys(name))}, or correct "
                "machine.gear_ratio",
            ) from error
        frames[quantity.message] = quantity.signal.insert(frames[quantity.message], bits)
    return frames


def _keys(name: str) -> tuple[str, ...]:
    """Return the keys of the limits in the bench file from which a limit of the map is computed."""
    return tuple(f"limits.{_HELD[field]}" for field in FIELDS[name])


def _tighter(name: str, quantity: BoundQuantity, value: float) -> float:
    raw = (value - quantity.bias) / quantity.gain
    upward = (name in _LOWER) is (quantity.gain > 0)
    if quantity.signal.real:
        return _tighter_real(raw, quantity.signal.width, upward)
    # The margin ensures that a value of a whole number of units is not changed by a rounding error.
    return math.ceil(raw - _ROUNDING) if upward else math.floor(raw + _ROUNDING)


def _tighter_real(raw: float, width: int, upward: bool) -> float:
    """Return the nearest floating-point number of this width that is not beyond ``raw``."""
    if width == 64 or not math.isfinite(raw):
        return raw
    nearest = np.float32(raw)
    found = float(nearest)
    if (found < raw) if upward else (found > raw):
        found = float(np.nextafter(nearest, np.float32(math.inf if upward else -math.inf)))
    return found


def verify(
    wanted: Mapping[str, float],
    held: Mapping[str, float],
    limits: Mapping[str, BoundLimit],
    who: str,
) -> None:
    """Check that the drive reports the written limits to within two units of the signals, and no
    wider limit.

    Raises:
        ConfigurationError: The message states each limit that differs.
    """
    wrong = []
    for name, found in held.items():
        unit = abs(limits[name].set.gain)
        room = found - wanted[name] if name in _LOWER else wanted[name] - found
        if not -_ROUNDING * max(1.0, abs(wanted[name])) <= room <= 2 * unit:
            keys = " or ".join(_keys(name))
            wrong.append(f"{name} ({keys}) reads {found:g} after {wanted[name]:g} was written")
    if wrong:
        raise ConfigurationError(
            f"{who} does not accept these limits (at the motor, SI units): {'; '.join(wrong)}; "
            "check the ranges in the drive's manual"
        )


def require_room(
    limits: ServoLimits, held: ServoLimits, settable: Mapping[str, BoundLimit], who: str
) -> None:
    """Check that the limits that only the maker's tool can set are not tighter than those of the
    bench file, so that the drive would stop first.

    Raises:
        ConfigurationError: The message states each limit that is tighter.
    """
    tight = [
        f"{name} ({' or '.join(_keys(name))}) {wanted:g} {unit} (drive: {own:g} {unit})"
        for name, wanted, own, unit in (
            ("angle_min", -limits.angle_min_rad, -held.angle_min_rad, "rad below zero"),
            ("angle_max", limits.angle_max_rad, held.angle_max_rad, "rad"),
            ("speed", limits.speed_rad_s, held.speed_rad_s, "rad/s"),
            ("current", limits.current_A, held.current_A, "A"),
        )
        if name not in settable and not wanted <= own * (1 + _ROUNDING)
    ]
    if tight:
        raise ConfigurationError(
            f"these limits are wider in the bench file than in {who}: {', '.join(tight)}; state "
            "tighter limits in the bench file"
        )
