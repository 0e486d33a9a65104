"""The control socket of a run: where `rig console` reads the run's state and sends commands.

The run creates the socket in a folder that only the user of the run can enter. Datagrams wait in
the operating system, which bounds their number, until the control loop takes them between two
cycles; a sender that is too fast, frozen or gone does not delay the loop, and an answer that its
receiver does not take is dropped. No thread is used.
"""

from __future__ import annotations

import json
import os
import secrets
import select
import socket
import stat
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Final, Self

from drivers.clock import NS, Clock, RealClock
from rig.common.text import valid
from rig.terminal.stop_button import StopButton

VERSION: Final = 1  # version of the messages; a program of another version only watches
LONGEST_BYTES: Final = 4096
REPLY_BYTES: Final = 65_536
LONGEST_TEXT: Final = 200
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
    """A command that was read from a message."""

    command: Command
    run: str
    number: int  # monotonic time at which the command was sent, ns
    who: str  # sender of the command, as text
    prompt: int = 0  # number of the prompt that `text` answers; 0 for none
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
    """Read a datagram; MessageError if it is not a JSON object."""
    try:
        message = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise MessageError(f"the datagram is not JSON: {error}") from error
    if not isinstance(message, dict):
        raise MessageError("the datagram is not a JSON object")
    return message


def order_of(message: Mapping[str, Any]) -> Order:
    """Check the fields of a command; MessageError if one is missing, unknown or of a wrong type."""
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


def objection(
    order: Order, run: str, last: int, now_ns: int, stops: Collection[int] = ()
) -> str | None:
    """Return why a command is refused, or None.

    ``last`` is the number of the last accepted command, ``stops`` are those of the accepted STOPs:
    a STOP is accepted after a later command of another program, but never twice.
    """
    if order.run != run:
        return "this command is meant for another run"
    stop = order.command is Command.STOP
    if order.number in stops if stop else order.number <= last:
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
    """Return the folders of this user's control sockets, that of new ones first, or OSError."""
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
    """Return a non-blocking datagram socket at a path that only this user can open, or OSError."""
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
    """Create the folder of the sockets if it is missing; SocketFolderError if open to others."""
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


_AT_ONCE: Final = 8  # greatest number of messages that are read between two cycles
_TOLD: Final = 40  # number of the latest messages to the operator that are kept
_LONGEST_TOLD: Final = 800
"""Number of characters of a message that are kept, so that all messages fit into one datagram."""
_PEERS: Final = 8  # greatest number of programs that are informed of the end of the run


class Topic(Enum):
    """Subject of a prompt."""

    WEIGHT = "weight"
    PAUSE = "pause"


class ControlSocket:
    """Receives commands for one run and answers questions on it. A context manager.

    Args:
        about: Data that do not change during the run: bench, limits, folder.

    Raises:
        OSError: The socket cannot be made.
    """

    def __init__(
        self,
        stop: StopButton,
        about: Mapping[str, Any],
        say: Callable[[str], None],
        folder: Path | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._stop = stop
        self._say = say
        self._clock = clock or RealClock()
        self.run = secrets.token_hex(16)  # value that identifies this run in commands
        self._about = {"version": VERSION, "run": self.run, "pid": os.getpid(), **about}
        # Returns the expected remaining time in motion, s.
        self.left_s: Callable[[], float] = lambda: 0.0
        self._topic, self._since = Topic.PAUSE, 0
        self._state: dict[str, Any] = {
            "stage": None,
            "phase": "connecting",
            "prompt": None,
            "ended": None,
        }
        self._told: list[tuple[int, str]] = []
        self._count = self._prompts = self._last = 0
        self._stops: set[int] = set()  # numbers of the accepted STOPs
        self._answer: str | None = None
        self._peers: dict[str, None] = {}
        self._path, self._socket = _bound(folder or socket_folders()[0])
        self._ready = select.poll()
        self._ready.register(self._socket, select.POLLIN)

    def __enter__(self) -> Self:
        """Register this socket as a source of commands for the stop button."""
        self._stop.listen = self.take
        return self

    def __exit__(self, *exception: object) -> None:
        """Close and remove the socket."""
        self._stop.listen = None
        with suppress(OSError):
            self._path.unlink()
        self._socket.close()

    def fileno(self) -> int:
        """Return the descriptor, to wait for messages."""
        return self._socket.fileno()

    def entered(self, stage: str, phase: str) -> None:
        """Store the start of a phase."""
        self._state["stage"], self._state["phase"] = stage, phase

    def tell(self, words: str) -> None:
        """Store a message to the operator."""
        self._count += 1
        self._told.append((self._count, words[:_LONGEST_TOLD]))
        del self._told[:-_TOLD]

    def ended(self, words: str, good: bool) -> None:
        """Store how the run ended, and inform every program that asked before."""
        self._state["ended"] = {"words": words, "good": good}
        for peer in self._peers:
            self._send(self._status(), peer)

    def begin(self, topic: Topic) -> None:
        """Announce messages that explain the next prompts, and the subject of these prompts."""
        self._topic, self._since = topic, self._count

    def ask(self, words: str) -> None:
        """Open a prompt; answers to earlier prompts are rejected from now on."""
        # Messages that wait in the socket were sent before the question was asked.
        self.take()
        self._prompts += 1
        self._answer = None
        self._state["prompt"] = {
            "number": self._prompts,
            "topic": self._topic.value,
            "since": self._since,
            "words": words,
        }

    def answered(self) -> str | None:
        """Read the waiting messages; return the answer to the open prompt, or None, or stop."""
        self.take()
        self._stop.raise_if_pressed()
        return self._answer

    def close_prompt(self) -> None:
        """Store that the prompt is over: answered on the socket, at the terminal, or abandoned."""
        self._state["prompt"] = self._answer = None

    def take(self) -> None:
        """Read the waiting messages, a limited number of them, without waiting."""
        for _ in range(_AT_ONCE):
            if not self._ready.poll(0):
                return
            try:
                data, peer = self._socket.recvfrom(LONGEST_BYTES + 1)
            except OSError:
                return
            self._handle(data, peer if isinstance(peer, str) else "")

    def _handle(self, data: bytes, peer: str) -> None:
        try:
            if len(data) > LONGEST_BYTES:
                raise MessageError(f"longer than {LONGEST_BYTES} bytes")
            message = decode(data)
            if "ask" in message:
                self._tell_state(message["ask"], peer)
                return
            order = order_of(message)
        except MessageError as error:
            self._send({"taken": False, "words": str(error)}, peer)
            return
        refused = objection(order, self.run, self._last, self._clock.now_ns(), self._stops)
        if refused is None:
            self._last = max(self._last, order.number)
            if order.command is Command.STOP:
                self._stops.add(order.number)
            refused = self._carry_out(order)
        self._send({"to": order.number, "taken": refused is None, "words": refused or ""}, peer)

    def _carry_out(self, order: Order) -> str | None:
        who = valid(order.who).strip() or "the console"
        if order.command is Command.STOP:
            self._stop.press(f"STOP by {who}")
            return None
        if order.command in (Command.PAUSE, Command.NO_PAUSE):
            self._stop.pausing = order.command is Command.PAUSE
            what = "pause requested" if self._stop.pausing else "pause cancelled"
            self._note(f"{what}, by {who}")
            return None
        prompt = self._state["prompt"]
        if prompt is None or prompt["number"] != order.prompt or self._answer is not None:
            return "the run no longer waits for this answer"
        self._answer = valid(order.text).strip()
        self._note(f"answered by {who}: {self._answer or '(nothing)'}")
        return None

    def _note(self, words: str) -> None:
        self._say(words)
        self.tell(words)

    def _tell_state(self, asked: object, peer: str) -> None:
        if peer:
            self._peers.pop(peer, None)
            self._peers[peer] = None
            if len(self._peers) > _PEERS:
                del self._peers[next(iter(self._peers))]
        self._send({"about": self._about} if asked == "about" else self._status(), peer)

    def _status(self) -> dict[str, Any]:
        state = {
            **self._state,
            "left_s": round(self.left_s(), 1),
            "pausing": self._stop.pausing,
            "stopping": self._stop.pressed,
            "told": self._told,
        }
        return {"status": state, "run": self.run}

    def _send(self, message: Mapping[str, Any], peer: str) -> None:
        if not peer:
            return
        # A receiver that is gone, or whose queue is full, must not delay the run.
        with suppress(OSError):
            self._socket.sendto(encode(message), socket.MSG_DONTWAIT, peer)


def _bound(folder: Path) -> tuple[Path, socket.socket]:
    """Create a socket in a folder, without those of programs that have ended, or OSError."""
    require_own_folder(folder)
    remove_left(folder)
    path = folder / f"{PREFIX}{os.getpid()}-{secrets.token_hex(4)}{SUFFIX}"
    return path, bound_socket(path)
