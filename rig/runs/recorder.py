"""Writes a run into an MCAP recording; a killed writer loses only the last data."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from rig.common.errors import StorageError
from rig.common.sample import Sample
from rig.runs.mcap.layout import (
    CLOCK_METADATA,
    EVENT_JSON_SCHEMA,
    EVENT_TOPIC,
    FRAME_ENCODING,
    FRAMES_TOPIC,
    SAMPLE_SCHEMA,
    SAMPLE_TOPIC,
    encode_frames,
    encode_sample,
    sample_descriptor,
)
from rig.runs.mcap.writer import McapWriter

if TYPE_CHECKING:
    from drivers.interfaces import RawFrame

FLUSH_NS = 100_000_000
LOOK_NS = 500_000_000  # time between two checks that the file is still at its place, ns of run time


_FULL = frozenset({errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)})
"""Errors of a full disk, an exceeded quota and a limit on the size of files."""


class GoneError(StorageError):
    """The recording is no longer in the folder of the run."""

    def __init__(self, path: Path, moved: bool) -> None:
        super().__init__(
            f"{path} was moved or renamed during the run; move it back, then use `rig recover`"
            if moved
            else f"{path} was deleted during the run, and its data are lost; start a new run"
        )


class Recorder:
    """A recording that is being written.

    Log times are nanoseconds since the start of the run, so that equal runs give equal bytes.

    Log times never decrease: if a clock was set back, its messages get the latest earlier log time.
    Every method raises a StorageError if it cannot write.

    Args:
        stream: A buffered binary stream; closed by :meth:`close`.
        path: The file of the stream; if given, a file that is deleted or moved is an error.
    """

    def __init__(self, stream: BinaryIO, path: Path | None = None) -> None:
        self._stream = stream
        self._path = path
        self._looked_ns = 0
        self._writer = writer = McapWriter(stream)
        self._zero_ns = 0
        self._flushed_ns = 0
        self._latest_ns = 0
        self._broken = False
        sample = writer.schema(SAMPLE_SCHEMA, "protobuf", sample_descriptor())
        event = writer.schema("loadrig.Event", "jsonschema", EVENT_JSON_SCHEMA)
        self._sample = writer.channel(SAMPLE_TOPIC, "protobuf", sample)
        self._event = writer.channel(EVENT_TOPIC, "json", event)
        self._frames = writer.channel(FRAMES_TOPIC, FRAME_ENCODING, 0)

    def begin(self, zero_ns: int) -> None:
        """Set the start of the recording, to be called before the first message; times of frames
        are then recorded as times since this start.
        """
        self._zero_ns = zero_ns
        self.metadata(CLOCK_METADATA, {"zero_ns": str(zero_ns)})

    def sample(self, time_ns: int, sample: Sample, frames: list[RawFrame]) -> None:
        """Record one cycle.

        When the method returns, all messages older than 0.1 s of run time have been passed to the
        operating system.

        Raises:
            StorageError: The cycle cannot be written (disk full), or the file was deleted or moved.
        """
        # Without the slower `with self._writing()`, because this method runs in every cycle.
        if self._broken:
            raise _broken_before()
        if time_ns < self._latest_ns:
            time_ns = self._latest_ns
        self._latest_ns = time_ns
        try:
            self._writer.message(self._sample, time_ns, encode_sample(sample))
            if frames:
                self._writer.message(self._frames, time_ns, encode_frames(frames, self._zero_ns))
            if time_ns - self._flushed_ns >= FLUSH_NS:
                self._flushed_ns = time_ns
                self._writer.flush()
                if time_ns - self._looked_ns >= LOOK_NS:
                    self._looked_ns = time_ns
                    self._require_in_place()
        except OSError as error:
            self._broken = True
            raise _failed(error) from error

    def _require_in_place(self) -> None:
        """Refuse a deleted or moved file, which can be written until it is closed, and is lost."""
        if self._path is None:
            return
        mine = os.fstat(self._stream.fileno())
        try:
            there = os.stat(self._path)
        except FileNotFoundError:
            there = None
        if there is not None and (there.st_ino, there.st_dev) == (mine.st_ino, mine.st_dev):
            return
        self._broken = True
        raise GoneError(self._path, moved=mine.st_nlink > 0)

    def event(self, time_ns: int, event: str, **details: object) -> None:
        """Record an event with JSON details, and pass it to the operating system immediately."""
        time_ns = self._latest_ns = max(time_ns, self._latest_ns)
        record = {"time": time_ns / 1e9, "event": event, **details}
        with self._writing():
            self._writer.message(self._event, time_ns, json.dumps(record).encode())
            self._writer.flush()
            self._require_in_place()

    def frames(self, time_ns: int, frames: list[RawFrame]) -> None:
        """Record frames from outside the control cycle, and pass them on immediately."""
        if frames:
            time_ns = self._latest_ns = max(time_ns, self._latest_ns)
            with self._writing():
                self._writer.message(self._frames, time_ns, encode_frames(frames, self._zero_ns))
                self._writer.flush()

    def copy(self, topic: str, time_ns: int, message: bytes) -> None:
        """Record a message unchanged from another recording."""
        channel = {
            SAMPLE_TOPIC: self._sample,
            EVENT_TOPIC: self._event,
            FRAMES_TOPIC: self._frames,
        }[topic]
        with self._writing():
            self._writer.message(channel, time_ns, message)

    def attach(self, name: str, media_type: str, content: bytes) -> None:
        """Attach a file."""
        with self._writing():
            self._writer.attachment(name, media_type, content)
            self._writer.flush()

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add key-value metadata."""
        with self._writing():
            self._writer.metadata(name, values)
            self._writer.flush()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Permit no write after the first failure: nothing behind it could be read."""
        if self._broken:
            raise _broken_before()
        try:
            yield
        except OSError as error:
            self._broken = True
            raise _failed(error) from error

    def close(self) -> None:
        """Write the index and close the file; further calls do nothing.

        Raises:
            StorageError: The end could not be written, and ``rig recover`` repairs such a file; or
                the file was deleted or moved.
        """
        if self._stream.closed:
            return
        try:
            try:
                if not self._broken:
                    self._writer.finish()
                    os.fsync(self._stream.fileno())
                    self._require_in_place()
            finally:
                # A stream that failed before fails again on the rest of its buffer.
                with suppress(OSError) if self._broken else nullcontext():
                    self._stream.close()
        except OSError as error:
            self._broken = True
            raise _failed(error) from error


def _broken_before() -> StorageError:
    return StorageError("an earlier write of the recording has failed")


def _failed(error: OSError) -> StorageError:
    reason = error.strerror or str(error)
    return StorageError(f"the recording cannot be written ({reason}); {remedy(error)}")


def remedy(error: OSError) -> str:
    """Return what the user must do before the next run after a file could not be written."""
    if error.errno in _FULL:
        return "free disk space, then run again"
    if error.errno == errno.ENOENT:
        return "its folder was deleted, moved or renamed: start a new run, and leave its folder"
    return "check the disk and its file system, then run again"


def open_recorder(path: Path) -> Recorder:
    """Create a recording file.

    Raises:
        StorageError: The file exists already or cannot be created.
    """
    try:
        return Recorder(open(path, "xb"), path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise StorageError(f"{path}: the recording cannot be created ({reason})") from error
