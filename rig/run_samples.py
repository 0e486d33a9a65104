"""The samples of a run, segment by segment: streamed where the recording is whole, read at once where it is not."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from identification.recording import Array
from rig.errors import InputError
from rig.mcap_reader import Log, NotARecordingError, read_run
from rig.mcap_records import DamageError
from rig.mcap_stream import sample_blocks
from rig.run_record import SegmentRecord

STAMPS = ("time", "host_time", "device_time", "encoder_time", "fresh")
LEFT_OUT = ("velocity", "voltage", "supply_voltage", "temperature")
"""Channels that an identification does without."""
CHANNELS = ("command", "motor_angle", "angle", "velocity", "current", "voltage", "supply_voltage", "temperature")
MOST_SAMPLES = 5_000_000
"""Samples of one recording above which :data:`LEFT_OUT` is not read: ten hours at 1 kHz fit into 4 GiB without."""

Samples = dict[str, Array]


def by_segment(path: Path, segments: Sequence[SegmentRecord], *, whole: bool) -> tuple[dict[int, Samples], str | None]:
    """Return segment index to its samples, stale ones among them, and what is damaged in words.

    Args:
        path: The recording.
        segments: Those that are wanted.
        whole: Whether the recording was closed in order, so that it can be streamed.

    Raises:
        InputError: It cannot be opened or is not a recording.
    """
    fields = {s.index: _fields(s, sum(other.samples for other in segments)) for s in segments}
    if whole:
        try:
            wanted = sorted({name for names in fields.values() for name in names})
            return _gather(sample_blocks(path, ["segment", *wanted]), fields), None
        except (DamageError, OSError):
            pass  # read_log says what is wrong, in full
    log = read_log(path)
    return _gather([log.samples], fields), log.damage


def read_log(path: Path) -> Log:
    """Read a recording as a whole.

    Raises:
        InputError: It cannot be opened or is not a recording.
    """
    try:
        return read_run(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except NotARecordingError as error:
        raise InputError(str(error)) from error


def _fields(segment: SegmentRecord, total: int) -> tuple[str, ...]:
    channels = CHANNELS if total <= MOST_SAMPLES else tuple(c for c in CHANNELS if c not in LEFT_OUT)
    return (*STAMPS, *channels, *(["pressure"] if segment.stage == "hot_fire" else []))


def _gather(blocks: Iterable[Mapping[str, Array]], fields: Mapping[int, Sequence[str]]) -> dict[int, Samples]:
    """Return the samples of each segment out of blocks of all, joined field by field."""
    parts: dict[int, dict[str, list[Array]]] = {k: {name: [] for name in names} for k, names in fields.items()}
    for block in blocks:
        for k, names in fields.items():
            mine = block["segment"] == k
            if not mine.any():
                continue
            for name in names:
                parts[k][name].append(block[name][mine])
    joined: dict[int, Samples] = {}
    for k, held in parts.items():
        # Piece by piece, so that no more than one field is held twice.
        joined[k] = {name: np.concatenate(held.pop(name) or [np.zeros(0)]) for name in fields[k]}
    return joined
