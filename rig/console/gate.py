"""Gate of the console: checks host and origin of every request, and the token that permits
commands.

A page of another site cannot command a run, because its origin differs. DNS rebinding, which makes
the name of the other site point to this computer, does not help the other site, because the Host
header differs. The address that the console prints has the token in its fragment, which a browser
does not send to a server; the page sends the token in a header. The console uses no cookie, because
all ports of a computer share cookies.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import secrets
from collections import deque
from collections.abc import Iterable
from typing import Any, Final

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose
from uvicorn.protocols.http.h11_impl import H11Protocol

from rig.results.run.report import inlined_script

HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cache-Control": "no-store",
}
"""Headers of every answer that does not state these headers itself."""
SANDBOX: Final = (
    "sandbox allow-popups; default-src 'none'; style-src 'unsafe-inline'; img-src data:"
)
"""Policy of a page from a run folder: it may show its own pictures, but run and load nothing."""
_CHARTS: Final = base64.b64encode(hashlib.sha256(inlined_script().encode()).digest()).decode()
RUN_SANDBOX: Final = f"{SANDBOX}; script-src 'sha256-{_CHARTS}'".replace(
    "allow-popups", "allow-popups allow-scripts"
)
"""Policy of the page of a run, which may also run the script of this program with this digest."""
_READING: Final = frozenset({"GET", "HEAD"})


class Token:
    """Random text that permits commands until this console ends."""

    def __init__(self) -> None:
        self.text = secrets.token_urlsafe(24)

    def fits(self, given: str) -> bool:
        """Return whether a text is the token; the comparison takes equally long for every text."""
        return secrets.compare_digest(given.encode(), self.text.encode())


class Gate:
    """Middleware that passes only requests whose host and origin are this console."""

    def __init__(self, app: ASGIApp, hosts: Iterable[str]) -> None:
        self._app = app
        self._hosts = frozenset(hosts)
        self._origins = frozenset(f"http://{host}" for host in self._hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request to the application, or refuse the request."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        refused = self._refusal(scope)
        if refused is None:
            await self._app(scope, receive, _with_headers(send))
        elif scope["type"] == "websocket":
            await WebSocketClose(code=1008, reason=refused)(scope, receive, send)
        else:
            answer = PlainTextResponse(refused, status_code=403)
            await answer(scope, receive, _with_headers(send))

    def _refusal(self, scope: Scope) -> str | None:
        headers = Headers(scope=scope)
        hosts = headers.getlist("host")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return (
                "this address does not belong to the console; use the address that the "
                "console printed"
            )
        origin = headers.get("origin")
        reading = scope["type"] == "http" and scope["method"] in _READING
        if origin not in self._origins and not (reading and origin is None):
            return "the request comes from another site"
        return None


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            own = list(message.get("headers", []))
            names = {name for name, _ in own}
            added = [(k.lower().encode(), v.encode()) for k, v in HEADERS.items()]
            added = [each for each in added if each[0] not in names]
            message = {**message, "headers": [*own, *added]}
        await send(message)

    return sending


MOST_OPEN: Final = 64
MOST_PAGES: Final = 12  # greatest number of open pages with the token
MOST_READERS: Final = 6
MOST_GREETING: Final = 24  # greatest number of WebSockets that have not sent their token yet
YOUNG_S: Final = 1.0  # age up to which a connection without a request stays open, s
YOUNG_SHARE: Final = 4  # multiple of `MOST_OPEN` beyond which young connections are closed too
REQUEST_S: Final = 5.0  # time for the first request of a connection, s
BURST: Final = 32
"""Connections accepted before requests are read; below :data:`MOST_OPEN`: commands come first."""
QUEUE: Final = 1024
"""Connections that wait in the system; a browser whose connection is dropped tries again."""

_FULL: Final = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


def bounded(most: int = MOST_OPEN) -> type[H11Protocol]:
    """Return the protocol of one server's HTTP connections, of which at most ``most`` are open.

    A WebSocket leaves this protocol when its request is complete.
    """
    held: dict[Bounded, float] = {}
    waiting: deque[Bounded] = deque()

    def read_next() -> None:
        """Read what the connection that has waited longest was sent."""
        first = waiting.popleft()
        if waiting:
            first.loop.call_soon(read_next)
        first.read_late()

    class Bounded(H11Protocol):
        """HTTP connection of a bounded number; its commands pass all other requests."""

        _late = b""

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            """Register the connection; close another one if there are too many."""
            super().connection_made(transport)
            now = self.loop.time()
            held[self] = now
            self._expiry = self.loop.call_later(REQUEST_S, self._expire)
            if len(held) <= most:
                return
            spare = (each for each in held if not each.commands)
            if len(held) <= YOUNG_SHARE * most:
                # A young one without a request may still bring a command.
                spare = (each for each in spare if each.asked or now - held[each] > YOUNG_S)
            for closed in list(spare)[: len(held) - most]:
                del held[closed]
                closed.transport.abort()

        def data_received(self, data: bytes) -> None:
            """Read a command at once; put anything else in the queue of all connections.

            One request of the queue is read in each turn of the event loop, so that a command never
            waits for more than one of them. The requests of one connection are read in their order.
            """
            if not self._late and (self.commands or data.startswith(b"POST ")):
                super().data_received(data)
                return
            self.flow.pause_reading()
            if not self._late:
                waiting.append(self)
                if len(waiting) == 1:
                    self.loop.call_soon(read_next)
            # The end of an earlier answer lets a connection be read again before its turn.
            self._late += data

        def read_late(self) -> None:
            """Read what has waited in the queue, unless the connection was closed meanwhile."""
            data, self._late = self._late, b""
            if not self.transport.is_closing():
                self.flow.resume_reading()
                super().data_received(data)

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
        def asked(self) -> bool:
            """Whether a request was read, or waits in the queue."""
            return bool(self._late) or getattr(self, "cycle", None) is not None

        @property
        def commands(self) -> bool:
            """Whether a command is in progress; a command without the token is refused at once."""
            cycle = self.cycle
            return bool(cycle and not cycle.response_complete and cycle.scope["method"] == "POST")

        def _leave(self) -> None:
            held.pop(self, None)
            self._expiry.cancel()

        def _expire(self) -> None:
            if not self.asked:
                self.transport.abort()

    return Bounded
