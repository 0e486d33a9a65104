"""Who may talk to the console: host and origin of every request, and the token of this start.

A page of another site cannot command a run, as its origin differs; nor after its name was made to
point to this computer (DNS rebinding), as the host then differs. The token is in the fragment of
the printed address, which a browser never sends by itself; the page sends it in a header. There is
no cookie, as those are shared by all ports of a computer.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from typing import Final

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

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
"""Sent with every answer that does not state the same header itself."""
SANDBOX: Final = (
    "sandbox allow-popups; default-src 'none'; style-src 'unsafe-inline'; img-src data:"
)
"""Policy of a page that is made of runs: it may show its own pictures, and may run nothing and
reach nothing.
"""
_READING: Final = frozenset({"GET", "HEAD"})


class Token:
    """The token of this start."""

    def __init__(self) -> None:
        self.text = secrets.token_urlsafe(24)

    def fits(self, given: str) -> bool:
        """Return whether a text is the token; takes equally long whatever it is."""
        return secrets.compare_digest(given.encode(), self.text.encode())


class Gate:
    """Lets requests pass whose host and origin are this console's own.

    Args:
        app: What they pass to.
        hosts: Values of the Host header that are this console's own.
    """

    def __init__(self, app: ASGIApp, hosts: Iterable[str]) -> None:
        self._app = app
        self._hosts = frozenset(hosts)
        self._origins = frozenset(f"http://{host}" for host in self._hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
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
        """Return why a request is refused, or None."""
        headers = Headers(scope=scope)
        hosts = headers.getlist("host")
        if len(hosts) != 1 or hosts[0] not in self._hosts:
            return "this address is not the console's own; use the address that it printed"
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
