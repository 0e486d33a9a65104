"""Reads ASAM MDF (asammdf) and TDMS of LabVIEW and DIAdem (npTDMS)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from rig.common.errors import InputError
from rig.sources.table import Array, Column, Table, heard, library, open_binary, seconds_per

TIME_MASTER = 1
_MASTERS = {2: "an angle", 3: "a distance", 4: "an index"}
_LINEAR = {3: 0, 4: 1}  # type number of the linear conversion, by version of the format


class _Channel(NamedTuple):
    group: int
    place: int
    series: int | None


class MdfTable(Table):
    """Table with one column for each channel, named ``group.channel``; with only one group, the
    name of the group is left out.

    A channel with an array is ``channel[0]``, ``channel[1]``, ... Conversions of the file are
    applied; samples that are marked by invalidation bits are NaN. Labels (value to text) are read
    as raw numbers, with a note. Each channel group has its own time base; all time bases are on the
    clock of the file.
    """

    def __init__(self, path: Path, _: object = None) -> None:
        self.path = path
        # asammdf imports python-can, whose reader of MDF would then find asammdf incomplete.
        import can  # noqa: F401

        self._asammdf = library("asammdf", path, "MDF", "mdf")
        columns: list[Column] = []
        with self._opened() as mdf:
            groups = [k for k, group in enumerate(mdf.groups) if group.channel_group.cycles_nr]
            self._require_inside(mdf, groups)
            self._groups, base_names = groups, _group_names(mdf, groups)
            self._masters: Mapping[int, Any] = dict(mdf.masters_db)
            for base, group in enumerate(groups):
                prefix = f"{base_names[base]}." if len(groups) > 1 else ""
                for index, channel in enumerate(mdf.groups[group].channels):
                    scale = _linear(channel.conversion, mdf.version)
                    for found in _parts(mdf, group, index):
                        suffix = "" if found.series is None else f"[{found.series}]"
                        name, unit = f"{prefix}{channel.name}{suffix}", str(channel.unit or "")
                        columns.append(Column(name, found, unit, base, scale))
        if not columns:
            raise InputError(f"{path}: holds no samples; check that the measurement was saved")
        self._lay_out(columns, base_names)

    def _require_inside(self, mdf: Any, groups: Sequence[int]) -> None:
        """Check that each channel lies within its records; asammdf reads beyond."""
        for group in groups:
            record_bits = 8 * mdf.groups[group].channel_group.samples_byte_nr
            for channel in mdf.groups[group].channels:
                if hasattr(channel, "byte_offset"):
                    first = 8 * channel.byte_offset + channel.bit_offset
                else:
                    more = getattr(channel, "additional_byte_offset", 0)
                    first = channel.start_offset + 8 * more
                if first + channel.bit_count > record_bits:
                    raise InputError(
                        f"{self.path}: cannot be read (channel {channel.name!r} is beyond its "
                        f"records of {record_bits // 8} bytes); {self.remedy}"
                    )

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        zipped = self.path.suffix.lower() == ".gz"
        with heard("asammdf") as said:
            source: Any = open_binary(self.path) if zipped else str(self.path)
            with self._asammdf.MDF(source) as mdf:
                yield mdf
        for words in said:
            self.note(f"asammdf: {words}")

    def _read(self, columns: Sequence[int]) -> list[Array]:
        with self._opened() as mdf:
            return [self._values(mdf, self._sources[k], self.names[k]) for k in columns]

    def stamps(self, base: int) -> Array | None:
        """Return the master channel of a group if it is time; see :meth:`Table.stamps`."""
        group = self._groups[base]
        index = self._masters.get(group)
        if index is None:
            return None
        with self._opened() as mdf:
            channel = mdf.groups[group].channels[index]
            if getattr(channel, "sync_type", TIME_MASTER) != TIME_MASTER:
                self.note(
                    f"{self.base_names[base]} is sampled over "
                    f"{_MASTERS.get(channel.sync_type, 'something else')}, not over time"
                )
                return None
            scale = seconds_per(str(channel.unit or "s"))
            values = self._values(mdf, _Channel(group, index, None), channel.name)
            return values if scale is None else values * scale

    def _values(self, mdf: Any, where: _Channel, name: str) -> Array:
        signal = mdf.get(group=where.group, index=where.place, ignore_invalidation_bits=True)
        samples: NDArray[Any] = np.asarray(signal.samples)
        if samples.dtype.kind in "SUO":
            samples = self._labels(mdf, where, name, samples)
        if samples.dtype.names is not None:
            samples = samples[samples.dtype.names[0]]
        if where.series is not None:
            samples = samples.reshape(len(samples), -1)[:, where.series]
        values = self.doubles(name, samples)
        invalid = signal.invalidation_bits
        if invalid is not None and np.any(invalid):
            values = np.where(np.asarray(invalid, np.bool_), np.nan, values)
        return values

    def _labels(self, mdf: Any, where: _Channel, name: str, samples: NDArray[Any]) -> NDArray[Any]:
        """Return the raw numbers of labels, or the text if the labels have no numbers."""
        numbers = [
            float(value) if isinstance(value, int | float | np.number) else np.nan
            for value in samples.tolist()
        ]
        if np.any(np.isfinite(numbers)):
            self.note(
                f"`{name}` has text labels between its numbers; the labels are read as "
                "missing values"
            )
            return np.array(numbers)
        raw = np.asarray(
            mdf.get(
                group=where.group, index=where.place, raw=True, ignore_invalidation_bits=True
            ).samples
        )
        if raw.dtype.kind in "biuf":
            found = dict.fromkeys(
                text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
                for text in samples[:1000].tolist()
            )
            self.note(f"`{name}` holds labels ({', '.join(found)[:60]}): read as its raw numbers")
            return raw
        return samples


def _group_names(mdf: Any, groups: Sequence[int]) -> list[str]:
    """Return the names of the groups, with a number added to names that occur more than once."""
    names = []
    for group in groups:
        stated = str(getattr(mdf.groups[group].channel_group, "acq_name", None) or "").strip()
        names.append(stated or f"group{group}")
    return [
        name if names.count(name) == 1 else f"{name}[{group}]"
        for name, group in zip(names, groups, strict=True)
    ]


def _parts(mdf: Any, group: int, index: int) -> Iterator[_Channel]:
    """Yield a channel, or each element of an array; the members of a structure are channels."""
    dependency = mdf.groups[group].channel_dependencies[index]
    if not dependency:
        yield _Channel(group, index, None)
    elif not isinstance(dependency[0], tuple):
        first = np.asarray(
            mdf.get(
                group=group,
                index=index,
                ignore_invalidation_bits=True,
                record_offset=0,
                record_count=1,
            ).samples
        )
        names = first.dtype.names
        values = first if names is None else first[names[0]]
        for series in range(int(np.prod(values.shape[1:], dtype=np.int64))):
            yield _Channel(group, index, series)


def _linear(conversion: Any, version: str) -> tuple[float, float] | None:
    """Return factor and offset of a linear conversion, else None."""
    if conversion is None:
        return None
    linear = _LINEAR.get(min(4, max(3, int(str(version)[0]))))
    if conversion.conversion_type != linear:
        return None
    return float(conversion.a), float(conversion.b)


_FRACTION_S = 2.0**-64  # value of one unit of the fractional part of a time stamp, s
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


class TdmsTable(Table):
    """Table with one column for each channel, named ``group.channel``; with only one group, the
    name of the group is left out.

    Channels of one group with equal length and equal waveform properties have common rows; the time
    of a waveform is a further column, ``time``. Scales of the file are applied. A channel of time
    stamps is read as seconds since the first stamp.
    """

    def __init__(self, path: Path, _: object = None) -> None:
        self.path = path
        self._nptdms = library("nptdms", path, "TDMS", "tdms")
        self._bases: list[_Base] = []
        self._whole: list[_Base] = []
        found: list[Column] = []
        with self._opened() as file:
            for group in file.groups():
                for channel in group.channels():
                    if len(channel):
                        base = self._base_of(channel, file.file_status)
                        unit = _unit(channel.properties)
                        found.append(Column(channel.name, channel.name, unit, base))
            if file.file_status.incomplete_final_segment:
                self.note(
                    "the file is cut off; only rows that all channels of a group have are read"
                )
        if not found:
            raise InputError(f"{path}: holds no channels with samples")
        columns: list[Column] = []
        for base, kept in enumerate(self._bases):
            own = [column for column in found if column.base == base]
            if kept.waveform is not None:
                names = {c.name for c in found if self._bases[c.base].group == kept.group}
                several = [b for b in self._bases if b.group == kept.group and b.waveform]
                word = "time" if "time" not in names else "time_track"
                name = word if len(several) == 1 else f"{own[0].name}.{word}"
                columns.append(Column(name, None, "s", base))
            columns += own
        if len({base.group for base in self._bases}) > 1:
            columns = [c._replace(name=f"{self._bases[c.base].group}.{c.name}") for c in columns]
        self._lay_out(columns, list(self._base_names()))

    def _base_of(self, channel: Any, status: Any) -> int:
        """Return the time base of a channel, by its length before the cut of a file."""
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
        with (
            heard("nptdms") as said,
            open_binary(self.path) as stream,
            self._nptdms.TdmsFile.open(stream, raw_timestamps=True) as file,
        ):
            yield file
        for words in said:
            if _UNSUPPORTED in words:
                raise InputError(
                    f"{self.path}: a channel's scale cannot be applied ({words}); save the scaled "
                    f"values"
                )
            self.note(f"npTDMS: {words}")

    def _read(self, columns: Sequence[int]) -> list[Array]:
        with self._opened() as file:
            return [self._values(file, k) for k in columns]

    def stamps(self, base: int) -> Array | None:
        """Return the time of the waveform on the clock of the file; see :meth:`Table.stamps`.

        Without a waveform, the stamps are those of a channel of time stamps that has as many rows.
        """
        starts = [b.waveform.start for b in self._bases if b.waveform and b.waveform.start]
        waveform = self._bases[base].waveform
        with self._opened() as file:
            channels = file[self._bases[base].group].channels()
            dated = [c for c in channels if len(c) == self._whole[base].length and _is_dated(c)]
            every = (c for group in file.groups() for c in group.channels())
            starts += [_exact(c) for c in every if len(c) and _is_dated(c)]
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

    def _values(self, file: Any, column: int) -> Array:
        base, channel = self._bases[self.bases[column]], self._sources[column]
        if channel is None:
            assert base.waveform is not None
            return self._time(base.waveform, self.bases[column])
        samples: NDArray[Any] = file[base.group][channel][: base.length]
        if samples.dtype.names is not None:
            self.note(f"`{self.names[column]}` holds time stamps: read as seconds since the first")
            return _stamp_seconds(samples)
        return self.doubles(self.names[column], np.asarray(samples))


def _unit(properties: Mapping[str, Any]) -> str:
    return next((str(properties[key]) for key in _UNIT_PROPERTIES if key in properties), "")


def _waveform(channel: Any) -> _Waveform | None:
    """Return the waveform properties of a channel, or None if it has none over time."""
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


def _exact(channel: Any) -> tuple[int, int]:
    first = channel[0]
    return int(first.seconds), int(first.second_fractions)


def _since(stamp: tuple[int, int], first: tuple[int, int]) -> float:
    whole = ((stamp[0] - first[0]) << 64) + stamp[1] - first[1]
    return whole / 2**64


def _stamp_seconds(stamps: Any) -> Array:
    seconds = np.asarray(stamps.seconds, np.int64)
    fractions = np.asarray(stamps.second_fractions, np.uint64)
    first = fractions[0]
    over = np.where(fractions >= first, fractions - first, first - fractions).astype(np.float64)
    rest = np.where(fractions >= first, over, -over) * _FRACTION_S
    whole: Array = (seconds - seconds[0]).astype(np.float64)
    return cast(Array, whole + rest)
