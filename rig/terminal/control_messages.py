"""Messages on a run's control socket, between the run and the programs that watch or command it.

Each message is one datagram of UTF-8 JSON. A question is ``{"ask": "status" | "about"}``. A command
names the run by a value ``run``, which is different in every run, and has a ``number``, the
sender's monotonic clock in ns; this number must be larger than the numbers of all earlier commands.
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
"""Length of the longest message that a run reads, bytes."""
REPLY_BYTES: Final = 65_536
"""Length of the longest message that a run sends, bytes."""
LONGEST_TEXT: Final = 200
"""Longest answer to a prompt, characters."""
STALE_NS: Final = 5 * NS
"""Age, ns, from which a command other than `stop` is refused: its sender may have been frozen."""
RECEIVED_BEFORE: Final = "this command, or a later command, was already received"
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
        command: Action to perform.
        run: Value of the run for which the command is meant.
        number: Monotonic time at which the command was sent, ns.
        who: Sender of the command, as text.
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
        MessageError: The datagram is not a JSON object.
    """
    try:
        message = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise MessageError(f"the datagram is not JSON: {error}") from error
    if not isinstance(message, dict):
        raise MessageError("the datagram is not a JSON object")
    return message


def order_of(message: Mapping[str, Any]) -> Order:
    """Check the fields of a command.

    Raises:
        MessageError: A field is missing, unknown, or of the wrong type.
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
        return "the number of this command is a time in the future"
    age_ns = now_ns - order.number
    if order.command is not Command.STOP and age_ns > STALE_NS:
        return (
            f"this command is {age_ns / NS:.1f} s old, at most {STALE_NS // NS} s are allowed; "
            "send the command again if it is still wanted"
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
    """Remove sockets of programs that have ended."""
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
        OSError: The socket cannot be created.
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
        SocketFolderError: The folder belongs to another user, is a link, or is open to others.
        OSError: The folder cannot be created.
    """
    with suppress(FileExistsError):
        os.mkdir(folder, _FOLDER_MODE)
    status = os.lstat(folder)
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid():
        raise SocketFolderError(
            f"{folder}: must be a folder that belongs to this user; remove or rename what has this "
            "name, or set XDG_RUNTIME_DIR to another folder"
        )
    if stat.S_IMODE(status.st_mode) & 0o077:
        raise SocketFolderError(
            f"{folder}: other users can enter this folder (mode "
            f"{stat.S_IMODE(status.st_mode):04o}); run `chmod 700 {folder}`"
        )
