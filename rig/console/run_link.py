"""The console's side of the control sockets: finds runs, requests their state, sends commands."""

from __future__ import annotations

import asyncio
import os
import secrets
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Final

from drivers.clock import Clock, RealClock
from rig.terminal.control_messages import (
    PREFIX,
    RECEIVED_BEFORE,
    REPLY_BYTES,
    SUFFIX,
    Command,
    MessageError,
    Order,
    bound_socket,
    decode,
    encode,
    remove_left,
    require_own_folder,
    socket_folders,
)

REPLY_S: Final = 0.25
"""Time after which a command without an answer is sent again, s."""
ATTEMPTS: Final = 4


class Unreachable(Exception):
    """The program of a run has ended, or does not answer."""


class Links:
    """Socket through which the console exchanges messages with all runs of this user.

    Args:
        heard: Called with the path of a run's socket and each message from this socket.
        clock: Clock by which commands are numbered.
    """

    def __init__(
        self, heard: Callable[[str, dict[str, Any]], None], clock: Clock | None = None
    ) -> None:
        self._heard = heard
        self._clock = clock or RealClock()
        folder = socket_folders()[0]
        require_own_folder(folder)
        remove_left(folder)
        self._path = folder / f"console-{os.getpid()}-{secrets.token_hex(4)}{SUFFIX}"
        self._socket = bound_socket(self._path)
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._last = 0

    def open(self) -> None:
        """Receive messages in the running event loop."""
        asyncio.get_running_loop().add_reader(self._socket, self._read)

    def close(self) -> None:
        """Close and remove the socket."""
        with suppress(RuntimeError):
            asyncio.get_running_loop().remove_reader(self._socket)
        self._socket.close()
        with suppress(OSError):
            self._path.unlink()

    def runs(self) -> list[str]:
        """Return the paths of the control sockets of all runs of this user."""
        found: list[str] = []
        for folder in socket_folders():
            with suppress(OSError):
                if folder.is_dir():
                    require_own_folder(folder)
                    found += map(str, folder.glob(f"{PREFIX}*{SUFFIX}"))
        return sorted(found)

    def ask(self, path: str, what: str) -> None:
        """Ask a run for its ``status`` or ``about``; the answer is passed to ``heard``.

        Raises:
            Unreachable: The program is gone.
        """
        self._send(path, {"ask": what})

    async def command(
        self, path: str, run: str, command: Command, who: str, prompt: int = 0, text: str = ""
    ) -> dict[str, Any]:
        """Send a command to a run, repeatedly, until the run has answered.

        A command that waits in the queue of the run is sent again with its number, so that the run
        executes the command only once. A command that did not get into the queue, or that the run
        refused because of a later command of another program, gets a new number. So the commands
        of this console wait in the queue in the order of their numbers, and no command is refused
        because another command of this console got into the queue first.

        Returns:
            The answer: ``taken`` and, for a refused command, ``words``.

        Raises:
            Unreachable: The program is gone, or did not answer; the text states whether the run
                will execute the command later.
        """
        queued = False
        order = self._order(run, command, who, prompt, text)
        for _ in range(ATTEMPTS):
            sent, answer = await self._once(path, order)
            if answer is not None and (answer["taken"] or answer["words"] != RECEIVED_BEFORE):
                return answer
            if answer is not None and queued:
                # The command was executed when it was first sent; only the answer was lost.
                return {"taken": True, "words": ""}
            queued = queued or (sent and answer is None)
            if not queued:
                order = self._order(run, command, who, prompt, text)
        if not queued:
            raise Unreachable(
                f"the run did not accept the command within {ATTEMPTS * REPLY_S:g} s and will NOT "
                "execute it later"
            )
        raise Unreachable(
            f"the run did not answer within {ATTEMPTS * REPLY_S:g} s; the run will execute the "
            "command when it responds again"
        )

    async def _once(self, path: str, order: Order) -> tuple[bool, dict[str, Any] | None]:
        """Send a command once; return whether it got into the queue of the run, and the answer, or
        None if no answer arrives in time.

        Raises:
            Unreachable: The program is gone.
        """
        future: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._waiting[order.number] = future
        sent = False
        try:
            sent = self._send(path, {**order.__dict__, "command": order.command.value})
            return sent, await asyncio.wait_for(future, REPLY_S)
        except TimeoutError:
            return sent, None
        finally:
            self._waiting.pop(order.number, None)

    def _order(self, run: str, command: Command, who: str, prompt: int, text: str) -> Order:
        self._last = max(self._clock.now_ns(), self._last + 1)
        return Order(command, run, self._last, who, prompt, text)

    def _send(self, path: str, message: Mapping[str, Any]) -> bool:
        """Send a message; return False if it cannot be sent now: the queue of the run is full, or
        the system lacks memory.

        Raises:
            Unreachable: The program is gone.
        """
        try:
            self._socket.sendto(encode(message), path)
        except (ConnectionRefusedError, FileNotFoundError) as error:
            raise Unreachable(f"the program of the run has ended ({error.strerror})") from error
        except OSError:
            return False
        return True

    def _read(self) -> None:
        while True:
            try:
                data, peer = self._socket.recvfrom(REPLY_BYTES)
                message = decode(data)
            except (OSError, MessageError):
                return
            waiting = self._waiting.get(message.get("to", 0))
            if waiting is not None and not waiting.done():
                waiting.set_result(message)
            elif isinstance(peer, str):
                self._heard(peer, message)
