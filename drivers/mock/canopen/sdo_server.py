"""SDO server of a simulated device: expedited and segmented transfers of CiA 301."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from drivers.mock.canopen.dictionary import WRONG_LENGTH, DeviceDictionary, SdoAbortError

_TOGGLE: Final = 0x10
_LAST: Final = 0x01
BAD_TOGGLE: Final = 0x05030000
BAD_COMMAND: Final = 0x05040001
_HEAD: Final = struct.Struct("<BHB")


@dataclass
class _Transfer:
    index: int
    subindex: int
    data: bytes
    size: int | None = None
    toggle: int = 0
    upload: bool = True


class SdoServer:
    """Answers SDO requests from an object dictionary, with the abort codes of CiA 301.

    Args:
        dictionary: The device's objects.
        refresh: Function that updates measured values in the dictionary; it is called before every
            upload.
    """

    def __init__(self, dictionary: DeviceDictionary, refresh: Callable[[], None]) -> None:
        self._dictionary = dictionary
        self._refresh = refresh
        self._transfer: _Transfer | None = None

    def reset(self) -> None:
        """Cancel a transfer in progress."""
        self._transfer = None

    def answer(self, request: bytes) -> bytes | None:
        """Return the response to one request frame of 8 bytes, or None if no response is due."""
        if len(request) != 8:
            return None
        command, index, subindex = _HEAD.unpack_from(request)
        service = command >> 5
        if service == 4:
            self._transfer = None
            return None
        try:
            match service:
                case 0:
                    return self._download_segment(command, request[1:])
                case 1:
                    return self._download(command, index, subindex, request[4:])
                case 2:
                    return self._upload(index, subindex)
                case 3:
                    return self._upload_segment(command)
                case _:
                    raise SdoAbortError(BAD_COMMAND)
        except SdoAbortError as abort:
            if self._transfer is not None and service in (0, 3):
                index, subindex = self._transfer.index, self._transfer.subindex
            self._transfer = None
            return _HEAD.pack(0x80, index, subindex) + struct.pack("<I", abort.code)

    def _upload(self, index: int, subindex: int) -> bytes:
        self._refresh()
        data = self._dictionary.read(index, subindex)
        if 0 < len(data) <= 4:
            return _HEAD.pack(0x43 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")
        self._transfer = _Transfer(index, subindex, data)
        return _HEAD.pack(0x41, index, subindex) + struct.pack("<I", len(data))

    def _upload_segment(self, command: int) -> bytes:
        transfer = self._expect(command, upload=True)
        chunk, transfer.data = transfer.data[:7], transfer.data[7:]
        last = not transfer.data
        response = bytes(
            [transfer.toggle | (7 - len(chunk)) << 1 | (_LAST if last else 0)]
        ) + chunk.ljust(7, b"\0")
        transfer.toggle ^= _TOGGLE
        if last:
            self._transfer = None
        return response

    def _download(self, command: int, index: int, subindex: int, data: bytes) -> bytes:
        self._transfer = None
        sized = command & 0x01
        if command & 0x02:
            # A request that states no size contains as many bytes as the object has.
            size = (
                4 - (command >> 2 & 0x03) if sized else self._dictionary.entry(index, subindex).size
            )
            self._dictionary.write(index, subindex, data[:size])
        else:
            self._dictionary.entry(index, subindex)
            announced = struct.unpack("<I", data)[0] if sized else None
            self._transfer = _Transfer(index, subindex, b"", announced, upload=False)
        return _HEAD.pack(0x60, index, subindex) + bytes(4)

    def _download_segment(self, command: int, data: bytes) -> bytes:
        transfer = self._expect(command, upload=False)
        transfer.data += data[: 7 - (command >> 1 & 0x07)]
        response = bytes([0x20 | transfer.toggle]) + bytes(7)
        transfer.toggle ^= _TOGGLE
        if command & _LAST:
            if transfer.size is not None and transfer.size != len(transfer.data):
                raise SdoAbortError(WRONG_LENGTH)
            self._dictionary.write(transfer.index, transfer.subindex, transfer.data)
            self._transfer = None
        return response

    def _expect(self, command: int, upload: bool) -> _Transfer:
        transfer = self._transfer
        if transfer is None or transfer.upload is not upload:
            raise SdoAbortError(BAD_COMMAND)
        if command & _TOGGLE != transfer.toggle:
            raise SdoAbortError(BAD_TOGGLE)
        return transfer
