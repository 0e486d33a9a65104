"""EDS files: the object dictionary of a device, from a file that may be damaged."""

from __future__ import annotations

import configparser
import warnings
from pathlib import Path

import canopen
from canopen.objectdictionary import ObjectDictionary, ObjectDictionaryError

from drivers.errors import ConfigurationError

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
"""What canopen's parser lets through where a file is damaged."""


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
            dictionary = canopen.import_od(str(eds), node_id)
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
