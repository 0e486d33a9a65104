"""Reads the object dictionary of a device from its EDS file, which may be damaged."""

from __future__ import annotations

import configparser
import warnings
from pathlib import Path

import canopen
from canopen.objectdictionary import ObjectDictionary, ObjectDictionaryError

from drivers.errors import ConfigurationError
from drivers.plain_file import require_plain

_UNREADABLE = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    configparser.Error,
    ObjectDictionaryError,
)
"""Exceptions that canopen's parser raises on damaged files."""


def read_eds(eds: Path, node_id: int) -> ObjectDictionary:
    """Read the object dictionary of a device.

    Args:
        eds: The file; EDS or DCF.
        node_id: Node identifier, for values that depend on it.

    Raises:
        ConfigurationError: It cannot be read, or describes no object.
    """
    try:
        # canopen warns of an incomplete file through a deprecated call of its logger.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            with open(eds, encoding=_encoding(eds)) as stream:
                dictionary = canopen.import_od(stream, node_id)
    except _UNREADABLE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ConfigurationError(
            f"EDS file {eds} of node {node_id} cannot be read: {reason}; use the device's own EDS "
            f"file"
        ) from error
    if not len(dictionary):
        raise ConfigurationError(
            f"EDS file {eds} of node {node_id} describes no object; use the device's own EDS file"
        )
    return dictionary


def _encoding(eds: Path) -> str:
    """Return a file's encoding: CiA 306 allows only ASCII, but makers use local encodings.

    Raises:
        OSError: It cannot be read, or is no plain file.
    """
    require_plain(eds)
    try:
        eds.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8-sig"
