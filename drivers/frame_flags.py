"""Flags in the identifier of a raw frame, as in SocketCAN."""

from __future__ import annotations

from typing import Final

EXTENDED_FLAG: Final = 0x80000000
REMOTE_FLAG: Final = 0x40000000
ERROR_FLAG: Final = 0x20000000
"""Error frames and other non-data frames."""
SERIAL_FLAG: Final = 0x10000000
"""Bytes of a serial line; the low bits are the line's number. Only without the other flags, since
the bit belongs to an extended identifier otherwise.
"""
IDENTIFIER_BITS: Final = 0x1FFFFFFF
