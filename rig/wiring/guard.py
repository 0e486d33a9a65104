"""Starts and arms the guardian (:mod:`rig.wiring.guardian`) of a port, and gets its report."""

from __future__ import annotations

import dataclasses
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
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
ANSWER_S: Final = 0.2
_TAKEOVER_S: Final = 3.0
"""Time to wait for the guardian's report after a takeover, s, longer than braking and reading back.
"""
_CHUNK: Final = 4096


class Guard:
    """Opens a drive's port, and runs a guardian process while the drive is energised.

    Program and guardian never use the port at the same time: while the guardian has the port,
    :meth:`feed` raises an error. The guardian answers every sign of life. A guardian that has
    ended, does not read, or does not answer for :data:`ANSWER_S` is reported once; the program can
    then take the power off itself.
    """

    def __init__(self, port: str, baud: int, node: int, eds: Path, scales: ServoScales) -> None:
        self.name = f"EPOS4 at {port}"
        self._path, self._baud = port, baud
        self._drive = {
            "name": self.name,
            "port": port,
            "baud": baud,
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
        self._deaf = self._mute = False
        self._heard = b""
        self._asked_ns: int | None = None

    def open_port(self) -> BytePort:
        """Open the port; locked, unless it is opened again, when the guardian may hold the lock.

        Raises:
            OSError: The port cannot be opened.
            ValueError: The port does not support this rate.
        """
        self._port = PySerialPort(self._path, self._baud, exclusive=self._process is None)
        return self._port

    def keep(self, descriptors: Sequence[int]) -> None:
        """Pass the bench's lock, as descriptors, to the guardian, which holds it while it runs."""
        self._keep = tuple(descriptors)

    def record_in(self, folder: Path) -> None:
        """Set the folder into which the guardian writes its report."""
        self._folder = folder.resolve()

    def arm(self, limit_s: float) -> None:
        """Arm the guardian: it stops the drive if this program dies or sends no sign of life for
        this time, s.

        Raises:
            LinkError: No guardian runs; the drive must not be enabled.
        """
        if self._process is None:
            self._process = self._start()
        folder = {} if self._folder is None else {"folder": str(self._folder)}
        self._tell({"armed": True, "limit_s": limit_s, **folder})
        self._armed, self._deaf, self._mute = True, False, False
        self._asked_ns = None
        self._fed_ns = time.monotonic_ns()

    def feed(self) -> None:
        """Send the guardian a sign of life of the control loop; without effect unless the guardian
        is armed.

        Raises:
            LinkError: The guardian has taken over, has ended, accepts no messages or does not
                answer. While the guardian has the drive, every call raises LinkError. Otherwise
                only one call raises LinkError, so that the drive can then be stopped and read back.
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
                f"the control loop did not run for {silent_ns / NS:.2f} s, so that the guardian "
                f"stopped the drive: {words}"
            )
        self._fed_ns = now
        self._check_answer(now)
        reported = self._deaf or self._mute
        try:
            self._write(b"\n")
        except LinkError:
            # A guardian that reads again later must find signs of life, and its takeover is noticed
            # above.
            if not (reported and self._deaf):
                raise

    def _check_answer(self, now_ns: int) -> None:
        """Take the answers that have arrived; LinkError once if there was none for too long."""
        if self._heard:
            self._heard = self._heard.rpartition(b"\n")[2]
            self._asked_ns, self._mute = None, False
        if self._asked_ns is None:
            self._asked_ns = now_ns
        elif now_ns - self._asked_ns > ANSWER_S * NS and not (self._mute or self._deaf):
            self._mute = True
            raise LinkError(
                f"the guardian of {self.name} did not answer for "
                f"{(now_ns - self._asked_ns) / NS:.2f} s (limit {ANSWER_S:g} s), so that nothing "
                "would stop the drive if this program failed; close other programs on this "
                "computer, then run again"
            )

    def release(self) -> None:
        """Disarm the guardian after the drive was verified off; the next :meth:`arm` arms it again.

        Raises:
            LinkError: The guardian has ended, or accepts no messages. In the second case it stays
                armed, so that its takeover is still noticed.
        """
        if self._armed:
            self._tell({"armed": False})
            self._armed = False

    def insist(self) -> None:
        """Leave a drive that was not proved off to the guardian, when :meth:`close` ends it."""
        self._armed = self._process is not None

    def close(self) -> None:
        """End the guardian. If :meth:`release` was not called, or :meth:`insist` was, the guardian
        stops the drive now, and repeats this until the stop is verified, or `rig off` takes over.
        """
        process = self._process
        if process is None:
            return
        if self._armed:
            with suppress(LinkError):
                self._tell({"left": True})
        self._process = None
        for pipe in (process.stdin, process.stdout):
            assert pipe is not None
            pipe.close()
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            if self._armed:
                # The guardian is still trying to stop the drive and must not be interrupted.
                process.returncode = 0
                return
            # A guardian that hangs after the drive was verified off would keep the bench locked.
            process.kill()
            process.wait()

    def _start(self) -> subprocess.Popen[bytes]:
        if self._port is None:
            raise LinkError(f"{self.name} is not open: call open() first")
        descriptor = self._port.fileno()
        # The guardian has its own session, so that neither Ctrl-C nor a closed terminal ends it.
        try:
            process = subprocess.Popen(
                [sys.executable, "-m", "rig.wiring.guardian", *map(str, (descriptor, *self._keep))],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                pass_fds=(descriptor, *self._keep),
                start_new_session=True,
                bufsize=0,
            )
        except OSError as error:
            raise LinkError(
                f"the guardian of {self.name} cannot be started ({error.strerror}); close other "
                "programs on this computer, then run again"
            ) from error
        self._process = process
        os.set_blocking(_pipe(process.stdin).fileno(), False)
        self._tell({"drive": self._drive})
        if self._says(READY, _START_S) is None:
            raise LinkError(
                f"the guardian of {self.name} did not start within {_START_S:g} s; the drive is "
                "not enabled without the guardian"
            )
        return process

    def _await_report(self, patience_s: float) -> str:
        """Return the report of a guardian that has released the drive; LinkError if it has not."""
        line = self._says(b"\n", patience_s)
        if line is None:
            raise LinkError(
                f"the guardian of {self.name} has taken over and is still trying to take the "
                f"power off: switch the main supply off"
            )
        self._taken = self._armed = False
        return line.decode(errors="replace").strip()

    def _says(self, words: bytes, patience_s: float) -> bytes | None:
        """Return the guardian's output up to a text; None after a time-out, or a LinkError."""
        assert self._process is not None
        descriptor = _pipe(self._process.stdout).fileno()
        deadline_ns = time.monotonic_ns() + patience_s * NS
        while words not in self._heard:
            left_s = max(deadline_ns - time.monotonic_ns(), 0) / NS
            if not select.select([descriptor], [], [], left_s)[0]:
                return None
            data = os.read(descriptor, _CHUNK)
            if not data:
                self._forget()
                raise LinkError(f"the guardian of {self.name} has ended; stop and run again")
            self._heard += data
        end = self._heard.index(words) + len(words)
        said, self._heard = self._heard[:end], self._heard[end:]
        return said

    def _forget(self) -> None:
        """Note that the guardian has ended: nobody else uses the port any more."""
        self._armed = self._taken = self._deaf = False

    def _tell(self, words: dict[str, object]) -> None:
        self._write(json.dumps(words).encode() + b"\n")

    def _write(self, data: bytes) -> None:
        assert self._process is not None
        try:
            # A pipe accepts a short line completely or not at all.
            os.write(_pipe(self._process.stdin).fileno(), data)
        except BlockingIOError as error:
            self._deaf = True
            raise LinkError(
                f"the guardian of {self.name} accepts no messages; stop and run again"
            ) from error
        except OSError as error:
            self._forget()
            raise LinkError(
                f"the guardian of {self.name} has ended ({error.strerror}); stop and run again"
            ) from error


def _pipe(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None
    return pipe
