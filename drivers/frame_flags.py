"""Flags in the identifier of a raw frame, as in SocketCAN."""

from __future__ import annotations

from typing import Final

EXTENDED_FLAG: Final = 0x80000000
REMOTE_FLAG: Final = 0x40000000
ERROR_FLAG: Final = 0x20000000
"""Flag of error frames and other frames that are no data frames."""
SERIAL_FLAG: Final = 0x10000000
"""Flag of bytes of a serial line, whose number is in the low bits. The flag is valid only without
the other flags, because this bit is also a bit of extended identifiers.
"""
IDENTIFIER_BITS: Final = 0x1FFFFFFF
