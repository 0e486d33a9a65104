"""The rights of an ordinary user, for tests that run as root: root reads and writes every file."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_VERSION_3 = 0x20080522
_OVERRIDES = (1 << 1) | (1 << 2) | (1 << 3)
"""CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH and CAP_FOWNER, linux/capability.h."""


class _Header(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint32), ("pid", ctypes.c_int))


class _Data(ctypes.Structure):
    _fields_ = (
        ("effective", ctypes.c_uint32),
        ("permitted", ctypes.c_uint32),
        ("inheritable", ctypes.c_uint32),
    )


@contextmanager
def ordinary_user() -> Iterator[None]:
    """Hold file permissions against this thread as they hold against their owner; an ordinary user
    is left alone.
    """
    if sys.platform != "linux" or os.geteuid() != 0:
        yield
        return
    before = _effective()
    _set_effective(before & ~_OVERRIDES)
    try:
        yield
    finally:
        _set_effective(before)


def _effective() -> int:
    return _exchange("capget")[0].effective


def _set_effective(bits: int) -> None:
    data = _exchange("capget")
    data[0].effective = bits
    _exchange("capset", data)


def _exchange(name: str, data: ctypes.Array[_Data] | None = None) -> ctypes.Array[_Data]:
    data = data if data is not None else (_Data * 2)()
    library = ctypes.CDLL(None, use_errno=True)
    if getattr(library, name)(ctypes.byref(_Header(_VERSION_3, 0)), data) != 0:
        raise OSError(ctypes.get_errno(), name)
    return data
