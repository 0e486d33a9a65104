"""What a client's first request must show, and what of it reaches the server behind."""

from __future__ import annotations

from ipaddress import ip_address

import pytest

from rig.runs.live import Gate, RefusedError, inner_host, refusal

GATE = Gate(port=8765, token="abc-123")
OPEN = Gate(port=8765, token=None)


def request(target: str = "/?token=abc-123", host: str = "127.0.0.1:8765", *more: str) -> bytes:
    fields = [
        f"Host: {host}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Key: x3JJHMbDL1EzLkh9GBhXDw==",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Protocol: foxglove.sdk.v1",
        "Sec-WebSocket-Extensions: permessage-deflate",
        *more,
    ]
    return "\r\n".join([f"GET {target} HTTP/1.1", *fields]).encode() + b"\r\n\r\n"


def test_what_passes_carries_neither_token_nor_compression() -> None:
    passed = GATE.pass_on(request(), "127.1.2.3:4000").decode()
    assert passed.startswith("GET / HTTP/1.1\r\nHost: 127.1.2.3:4000\r\n")
    assert passed.endswith("\r\n\r\n")
    assert "abc-123" not in passed
    assert "permessage-deflate" not in passed
    assert "sec-websocket-key: x3JJHMbDL1EzLkh9GBhXDw==" in passed


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:8765"])
def test_names_of_this_computer_pass(host: str) -> None:
    assert GATE.pass_on(request(host=host), "inner")


@pytest.mark.parametrize(
    "head",
    [
        request(target="/"),
        request(target="/?token=abc-12"),
        request(target="/?token=abc-123x"),
        request(target="/?Token=abc-123"),
        request(host="127.0.0.1"),
        request(host="127.0.0.1:8766"),
        request(host="evil.example:8765"),
        request(host="127.0.0.1.evil.example:8765"),
        request("/?token=abc-123", "127.0.0.1:8765", "Host: localhost:8765"),
        request("/?token=abc-123", "127.0.0.1:8765", "no colon"),
        request().replace(b"GET", b"POST", 1),
        b"\r\n\r\n",
        b"\xff\xfe\x00\r\n\r\n",
    ],
)
def test_what_is_refused(head: bytes) -> None:
    with pytest.raises(RefusedError):
        GATE.pass_on(head, "inner")


@pytest.mark.parametrize(
    ("origin", "passes"),
    [
        ("", True),
        ("https://app.foxglove.dev", True),
        ("https://app.foxglove.dev.evil.example", False),
        ("http://localhost:3000", False),
        ("null", False),
    ],
)
def test_pages_without_a_token(origin: str, passes: bool) -> None:
    head = request("/", "127.0.0.1:8765", f"Origin: {origin}")
    if passes:
        assert OPEN.pass_on(head, "inner")
    else:
        with pytest.raises(RefusedError, match="refuses web pages, also the page of"):
            OPEN.pass_on(head, "inner")


def test_a_refusal_is_an_answer_in_words() -> None:
    head, _, body = refusal("the reason").partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 403 ")
    assert body == b"the reason\n"
    assert b"Content-Length: 11" in head


def test_the_server_behind_the_gate_hides_at_a_loopback_address(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = {inner_host() for _ in range(8)}
    assert all(ip_address(host).is_loopback for host in found)
    assert len(found) == 8
    # As on macOS, which has 127.0.0.1 alone.
    monkeypatch.setattr("rig.runs.live.socket.socket", NoAddress)
    assert inner_host() == "127.0.0.1"


class NoAddress:
    def __enter__(self) -> NoAddress:
        return self

    def __exit__(self, *exception: object) -> None:
        pass

    def bind(self, address: object) -> None:
        raise OSError("cannot assign requested address")
