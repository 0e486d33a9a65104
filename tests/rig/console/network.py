"""The network between browser and console, which can be lost."""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import Future
from typing import Any

HOST = "127.0.0.1"


class Network:
    """Relay of TCP connections from a port of its own to a console's port.

    The browser's emulation of a loss is not used, because the browser does not always come back
    from it. While the network is lost, connections break and new ones are closed at once.
    """

    def __init__(self, port: int) -> None:
        self._console = port
        self._lost = False
        self._open: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="network")

    def __enter__(self) -> Network:
        self._thread.start()
        self._server = self._call(asyncio.start_server(self._carry, HOST, 0))
        return self

    def __exit__(self, *_: object) -> None:
        self.lose()
        self._call(self._ended())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    @property
    def rule(self) -> str:
        """Rule for the browser's name resolver."""
        port = self._server.sockets[0].getsockname()[1]
        return f"MAP {HOST}:{self._console} {HOST}:{port}"

    def lose(self) -> None:
        """Break every connection, and refuse new ones."""
        self._call(self._switch(lost=True))

    def find(self) -> None:
        """Let new connections pass."""
        self._call(self._switch(lost=False))

    def _call(self, work: Any) -> Any:
        done: Future[Any] = asyncio.run_coroutine_threadsafe(work, self._loop)
        return done.result(10.0)

    async def _switch(self, *, lost: bool) -> None:
        self._lost = lost
        if lost:
            for writer in tuple(self._open):
                writer.transport.abort()

    async def _ended(self) -> None:
        self._server.close()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    async def _carry(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._lost:
            writer.transport.abort()
            return
        self._open.add(writer)
        try:
            further, onward = await asyncio.open_connection(HOST, self._console)
            self._open.add(onward)
            await asyncio.gather(self._pump(reader, onward), self._pump(further, writer))
            self._open.discard(onward)
        except OSError:
            pass
        finally:
            self._open.discard(writer)
            writer.transport.abort()

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while data := await reader.read(1 << 16):
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        finally:
            writer.close()
