"""Reads the columns that a campaign maps, as canonical channels in SI units on one time base."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array
from rig.common.errors import InputError
from rig.config.campaign import Campaign
from rig.config.campaign_sections import RecordingSection
from rig.config.configuration import Document, nearest
from rig.sources.repair import GAP_PERIODS
from rig.sources.table import Table

SLOWER, FASTER = 0.9, 1.5
"""Ratio of a channel's rate to that of the result below, or above, which a note results."""
EDGE_PERIODS = 1e-6
"""Periods beyond the first or last sample that count as inside, because stamps are rounded."""
HELD = frozenset({"enabled"})
"""Channels whose values are not interpolated, but hold until the next sample."""


@dataclass(frozen=True)
class Base:
    """One time base of a file, with the stamps of its rows by the file's clock, s, shape (n,)."""

    name: str
    stamps: Array


class StampsError(Exception):
    """The time stamps of a time base cannot be used; the message states the reason."""


def _on_one_base(
    channels: Mapping[str, Array], bases: Mapping[str, Base], wanted: Base
) -> tuple[dict[str, Array], int, list[str]]:
    """Interpolate the channels of other time bases at the time stamps of the wanted base.

    Between samples that are more than :data:`GAP_PERIODS` median periods apart, values are missing.
    Rows before the first or after the last sample of any channel are left out.
    """
    found: dict[str, Array] = {}
    notes: list[str] = []
    inside = np.ones(len(wanted.stamps), dtype=np.bool_)
    for name, values in channels.items():
        base = bases[name]
        if base is wanted or np.array_equal(base.stamps, wanted.stamps):
            found[name] = values
            continue
        found[name], within = _interpolated(name, values, base, wanted)
        inside &= within
        notes.append(f"`{name}`: {_words(base, wanted, name)}")
    rows = np.flatnonzero(inside)
    if not rows.size:
        others = {base.name for base in bases.values()} - {wanted.name}
        raise StampsError(
            f"no row of {wanted.name} is within the times of {', '.join(sorted(others))}; use "
            f"columns of one time base"
        )
    first, stop = int(rows[0]), int(rows[-1]) + 1
    left = len(inside) - (stop - first)
    if left:
        notes.append(f"{left} rows of {wanted.name} outside of the other time bases left out")
    return {name: values[first:stop] for name, values in found.items()}, first, notes


def _interpolated(
    name: str, values: Array, base: Base, wanted: Base
) -> tuple[Array, NDArray[np.bool_]]:
    known = np.isfinite(values)
    stamps, samples = base.stamps[known], values[known]
    for one in (base, wanted):
        steps = np.diff(one.stamps)
        if not np.all(np.isfinite(one.stamps)) or np.any(steps < 0):
            row = int(np.argmax(~(steps >= 0))) + 1
            raise StampsError(
                f"the time stamps of {one.name} run backwards or are missing at its row {row + 1}, "
                f"so that columns cannot be interpolated between time bases; use columns of one "
                f"time base"
            )
    if len(stamps) < 2:
        raise StampsError(
            f"`{name}` has {len(stamps)} samples in {base.name}; at least two are needed to "
            f"interpolate it at the time stamps of {wanted.name}"
        )
    first = np.concatenate(([True], np.diff(stamps) > 0))
    stamps, samples = stamps[first], samples[first]
    at = wanted.stamps
    after = np.clip(np.searchsorted(stamps, at, side="right"), 1, max(1, len(stamps) - 1))
    if name in HELD:
        result = samples[np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, None)]
    else:
        result = np.interp(at, stamps, samples)
    if len(stamps) > 1:
        wide = np.diff(stamps)
        apart = wide[after - 1] > GAP_PERIODS * float(np.median(wide))
        apart &= (at > stamps[after - 1]) & (at < stamps[after])
        result = np.where(apart, np.nan, result)
    slack = EDGE_PERIODS * (float(np.median(np.diff(at))) if len(at) > 1 else 0.0)
    return result, (at >= stamps[0] - slack) & (at <= stamps[-1] + slack)


def _words(base: Base, wanted: Base, name: str) -> str:
    own, target = (_rate(one.stamps) for one in (base, wanted))
    how = "held between its samples" if name in HELD else "interpolated"
    words = f"of {base.name} ({own:.4g} Hz), {how} at the stamps of {wanted.name} ({target:.4g} Hz)"
    if own < SLOWER * target:
        words += "; its rate is lower, so that the course between samples is a guess"
    elif own > FASTER * target:
        words += "; its rate is higher: to use all of its samples, map `time` to its own stamps"
    return words


def _rate(stamps: Array) -> float:
    period = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    return 1.0 / period if period > 0 else 0.0


POWERS = range(8, 33)  # widths of counters that are recognised, bits
CONVERTED_UNITS = (1e-3, 1e-6)
"""Units, in seconds, of a 32-bit counter of time that the logger has converted to seconds:
milliseconds and microseconds. Overflows of shorter counters are not searched in converted time
stamps, because successive recordings of 4096 or 65536 samples look like such overflows.
"""
LEVELS = 8
"""Least number of different values of a signed column; one with fewer may be a digital output."""
DAY_S = 86400.0
WHOLE_TOLERANCE = 1e-3
"""Greatest distance from an integer at which a value divided by the file's scale is a count."""
ORDINARY_SHARE = 0.125
"""Greatest step between overflows, as a share of the modulus; larger steps have no sure sign."""
TIME_PERIODS = 100.0  # longest time step at an overflow, in median periods
SURE_SHARE = 0.01
"""Greatest uncertainty of a measured modulus, relative to it, at which a width in bits is sure; and
the greatest deviation of a clock's, which lost samples cause."""
POSITIONS = frozenset({"angle", "motor_angle"})
TIMES = frozenset({"time", "angle_time"})


def unwrapped(name: str, values: Array) -> tuple[Array, str]:
    """Return a column without the overflows of a counter, shape (n,), and a note; empty if none."""
    if name == "enabled" or len(values) < 3:
        return values, ""
    if name in TIMES:
        return _time(values)
    finite = values[np.isfinite(values)]
    if finite.size < 3 or np.any(finite != np.rint(finite)):
        return values, ""
    steps, low, high = np.diff(finite), finite.min(), finite.max()
    turn = starts_again(finite) if name in POSITIONS else None
    for power in POWERS:
        modulus = float(2**power)
        if turn is not None and not turn.agrees(modulus):
            continue
        jumps = np.abs(steps) > modulus / 2
        # Whether all values fit into an unsigned or a signed counter with this modulus.
        fit = (low >= 0 and high < modulus) or (low >= -modulus / 2 and high < modulus / 2)
        if not jumps.any() or not fit:
            continue
        turned = steps - modulus * np.sign(steps) * jumps
        if np.max(np.abs(turned)) > ORDINARY_SHARE * modulus:
            continue
        count = int(jumps.sum())
        if name in POSITIONS:
            return _continued(values, modulus), (
                f"a counter of {power} bits that overflows {count} times: corrected"
            )
        if low >= 0 and len(np.unique(finite)) >= LEVELS:
            signed = np.where(values >= modulus / 2, values - modulus, values)
            return signed, (
                f"steps of 2^{power} around zero: the column holds signed numbers of {power} bits "
                f"as unsigned numbers, and was read as signed numbers"
            )
    return values, ""


def unwrapped_counts(name: str, values: Array, scale: tuple[float, float]) -> tuple[Array, str]:
    """Correct a counter, as :func:`unwrapped`, to which the file has applied factor and offset."""
    factor, offset = scale
    if not np.isfinite(factor) or factor == 0.0:
        return values, ""
    counts = (values - offset) / factor
    whole = np.rint(counts)
    known = np.isfinite(counts)
    if not known.any() or np.max(np.abs(counts - whole)[known]) > WHOLE_TOLERANCE:
        return values, ""
    turned, note = unwrapped(name, whole)
    return (values + factor * (turned - whole), note) if note else (values, "")


JUMP, ORDINARY = 0.6, 0.4
"""Least jump at which an angle starts again, and greatest other step, as shares of its range."""
SLOPE_SAMPLES = 20
"""Number of samples on either side of a jump over which the motion there is measured."""


class Turn(NamedTuple):
    """The change after which a column starts again, in units of the column."""

    after: float  # the change, measured at the jumps and rounded within its uncertainty
    uncertainty: float  # uncertainty of the change
    times: int  # number of jumps

    def agrees(self, modulus: float) -> bool:
        """Return whether the column surely starts again after this change and no other."""
        allowed = min(self.uncertainty, SURE_SHARE * modulus)
        return self.uncertainty <= SURE_SHARE * modulus and abs(self.after - modulus) <= allowed


def starts_again(values: Array) -> Turn | None:
    """Return after which change a position starts again, or None if it does not.

    A position that starts again jumps over its whole range against its motion: it runs up to the
    upper end and goes on, at the same speed, from the lower end. A fast move to another place jumps
    along its motion or from rest, and a wrong sample jumps there and back. The size of a turn is
    the jump less the motion of the joint during the jump.
    """
    known = values[np.isfinite(values)]
    if len(known) < 2 * SLOPE_SAMPLES:
        return None
    steps, span = np.diff(known), float(np.ptp(known))
    sizes = np.abs(steps)
    rows = np.flatnonzero(sizes > JUMP * span)
    ordinary = np.delete(steps, rows)
    if not rows.size or float(np.max(np.abs(ordinary), initial=0.0)) > ORDINARY * span:
        return None
    # First the turn is as long as the jumps; what the joint moves during a jump follows from it.
    straight = _continued(known, float(np.median(sizes[rows])))
    before, after = np.maximum(rows - SLOPE_SAMPLES, 0), rows + 1 + SLOPE_SAMPLES
    after = np.minimum(after, len(known) - 1)
    slopes = np.zeros((2, len(rows)))
    for slope, first, last in zip(slopes, (before, rows + 1), (rows, after), strict=True):
        np.divide(straight[last] - straight[first], last - first, out=slope, where=last > first)
    noise = np.abs(np.diff(np.delete(np.diff(straight), rows)))
    clear = float(np.median(noise)) / np.sqrt(SLOPE_SAMPLES)
    ways = np.sign(slopes) * (np.abs(slopes) > clear)
    against = -np.sign(steps[rows]) * np.where(ways[0] == ways[1], ways[0], 0.0)
    # Moves between two places from rest also jump; a position that starts again does so in motion.
    if 2.0 * np.sum(against) <= len(rows):
        return None
    near = np.stack([np.clip(rows + k, 0, len(steps) - 1) for k in (-1, 1)])
    moved = np.where(np.isin(near, rows), np.nan, steps[near])
    moved = np.where(np.isnan(moved), slopes, moved).mean(axis=0)
    turns = np.abs(steps[rows] - moved)
    rms = float(np.sqrt(np.mean(noise**2))) if noise.size else 0.0
    whole = bool(np.all(known == np.rint(known)))
    # The error of a turn is that of a second difference, and of counts half a count.
    uncertainty = 2.0 * rms + 0.5 * whole + 1e-6 * span
    return Turn(_rounded(float(np.median(turns)), uncertainty), uncertainty, len(rows))


def _rounded(turn: float, uncertainty: float) -> float:
    """Return the change that a maker would choose within the uncertainty of the measured one."""
    usual = (360.0, 2.0 * pi, 1.0, *(2.0**power for power in POWERS))
    found = [value for value in usual if abs(value - turn) <= uncertainty]
    found += [
        value for k in range(1, 7) if abs((value := float(f"{turn:.{k}g}")) - turn) <= uncertainty
    ]
    return found[0] if found else turn


def _declared(name: str, values: Array, modulus: float) -> tuple[Array, str]:
    """Return a column without the declared change at which it starts again, and a note."""
    exact = 2.0 * pi if abs(modulus / (2.0 * pi) - 1.0) < WHOLE_TOLERANCE else modulus
    known = values[np.isfinite(values)]
    span = float(np.ptp(known)) if known.size else 0.0
    if span > (1.0 + WHOLE_TOLERANCE) * exact:
        raise ValueError(
            f"`{name}` covers {span:.6g} in units of its column, and `wraps_after` is {modulus:g}: "
            "a column that starts again covers at most one turn; correct or remove `wraps_after`"
        )
    result = _continued(values, exact)
    times = int(np.sum(np.abs(np.diff(known)) > 0.5 * exact))
    fastest = float(np.max(np.abs(np.diff(result[np.isfinite(result)])), initial=0.0))
    words = f"starts again after {modulus:g}, {times} times: continued"
    if fastest > ORDINARY * exact:
        words += (
            f"; between two samples it changes by up to {100.0 * fastest / exact:.0f} % of a turn, "
            "and of half a turn or more the direction is unknown"
        )
    return result, words


def _continued(values: Array, modulus: float) -> Array:
    """Return the values plus multiples of the modulus, so that no step exceeds half of it."""
    result = values.astype(np.float64)
    known = np.isfinite(result)
    steps = np.diff(result[known])
    turns = np.concatenate(([0.0], np.cumsum(-np.rint(steps / modulus))))
    result[known] += modulus * turns
    return result


def _time(values: Array) -> tuple[Array, str]:
    if not np.all(np.isfinite(values)):
        return values, ""
    steps = np.diff(values)
    back = steps < 0
    if not back.any():
        return values, ""
    forward = steps[steps > 0]
    if not forward.size:
        return values, ""
    period = float(np.median(forward))
    longest = TIME_PERIODS * period
    whole = bool(np.all(values == np.rint(values)))
    after = float(np.median(period - steps[back]))
    candidates = [(2.0**power, f"2^{power}") for power in POWERS if whole]
    candidates += [(2.0**32 * unit, f"2^32 x {unit:g}") for unit in CONVERTED_UNITS]
    candidates += [(DAY_S * scale, "one day") for scale in (1.0, 1e3, 1e6)]
    for modulus, words in candidates:
        # A clock counts on, less a few lost samples; 0 to 999 is a part of a second, no 10 bits.
        if abs(after - modulus) > SURE_SHARE * modulus:
            continue
        over = steps[back] + modulus
        if values.min() >= 0 and values.max() < modulus and np.all((over > 0) & (over <= longest)):
            turns = np.concatenate(([0.0], np.cumsum(back)))
            return values + modulus * turns, (
                f"starts again after {words}, {int(back.sum())} times: corrected"
            )
    return values, ""


def read_channels(
    table: Table, section: RecordingSection, document: Document[Campaign], index: int
) -> tuple[dict[str, Array], int, list[str]]:
    """Read the columns that a recording maps.

    Returns:
        Canonical channels in SI units, all of shape (n,), including the time; the number of rows of
        the file before the first used row; and notes.
    """
    columns, notes = _columns(table, section, document, index)
    # A column may feed several channels; it is read once.
    data: dict[int, Array] = {}
    for base in dict.fromkeys(_base(table, column) for column in columns.values()):
        wanted = sorted({c for c in columns.values() if _base(table, c) == base})
        data |= zip(wanted, table.read(wanted), strict=True)
    wraps = {name: channel.wraps_after for name, channel in section.channels.items()}
    raw, left_out, found = on_one_time(table, columns, data, wraps)
    lengths = {name: len(values) for name, values in raw.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise InputError(
            f"{table.path}: channels differ in length: {listed}; channels must have common rows"
        )
    channels = {}
    for name, values in raw.items():
        scale, offset = section.channels[name].scale, section.channels[name].offset
        plain = scale == 1.0 and offset == 0.0
        channels[name] = np.ascontiguousarray(values if plain else values * scale + offset)
    if section.rate is not None:
        channels["time"] = np.arange(next(iter(lengths.values()))) / section.rate
    return channels, left_out, notes + found


def on_one_time(
    table: Table,
    columns: Mapping[str, int],
    data: Mapping[int, Array],
    wraps: Mapping[str, float | None],
) -> tuple[dict[str, Array], int, list[str]]:
    """Unwrap counters, resample the channels at the stamps of the time, in units of the file.

    ``wraps`` holds the change after which a channel starts again, where the campaign states it.
    Returns as well the number of rows before the first used one, and notes.
    """
    raw: dict[str, Array] = {}
    notes: list[str] = []
    problems: list[str] = []
    for name, column in columns.items():
        scale, values, after = table.counts.get(column), data[column], wraps.get(name)
        try:
            if after is not None:
                raw[name], note = _declared(name, values, after)
            elif scale is None:
                raw[name], note = unwrapped(name, values)
            else:
                raw[name], note = unwrapped_counts(name, values, scale)
        except ValueError as error:
            problems.append(f"{table.path}: {error}")
            continue
        notes += [f"`{name}`: {note}"] if note else []
        turn = None if note or name not in POSITIONS | TIMES else starts_again(values)
        if turn is not None:
            problems.append(f"{table.path}: {starting_again(name, turn)}")
    if problems:
        raise InputError(problems)
    raw, left_out, joined = _joined(table, columns, raw)
    return raw, left_out, notes + joined


def starting_again(name: str, turn: Turn) -> str:
    """Return that a column starts again after a turn, with the key that states this, if any."""
    times = "once" if turn.times == 1 else f"{turn.times} times"
    if name in TIMES:
        return (
            f"`{name}` starts again {times}, after {turn.after:.6g} in units of its column, which "
            "is no end of a counter that is known: the column holds a part of the time, or several "
            "recordings; use a column in which the whole time goes on, state `rate` in place of "
            "`time`, or cut the file there"
        )
    return (
        f"`{name}` jumps {times} over its whole range, by {turn.after:.6g} in units of its column: "
        "it starts again after a turn; state the turn beside the column, "
        f"`{name}: {{column: ..., wraps_after: {turn.after:.10g}}}`; if it was set to zero there, "
        "use the part before or after the jump by `window`"
    )


def _columns(
    table: Table, section: RecordingSection, document: Document[Campaign], index: int
) -> tuple[dict[str, int], list[str]]:
    columns: dict[str, int] = {}
    problems: list[str] = []
    notes: list[str] = []
    for name, channel in section.channels.items():
        found = _find(table, channel.column)
        if isinstance(found, int):
            columns[name] = found
            if isinstance(channel.column, str) and table.names[found] != channel.column:
                notes.append(f"`{name}`: {channel.column!r} is column {table.names[found]!r}")
        else:
            problems.append(
                document.problem(("recordings", index, "channels", name), found, channel.column)
            )
    if problems:
        raise InputError(problems)
    return columns, notes


def _base(table: Table, column: int) -> int:
    return table.bases[column] if table.bases else 0


def _joined(
    table: Table, columns: Mapping[str, int], raw: dict[str, Array]
) -> tuple[dict[str, Array], int, list[str]]:
    """Resample channels of several time bases at the time stamps of the column of time."""
    bases = {name: _base(table, column) for name, column in columns.items()}
    several = sorted(set(bases.values()))
    table.base = bases.get("time", several[0])
    if len(several) == 1:
        return raw, 0, []
    names = ", ".join(table.base_names[base] for base in several)
    if "time" not in bases:
        raise InputError(
            f"{table.path}: the columns are of several time bases ({names}); instead of `rate`, "
            "map `time` to the stamps of one time base, or use only columns of one time base"
        )
    stamps = {base: table.stamps(base) for base in several}
    found = {n: Base(table.base_names[n], s) for n, s in stamps.items() if s is not None}
    if len(found) < len(several):
        without = ", ".join(table.base_names[base] for base in several if base not in found)
        raise InputError(
            f"{table.path}: the columns are of several time bases ({names}), and {without} has "
            "no stamps on a clock that all time bases share; use columns of one time base"
        )
    try:
        of = {name: found[base] for name, base in bases.items()}
        return _on_one_base(raw, of, found[bases["time"]])
    except StampsError as error:
        raise InputError(f"{table.path}: {error}") from None


def _find(table: Table, column: str | int) -> int | str:
    """Return a column's index, or an error message if the column is not found."""
    if isinstance(column, int):
        count = len(table.names)
        return (
            column
            if column < count
            else f"{table.path} has {count} columns, index 0 to {count - 1}"
        )
    matches = [k for k, name in enumerate(table.names) if name == column]
    if len(matches) == 1:
        return matches[0]
    if not matches:
        matches = [k for k, name in enumerate(table.names) if name.endswith(f".{column}")]
        if len(matches) == 1:
            return matches[0]
    if matches:
        full = [table.names[k] for k in matches]
        words = f"one of {matches}"
        if len(set(full)) > 1:
            words = f"or the whole name: {', '.join(full[:8])}{', ...' if len(full) > 8 else ''}"
        return f"{table.path} has {len(matches)} columns of this name; give the index, {words}"
    named = [name for name in table.names if name]
    if not named:
        return (
            f"{table.path} has no header line below the skipped rows; give the index, 0 to "
            f"{len(table.names) - 1}"
        )
    listed = f"columns are {', '.join(named[:20])}{', ...' if len(named) > 20 else ''}"
    suggestion = nearest(column, named)
    notes = "".join(f"; {note}" for note in table.notes)
    return f"no such column in {table.path}; " + (
        f"{suggestion} {listed}{notes}" if "did you" in suggestion else listed + notes
    )
