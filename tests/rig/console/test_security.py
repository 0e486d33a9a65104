"""Who may read and who may command: host, origin, token, method and number of every request."""

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import uvicorn
from uvicorn.server import ServerState
from wsproto import ConnectionType, WSConnection
from wsproto.events import (
    AcceptConnection,
    CloseConnection,
    Message,
    Ping,
    RejectConnection,
    Request,
    TextMessage,
)

from rig.cli.entry import STOPPED
from rig.console.app import Console
from rig.console.gate import MOST_OPEN, MOST_PAGES, MOST_READERS, YOUNG_SHARE, Token, bounded
from rig.console.hub import Controls, Refusal

from .processes import Served, place, served, wait_until

STOP = {"page": "none", "number": 1, "command": "stop", "run": "0" * 32}


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with place(tmp_path_factory.mktemp("console")) as where, served(where) as made:
        yield made


class Page:
    """The WebSocket of a page."""

    def __init__(self, console: Served, token: str, **headers: str) -> None:
        host = f"127.0.0.1:{console.port}"
        given = {"origin": f"http://{host}", **headers}
        self.socket = socket.create_connection(("127.0.0.1", console.port), timeout=20)
        self.wire = WSConnection(ConnectionType.CLIENT)
        sent = given.pop("host", host)
        extra = [(name.encode(), value.encode()) for name, value in given.items() if value]
        self.socket.sendall(self.wire.send(Request(host=sent, target="/live", extra_headers=extra)))
        self.events: list[Any] = []
        self.accepted = isinstance(self._next(), AcceptConnection)
        self.refused = False
        if self.accepted:
            self.socket.sendall(self.wire.send(Message(data=json.dumps({"token": token}))))
            event = self._next()
            self.refused = isinstance(event, CloseConnection)
            if not self.refused:
                self.events.insert(0, event)
                self.key = self.read()["hello"]["page"]

    def _next(self) -> Any:
        while True:
            while not self.events:
                data = self.socket.recv(65536)
                assert data, "the console closed the page"
                self.wire.receive_data(data)
                self.events += list(self.wire.events())
            event = self.events.pop(0)
            if not isinstance(event, Ping):
                return event
            self.socket.sendall(self.wire.send(event.response()))

    def read(self) -> dict[str, Any]:
        """Return the next message that is text."""
        text = ""
        while True:
            event = self._next()
            if isinstance(event, TextMessage):
                text += event.data
                if event.message_finished:
                    found = json.loads(text)
                    assert isinstance(found, dict)
                    return found
            assert not isinstance(event, RejectConnection)

    def controls(self) -> dict[str, Any]:
        """Return who holds the controls, as soon as it is told."""
        while True:
            state = self.read().get("state", {})
            if "controls" in state:
                found = state["controls"]
                assert isinstance(found, dict)
                return found

    def close(self) -> None:
        self.socket.close()


@pytest.fixture
def opened(console: Served) -> Iterator[Callable[..., Page]]:
    """Open pages, which are closed at the end."""
    pages: list[Page] = []

    def opening(token: str, **headers: str) -> Page:
        pages.append(Page(console, token, **headers))
        return pages[-1]

    yield opening
    for made in pages:
        made.close()


@pytest.fixture
def page(console: Served, opened: Callable[..., Page]) -> Page:
    """Return a page that holds the controls."""
    made = opened(console.token)
    # The console may not yet have noticed that the pages of the test before are closed.
    for _ in range(200):
        if made.accepted and not made.refused:
            break
        made = opened(console.token)
    console.request("POST", "/controls", {"page": made.key, "number": 1})
    while not made.controls()["yours"]:
        pass
    return made


def test_the_page_is_read_without_a_token(console: Served) -> None:
    status, text, headers = console.request("GET", "/")
    assert status == 200
    assert "not an emergency stop" in text
    assert console.token not in text
    assert headers["x-frame-options"] == "DENY"
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "set-cookie" not in headers
    # Everything comes from the console itself, and nothing else does.
    for name in ("page.js", "link.js", "charts.js", "console.css", "index.html"):
        status, text, _ = console.request("GET", f"/static/{name}")
        assert status == 200
        assert "https://" not in text
    for name in ("../app.py", "..%2fapp.py", "%2e%2e/app.py", ".hidden", "app.py", ""):
        assert console.request("GET", f"/static/{name}")[0] == 404


def test_a_foreign_host_is_refused(console: Served) -> None:
    # As after DNS rebinding: the browser sends the other site's name to this computer.
    port = console.port
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", f"0.0.0.0:{port}"):
        for method, path in (("GET", "/"), ("POST", "/command")):
            given = {"host": host, "origin": f"http://{host}"}
            assert console.request(method, path, STOP, **given)[0] == 403


def test_a_command_of_another_site_is_refused(console: Served) -> None:
    port = console.port
    for origin in ("http://evil.example", "null", None, f"https://127.0.0.1:{port}"):
        assert console.request("POST", "/command", STOP, origin=origin)[0] == 403
    # As the form of another page sends it.
    assert console.request("POST", "/command", STOP, content_type="text/plain")[0] == 415


PATHS = ("/command", "/controls", "/dry-run", "/start", "/resume", "/off")


@pytest.mark.parametrize("path", PATHS)
def test_no_command_without_the_token_or_by_another_method(console: Served, path: str) -> None:
    for given in ("Bearer wrong", None, "", "Bearer", f"Basic {console.token}"):
        assert console.request("POST", path, STOP, authorization=given)[0] == 401
    query = f"{path}?token={console.token}"
    assert console.request("POST", query, STOP, authorization=None)[0] == 401
    origin = f"http://127.0.0.1:{console.port}"
    headers = {"authorization": f"Bearer {console.token}", "origin": origin}
    for method in ("GET", "HEAD", "PUT", "OPTIONS"):
        assert console.request(method, path, **headers)[0] == 405


@pytest.mark.parametrize(
    ("content", "status"),
    [
        (b"", 400),
        (b"[]", 400),
        (b"\xff", 400),
        (b"[" * 5000, 400),
        ({"page": 1, "number": 1}, 400),
        ({"page": "p", "number": True}, 400),
        (b"[" * 9000, 413),
        ({**STOP, "command": "jump"}, 409),
        ({**STOP, "prompt": "1"}, 409),
        ({**STOP, "run": ["x"]}, 409),
    ],
)
def test_broken_commands_are_refused_in_words(console, content, status):
    found, text, _ = console.request("POST", "/command", content)
    assert (found, bool(json.loads(text)["words"])) == (status, True)


def test_a_replayed_command_of_a_page_is_refused(console: Served, page: Page) -> None:
    content = {"page": page.key, "number": 7}
    assert console.request("POST", "/controls", content)[0] == 200
    status, text, _ = console.request("POST", "/controls", content)
    assert (status, "already received" in text) == (409, True)
    assert console.request("POST", "/controls", {"page": page.key, "number": 6})[0] == 409
    assert console.request("POST", "/controls", {"page": page.key, "number": 8})[0] == 200


def test_another_site_cannot_watch(console: Served, opened: Callable[..., Page]) -> None:
    for headers in ({"origin": "http://evil.example"}, {"origin": ""}, {"host": "evil.example"}):
        assert not opened(console.token, **headers).accepted


def test_one_page_holds_the_controls_until_it_closes(console, page, opened):
    reader = opened("wrong").controls()
    assert (reader["yours"], reader["may"]) == (False, False)
    second = opened(console.token)
    assert not second.controls()["yours"]
    content = {"page": second.key, "number": 1, "command": "pause", "run": "0" * 32}
    assert console.request("POST", "/command", content)[0] == 409
    assert console.request("POST", "/start", {**content, "number": 2, "shown": ""})[0] == 409
    assert console.request("POST", "/controls", {"page": second.key, "number": 3})[0] == 200
    assert second.controls()["yours"]
    assert not page.controls()["yours"]
    # The controls of a closed page go to the only other page that may have them.
    second.close()
    assert page.controls()["yours"]


def test_only_known_benches_are_made_safe(console: Served) -> None:
    content = {"page": "none", "number": 1}
    for bench in ("/etc/passwd", "-h", ["practical"], None):
        assert console.request("POST", "/off", {**content, "bench": bench})[0] == 409
    status, text, _ = console.request("POST", "/off", {**content, "bench": "practical"})
    assert (status, json.loads(text)["proved"]) == (200, True)


def still_open(connections: list[socket.socket]) -> int:
    count = 0
    for each in connections:
        each.setblocking(False)
        try:
            count += bool(each.recv(1, socket.MSG_PEEK))
        except BlockingIOError:
            count += 1
        except OSError:
            pass
    return count


def test_connections_are_bounded_and_the_newest_is_served(console: Served) -> None:
    connections = []
    for number in range(300):
        connections.append(socket.create_connection(("127.0.0.1", console.port), timeout=20))
        connections[-1].sendall(b"GET / HTTP/1.1\r\nHost: " if number % 2 else b"")
    # A command comes after them, and is answered.
    assert console.request("POST", "/command", {**STOP, "run": None})[0] == 200
    assert still_open(connections) <= YOUNG_SHARE * MOST_OPEN
    # What sends no whole request is closed.
    wait_until(lambda: not still_open(connections), 30.0)
    for each in connections:
        each.close()


class Wire:
    """The transport of a connection that only remembers that it was closed."""

    def __init__(self) -> None:
        self.aborted = False

    def abort(self) -> None:
        self.aborted = True

    def do_nothing(self, *_: object) -> None:
        pass

    pause_reading = resume_reading = write = close = do_nothing

    def get_extra_info(self, name: str) -> None:
        return None

    def is_closing(self) -> bool:
        return self.aborted


@pytest.mark.parametrize(
    ("apart_s", "count", "closed"),
    [(2.0, 5, {1, 2}), (0.0, 3 * YOUNG_SHARE, set()), (0.0, 13, set(range(1, 11)))],
)
def test_a_connection_that_may_bring_a_command_is_closed_last(apart_s, count, closed):
    """The first of them has a command in progress; young ones may still bring one."""

    async def nothing(scope: object, receive: object, send: object) -> None:
        return None

    async def opening() -> list[bool]:
        config = uvicorn.Config(nothing)
        config.load()
        kind, wires, made = bounded(3), [], []
        loop = asyncio.get_running_loop()
        for number in range(count):
            made.append(kind(config, ServerState(), {}))
            wires.append(Wire())
            made[-1].loop = SimpleNamespace(  # type: ignore[assignment]
                time=lambda n=number: n * apart_s, call_later=loop.call_later
            )
            made[-1].connection_made(wires[-1])  # type: ignore[arg-type]
            if not number:
                made[0].cycle = SimpleNamespace(  # type: ignore[assignment]
                    response_complete=False, scope={"method": "POST"}
                )
        for each in made:
            each._leave()
        return [each.aborted for each in wires]

    assert {n for n, aborted in enumerate(asyncio.run(opening())) if aborted} == closed


def test_a_command_passes_the_requests_that_wait() -> None:
    """Every other request is answered once, in the order of its connection."""
    count = 20

    async def asking() -> list[str]:
        order, answered = [], asyncio.Event()

        async def listing(scope: dict[str, Any], receive: object, send: Callable[..., Any]) -> None:
            order.append(scope["path"])
            await send({"type": "http.response.start", "status": 200, "headers": []})
            await send({"type": "http.response.body", "body": b""})
            if len(order) == 3 * count + 1:
                answered.set()

        config = uvicorn.Config(listing)
        config.load()
        kind, made = bounded(), []
        for _ in range(count + 1):
            made.append(kind(config, ServerState(), {}))
            made[-1].connection_made(Wire())  # type: ignore[arg-type]
        for number, each in enumerate(made[:-1]):
            each.data_received(f"GET /{number}/a HTTP/1.1\r\nHost: here\r\n\r\n".encode())
            # A client that does not wait for its answer, not even before a command.
            rest = "TP/1.1\r\nHost: here\r\n\r\n"
            for part in (f"GET /{number}/b HT", rest, f"POST /{number}/c HT{rest}"):
                each.data_received(part.encode())
        made[-1].data_received(b"POST /stop HTTP/1.1\r\nHost: here\r\nContent-Length: 0\r\n\r\n")
        await asyncio.wait_for(answered.wait(), 20.0)
        for each in made:
            each.connection_lost(None)
        return order

    order = asyncio.run(asking())
    assert order[0] == "/stop"
    asked = [f"/{number}/{part}" for number in range(count) for part in "abc"]
    assert sorted(order[1:]) == sorted(asked)
    for number in range(count):
        places = [order.index(f"/{number}/{part}") for part in "abc"]
        assert places == sorted(places)


@pytest.mark.parametrize("may", [True, False])
def test_pages_are_bounded(console: Served, opened: Callable[..., Page], may: bool) -> None:
    most = MOST_PAGES if may else MOST_READERS
    pages = [opened(console.token if may else "") for _ in range(most + 5)]
    # A page of the test before may still be open at first.
    assert sum(not page.refused for page in pages) <= most
    assert pages[-1].refused
    # The others still have room, and STOP needs no page.
    wait_until(lambda: not opened("" if may else console.token).refused)
    assert console.request("POST", "/command", {**STOP, "run": None})[0] == 200


def test_a_run_takes_a_stop_once(console: Served, page: Page) -> None:
    where = console.place
    where.run(where.sequence("replayed", 30.0), "--yes", "--realtime")
    key = None
    while True:
        state = page.read().get("state", {})
        key = state.get("run") or key
        if (state.get("status") or {}).get("phase") == "excite":
            break
    content = {"page": page.key, "number": 9, "command": "stop", "run": key}
    status, text, _ = console.request("POST", "/command", content)
    assert (status, json.loads(text)["words"]) == (200, "taken")
    # Sent again, because its answer was lost, it is no second press.
    assert console.request("POST", "/command", content)[:2] == (200, text)
    while not (page.read().get("state", {}).get("status") or {}).get("ended"):
        pass
    where.started[-1].wait(60)
    (record,) = where.records()
    assert (record["state"], record["de_energised"]) == ("stopped", True)
    assert "STOP by the console, page" in record["message"]


def test_a_stop_sent_again_while_it_is_carried_out_is_one_press() -> None:
    async def pressing() -> tuple[list[int], int]:
        hub = SimpleNamespace(controls=Controls())
        page, token = hub.controls.open(), Token()
        go, taken = asyncio.Event(), 0

        async def act(*_: object) -> dict[str, Any]:
            nonlocal taken
            taken += 1
            await go.wait()
            if taken == 1:
                raise Refusal("not taken")
            return {"words": "taken"}

        async def body() -> AsyncIterator[bytes]:
            yield json.dumps({"page": page.key, "number": 7, "command": "stop"}).encode()

        def press() -> asyncio.Task[Any]:
            headers = {
                "authorization": f"Bearer {token.text}",
                "content-type": "application/json",
            }
            request = SimpleNamespace(headers=headers, stream=body)
            return asyncio.ensure_future(endpoint(request))

        me = SimpleNamespace(_hub=hub, _token=token)
        endpoint: Any = Console._posted(me, act)  # type: ignore[arg-type]
        answers = []
        # A run that did not take it gets it again.
        for _ in range(2):
            pressed = [press() for _ in range(3)]
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            go.set()
            answers += [answer.status_code for answer in await asyncio.gather(*pressed)]
        return answers, taken

    assert asyncio.run(pressing()) == ([409] * 3 + [200] * 3, 2)


def test_stop_reaches_a_jog(console: Served, page: Page) -> None:
    where = console.place
    where.command("jog", "practical", "--to", "20", "--speed", "0.2", "--realtime")
    names: list[str] = []
    while names != ["jog on practical"]:
        state = page.read().get("state", {})
        names = [each["name"] for each in state.get("moving", [])]
    content = {"page": page.key, "number": 99, "command": "stop"}
    status, text, _ = console.request("POST", "/command", content)
    assert (status, json.loads(text)["words"]) == (200, "jog on practical")
    assert where.started[-1].wait(60) == STOPPED
    while names:
        names = page.read().get("state", {}).get("moving", names)
