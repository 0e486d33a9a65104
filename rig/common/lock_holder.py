"""Describes the holder of a lock: written to the lock file as JSON, read back with validation, and
shown as text.
"""

from __future__ import annotations

import dataclasses
import json
import os
import socket
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Self

from rig.common.provenance import utc_now

_LONGEST: Final = 300
"""Greatest number of characters of a text that are shown, because anyone may write a lock file."""
_GREATEST_PID: Final = 2**31 - 1
_STEPS: Final = ((86_400, "d"), (3_600, "h"), (60, "min"), (1, "s"))


@dataclass(frozen=True)
class Holder:
    """A program that holds a lock.

    Attributes:
        pid: Process identifier of the program.
        command: Name of the program, such as ``rig run``.
        what: Locked object: ``bench NAME`` or ``run folder PATH``.
        user: User who started the program.
        host: Computer on which the program runs.
        since: Time at which the program took the lock, ISO 8601 in UTC.
    """

    pid: int
    command: str
    what: str
    user: str
    host: str
    since: str

    @classmethod
    def here(cls, command: str, what: str) -> Self:
        """Return a record of this process as the holder of a lock, with the present time."""
        since = utc_now().isoformat(timespec="seconds")
        return cls(os.getpid(), command, what, _user(), socket.gethostname(), since)

    @classmethod
    def parse(cls, content: bytes) -> Self | None:
        """Return the holder named in a lock file, or None if the file is empty or damaged."""
        try:
            told = json.loads(content)
        except (ValueError, RecursionError):
            return None
        if not isinstance(told, dict):
            return None
        pid = told.get("pid")
        if not isinstance(pid, int) or isinstance(pid, bool) or not 0 < pid <= _GREATEST_PID:
            return None
        names = [field.name for field in dataclasses.fields(cls) if field.name != "pid"]
        return cls(pid, *(_printable(told.get(name)) for name in names))

    def content(self) -> bytes:
        """Return the content for the lock file."""
        return json.dumps(dataclasses.asdict(self)).encode() + b"\n"

    def alive(self) -> bool:
        """Whether the process exists; true if its existence cannot be checked."""
        if self.host != socket.gethostname() or os.name != "posix":
            return True
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return False
        except OSError:
            # The process exists and belongs to another user.
            return True
        return True

    def words(self, what: str, now: datetime) -> str:
        """Return a description of the holder of a lock, with the start time of the holder, and with
        the name of the locked object if this name is not ``what``.
        """
        other = f" on {self.what}" if self.what and self.what != what else ""
        user = f", user {self.user}" if self.user else ""
        host = f", computer {self.host}" if self.host and self.host != socket.gethostname() else ""
        return (
            f"`{self.command or 'a program'}`{other} (process "
            f"{self.pid}{user}{host}){self._when(now)}"
        )

    def _when(self, now: datetime) -> str:
        """Return the start time and the time since then; empty if the file has no start time."""
        try:
            since = datetime.fromisoformat(self.since).astimezone(UTC)
        except (ValueError, OverflowError):
            return ""
        day = "" if since.date() == now.astimezone(UTC).date() else f"{since:%Y-%m-%d} "
        return f" since {day}{since:%H:%M:%S} UTC{_ago((now - since).total_seconds())}"


def is_held(file: Path) -> bool:
    """Return whether a program on this computer holds a lock file; a lock that is taken for this
    test is released at once.

    A file that exists but cannot be opened counts as held.
    """
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except (ImportError, OSError):
        return True
    finally:
        os.close(descriptor)
    return False


def _ago(seconds: float) -> str:
    """Return the time that has passed, as text; empty if the clock was set back meanwhile."""
    for length_s, unit in _STEPS:
        if seconds >= length_s:
            return f", {int(seconds // length_s)} {unit} ago"
    return ", just now" if seconds >= 0 else ""


def _printable(text: Any) -> str:
    """Return a text shortened and without control characters, safe for a terminal."""
    if not isinstance(text, str):
        return ""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:_LONGEST])


def _user() -> str:
    """Return the user of this process; the number if the system has no name."""
    try:
        import pwd
    except ImportError:
        return os.environ.get("USERNAME", "")
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return str(os.getuid())
