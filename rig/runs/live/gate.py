"""Checks the first request of a client of the live stream before the server behind the gate
answers.

The protocol has no password, and a browser lets every web page open a WebSocket to this computer.
The address therefore contains a token, and a request without the token is refused.
"""

from __future__ import annotations

import hmac
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

HEAD_BYTES = 8192
"""Greatest length of the head of a request, bytes."""
END = b"\r\n\r\n"
NAMES = frozenset({"127.0.0.1", "localhost"})
"""Accepted names of this computer in the field ``Host``. A request with another name may come from
a web page whose owner makes this name point to this computer (DNS rebinding).
"""
APP = "https://app.foxglove.dev"
"""Origin of Foxglove in a browser."""
_PASSED = (
    "upgrade",
    "connection",
    "sec-websocket-key",
    "sec-websocket-version",
    "sec-websocket-protocol",
)
"""Fields of a request that the server behind the gate needs. The field for compression is left out,
because the session counts the bytes that pass, and loopback needs no compression.
"""


class RefusedError(Exception):
    """A request is refused; the message states the reason and the remedy."""


@dataclass(frozen=True)
class Gate:
    """Conditions that a request must meet.

    Attributes:
        port: The port at which the request arrived.
        token: The token that the address of the request must contain, or None for no token.
    """

    port: int
    token: str | None

    def pass_on(self, head: bytes, inner: str) -> bytes:
        """Return the head of a request for the server behind the gate.

        Args:
            head: Head of the request, with the blank line at its end.
            inner: Host and port of the server behind the gate.

        Raises:
            RefusedError: The request must not pass.
        """
        target, fields = _parse(head)
        host = fields.get("host", "")
        name, _, port = host.rpartition(":")
        if name not in NAMES or port != str(self.port):
            raise RefusedError(f"Host is {host!r}, not 127.0.0.1:{self.port}")
        if self.token is None:
            origin = fields.get("origin", "")
            if origin not in ("", APP):
                raise RefusedError(
                    "the stream was started with --no-token and therefore refuses web pages, "
                    f"also the page of {origin}; start `rig watch` without --no-token"
                )
        elif not self._carries_token(target):
            raise RefusedError(
                "the address lacks the token of this start; use the address "
                "that the command printed"
            )
        lines = [f"{key}: {fields[key]}" for key in _PASSED if key in fields]
        return "\r\n".join(["GET / HTTP/1.1", f"Host: {inner}", *lines]).encode("latin-1") + END

    def _carries_token(self, target: str) -> bool:
        given = parse_qs(urlsplit(target).query).get("token", [""])[0]
        return hmac.compare_digest(given.encode(), (self.token or "").encode())


def _parse(head: bytes) -> tuple[str, Mapping[str, str]]:
    """Return target and fields (names in lower case) of a GET request.

    Raises:
        RefusedError: The text is not a GET request, or a field occurs twice.
    """
    first, *rest = head.removesuffix(END).decode("latin-1").split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or words[0] != "GET" or not words[2].startswith("HTTP/1."):
        raise RefusedError("not a WebSocket request")
    fields: dict[str, str] = {}
    for line in rest:
        name, colon, value = line.partition(":")
        key = name.lower()
        if not colon or key in fields:
            raise RefusedError(f"the field {name!r} of the request is malformed or repeated")
        fields[key] = value.strip()
    return words[1], fields


def refusal(words: str) -> bytes:
    """Return the answer to a request that is refused."""
    body = words.encode() + b"\n"
    head = (
        "HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain; charset=utf-8\r\n"
        f"Content-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + body
