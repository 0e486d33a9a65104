"""The guarded side of :mod:`rig.guardian`: starts it with the port, and tells it when the drive is under power."""

from __future__ import annotations

import dataclasses
import json
import select
import subprocess
import sys
from pathlib import Path
from typing import Final

from drivers.errors import LinkError
from drivers.serial_port import BytePort, PySerialPort
from drivers.units import ServoScales
from rig.guardian import READY

_START_S: Final = 20.0
_END_S: Final = 5.0


class Guard:
    """Opens a drive's port, and has a process of its own stand by while the drive is under power.

    Args:
        port: Device of this computer.
        baud: Bit/s.
        node: Node identifier of the drive.
        eds: Its EDS file.
        scales: Its units.
    """

    def __init__(self, port: str, baud: int, node: int, eds: Path, scales: ServoScales) -> None:
        self.name = f"EPOS4 at {port}"
        self._path, self._baud = port, baud
        self._drive = {
            "name": self.name,
            "node": node,
            "eds": str(eds.resolve()),
            "scales": dataclasses.asdict(scales),
        }
        self._folder: Path | None = None
        self._port: PySerialPort | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._armed = False

    def open_port(self) -> BytePort:
        """Open the port.

        Raises:
            OSError: It cannot be opened.
            ValueError: It does not take this rate.
        """
        self._port = PySerialPort(self._path, self._baud)
        return self._port

    def record_in(self, folder: Path) -> None:
        """Have what the guardian does written into this folder."""
        self._folder = folder.resolve()

    def arm(self) -> None:
        """Have the drive stopped if this program dies from now on.

        Raises:
            LinkError: There is no guardian, so that the drive must not be enabled.
        """
        if self._process is None:
            self._process = self._start()
        folder = {} if self._folder is None else {"folder": str(self._folder)}
        self._tell({"armed": True, **folder})
        self._armed = True

    def release(self) -> None:
        """The drive is verified off: there is nothing to guard until the next :meth:`arm`.

        Raises:
            LinkError: The guardian is gone.
        """
        if self._armed:
            self._armed = False
            self._tell({"armed": False})

    def close(self) -> None:
        """Let the guardian go; one that has not been released stops the drive now, and goes on trying by itself."""
        process, self._process = self._process, None
        if process is None:
            return
        for pipe in (process.stdin, process.stdout):
            assert pipe is not None
            pipe.close()
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            # It is still trying to reach the drive, and must not be kept from that.
            process.returncode = 0

    def _start(self) -> subprocess.Popen[bytes]:
        if self._port is None:
            raise LinkError(f"{self.name} is not open: call open() first")
        descriptor = self._port.fileno()
        # In a session of its own, so that neither Ctrl-C nor a closed terminal reaches it.
        process = subprocess.Popen(
            [sys.executable, "-m", "rig.guardian", str(descriptor)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=(descriptor,),
            start_new_session=True,
        )
        self._process = process
        self._tell({"drive": self._drive})
        assert process.stdout is not None
        ready, _, _ = select.select([process.stdout], [], [], _START_S)
        if not ready or process.stdout.readline() != READY:
            raise LinkError(
                f"the guardian of {self.name} did not start within {_START_S:g} s; the drive is not enabled without it"
            )
        return process

    def _tell(self, words: dict[str, object]) -> None:
        process = self._process
        assert process is not None
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps(words).encode() + b"\n")
            process.stdin.flush()
        except OSError as error:
            raise LinkError(f"the guardian of {self.name} is gone ({error.strerror}); stop and run again") from error
