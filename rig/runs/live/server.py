"""Serves a recording as a live stream on this computer, to several clients."""

from __future__ import annotations

import asyncio
import secrets
import socket
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.runs.live.gate import END, HEAD_BYTES, Gate, RefusedError, refusal
from rig.runs.live.session import Session
from rig.runs.mcap.reader import Tail

HOST = "127.0.0.1"
MOST_CLIENTS = 16
_HEAD_S = 5.0
"""Greatest time from the connection of a client to its first request, s."""
_READ_BYTES = 1 << 16


@dataclass(frozen=True)
class Offer:
    """Recording that is served, and how it is served.

    Attributes:
        recording: The file.
        name: Name of the source that clients show.
        token: Token that an address must contain, or None for no token.
        last_s: Length of the recorded part that a new subscriber gets, s, or None for all.
    """

    recording: Path
    name: str
    token: str | None
    last_s: float | None = None


def inner_host() -> str:
    """Return the address on which the servers behind the gate listen.

    If the system accepts every address of 127.0.0.0/8 without set-up, as Linux does, a random
    address is used, because no web page can try all of these addresses.
    """
    drawn = ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])
    with socket.socket() as probe:
        try:
            probe.bind((drawn, 0))
        except OSError:
            return HOST
    return drawn


async def serve(offer: Offer, port: int, started: Callable[[int], None]) -> None:
    """Serve the recording until the task is cancelled.

    Args:
        offer: Recording that is served.
        port: Port of this computer; 0 for a free port.
        started: Called with the port once clients can connect.

    Raises:
        OSError: The port cannot be used.
    """
    doors = _Doors(offer, inner_host())
    server = await asyncio.start_server(doors.open, HOST, port, limit=HEAD_BYTES)
    doors.port = server.sockets[0].getsockname()[1]
    async with server:
        started(doors.port)
        try:
            await server.serve_forever()
        finally:
            await doors.close()


class _Doors:
    """Accepts clients, and starts a session for each."""

    def __init__(self, offer: Offer, inner: str) -> None:
        self._offer = offer
        self._inner = inner
        self._inside: set[asyncio.Task[None]] = set()
        self.port = 0

    async def open(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client from its request to the end of its connection."""
        task = asyncio.current_task()
        assert task is not None
        self._inside.add(task)
        try:
            await self._serve(reader, writer)
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
            pass  # the client has closed the connection, or sent no request in time
        except asyncio.CancelledError:
            pass  # cancelled by :meth:`close`; asyncio would report a raised exception as an error
        finally:
            self._inside.discard(task)
            writer.close()

    async def close(self) -> None:
        """End every session."""
        inside = list(self._inside)
        for task in inside:
            task.cancel()
        await asyncio.gather(*inside, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = await asyncio.wait_for(reader.readuntil(END), _HEAD_S)
        gate = Gate(self.port, self._offer.token)
        try:
            gate.pass_on(head, "")
            if len(self._inside) > MOST_CLIENTS:
                raise RefusedError(
                    f"{MOST_CLIENTS} clients are already connected; close one of them"
                )
        except RefusedError as error:
            writer.write(refusal(str(error)))
            await writer.drain()
            return
        with Tail(self._offer.recording) as tail:
            session = Session(self._offer.name, self._inner, tail, self._offer.last_s)
            try:
                host, port = session.address
                inner_reader, inner_writer = await asyncio.open_connection(host, port)
                try:
                    inner_writer.write(gate.pass_on(head, f"{host}:{port}"))
                    await _until_one_ends(
                        _pump(reader, inner_writer, None),
                        _pump(inner_reader, writer, session.passed),
                        session.feed(),
                    )
                finally:
                    inner_writer.close()
            finally:
                await session.close()


async def _pump(
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
    count: Callable[[int], None] | None,
) -> None:
    while data := await reader.read(_READ_BYTES):
        writer.write(data)
        await writer.drain()
        if count is not None:
            count(len(data))


async def _until_one_ends(*work: Coroutine[Any, Any, None]) -> None:
    """Run all tasks until the first task ends, then cancel the others; raise the error of the first
    task.
    """
    tasks = [asyncio.ensure_future(one) for one in work]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
