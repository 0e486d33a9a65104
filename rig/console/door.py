"""Bounds the connections to the console, so that many of them do not delay STOP.

A connection that waits costs almost nothing; only their number is bounded. A new connection is
always accepted, because it may bring a STOP: beyond :data:`MOST_OPEN` connections, the oldest
connection without a request in progress is closed, then the oldest of all. A connection without a
whole request within :data:`REQUEST_S` is closed. Pages, which cost processor time, are bounded by
:data:`MOST_PAGES` and :data:`MOST_READERS`.
"""

from __future__ import annotations

import asyncio
from typing import Any, Final

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_OPEN: Final = 100
"""Greatest number of HTTP connections."""
MOST_PAGES: Final = 12
"""Greatest number of open pages with the token."""
MOST_READERS: Final = 6
"""Greatest number of open pages without the token."""
MOST_GREETING: Final = 24
"""Greatest number of WebSockets that have not sent their token yet."""
REQUEST_S: Final = 5.0
"""Time for the first request of a connection, s."""
BACKLOG: Final = 512
"""Greatest number of connections that wait to be accepted; the system drops further ones, and tries
again after a second.
"""


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
                idle = (each for each in held if each is not self and not each.busy)
                oldest = next(idle, next(iter(held)))
                del held[oldest]
                oldest.transport.abort()

        def connection_lost(self, exc: Exception | None) -> None:
            """Forget the connection."""
            self._leave()
            super().connection_lost(exc)

        def handle_websocket_upgrade(self, event: Any) -> None:
            """Pass the connection to the WebSocket protocol."""
            self._leave()
            super().handle_websocket_upgrade(event)

        @property
        def busy(self) -> bool:
            """Whether a request is in progress."""
            return self.cycle is not None and not self.cycle.response_complete

        def _leave(self) -> None:
            held.pop(self, None)
            self._expiry.cancel()

        def _expire(self) -> None:
            # None until the head of the first request is complete.
            if getattr(self, "cycle", None) is None:
                self.transport.abort()

    return Bounded
