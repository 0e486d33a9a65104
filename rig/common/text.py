"""Text from the command line and from file names, made fit for files.

Python carries bytes that its locale cannot decode as lone surrogates: the whole of a name like
"Jürgen" in a C locale. They are no text: UTF-8 cannot hold them, and strict JSON readers refuse
them.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def valid(text: str) -> str:
    """Return what was meant where bytes of UTF-8 were not decoded; other bytes become escapes like
    ``\\xfc``.
    """
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return _bytes(text).decode("utf-8", "backslashreplace")
    return text


def valid_record(record: Any) -> Any:
    """Return a record of mappings, lists and scalars with valid text throughout."""
    if isinstance(record, str):
        return valid(record)
    if isinstance(record, Mapping):
        return {valid_record(key): valid_record(value) for key, value in record.items()}
    if isinstance(record, list | tuple):
        return [valid_record(item) for item in record]
    return record


def stored_path(text: str) -> Path:
    """Return the path that a text of a file stands for, as this process encodes names of files."""
    try:
        os.fsencode(text)
    except UnicodeEncodeError:
        return Path(os.fsdecode(_bytes(text)))
    return Path(text)


def _bytes(text: str) -> bytes:
    try:
        return text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:
        # Half of a character of UTF-16: it never was bytes.
        return text.encode("utf-8", "replace")
