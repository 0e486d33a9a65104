"""Reads ASAM MDF files (MF4, and MDF versions 2 and 3) with the optional library asammdf."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.recording import Array
from rig.common.errors import InputError
from rig.common.places import require_plain
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
    BufferError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
    zlib.error,
)
"""Exceptions that asammdf raises on damaged files, in addition to its own exception."""
_REMEDY = "check that the file was copied completely, or save it again with the tool that wrote it"
TIME_MASTER = 1
"""Sync type of a master channel that contains the time, s."""
_MASTERS = {2: "an angle", 3: "a distance", 4: "an index"}
_LINEAR = {3: 0, 4: 1}
"""Type number of the linear conversion, by version of the format."""


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

    Raises:
        InputError: asammdf is not installed, or the file is damaged or holds no samples.
    """

    def __init__(self, path: Path, _: ReadSection) -> None:
        self.path = path
        self._asammdf = library("asammdf", path, "MDF", "mdf")
        columns: list[tuple[_Channel, str, str]] = []
        counts: dict[int, tuple[float, float]] = {}
        with self._opened() as mdf:
            groups = [k for k, group in enumerate(mdf.groups) if group.channel_group.cycles_nr]
            self._require_inside(mdf, groups)
            self.base_names = tuple(_group_names(mdf, groups))
            self._masters: Mapping[int, Any] = dict(mdf.masters_db)
            for base, group in enumerate(groups):
                prefix = f"{self.base_names[base]}." if len(groups) > 1 else ""
                for index, channel in enumerate(mdf.groups[group].channels):
                    for found in _parts(mdf, group, index):
                        suffix = "" if found.series is None else f"[{found.series}]"
                        scale = _linear(channel.conversion, mdf.version)
                        if scale is not None:
                            counts[len(columns)] = scale
                        name = f"{prefix}{channel.name}{suffix}"
                        columns.append((found, name, str(channel.unit or "")))
        if not columns:
            raise InputError(f"{path}: holds no samples; check that the measurement was saved")
        self._columns = [found for found, _, _ in columns]
        self.names = tuple(name for _, name, _ in columns)
        self.units = tuple(unit for _, _, unit in columns)
        self.counts = counts
        where = {group: base for base, group in enumerate(groups)}
        self._groups = groups
        self.bases = tuple(where[found.group] for found in self._columns)

    def _require_inside(self, mdf: Any, groups: Sequence[int]) -> None:
        """Check that each channel lies within the records of its group; asammdf reads beyond them,
        which ends the process or returns other data.
        """
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
                        f"records of {record_bits // 8} bytes); {_REMEDY}"
                    )

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """Open the file with asammdf, and close it at the end.

        Raises:
            InputError: The file is damaged.
        """
        require_plain(self.path)
        errors = (*_DAMAGED, self._asammdf.blocks.utils.MdfException)
        zipped = self.path.suffix.lower() == ".gz"
        said: list[str] = []
        try:
            # asammdf prints messages when it fails.
            with heard("asammdf") as said, quiet_ends(), redirect_stdout(io.StringIO()):
                source: Any = open_binary(self.path) if zipped else str(self.path)
                with self._asammdf.MDF(source) as mdf:
                    yield mdf
        except InputError:
            raise
        except errors as error:
            raise damaged(self.path, error, _REMEDY) from error
        for words in said:
            self.note(f"asammdf: {words}")

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`."""
        self.require_one_base(columns)
        with self._opened() as mdf:
            return [self._values(mdf, self._columns[k], self.names[k]) for k in columns]

    def stamps(self, base: int) -> Array | None:
        """Return the master channel of a group if it contains the time; see
        :meth:`Table.stamps`.
        """
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
        try:
            if samples.ndim != 1:
                raise NotNumbersError("bytes or a structure")
            values, note = as_doubles(samples)
        except NotNumbersError as error:
            raise InputError(
                f"{self.path}: channel {name!r} does not contain numbers ({error})"
            ) from None
        if note:
            self.note(f"`{name}`: {note}")
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
    """Yield a channel, or each element of an array channel; the members of a structure are
    channels.
    """
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
    """Return factor and offset of a linear conversion, or None for a channel without a conversion
    or with a conversion of another type.
    """
    if conversion is None:
        return None
    linear = _LINEAR.get(min(4, max(3, int(str(version)[0]))))
    if conversion.conversion_type != linear:
        return None
    return float(conversion.a), float(conversion.b)
