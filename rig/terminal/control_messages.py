"""Messages between a run and the programs that watch and command it over its control socket.

One datagram of UTF-8 JSON each. A question is ``{"ask": "status" | "about"}``. A command names the
run by its ``run`` value, which differs in every run, and carries a ``number``, the sender's
monotonic clock in ns; this number has to be larger than the numbers of all earlier commands.
Therefore a command that is sent again, or was meant for another run, is refused.
"""

from __future__ import annotations

import json
import os
import socket
import stat
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Final

from drivers.clock import NS

VERSION: Final = 1
"""Version of the messages; a program of another version only watches."""
LONGEST_BYTES: Final = 4096
"""Longest message that a run reads."""
REPLY_BYTES: Final = 65_536
"""Longest message that a run sends."""
LONGEST_TEXT: Final = 200
"""Longest answer to a prompt, characters."""
STALE_NS: Final = 5 * NS
"""Age from which a command other than `stop` is refused: its sender may have been frozen."""
RECEIVED_BEFORE: Final = "this command, or one sent after it, was received before"
PREFIX: Final = "run-"
SUFFIX: Final = ".sock"
_FOLDER_MODE: Final = 0o700


class Command(Enum):
    """Action that a run performs on request."""

    STOP = "stop"
    PAUSE = "pause"
    NO_PAUSE = "no pause"
    ANSWER = "answer"


@dataclass(frozen=True)
class Order:
    """A command that was read from a message.

    Attributes:
        command: What to do.
        run: The run that it is meant for.
        number: Monotonic time at which it was sent, ns.
        who: Who sent it, as text.
        prompt: Number of the prompt that ``text`` answers; 0 for none.
        text: The answer.
    """

    command: Command
    run: str
    number: int
    who: str
    prompt: int = 0
    text: str = ""

    def encode(self) -> bytes:
        """Return the datagram."""
        return encode({**self.__dict__, "command": self.command.value})


class MessageError(ValueError):
    """A datagram is no message of this protocol; the text states why."""


class SocketFolderError(OSError):
    """The folder of the control sockets cannot be used."""


def encode(message: Mapping[str, Any]) -> bytes:
    """Return the datagram of a message."""
    return json.dumps(message, separators=(",", ":")).encode()


def decode(data: bytes) -> dict[str, Any]:
    """Read a datagram.

    Raises:
        MessageError: It is no JSON object.
    """
    try:
        message = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise MessageError(f"no JSON: {error}") from error
    if not isinstance(message, dict):
        raise MessageError("no JSON object")
    return message


def order_of(message: Mapping[str, Any]) -> Order:
    """Check the fields of a command.

    Raises:
        MessageError: One is missing, unknown, or of the wrong type.
    """
    try:
        command = Command(message["command"])
        order = Order(**{**message, "command": command})
    except (KeyError, TypeError, ValueError) as error:
        raise MessageError(f"no command of a run: {error}") from error
    for name, kind in (("run", str), ("number", int), ("who", str), ("prompt", int), ("text", str)):
        value = getattr(order, name)
        if not isinstance(value, kind) or isinstance(value, bool):
            raise MessageError(f"{name}: expected {kind.__name__} (got {value!r})")
    if len(order.text) > LONGEST_TEXT or len(order.who) > LONGEST_TEXT:
        raise MessageError(f"text longer than {LONGEST_TEXT} characters")
    return order


def objection(order: Order, run: str, last: int, now_ns: int) -> str | None:
    """Return why a command is refused, or None if it is accepted.

    Args:
        order: The command.
        run: Value that identifies this run.
        last: Number of the last command that was accepted.
        now_ns: Monotonic time, ns.
    """
    if order.run != run:
        return "this command is meant for another run"
    if order.number <= last:
        return RECEIVED_BEFORE
    if order.number > now_ns:
        return "this command is numbered in the future"
    age_ns = now_ns - order.number
    if order.command is not Command.STOP and age_ns > STALE_NS:
        return (
            f"this command is {age_ns / NS:.1f} s old, at most {STALE_NS // NS} s are allowed; "
            "send it again if it is still meant"
        )
    return None


def socket_folders() -> list[Path]:
    """Return the folders that control sockets of this user can be in, the folder for new sockets
    first: in ``XDG_RUNTIME_DIR`` if this variable is set, and in ``/tmp``.

    Raises:
        OSError: The system has no Unix sockets.
    """
    if not (hasattr(os, "geteuid") and hasattr(socket, "AF_UNIX")):
        raise OSError("this system has no Unix sockets")
    runtime = os.environ.get("XDG_RUNTIME_DIR", "")
    session = [Path(runtime) / "loadrig"] if os.path.isabs(runtime) else []
    return [*(f for f in session if f.parent.is_dir()), Path(f"/tmp/loadrig-{os.geteuid()}")]


def remove_left(folder: Path) -> None:
    """Remove sockets whose program has ended."""
    for path in folder.glob(f"*{SUFFIX}"):
        probe = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with probe, suppress(OSError):
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()


def bound_socket(path: Path) -> socket.socket:
    """Return a non-blocking datagram socket at a path that only this user can open.

    Raises:
        OSError: It cannot be made.
    """
    made = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        made.setblocking(False)
        # The mode is in force before any message can arrive.
        old = os.umask(0o177)
        try:
            made.bind(str(path))
        finally:
            os.umask(old)
    except BaseException:
        made.close()
        raise
    return made


def require_own_folder(folder: Path) -> None:
    """Create the folder of the sockets if it is missing, and check that only this user can enter
    it.

    Raises:
        SocketFolderError: It belongs to another user, is a link, or is open to others.
        OSError: It cannot be made.
    """
    with suppress(FileExistsError):
        os.mkdir(folder, _FOLDER_MODE)
    status = os.lstat(folder)
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid():
        raise SocketFolderError(
            f"{folder}: must be a folder of this user; remove what is there, or set XDG_RUNTIME_DIR"
        )
    if stat.S_IMODE(status.st_mode) & 0o077:
        raise SocketFolderError(
            f"{folder}: other users can enter this folder (mode "
            f"{stat.S_IMODE(status.st_mode):04o}); run `chmod 700 {folder}`"
        )
