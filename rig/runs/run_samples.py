"""Reads the samples of a run by segment: a complete recording is streamed, an incomplete recording
is read as a whole.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from identification.recording import Array
from rig.common.errors import InputError
from rig.common.input_files import is_file
from rig.runs.mcap.reader import Log, NotARecordingError, read_run
from rig.runs.mcap.records import DamageError
from rig.runs.mcap.stream import sample_blocks
from rig.runs.run_record import SegmentRecord

STAMPS = ("time", "host_time", "device_time", "encoder_time", "fresh")
LEFT_OUT = ("velocity", "voltage", "supply_voltage", "temperature")
"""Channels that an identification does not need."""
CHANNELS = (
    "command",
    "motor_angle",
    "angle",
    "velocity",
    "current",
    "voltage",
    "supply_voltage",
    "temperature",
)
MOST_SAMPLES = 5_000_000
"""Number of samples of one recording above which the channels :data:`LEFT_OUT` are not read; ten
hours at 1 kHz fit into 4 GiB without these channels.
"""
_MOST_PER_BYTE = 4
"""Greatest number of samples per byte of a recording, because LZ4 packs 255 bytes into 1; a
``run.json`` that states more samples is wrong.
"""

Samples = dict[str, Array]


def by_segment(
    path: Path, segments: Sequence[SegmentRecord], *, whole: bool
) -> tuple[dict[int, Samples], str | None]:
    """Return the samples by index of the segment, including stale samples, and a message on damage.

    Args:
        path: The recording.
        segments: The requested segments.
        whole: Whether the recording was closed regularly, so that it can be streamed.

    Raises:
        InputError: The file cannot be opened or is not a recording.
    """
    most = _MOST_PER_BYTE * path.stat().st_size if is_file(path) else 0
    expected = {s.index: min(s.samples, most) for s in segments}
    fields = {s.index: _fields(s, sum(other.samples for other in segments)) for s in segments}
    if whole:
        try:
            wanted = sorted({name for names in fields.values() for name in names})
            return _gather(sample_blocks(path, ["segment", *wanted]), fields, expected), None
        except (DamageError, OSError):
            pass  # read_log reports the damage in full
    log = read_log(path)
    return _gather([log.samples], fields, expected), log.damage


def read_log(path: Path) -> Log:
    """Read a recording as a whole.

    Raises:
        InputError: The file cannot be opened or is not a recording.
    """
    try:
        return read_run(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except NotARecordingError as error:
        raise InputError(str(error)) from error


def _fields(segment: SegmentRecord, total: int) -> tuple[str, ...]:
    channels = (
        CHANNELS if total <= MOST_SAMPLES else tuple(c for c in CHANNELS if c not in LEFT_OUT)
    )
    return (*STAMPS, *channels, *(["pressure"] if segment.stage == "hot_fire" else []))


class _Growing:
    """One field of a segment, into which blocks are copied as they arrive, because joining the
    blocks at the end would need twice the memory.
    """

    def __init__(self, expected: int) -> None:
        self._values = np.empty(expected)
        self._count = 0

    def extend(self, values: Array) -> None:
        """Add values; if there are more values than expected, the whole field is copied."""
        stop = self._count + len(values)
        if stop > len(self._values):
            self._values = np.concatenate(
                (self._values[: self._count], np.empty(2 * len(values) + self._count))
            )
        self._values[self._count : stop] = values
        self._count = stop

    def done(self) -> Array:
        """Return all added values."""
        return self._values[: self._count]


def _gather(
    blocks: Iterable[Mapping[str, Array]],
    fields: Mapping[int, Sequence[str]],
    expected: Mapping[int, int],
) -> dict[int, Samples]:
    """Return the samples of each segment from blocks of samples of all segments."""
    held = {k: {name: _Growing(expected[k]) for name in names} for k, names in fields.items()}
    for block in blocks:
        for k, names in fields.items():
            mine = block["segment"] == k
            if mine.any():
                for name in names:
                    held[k][name].extend(block[name][mine])
    return {k: {name: grown.done() for name, grown in each.items()} for k, each in held.items()}
