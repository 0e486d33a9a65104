"""A command behind a terminal line of 9600 baud: `python -m tests.long.slow_line COMMAND...`.

What it writes comes through at 960 bytes a second; behind that its own terminal fills, as a serial
console's does.
"""

from __future__ import annotations

import fcntl
import os
import pty
import select
import signal
import sys
import termios
import time
import tty

BYTES_PER_S = 960
_STEP_S = 0.05


def main() -> int:
    """Relay until the command has ended and all it wrote is through; return its status."""
    outside = sys.stdin.fileno()
    inherited = [int(number) for number in os.listdir("/proc/self/fd") if int(number) > 2]
    pid, inside = pty.fork()
    if not pid:
        for number in inherited:
            try:
                os.set_inheritable(number, True)
            except OSError:
                continue
        os.execvp(sys.argv[1], sys.argv[1:])

    def resized(*_: object) -> None:
        size = fcntl.ioctl(outside, termios.TIOCGWINSZ, bytes(8))
        fcntl.ioctl(inside, termios.TIOCSWINSZ, size)

    resized()
    signal.signal(signal.SIGWINCH, resized)
    before = termios.tcgetattr(outside)
    tty.setraw(outside)
    try:
        relay(outside, inside)
    finally:
        termios.tcsetattr(outside, termios.TCSADRAIN, before)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def relay(outside: int, inside: int) -> None:
    """Pass keys on at once and what is written at the speed of the line, until the other side is
    closed.
    """
    due = time.monotonic()
    while True:
        wait_s = due - time.monotonic()
        sources = [outside] if wait_s > 0 else [outside, inside]
        ready, _, _ = select.select(sources, [], [], max(0.0, wait_s) if wait_s > 0 else None)
        if outside in ready:
            os.write(inside, os.read(outside, 1024))
        if inside in ready:
            try:
                data = os.read(inside, round(BYTES_PER_S * _STEP_S))
            except OSError:
                return
            os.write(1, data)
            due = max(due, time.monotonic() - _STEP_S) + len(data) / BYTES_PER_S


if __name__ == "__main__":
    sys.exit(main())
