"""Reads the columns that a campaign maps, as canonical channels in SI units on one time base."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from identification.recording import Array
from rig.common.errors import InputError
from rig.config.campaign import Campaign
from rig.config.campaign_columns import ChannelSection
from rig.config.campaign_sections import RecordingSection
from rig.config.configuration import Document, Loc, nearest
from rig.sources.formats import Table
from rig.sources.one_base import Base, StampsError, on_one_base
from rig.sources.wraps import unwrapped, unwrapped_counts


def read_channels(
    table: Table, section: RecordingSection, document: Document[Campaign], index: int
) -> tuple[dict[str, Array], int, list[str]]:
    """Read the columns that a recording maps.

    Args:
        table: The opened file.
        section: Entry of the file in the campaign.
        document: The campaign, for the place of the entry in errors.
        index: Position of the entry in ``recordings``.

    Returns:
        Canonical channels in SI units, all of shape (n,), including the time; the number of rows of
        the file before the first used row; and notes.

    Raises:
        InputError: A column is missing or has no numbers, or the columns have no common rows.
    """
    columns, notes = _columns(table, section, document, index)
    # A column may feed several channels; it is read once.
    data: dict[int, Array] = {}
    for base in dict.fromkeys(_base(table, column) for column in columns.values()):
        wanted = sorted({c for c in columns.values() if _base(table, c) == base})
        data |= zip(wanted, table.read(wanted), strict=True)
    raw, left_out, found = on_one_time(table, columns, data)
    lengths = {name: len(values) for name, values in raw.items()}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name} {n}" for name, n in lengths.items())
        raise InputError(
            f"{table.path}: channels differ in length: {listed}; channels must have common rows"
        )
    channels = {name: _to_si(values, section.channels[name]) for name, values in raw.items()}
    if section.rate is not None:
        channels["time"] = np.arange(next(iter(lengths.values()))) / section.rate
    return channels, left_out, notes + found


def on_one_time(
    table: Table, columns: Mapping[str, int], data: Mapping[int, Array]
) -> tuple[dict[str, Array], int, list[str]]:
    """Unwrap counters, and resample the channels at the time stamps of the column of time.

    Args:
        table: The opened file.
        columns: Column of each channel.
        data: Values of each column, on its own time base.

    Returns:
        Channels in the units of the file, the number of rows of the file before the first used
        row, and notes.

    Raises:
        InputError: The columns cannot be brought to common times.
    """
    raw: dict[str, Array] = {}
    notes: list[str] = []
    for name, column in columns.items():
        scale = table.counts.get(column)
        values = data[column]
        raw[name], note = (
            unwrapped(name, values) if scale is None else unwrapped_counts(name, values, scale)
        )
        notes += [f"`{name}`: {note}"] if note else []
    raw, left_out, joined = _joined(table, columns, raw)
    return raw, left_out, notes + joined


def _columns(
    table: Table, section: RecordingSection, document: Document[Campaign], index: int
) -> tuple[dict[str, int], list[str]]:
    """Return the index of each channel's column, and notes on incomplete names that were completed.

    Raises:
        InputError: No column, or more than one column, fits a channel.
    """
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
            problems.append(document.problem(_column_loc(index, name), found, channel.column))
    if problems:
        raise InputError(problems)
    return columns, notes


def _base(table: Table, column: int) -> int:
    return table.bases[column] if table.bases else 0


def _joined(
    table: Table, columns: Mapping[str, int], raw: dict[str, Array]
) -> tuple[dict[str, Array], int, list[str]]:
    """Resample channels of several time bases at the time stamps of the column of time.

    Raises:
        InputError: No column of time selects the time base, or the time bases have no common clock.
    """
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
        return on_one_base(raw, of, found[bases["time"]])
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


def _column_loc(index: int, name: str) -> Loc:
    return ("recordings", index, "channels", name)


def _to_si(values: Array, channel: ChannelSection) -> Array:
    if channel.scale == 1.0 and channel.offset == 0.0:
        return np.ascontiguousarray(values)
    scaled: Array = values * channel.scale
    scaled += channel.offset
    return scaled
