"""Bounds the connections to the console, so that many of them do not delay STOP.

A new connection is always accepted, because it may bring a STOP: beyond :data:`MOST_OPEN`
connections, the oldest connection is closed that has no command in progress. A connection without a
whole request within :data:`REQUEST_S` is closed. Pages, which cost processor time, are bounded by
:data:`MOST_PAGES` and :data:`MOST_READERS`; a WebSocket beyond all of them is refused before any
other work.
"""

from __future__ import annotations

import asyncio
from typing import Any, Final

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_OPEN: Final = 64
"""Greatest number of HTTP connections."""
MOST_PAGES: Final = 12
"""Greatest number of open pages with the token."""
MOST_READERS: Final = 6
"""Greatest number of open pages without the token."""
MOST_GREETING: Final = 24
"""Greatest number of WebSockets that have not sent their token yet."""
REQUEST_S: Final = 5.0
"""Time for the first request of a connection, s."""
BURST: Final = 32
"""Greatest number of connections that are accepted before requests are read again. It is smaller
than :data:`MOST_OPEN`, so that a command is read before newer connections can replace its own.
"""
QUEUE: Final = 1024
"""Number of connections that wait in the system to be accepted. The system drops further ones, and
a browser then tries again after a second.
"""

_FULL: Final = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


def bounded(most: int = MOST_OPEN) -> type[H11Protocol]:
    """Return the protocol of one server's HTTP connections, of which at most ``most`` are open.

    A WebSocket leaves this protocol when its request is complete.
    """
    held: dict[Bounded, None] = {}

    class Bounded(H11Protocol):
        """HTTP connection of a bounded number."""

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            """Register the connection; close the oldest connection if there are too many."""
            super().connection_made(transport)
            held[self] = None
            self._expiry = self.loop.call_later(REQUEST_S, self._expire)
            if len(held) > most:
                oldest = next((each for each in held if not each.commands), next(iter(held)))
                del held[oldest]
                oldest.transport.abort()

        def connection_lost(self, exc: Exception | None) -> None:
            """Forget the connection."""
            self._leave()
            super().connection_lost(exc)

        def handle_websocket_upgrade(self, event: Any) -> None:
            """Pass the connection to the WebSocket protocol."""
            self._leave()
            if len(self.connections) - len(held) > MOST_PAGES + MOST_READERS + MOST_GREETING:
                self.transport.write(_FULL)
                self.transport.close()
                return
            super().handle_websocket_upgrade(event)

        @property
        def commands(self) -> bool:
            """Whether a command is in progress; a command without the token is refused at once."""
            cycle = self.cycle
            return bool(cycle and not cycle.response_complete and cycle.scope["method"] == "POST")

        def _leave(self) -> None:
            held.pop(self, None)
            self._expiry.cancel()

        def _expire(self) -> None:
            # None until the head of the first request is complete.
            if getattr(self, "cycle", None) is None:
                self.transport.abort()

    return Bounded
