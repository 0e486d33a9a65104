"""Reads TDMS files of LabVIEW and DIAdem with the optional library npTDMS."""

from __future__ import annotations

import logging
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array
from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.formats.table import (
    NotNumbersError,
    Table,
    as_doubles,
    damaged,
    heard,
    library,
    open_binary,
    quiet_ends,
    seconds_per,
)

_DAMAGED = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
)
"""Exceptions that npTDMS raises on damaged files."""
_FRACTION_S = 2.0**-64
"""Value of one unit of the fractional part of a time stamp, s."""
_UNIT_PROPERTIES = ("unit_string", "NI_UnitDescription")
_UNSUPPORTED = "Unsupported scale type"


class _Waveform(NamedTuple):
    """Time of a waveform: start (seconds and units of 2^-64 s since 1904, or None if not stated),
    time from the start to the first sample, and sample period, s.
    """

    start: tuple[int, int] | None
    offset: float
    increment: float


class _Base(NamedTuple):
    group: str
    length: int
    waveform: _Waveform | None


class _Column(NamedTuple):
    base: int
    channel: str | None
    """Name of the channel; None for the computed time of a waveform."""


class TdmsTable(Table):
    """Table with one column for each channel, named ``group.channel``; with only one group, the
    name of the group is left out.

    Channels of one group with equal length and equal waveform properties have common rows; the time
    of a waveform is a further column, ``time``. Scales of the file are applied. A channel of time
    stamps is read as seconds since the first stamp.

    Raises:
        InputError: npTDMS is not installed, or the file is damaged or holds no channels.
    """

    def __init__(self, path: Path, _: ReadSection) -> None:
        self.path = path
        self._nptdms = library("nptdms", path, "TDMS", "tdms")
        self._bases: list[_Base] = []
        self._whole: list[_Base] = []
        found: list[tuple[_Column, str, str]] = []
        with self._opened() as file:
            for group in file.groups():
                for channel in group.channels():
                    if len(channel):
                        base = self._base_of(channel, file.file_status)
                        unit = _unit(channel.properties)
                        found.append((_Column(base, channel.name), channel.name, unit))
            if file.file_status.incomplete_final_segment:
                self.note(
                    "the file is cut off; only rows that all channels of a group have are read"
                )
        if not found:
            raise InputError(f"{path}: holds no channels with samples")
        groups = {base.group for base in self._bases}
        self.base_names = tuple(self._base_names())
        columns: list[tuple[_Column, str, str]] = []
        for base, kept in enumerate(self._bases):
            own = [one for one in found if one[0].base == base]
            if kept.waveform is not None:
                names = {name for column, name, _ in found if self._group(column) == kept.group}
                several = [b for b in self._bases if b.group == kept.group and b.waveform]
                word = "time" if "time" not in names else "time_track"
                name = word if len(several) == 1 else f"{own[0][1]}.{word}"
                columns.append((_Column(base, None), name, "s"))
            columns += own
        self._columns = [column for column, _, _ in columns]
        self.names = tuple(
            name if len(groups) == 1 else f"{self._group(column)}.{name}"
            for column, name, _ in columns
        )
        self.units = tuple(unit for _, _, unit in columns)
        self.bases = tuple(column.base for column in self._columns)

    def _group(self, column: _Column) -> str:
        return self._bases[column.base].group

    def _base_of(self, channel: Any, status: Any) -> int:
        """Return the time base of a channel; in a file that is cut off, by the channel's length
        before the cut.
        """
        cut = (status.channel_statuses or {}).get(channel.path)
        lost = 0 if cut is None else cut.expected_length - cut.read_length
        whole = _Base(channel.group_name, len(channel) + lost, _waveform(channel))
        if whole not in self._whole:
            self._whole.append(whole)
            self._bases.append(whole)
        base = self._whole.index(whole)
        length = min(len(channel), self._bases[base].length)
        self._bases[base] = whole._replace(length=length)
        return base

    def _base_names(self) -> Iterator[str]:
        groups = [base.group for base in self._bases]
        for k, group in enumerate(groups):
            place = groups[:k].count(group)
            yield group if groups.count(group) == 1 else f"{group}[{place}]"

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """Open the file with npTDMS, and close it at the end.

        Raises:
            InputError: The file is damaged.
        """
        # npTDMS prints its warnings with its own handler.
        self._nptdms.log.log_manager.console_handler.setLevel(logging.CRITICAL + 1)
        said: list[str] = []
        try:
            with (
                heard("nptdms") as said,
                quiet_ends(),
                open_binary(self.path) as stream,
                self._nptdms.TdmsFile.open(stream, raw_timestamps=True) as file,
            ):
                yield file
        except InputError:
            raise
        except _DAMAGED as error:
            raise damaged(
                self.path, error, "check that the file was copied completely, or save it again"
            ) from error
        for words in said:
            if _UNSUPPORTED in words:
                raise InputError(
                    f"{self.path}: a channel's scale cannot be applied ({words}); save the scaled "
                    f"values"
                )
            self.note(f"npTDMS: {words}")

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`."""
        self.require_one_base(columns)
        with self._opened() as file:
            return [self._values(file, self._columns[k], self.names[k]) for k in columns]

    def stamps(self, base: int) -> Array | None:
        """Return the time of the waveform on the clock of the file; see :meth:`Table.stamps`.

        Without a waveform, the stamps are those of a channel of time stamps that has as many rows.
        """
        starts = [b.waveform.start for b in self._bases if b.waveform and b.waveform.start]
        waveform = self._bases[base].waveform
        with self._opened() as file:
            channels = file[self._bases[base].group].channels()
            dated = [c for c in channels if len(c) == self._whole[base].length and _is_dated(c)]
            starts += [_exact(channel) for channel in _dated_channels(file)]
            earliest = min(starts, default=None)
            if waveform is not None:
                if waveform.start is None:
                    return self._time(waveform, base) if earliest is None else None
                assert earliest is not None
                return self._time(waveform, base) + _since(waveform.start, earliest)
            if len(dated) != 1 or earliest is None:
                return None
            own = _exact(dated[0])
            return _stamp_seconds(dated[0][: self._bases[base].length]) + _since(own, earliest)

    def _time(self, waveform: _Waveform, base: int) -> Array:
        rows = np.arange(self._bases[base].length, dtype=np.float64)
        return waveform.offset + waveform.increment * rows

    def _values(self, file: Any, column: _Column, name: str) -> Array:
        base = self._bases[column.base]
        if column.channel is None:
            assert base.waveform is not None
            return self._time(base.waveform, column.base)
        samples: NDArray[Any] = file[base.group][column.channel][: base.length]
        if samples.dtype.names is not None:
            self.note(f"`{name}` holds time stamps: read as seconds since the first")
            return _stamp_seconds(samples)
        try:
            values, note = as_doubles(np.asarray(samples))
        except NotNumbersError as error:
            raise InputError(
                f"{self.path}: channel {name!r} does not contain numbers ({error})"
            ) from None
        if note:
            self.note(f"`{name}`: {note}")
        return values


def _unit(properties: Mapping[str, Any]) -> str:
    return next((str(properties[key]) for key in _UNIT_PROPERTIES if key in properties), "")


def _waveform(channel: Any) -> _Waveform | None:
    """Return the waveform properties of a channel, or None if the channel has none, or if its
    waveform is not over time.
    """
    properties = channel.properties
    try:
        increment = float(properties["wf_increment"])
        offset = float(properties.get("wf_start_offset", 0.0))
    except (KeyError, TypeError, ValueError):
        return None
    scale = seconds_per(str(properties.get("wf_xunit_string", "") or "s"))
    if not (math.isfinite(increment) and math.isfinite(offset)) or increment <= 0 or scale is None:
        return None
    start = properties.get("wf_start_time")
    known = hasattr(start, "second_fractions")
    exact = (int(start.seconds), int(start.second_fractions)) if known else None
    # LabVIEW writes the start of 1904 if no start time was set.
    return _Waveform(exact if exact and any(exact) else None, offset * scale, increment * scale)


def _is_dated(channel: Any) -> bool:
    return channel.data_type is not None and channel.data_type.__name__ == "TimeStamp"


def _dated_channels(file: Any) -> Iterator[Any]:
    """Yield the channels of a file that contain time stamps."""
    for group in file.groups():
        yield from (channel for channel in group.channels() if len(channel) and _is_dated(channel))


def _exact(channel: Any) -> tuple[int, int]:
    first = channel[0]
    return int(first.seconds), int(first.second_fractions)


def _since(stamp: tuple[int, int], first: tuple[int, int]) -> float:
    """Return the time between two stamps, s."""
    whole = ((stamp[0] - first[0]) << 64) + stamp[1] - first[1]
    return whole / 2**64


def _stamp_seconds(stamps: Any) -> Array:
    """Return time stamps as seconds since the first stamp."""
    seconds = np.asarray(stamps.seconds, np.int64)
    fractions = np.asarray(stamps.second_fractions, np.uint64)
    first = fractions[0]
    over = np.where(fractions >= first, fractions - first, first - fractions).astype(np.float64)
    rest = np.where(fractions >= first, over, -over) * _FRACTION_S
    whole: Array = (seconds - seconds[0]).astype(np.float64)
    return cast(Array, whole + rest)
