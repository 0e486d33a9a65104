"""A pseudo-terminal whose far end is the test."""

import os
import select
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass


@dataclass
class Pty:
    """Attributes: the far end's descriptor, the near end's, and the path to open that by."""

    ours: int
    theirs: int
    path: str

    def say(self, data: bytes) -> None:
        assert os.write(self.ours, data) == len(data)

    def heard(self) -> bytes:
        """Return what has come in; waits a little for it."""
        data = b""
        while select.select([self.ours], [], [], 0.02)[0]:
            data += os.read(self.ours, 4096)
        return data

    def stall(self) -> None:
        """Fill the line to the last byte; the far end reads nothing."""
        os.set_blocking(self.theirs, False)
        while select.select([], [self.theirs], [], 0.01)[1]:
            os.write(self.theirs, bytes(4096))
        with suppress(BlockingIOError):
            while True:
                os.write(self.theirs, b"\0")

    def hang_up(self) -> None:
        """Be gone, as an adapter that is pulled out."""
        ours, self.ours = self.ours, -1
        os.close(ours)


@contextmanager
def pty_line() -> Iterator[Pty]:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    made = Pty(ours, theirs, os.ttyname(theirs))
    try:
        yield made
    finally:
        if made.ours >= 0:
            os.close(made.ours)
        os.close(made.theirs)
