"""A second program that holds a lock, run by the tests of locks:
``python lock_child.py KIND FOLDER NAME``.

KIND is ``bench``, whose lock files are in FOLDER, or ``folder``. The program says ``held``, and
obeys the lines of its input: ``release``, ``guard``. After ``guard`` a child that has inherited the
lock obeys them in its place: ``note NAME``, ``release``; SIGUSR1 then makes the first program
release. Each answers in a line what it has done.
"""

import signal
import subprocess
import sys
from pathlib import Path

from rig.common.locks import Lock, Resource, hold_bench, hold_folder, inherited

PART = Resource("/dev/ttyX", "port /dev/ttyX")


def say(words: str) -> None:
    print(words, flush=True)


def owner(kind: str, folder: Path, command: str) -> None:
    lock = (
        hold_bench("wired", [PART], command, folder)
        if kind == "bench"
        else hold_folder(folder, command)
    )
    say("held")
    for line in sys.stdin:
        if line == "guard\n":
            stand_by(kind, folder, lock)
        lock.release()
        say("released")


def stand_by(kind: str, folder: Path, lock: Lock) -> None:
    """Start the child, and wait to be killed or told to release."""

    def release(*_: object) -> None:
        lock.release()
        say("released")

    signal.signal(signal.SIGUSR1, release)
    numbers = [str(number) for number in lock.descriptors]
    subprocess.Popen(
        [sys.executable, __file__, "guardian", kind, str(folder), *numbers],
        pass_fds=lock.descriptors,
    )
    while True:
        signal.pause()


def guardian(kind: str, folder: Path, *numbers: str) -> None:
    lock = inherited([int(number) for number in numbers], folder if kind == "folder" else None)
    say("guarding")
    for line in sys.stdin:
        verb, _, name = line.strip().partition(" ")
        if verb == "note":
            lock.note(name)
        else:
            lock.release()
        say(f"{verb}d")


if __name__ == "__main__":
    role, *rest = sys.argv[1:]
    if role == "guardian":
        guardian(rest[0], Path(rest[1]), *rest[2:])
    else:
        owner(role, Path(rest[0]), rest[1])
