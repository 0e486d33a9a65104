"""Guesses the channel of each column of a recording from the names and units of the columns."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple, cast

import numpy as np

from identification.model.parameters import unit_on
from identification.recording import CHANNELS, Array
from rig.config.campaign_sections import RecordingSection
from rig.sources.table import Table

UNITS: Final[Mapping[str, tuple[str, float]]] = {
    "s": ("s", 1.0),
    "sec": ("s", 1.0),
    "seconds": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "ns": ("s", 1e-9),
    "a": ("A", 1.0),
    "ma": ("A", 1e-3),
    "v": ("V", 1.0),
    "mv": ("V", 1e-3),
    "rad": ("rad", 1.0),
    "mrad": ("rad", 1e-3),
    "deg": ("rad", math.pi / 180.0),
    "degrees": ("rad", math.pi / 180.0),
    "°": ("rad", math.pi / 180.0),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180.0),
    "°/s": ("rad/s", math.pi / 180.0),
    "rpm": ("rad/s", math.pi / 30.0),
    "1/min": ("rad/s", math.pi / 30.0),
    "rev": ("rad", 2.0 * math.pi),
    "turns": ("rad", 2.0 * math.pi),
    "m": ("m", 1.0),
    "mm": ("m", 1e-3),
    "um": ("m", 1e-6),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
    "nm": ("N m", 1.0),
    "mnm": ("N m", 1e-3),
    "n": ("N", 1.0),
    "kn": ("N", 1e3),
    "c": ("deg C", 1.0),
    "degc": ("deg C", 1.0),
    "°c": ("deg C", 1.0),
    "pa": ("Pa", 1.0),
    "kpa": ("Pa", 1e3),
    "mpa": ("Pa", 1e6),
    "bar": ("Pa", 1e5),
}
"""SI unit and scale for each unit as files write it (lower case, no blanks)."""
_NAMES: Final[Mapping[str, str]] = {
    "time": r"t|time|timestamp|zeit|stamp|seconds|elapsed",
    "supply_voltage": r"supply|u_?dc|v_?dc|vbus|dc_?link|battery",
    "voltage": r"u|v|volt|voltage|u_?m|u_?motor|motor_?voltage|spannung",
    "current": r"i|iq|i_?q|current|i_?meas|i_?m|i_?motor|motor_?current|cur|strom",
    "torque": r"torque|trq|tau|m_?d|moment|drehmoment|force|effort",
    "motor_angle": r"motor_?(angle|pos|position)|phi_?m|theta_?m|(pos|position|angle)_?motor",
    "command": r"command|cmd|target|setpoint|reference|ref|desired|goal"
    r"|(pos|position|angle)_?(ref|cmd|des)",
    "angle": r"angle|pos|position|phi|theta|q|winkel|joint|joint_?angle"
    r"|(pos|position|angle)_?(joint|load)",
    "velocity": r"velocity|vel|speed|omega|dq|qd|dphi|dtheta|drehzahl",
    "load_force": r"load_?force|f_?load",
    "temperature": r"temp|temperature|t_?motor",
    "pressure": r"p|pressure|druck|chamber_?pressure",
}
"""Usual column names of each channel; more specific channels come first."""


class Guess(NamedTuple):
    """Column that is guessed for a channel.

    Attributes:
        column: Name, or index if the columns have no names.
        scale: SI units per unit of the column.
        sure: Whether the column states its unit.
    """

    column: str | int
    scale: float
    sure: bool


def split_unit(name: str) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit in lower case; the unit is empty if the
    name has no unit.

    ``current [mA]``, ``current (mA)``, ``current/mA`` and ``current_mA`` name a unit.
    """
    found = re.fullmatch(r"\s*(.*?)\s*[\[(]([^\])]*)[\])]\s*", name)
    if found is None:
        # "i_m" is a motor current: the letter m counts as a unit in brackets only.
        for unit in sorted(UNITS.keys() - {"m"}, key=len, reverse=True):
            tail = re.fullmatch(rf"\s*(.+?)[_/ ]{re.escape(unit)}\s*", name, re.IGNORECASE)
            tail = tail or re.fullmatch(
                rf"\s*(.+?)[_/ ]{re.escape(unit.replace('/', '_'))}\s*", name, re.IGNORECASE
            )
            if tail is not None:
                return tail[1].strip(), unit
        return name.strip(), ""
    unit = found[2].lower().replace(" ", "").replace("*", "").replace("·", "").replace(".", "")
    return found[1].strip(), unit


def channel_unit(channel: str, linear: bool = False) -> str:
    """Return the SI unit of a channel on a rotary or a linear bench; channels of the motor are
    rotary on either kind of bench.
    """
    if channel == "motor_angle":
        return CHANNELS[channel]
    return unit_on("linear" if linear else "rotary", CHANNELS[channel])


def scale_of(name: str, channel: str, linear: bool = False) -> float:
    """Return the scale to SI from the unit in a column's name; 1 without a unit."""
    unit, scale = UNITS.get(split_unit(name)[1], ("", 1.0))
    return scale if unit == channel_unit(channel, linear) else 1.0


def guess_channels(names: Iterable[str], linear: bool = False) -> dict[str, Guess]:
    """Return the channels that columns with these names may contain, each column at most once.

    Args:
        names: Column names in the order of the file; empty for a column without a name.
        linear: Whether the bench is linear: positions in m, forces in N.
    """
    columns = [(name, *split_unit(name)) for name in names if name]
    found: dict[str, Guess] = {}
    taken: set[str] = set()
    for channel, pattern in _NAMES.items():
        unit = channel_unit(channel, linear)
        for column, bare, stated in columns:
            word = re.sub(r"[\s\-.]+", "_", bare.lower()).strip("_")
            # The scale of an unknown unit is unknown, so that the column is not used.
            si, scale = UNITS.get(stated, ("", 1.0)) if stated else (unit, 1.0)
            if column in taken or not re.fullmatch(f"{channel}|{pattern}", word) or si != unit:
                continue
            found[channel] = Guess(column, scale, stated in UNITS)
            taken.add(column)
            break
    return found


def is_linear(names: Iterable[str]) -> bool:
    """Return whether a column has a unit of length or of linear speed, as on a linear bench."""
    return any(
        UNITS.get(split_unit(name)[1], ("", 1.0))[0] in ("m", "m/s") for name in names if name
    )


def guess_mass(stem: str) -> float:
    """Return the mass on the lever from a file's name, kg; 0 if the name states no mass."""
    found = re.search(r"(?<![\d.,])(\d+(?:[.,p]\d+)?)\s*_?kg", stem, re.IGNORECASE)
    return float(re.sub("[,p]", ".", found[1])) if found else 0.0


BLOCK_S = 0.02
"""Time over which samples are averaged before a position is differentiated, s."""
FACTOR_TOLERANCE = 0.1
"""Relative deviation of a measured speed from the derivative of the position above which a note
results.
"""
AGREEMENT = 0.9
"""Correlation of speed and derivative above which the ratio of the two is meaningful."""
BOTH_WAYS = 0.1
"""Least share of the motion in each direction that is required to check whether the current changes
its sign.
"""
ALIKE = 1.5
"""Greatest ratio of the efforts (torque, current or voltage) in the two directions at which a log
may contain magnitudes only.
"""
FAR = 100.0
"""Ratio of a sample's distance from its neighbours to the greatest such distance of all other
samples, above which a note results.
"""
OUTLIERS = 3
"""Greatest number of samples of a channel that count as single outliers."""
_FACTORS = (
    (30.0 / np.pi, "rpm", "0.10471975511965977"),
    (180.0 / np.pi, "degrees per second", "0.017453292519943295"),
    (1.0 / (2.0 * np.pi), "turns per second", "6.283185307179586"),
    (1e3, "thousandths", "0.001"),
)


def unit_row_doubts(table: Table, section: RecordingSection) -> Iterator[str]:
    """Yield a note for each channel with scale 1 whose unit, by the file's row of units, is not
    SI.
    """
    if not table.units:
        return
    for name, channel in section.channels.items():
        column = channel.column
        place = column if isinstance(column, int) else _index(table.names, column)
        if place is None or place >= len(table.units) or channel.scale != 1.0:
            continue
        unit = table.units[place].strip("[]() ")
        si, size = UNITS.get(unit.lower(), ("", 1.0))
        if size != 1.0 and name in CHANNELS and si == CHANNELS[name]:
            yield (
                f"`{name}` is in {unit} by the file's row of units, but its scale is 1: set the "
                f"scale to {size:.10g}"
            )


def _index(names: tuple[str, ...], column: str) -> int | None:
    return names.index(column) if column in names else None


def doubts(
    channels: Mapping[str, Array], gear_ratio: float, *, driven_by_weight: bool
) -> Iterator[str]:
    """Yield a note for each channel that contradicts another channel or has contradictory samples.

    Args:
        channels: Canonical channels in SI units, shape (n,); time increasing.
        gear_ratio: Gear ratio of the bench.
        driven_by_weight: Whether a weight that turns with the joint is declared; the torque may
            then have one sign.
    """
    time = channels["time"]
    position = "angle" if "angle" in channels else "motor_angle"
    if position in channels:
        block = max(1, min(round(BLOCK_S / float(np.median(np.diff(time)))), len(time) // 4))
        mean = {name: _block_mean(values, block) for name, values in channels.items()}
        derived = cast(Array, np.gradient(mean[position], mean["time"]))
        if "velocity" in mean:
            gear = gear_ratio if position == "motor_angle" else 1.0
            yield from _speed(position, derived, mean["velocity"], gear)
        if not driven_by_weight:
            yield from _signless(channels, mean, derived)
    for name, values in channels.items():
        if name not in ("time", "angle_time", "enabled"):
            yield from _single(name, values, time)


def _speed(position: str, derived: Array, measured: Array, gear: float) -> Iterator[str]:
    good = np.isfinite(measured) & np.isfinite(derived)
    a, b = derived[good], measured[good]
    energy = float((a @ a) * (b @ b))
    if energy <= 0.0 or float(a @ b) / np.sqrt(energy) < AGREEMENT:
        return
    factor = float(a @ b) / float(a @ a)
    # The velocity is at the joint, whether the position is that of the motor or of the joint.
    ratio = factor * gear
    if abs(ratio - 1.0) <= FACTOR_TOLERANCE:
        return
    guess = next(
        (
            f": if it is in {unit}, set its scale to {scale}"
            for size, unit, scale in _FACTORS
            if abs(ratio / size - 1.0) <= FACTOR_TOLERANCE
        ),
        ": check its scale, the gear ratio, and whether both channels belong to one shaft",
    )
    yield f"`velocity` is {ratio:.4g} times the speed of the joint by `{position}`{guess}"


def _signless(
    channels: Mapping[str, Array], mean: Mapping[str, Array], derived: Array
) -> Iterator[str]:
    """Yield a note if the effort (torque, current or voltage) keeps one sign and is about equally
    large in both directions of motion.

    With a load in one direction the effort may also keep one sign, but then the effort is greater
    against the load than with the load.
    """
    moving = np.abs(derived) > BOTH_WAYS * np.max(np.abs(derived), initial=0.0)
    forward = float(np.mean(derived[moving] > 0)) if moving.any() else 0.0
    if not BOTH_WAYS <= forward <= 1.0 - BOTH_WAYS:
        return
    for name in ("torque", "current", "voltage"):
        if name not in channels:
            continue
        values = channels[name][np.isfinite(channels[name])]
        if not values.size or not np.any(values):
            continue
        known = moving & np.isfinite(mean[name])
        ahead, back = known & (derived > 0), known & (derived < 0)
        if not ahead.any() or not back.any():
            continue
        sizes = sorted(abs(float(mean[name][part].mean())) for part in (ahead, back))
        if (values.min() >= 0.0 or values.max() <= 0.0) and sizes[1] < ALIKE * sizes[0]:
            yield (
                f"`{name}` keeps one sign while the joint moves both ways: the log may contain "
                "its magnitude only, and the fit is then wrong; log the channel with its sign, or "
                "use `voltage` instead"
            )


def _single(name: str, values: Array, time: Array) -> Iterator[str]:
    """Yield a note if single samples are far from both neighbours."""
    known = np.isfinite(values)
    x, t = values[known], time[known]
    if len(x) < 10:
        return
    steps = np.diff(x)
    apart = np.where(
        steps[:-1] * steps[1:] < 0, np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])), 0.0
    )
    order = np.sort(apart)
    usual = max(float(order[-1 - OUTLIERS]), float(np.percentile(np.abs(steps), 99)))
    far = np.flatnonzero(apart > FAR * usual) if usual > 0 else np.empty(0, int)
    if 0 < far.size <= OUTLIERS:
        row = int(far[0]) + 1
        yield (
            f"`{name}` has {far.size} single {'sample' if far.size == 1 else 'samples'} more than "
            f"{FAR:g} times as far from the neighbours as all others, first {x[row]:.6g} "
            f"{CHANNELS[name]} at {t[row]:.6g} s: repair the file if the value is wrong"
        )


def _block_mean(values: Array, block: int) -> Array:
    count = len(values) // block
    return cast(Array, values[: count * block].reshape(count, block).mean(axis=1))
