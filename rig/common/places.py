"""Checks output paths before a command's work, and writes the files atomically afterwards."""

from __future__ import annotations

import errno
import json
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.text import valid, valid_record


def require_plain(path: Path) -> None:
    """Check that a path leads to a plain file, without opening it.

    To open a pipe would wait for a writer without end, and to read a device such as ``/dev/zero``
    never ends.

    Raises:
        OSError: The path does not lead to a plain file; ``strerror`` states the reason.
    """
    try:
        mode = path.stat().st_mode
    except ValueError as error:
        # The path contains a zero byte, or a character that is not allowed in file names on this
        # system.
        raise OSError(errno.EINVAL, f"it is not a valid file name ({error})", str(path)) from error
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "it is a folder", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(
            errno.EINVAL,
            "the path leads to a pipe or a device; state the path of a file",
            str(path),
        )


@contextmanager
def usable(place: object, deed: str, remedy: str = "") -> Iterator[None]:
    """Turn an error of the operating system into an InputError: ``place`` cannot be ``deed``."""
    try:
        yield
    except OSError as error:
        words = f"{place}: cannot be {deed}: {error.strerror or error}"
        raise InputError(f"{words}; {remedy}" if remedy else words) from error


def read_bytes(path: Path) -> bytes:
    """Return the content of a regular file."""
    require_plain(path)
    return path.read_bytes()


def read_json(path: Path, remedy: str = "") -> Any:
    """Return the content of a JSON file."""
    return parse_json(path, read_utf8(path, remedy))


def read_utf8(path: Path, remedy: str = "") -> str:
    """Return the text of a file in UTF-8."""
    try:
        with usable(path, "read", remedy):
            return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8 text"
        ) from error


def parse_json(path: Path, text: str) -> Any:
    """Return the content of JSON text."""
    try:
        return json.loads(text, parse_int=_whole)
    except RecursionError as error:
        raise InputError(f"{path}: not JSON: nested too deeply") from error
    except ValueError as error:
        raise InputError(f"{path}: not JSON: {error}") from error


def source_name(source: Path) -> str:
    """Return the name of a run folder or campaign file without suffix, after resolving the path."""
    return Path(os.path.realpath(source)).stem


def is_file(path: Path) -> bool:
    """Return whether ``path`` is a regular file, links followed; never raises."""
    return os.path.isfile(path)


def is_folder(path: Path) -> bool:
    """Return whether ``path`` is a folder, links followed; never raises."""
    return os.path.isdir(path)


def _whole(digits: str) -> int:
    number = int(digits)
    try:
        float(number)
    except OverflowError:
        raise ValueError(f"the number {digits[:20]}... is too large") from None
    return number


def require_folder(path: Path, option: str) -> None:
    """Check before the work that a folder exists or can be created; create nothing."""
    above = path
    while not os.path.exists(above) and above != above.parent:
        above = above.parent
    if not is_folder(above):
        raise InputError(
            f"{path}: cannot be created, because {above} is a file; give {option} another place"
        )
    if not os.access(above, os.W_OK | os.X_OK):
        raise InputError(f"{path}: no permission to write to {above}; give {option} another place")


def require_file(path: Path | None, option: str) -> None:
    """Check before the work that a file can be written; the function creates nothing."""
    if path is None:
        return
    if is_folder(path):
        raise InputError(f"{path}: is a folder; give {option} a file")
    if not is_folder(path.parent):
        raise InputError(
            f"{path}: the folder {path.parent} does not exist; create the folder, or give "
            f"{option} another place"
        )
    judged = path.parent if is_file(path) or not os.path.exists(path) else path
    if not os.access(judged, os.W_OK):
        raise InputError(f"{path}: no permission to write to {judged}; give {option} another place")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary name; the file replaces ``path`` at the end, or is removed after an error.

    Readers never see an incomplete file, and an earlier version survives a full disk or Ctrl-C. A
    link is followed; a path that is not a regular file (a pipe, ``/dev/stdout``) is written
    directly and never replaced.
    """
    if os.path.exists(path) and not is_file(path):
        yield path
        return
    # Unlike Path.resolve, realpath accepts a loop of links; opening it then raises the error.
    target = Path(os.path.realpath(path))
    draft = target.with_name(f".{target.name}.new")
    try:
        yield draft
        # Opened for writing, because Windows flushes no other descriptors to the disk.
        with open(draft, "r+b") as stream:
            os.fsync(stream.fileno())
        os.replace(draft, target)
    finally:
        draft.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write a text file in one step."""
    with replacing(path) as draft, open(draft, "w", encoding="utf-8") as stream:
        stream.write(valid(text))


def write_json(path: Path, record: Mapping[str, Any]) -> None:
    """Write JSON in one step."""
    text = json.dumps(record, indent=1)
    if "\\ud" in text:
        # The text may have undecoded bytes as lone surrogates, which strict JSON readers refuse.
        text = json.dumps(valid_record(record), indent=1)
    write_text(path, text + "\n")


def write_asked(path: Path | None, record: Mapping[str, Any]) -> None:
    """Write the file of ``--json``; do nothing if the path is None."""
    if path is None:
        return
    with usable(path, "written", "give --json another place"):
        write_json(path, record)
