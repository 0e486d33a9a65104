"""Reads files named by the user, with an error message for every cause of failure."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from drivers.plain_file import require_plain
from rig.common.errors import InputError


def read_bytes(path: Path) -> bytes:
    """Return the content of a regular file.

    Raises:
        OSError: The file cannot be read; ``strerror`` states the reason.
    """
    require_plain(path)
    return path.read_bytes()


def read_json(path: Path, remedy: str = "") -> Any:
    """Return the content of a JSON file.

    Args:
        path: The file.
        remedy: Remedy for the message if the file cannot be read.

    Raises:
        InputError: The file cannot be read, is not JSON, or has a number beyond the floating-point
            range.
    """
    return parse_json(path, read_utf8(path, remedy))


def read_utf8(path: Path, remedy: str = "") -> str:
    """Return the text of a file in UTF-8.

    Raises:
        InputError: The file cannot be read, or has another encoding.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror or error}{_after(remedy)}"
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: byte {error.start} is not UTF-8; save the file as UTF-8 text"
        ) from error


def parse_json(path: Path, text: str) -> Any:
    """Return the content of JSON text.

    Raises:
        InputError: The text is not JSON, or has a number beyond the floating-point range.
    """
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
    """Return whether ``path`` is an existing regular file, after following links; false if access
    is denied. Unlike :meth:`pathlib.Path.is_file`, this function never raises an exception.
    """
    return os.path.isfile(path)


def is_folder(path: Path) -> bool:
    """Return whether ``path`` is an existing folder, after following links; false if access is
    denied. Unlike :meth:`pathlib.Path.is_dir`, this function never raises an exception.
    """
    return os.path.isdir(path)


def _whole(digits: str) -> int:
    number = int(digits)
    try:
        float(number)
    except OverflowError:
        raise ValueError(f"the number {digits[:20]}... is too large") from None
    return number


def _after(remedy: str) -> str:
    return f"; {remedy}" if remedy else ""
