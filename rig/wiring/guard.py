"""The guarded side of :mod:`rig.wiring.guardian`.

Starts the guardian with the port, arms it, feeds it, and hears when it takes over.
"""

from __future__ import annotations

import dataclasses
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Final

from drivers.clock import NS
from drivers.errors import LinkError
from drivers.serial_port import BytePort, PySerialPort
from drivers.units import ServoScales
from rig.wiring.guardian import READY, TOOK_OVER

_START_S: Final = 20.0
_END_S: Final = 2.0
_FEED_NS: Final = NS // 50
_TAKEOVER_S: Final = 3.0
"""How long the guardian's report is waited for once it has taken over: braking and reading back
take less.
"""
_CHUNK: Final = 4096


class Guard:
    """Opens a drive's port, and has a process of its own stand by while the drive is under power.

    The two never speak to the drive at once: while the guardian has the drive, :meth:`feed` raises.

    Args:
        port: Device of this computer.
        baud: Bit/s.
        node: Node identifier of the drive.
        eds: Its EDS file.
        scales: Its units.
    """

    def __init__(
        self,
        port: str,
        baud: int,
        node: int,
        eds: Path,
        scales: ServoScales,
    ) -> None:
        self.name = f"EPOS4 at {port}"
        self._path, self._baud = port, baud
        self._drive = {
            "name": self.name,
            "node": node,
            "eds": str(eds.resolve()),
            "scales": dataclasses.asdict(scales),
        }
        self._keep: tuple[int, ...] = ()
        self._folder: Path | None = None
        self._port: PySerialPort | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._armed = False
        self._taken = False
        self._heard = b""

    def open_port(self) -> BytePort:
        """Open the port.

        Raises:
            OSError: It cannot be opened.
            ValueError: It does not take this rate.
        """
        self._port = PySerialPort(self._path, self._baud)
        return self._port

    def keep(self, descriptors: Sequence[int]) -> None:
        """Have the guardian hold the bench's lock, given as file descriptors, for as long as it
        lives.
        """
        self._keep = tuple(descriptors)

    def record_in(self, folder: Path) -> None:
        """Have what the guardian does written into this folder."""
        self._folder = folder.resolve()

    def arm(self, limit_s: float) -> None:
        """Have the drive stopped if this program dies from now on, or does not feed for this long,
        s.

        Raises:
            LinkError: There is no guardian, so that the drive must not be enabled.
        """
        if self._process is None:
            self._process = self._start()
        folder = {} if self._folder is None else {"folder": str(self._folder)}
        self._tell({"armed": True, "limit_s": limit_s, **folder})
        self._armed = True
        self._fed_ns = time.monotonic_ns()

    def feed(self) -> None:
        """Show the guardian that the control loop is alive; nothing unless armed.

        Raises:
            LinkError: The guardian has taken over, or is gone. It is raised once where the guardian
                has left the drive, so that the drive can be read back, and every time as long as it
                has not.
        """
        if self._taken:
            self._await_report(0.0)
        if not self._armed:
            return
        now = time.monotonic_ns()
        silent_ns = now - self._fed_ns
        if silent_ns < _FEED_NS:
            return
        if self._says(TOOK_OVER, 0.0) is not None:
            self._taken = True
            words = self._await_report(_TAKEOVER_S)
            raise LinkError(
                f"the control loop did not run for {silent_ns / NS:.2f} s, and the guardian "
                f"stopped: {words}"
            )
        self._fed_ns = now
        self._write(b"\n")

    def release(self) -> None:
        """The drive is verified off: there is nothing to guard until the next :meth:`arm`.

        Raises:
            LinkError: The guardian is gone.
        """
        if self._armed:
            self._armed = False
            self._tell({"armed": False})

    def close(self) -> None:
        """Let the guardian go; one that has not been released stops the drive now, and goes on
        trying by itself.
        """
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
            [sys.executable, "-m", "rig.wiring.guardian", *map(str, (descriptor, *self._keep))],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=(descriptor, *self._keep),
            start_new_session=True,
            bufsize=0,
        )
        self._process = process
        os.set_blocking(_pipe(process.stdin).fileno(), False)
        self._tell({"drive": self._drive})
        if self._says(READY, _START_S) is None:
            raise LinkError(
                f"the guardian of {self.name} did not start within {_START_S:g} s; the drive is "
                f"not enabled without it"
            )
        return process

    def _await_report(self, patience_s: float) -> str:
        """Return what the guardian did, once it has left the drive.

        Raises:
            LinkError: It still has it.
        """
        line = self._says(b"\n", patience_s)
        if line is None:
            raise LinkError(
                f"the guardian of {self.name} has taken over and is still trying to take the "
                f"power off: "
                "switch the main supply off"
            )
        self._taken = self._armed = False
        return line.decode(errors="replace").strip()

    def _says(self, words: bytes, patience_s: float) -> bytes | None:
        """Return what the guardian says up to and with these words; None where it does not say them
        in time.

        Raises:
            LinkError: The guardian is gone.
        """
        assert self._process is not None
        descriptor = _pipe(self._process.stdout).fileno()
        deadline_ns = time.monotonic_ns() + patience_s * NS
        while words not in self._heard:
            left_s = max(deadline_ns - time.monotonic_ns(), 0) / NS
            if not select.select([descriptor], [], [], left_s)[0]:
                return None
            data = os.read(descriptor, _CHUNK)
            if not data:
                raise LinkError(f"the guardian of {self.name} is gone; stop and run again")
            self._heard += data
        end = self._heard.index(words) + len(words)
        said, self._heard = self._heard[:end], self._heard[end:]
        return said

    def _tell(self, words: dict[str, object]) -> None:
        self._write(json.dumps(words).encode() + b"\n")

    def _write(self, data: bytes) -> None:
        assert self._process is not None
        try:
            # A pipe takes a line whole or not at all.
            os.write(_pipe(self._process.stdin).fileno(), data)
        except BlockingIOError as error:
            raise LinkError(
                f"the guardian of {self.name} does not listen; stop and run again"
            ) from error
        except OSError as error:
            raise LinkError(
                f"the guardian of {self.name} is gone ({error.strerror}); stop and run again"
            ) from error


def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None
    return pipe
