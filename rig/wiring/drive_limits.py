"""Compares the bench's limits with the limits held in the drive, before and after writing them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from dataclasses import dataclass
from typing import Final

from drivers.errors import ConfigurationError
from drivers.interfaces import LimitSteps, Servo, ServoLimits

ROUNDING = 1e-3
"""Relative difference up to which limits count as equal: bench files state three or four digits."""
_WHOLE_STEP = 1.0 + 1e-6
"""Difference of equal limits, in steps of the drive: one step, and floating-point rounding."""
_STAYING = frozenset({5, 6, 7, 8})
"""Options of 605Ah that leave the drive in QUICK STOP ACTIVE, with power, after the ramp."""


@dataclass(frozen=True)
class Row:
    """Comparison of one limit, in SI units."""

    name: str
    objects: str  # objects in which the drive holds the limit
    field: str
    unit: str
    first: float | None  # the limit under test, or None for no limit
    second: float | None  # the limit that `first` must not exceed
    looser: bool  # whether `first` is looser than `second`


SPEED_UNIT: Final = (
    "; if the drive's speed limit differs from the value set with the maker's tool, the unit of "
    "the speed is wrong: compare servo.velocity_unit with the manual of the drive"
)
"""Second possible cause of a wrong speed limit, for messages."""
_ROWS = (
    ("joint angle, lower end", "607Dh:01h", "angle_min_rad", "rad", "angle_rad"),
    ("joint angle, upper end", "607Dh:02h", "angle_max_rad", "rad", "angle_rad"),
    ("joint speed", "607Fh", "speed_rad_s", "rad/s", "speed_rad_s"),
    ("joint torque", "6072h", "torque_N_m", "N m", "torque_N_m"),
    ("motor current", "6073h", "current_A", "A", "current_A"),
    ("following error", "6065h", "following_error_rad", "rad", "following_error_rad"),
    ("quick stop option", "605Ah", "quick_stop_option", "", ""),
    (
        "quick stop deceleration",
        "6085h",
        "quick_stop_deceleration_rad_s2",
        "rad/s^2",
        "quick_stop_deceleration_rad_s2",
    ),
)
"""Name, objects, field, unit, and field of :class:`~drivers.interfaces.LimitSteps`."""
_REACTIONS = frozenset({"quick_stop_option", "quick_stop_deceleration_rad_s2"})


def compare(
    first: ServoLimits,
    second: ServoLimits,
    steps: LimitSteps | None = None,
    places: Mapping[str, str] | None = None,
) -> list[Row]:
    """Compare every limit of ``first`` with the corresponding limit of ``second``.

    Two limits count as equal if they differ by at most one step of the drive or, if this is more,
    by :data:`ROUNDING` of their size.

    Args:
        first: The limits under test.
        second: The limits that ``first`` must not exceed.
        steps: Resolution of the drive that holds ``first`` or ``second``, or None if unknown.
        places: Objects in which the drive holds each limit, or None for the objects of CiA 402.
    """
    names = places or {}
    return [
        Row(
            name,
            names.get(field, objects),
            field,
            unit,
            a,
            b,
            _looser(field, a, b, _step(steps, resolution)),
        )
        for name, objects, field, unit, resolution in _ROWS
        for a, b in [(getattr(first, field), getattr(second, field))]
    ]


def _step(steps: LimitSteps | None, resolution: str) -> float:
    return float(getattr(steps, resolution)) if steps is not None and resolution else 0.0


def loosened(
    wanted: ServoLimits,
    own: ServoLimits,
    steps: LimitSteps | None = None,
    places: Mapping[str, str] | None = None,
    unheld: Set[str] = frozenset(),
) -> list[Row]:
    """Return the drive's limits that ``wanted`` would loosen; see :func:`require_within_own`."""
    keeps_power = wanted.quick_stop_option in _STAYING and own.quick_stop_option not in _STAYING
    return [
        row
        for row in compare(wanted, own, steps, places)
        if row.field not in unheld
        and (
            (row.looser and row.field not in _REACTIONS)
            or (keeps_power and row.field == "quick_stop_option")
        )
    ]


def require_within_own(
    wanted: ServoLimits,
    own: ServoLimits,
    steps: LimitSteps | None = None,
    places: Mapping[str, str] | None = None,
    unheld: Set[str] = frozenset(),
) -> None:
    """Refuse to loosen the limits that the drive had when it was commissioned.

    Args:
        wanted: The limits to be written.
        own: The limits that the drive held when the bus was opened. The quick stop option is
            refused only if the drive takes the power off after the ramp but would be set to keep
            the power on; the quick stop deceleration is a setting, not a limit.
        steps: See :func:`compare`.
        places: See :func:`compare`.
        unheld: Limits for which the drive has no object, see :class:`drivers.interfaces.Lacks`.

    Raises:
        ConfigurationError: Limits would become looser; the message lists all of them.
    """
    rows = loosened(wanted, own, steps, places, unheld)
    if rows:
        speed = any(row.field == "speed_rad_s" for row in rows)
        raise ConfigurationError(
            f"the bench file is looser than the drive's own limits: "
            f"{_list(rows, 'bench file', 'drive')}; tighten the "
            "bench file, or change the drive with its maker's tool; if an aborted run has left "
            "its limits in the drive, switch the drive's supply off and on"
            + (SPEED_UNIT if speed else "")
        )


def require_held(
    held: ServoLimits,
    wanted: ServoLimits,
    steps: LimitSteps | None = None,
    places: Mapping[str, str] | None = None,
    taken: Set[str] | None = None,
) -> None:
    """Refuse a drive that holds a looser limit than the limit that was written.

    Args:
        held: The limits read back from the drive.
        wanted: The limits that were written.
        steps: See :func:`compare`.
        places: See :func:`compare`.
        taken: Limits that the drive accepts, or None for all; other limits are not compared,
            because the drive has no object for them or they are not written (:func:`only_here`).

    Raises:
        ConfigurationError: Limits of the drive are looser; the message lists all of them.
    """
    rows = [
        row
        for row in compare(held, wanted, steps, places)
        if row.looser and (taken is None or row.field in taken)
    ]
    if rows:
        raise ConfigurationError(
            "the drive does not hold the limits written into it: "
            f"{_list(rows, 'drive', 'wanted')}; the drive is not enabled; check in the manual of "
            "the drive the range of these objects, and whether the objects are write-protected"
        )


def require_written(servo: Servo, wanted: ServoLimits, cycle_s: float) -> None:
    """Read the limits back; refuse, as :func:`require_held`, a drive without one that it takes."""
    taken = servo.limits_taken - servo.lacks(cycle_s).limits
    require_held(servo.read_limits(), wanted, servo.limit_steps(), servo.limit_places, taken)


def only_here(servo: Servo, wanted: ServoLimits, held: ServoLimits) -> str | None:
    """Return a text on the limits that the drive does not take over its bus, or None for none."""
    rows = [
        row
        for row in compare(held, wanted, servo.limit_steps(), servo.limit_places)
        if row.looser and row.field not in servo.limits_taken and row.field not in _REACTIONS
    ]
    if not rows:
        return None
    return (
        "this drive does not accept these limits over its bus: "
        f"{_list(rows, 'drive', 'this program')}. The tighter limits are checked by this program "
        "alone, in every cycle; map these limits under servo.limits if the drive has signals "
        "for them"
    )


def _list(rows: list[Row], first: str, second: str) -> str:
    return "; ".join(
        f"{row.name} ({row.objects}): {first} {show(row.field, row.first)}, {second} "
        f"{show(row.field, row.second)}"
        for row in rows
    )


def _looser(field: str, first: float | None, second: float | None, step: float) -> bool:
    """Return whether the first limit is looser than the second; NaN counts as looser."""
    if second is None:
        return False
    if first is None:
        return True
    margin = max(ROUNDING * abs(second), _WHOLE_STEP * step)
    if field == "quick_stop_option":
        return first != second
    if field in ("angle_min_rad", "quick_stop_deceleration_rad_s2"):
        return not first >= second - margin
    return not first <= second + margin


def show(field: str, value: float | None) -> str:
    """Return a limit as the bench file states it: angles in degrees, with the unit."""
    if value is None:
        return "off"
    if field == "quick_stop_option":
        return f"{value:g}"
    unit = next(unit for _, _, name, unit, _ in _ROWS if name == field)
    if unit.startswith("rad"):
        return f"{math.degrees(value):.4g} {unit.replace('rad', 'deg')}"
    return f"{value:.4g} {unit}"
