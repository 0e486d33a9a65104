"""Converts text from the command line and from file names to valid Unicode for files.

Python represents bytes that its locale cannot decode by lone surrogates, for example the umlaut of
"Jürgen" in a C locale. UTF-8 cannot encode these surrogates, and strict JSON readers refuse them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any


def valid(text: str) -> str:
    """Return a text with undecoded bytes as UTF-8, or as escapes like ``\\xfc``."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return _bytes(text).decode("utf-8", "backslashreplace")
    return text


def valid_record(record: Any) -> Any:
    """Return a record of mappings, lists and scalars with valid text throughout."""
    return changed_texts(record, valid)


def changed_texts(record: Any, change: Callable[[str], str]) -> Any:
    """Return a record of mappings, lists and scalars with each text changed, keys included."""
    if isinstance(record, str):
        return change(record)
    if isinstance(record, Mapping):
        return {changed_texts(k, change): changed_texts(v, change) for k, v in record.items()}
    if isinstance(record, list | tuple):
        return [changed_texts(item, change) for item in record]
    return record


def stored_path(text: str) -> Path:
    """Return the path for a text from a file, in this process's encoding of file names."""
    try:
        os.fsencode(text)
    except UnicodeEncodeError:
        return Path(os.fsdecode(_bytes(text)))
    return Path(text)


def _bytes(text: str) -> bytes:
    try:
        return text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:
        # A surrogate that is half of a UTF-16 character does not represent a byte.
        return text.encode("utf-8", "replace")
