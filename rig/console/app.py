"""HTTP and WebSocket routes of the console, and its list of recorded runs.

A reading request needs no token. A command is a POST request with the token in its header and JSON
as its content; the JSON contains the number of the command, which increases with each command of a
page.
"""

from __future__ import annotations

import asyncio
import glob
import json
import math
import os
import socket
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from rig.common.errors import InputError
from rig.common.places import is_file
from rig.console.followed import Followed
from rig.console.gate import (
    BURST,
    MOST_GREETING,
    QUEUE,
    RUN_SANDBOX,
    SANDBOX,
    Gate,
    Token,
    bounded,
)
from rig.console.hub import Hub, Page, Refusal
from rig.console.starting import Starter, StartError, Wish
from rig.results.catalogue.listing import PAGES, cells
from rig.results.run.report import REPORT_FILE
from rig.results.run.report import STATIC as SHARED
from rig.runs.catalogue.entry import Entry, Wanted, chosen, latest
from rig.runs.catalogue.index import list_runs
from rig.terminal.control_socket import Command

_HEAD: Final = struct.Struct("<I")
SHOWN: Final = 30
MOST_SHOWN: Final = 300
_FRESH_S: Final = 3.0  # time for which a list is reused, s


class View:
    """Record of what one page has received."""

    def __init__(self, hub: Hub, page: Page) -> None:
        self._hub = hub
        self._page = page
        self._sent: dict[str, object] = {}
        self._events = self._notes = 0
        self._run: str | None = None
        self._level: tuple[int, float] | None = None
        self._next = 0
        self._latest_s = 0.0
        self._points = (0, 0)

    def state(self) -> dict[str, Any]:
        """Return the parts of the state that changed since the last message."""
        hub, page = self._hub, self._page
        run = hub.run_of(page)
        key = None if run is None else run.key
        if key != self._run:
            self._run, self._events, self._level, self._points = key, 0, None, (0, 0)
            self._sent.clear()
        holder = hub.controls.holder
        parts: dict[str, tuple[object, Any]] = {
            "runs": _same([_listed(each) for each in hub.runs.values()]),
            "controls": _same(
                {
                    "holder": None if holder is None else holder.name,
                    "yours": holder is page,
                    "may": page.may,
                }
            ),
            "moving": _same(
                [
                    {
                        "key": each.key,
                        "name": program_words(each.about),
                        "stopping": bool(each.status and each.status["stopping"]),
                    }
                    for each in hub.moving
                ]
            ),
            "scope": _same(hub.scope),
            "choices": (0, hub.starter.choices),
            "run": (key, key),
            "own": _same(page.own and page.run is None),
        }
        if run is not None:
            parts |= run.parts()
        changed = {}
        for name, (version, value) in parts.items():
            if name not in self._sent or self._sent[name] != version:
                self._sent[name] = version
                changed[name] = value
        self._add_new(changed, run)
        return changed

    def _add_new(self, changed: dict[str, Any], run: Followed | None) -> None:
        if notes := [words for number, words in self._hub.notes if number > self._notes]:
            changed["notes"] = notes
            self._notes = self._hub.notes[-1][0]
        if run is None:
            return
        if run.events and run.events[-1][0] > self._events:
            changed["events"] = [words for number, words in run.events if number > self._events]
            self._events = run.events[-1][0]
        version, count = self._points
        found = run.torque_speed
        if version != found.version:
            version, count = found.version, 0
        if len(found.points) > count or self._points != (version, count):
            changed["points"] = {"from": count, "rows": np.round(found.points[count:], 3).tolist()}
        self._points = (version, len(found.points))

    def charts(self) -> bytes | None:
        """Return the new intervals of the charts, or None if there are none.

        The message contains the length of a JSON header, the header, and for each channel the
        minima and the maxima as 32-bit floats. The last interval of each message is sent again with
        the next message, because the interval may have been incomplete.
        """
        run = self._hub.run_of(self._page)
        if run is None or run.key != self._run:
            return None
        decimation, page = run.decimation, self._page
        # If the recording is shorter than the window, it fills the whole chart.
        window_s = min(page.window_s or math.inf, max(decimation.latest_s, 1.0))
        level = decimation.level(window_s, page.pixels)
        fresh = self._level != (level, page.window_s)
        if fresh:
            interval_s = decimation.interval_s(level)
            self._next = max(0, int((decimation.latest_s - window_s) / interval_s))
        found = decimation.since(level, self._next)
        count = found.low.shape[1]
        if not count or (not fresh and decimation.latest_s == self._latest_s):
            return None
        self._level, self._latest_s = (level, page.window_s), decimation.latest_s
        self._next = found.first + count - 1
        head = json.dumps(
            {
                "run": run.key,
                "fresh": fresh,
                "interval_s": decimation.interval_s(level),
                "first": found.first,
                "count": count,
                "latest_s": decimation.latest_s,
                "continued_s": run.continued_s,
            }
        ).encode()
        head += b" " * (-len(head) % 4)
        values = np.stack([found.low, found.high], axis=1).astype("<f4")
        return _HEAD.pack(len(head)) + head + values.tobytes()


def program_words(about: Mapping[str, Any]) -> str:
    """Return the name of a program in progress, and its bench."""
    return f"{about['name']} on {about['bench']}"


def _listed(run: Followed) -> dict[str, Any]:
    about = run.about
    return {
        "key": run.key,
        "name": about["name"],
        "bench": about["bench"],
        "real": about["real"],
        "over": run.over,
        "ended": bool(run.status and run.status["ended"]),
        "folder": run.folder.name,
        "begun": run.begun,
    }


def _same(value: Any) -> tuple[object, Any]:
    """Return a part whose value also serves as its version, because the value is small."""
    return value, value


STATIC: Final = (Path(__file__).parent / "static", SHARED)
LONGEST_BODY: Final = 8192
HELLO_S: Final = 5.0  # time for the first message of a WebSocket, which has the token, s
LONGEST_YIELD_S: Final = 0.2  # longest time for which the messages to pages wait for a command, s
_KINDS: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".txt": "text/plain; charset=utf-8",
    ".svg": "image/svg+xml",
}
_PUSH_EVERY: Final = 2
_COMMANDS: Final = {command.value: command for command in Command}
_LONGEST_WINDOW_S: Final = 86_400.0


@dataclass(frozen=True)
class Choice:
    """Which of the recorded runs are listed."""

    bench: str = ""
    last: int = SHOWN

    @classmethod
    def of(cls, given: Mapping[str, str]) -> Choice:
        """Return the choice that a query states; ValueError if it is not valid."""
        last = given.get("last", str(SHOWN))
        if not last.isdecimal() or len(last) > 9 or not 0 < int(last) <= MOST_SHOWN:
            raise ValueError(f"last must be a whole number from 1 to {MOST_SHOWN}")
        return cls(given.get("bench", ""), int(last))


class Recorded:
    """Lists the runs of a folder, and serves the pages in the run folders, read only."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self._held, self._listing = asyncio.Lock(), asyncio.Lock()
        self._lists: dict[Choice, str] = {}
        self._listed_s = -_FRESH_S
        self._entries: Sequence[Entry] = ()
        self._problem = ""
        self._read_s = -_FRESH_S
        self._folders: frozenset[str] = frozenset()
        self.routes = [
            Route("/recorded", self._list, methods=["GET"]),
            Route("/recorded/{path:path}", self._page, methods=["GET"]),
        ]

    async def _list(self, request: Request) -> Response:
        try:
            choice = Choice.of(request.query_params)
        except ValueError as error:
            return Response(str(error), status_code=400, media_type="text/plain")
        await self._refresh()
        async with self._listing:
            # One list is made at a time, and a fresh one is used again: pages without the token
            # must not take the processor from a command.
            if self._listed_s != self._read_s:
                self._lists, self._listed_s = {}, self._read_s
            if choice not in self._lists:
                self._lists[choice] = await asyncio.to_thread(self._listed, choice)
            listed = self._lists[choice]
        return Response(listed, media_type="application/json")

    async def _refresh(self) -> None:
        # Only one list is read at a time, for all pages; the folders are read in a thread.
        async with self._held:
            if time.monotonic() - self._read_s >= _FRESH_S:
                await asyncio.to_thread(self._read)
                self._read_s = time.monotonic()

    def _read(self) -> None:
        entries: list[Entry] = []
        problem = ""
        try:
            entries = list_runs(self.root).entries if self.root.is_dir() else []
        except (InputError, OSError) as error:
            problem = str(error)
        self._entries, self._problem = entries, problem
        self._folders = frozenset(entry.folder for entry in entries)

    def _listed(self, choice: Choice) -> str:
        """Return the list as JSON in ASCII, whose escapes also encode names that are no Unicode."""
        everything = self._entries
        wanted: Sequence[Entry] = everything
        if choice.bench:
            wanted = chosen(self.root, everything, Wanted(bench=glob.escape(choice.bench)))
        benches = {entry.head.bench for entry in everything} - {""}
        found = {
            "root": os.path.abspath(self.root),
            "count": len(everything),
            "problem": self._problem,
            "benches": sorted(benches),
            "runs": [self._row(entry) for entry in reversed(latest(wanted, choice.last))],
        }
        return json.dumps(found)

    def _row(self, entry: Entry) -> dict[str, Any]:
        folder = self.root / entry.folder
        known = cells(self.root, entry)
        return {
            "folder": entry.folder,
            "cells": list(known.values())[1:],
            "verdict": known["verdict"],
            "problem": entry.head.problem,
            "pages": [each for each in PAGES if is_file(folder / each[0])],
        }

    async def _page(self, request: Request) -> Response:
        path = str(request.path_params["path"])
        # The longest fitting name is used, because the name of a diagnosis page, in its folder,
        # ends with the name of another page.
        fitting = [name for name, _ in PAGES if path.endswith(f"/{name}")]
        name = max(fitting, key=len, default="")
        folder = path.removesuffix(f"/{name}") or "."
        if not name or folder not in self._folders:
            return Response("no such page", status_code=404, media_type="text/plain")
        try:
            content = await asyncio.to_thread((self.root / folder / name).read_bytes)
        except OSError as error:
            words = f"{name}: {error.strerror}"
            return Response(words, status_code=404, media_type="text/plain")
        policy = RUN_SANDBOX if name == REPORT_FILE else SANDBOX
        headers = {"Content-Security-Policy": policy}
        return Response(content, media_type=_KINDS[".html"], headers=headers)


class Console:
    """The web application of the console."""

    def __init__(self, hub: Hub, token: Token, hosts: frozenset[str]) -> None:
        self.broken: Callable[[], None] = lambda: None
        self.failure: BaseException | None = None
        self._hub = hub
        self._token = token
        self._greeting = self._commands = 0
        self._turn, self._calm = asyncio.Lock(), asyncio.Event()
        self._files = {
            path.name: (path.read_bytes(), _KINDS[path.suffix])
            for folder in STATIC
            for path in folder.iterdir()
            if path.suffix in _KINDS
        }
        recorded = Recorded(hub.starter.runs)
        self.app = Starlette(
            routes=[
                Route("/", self._static, methods=["GET"]),
                Route("/static/{name}", self._static, methods=["GET"]),
                Route("/command", self._posted(self._command), methods=["POST"]),
                Route("/off", self._posted(self._off), methods=["POST"]),
                Route("/controls", self._posted(self._controls), methods=["POST"]),
                Route("/dry-run", self._posted(self._dry_run), methods=["POST"]),
                Route("/start", self._posted(self._start), methods=["POST"]),
                Route("/resume", self._posted(self._resume), methods=["POST"]),
                WebSocketRoute("/live", self._live),
                *recorded.routes,
            ],
            middleware=[Middleware(Gate, hosts=hosts)],
            lifespan=self._lifespan,
        )

    @asynccontextmanager
    async def _lifespan(self, app: Starlette) -> AsyncIterator[None]:
        following = asyncio.create_task(self._hub.follow())
        following.add_done_callback(self._ended)
        yield
        following.cancel()
        await asyncio.wait([following])

    def _ended(self, following: asyncio.Task[None]) -> None:
        if not following.cancelled():
            self.failure = following.exception()
            self.broken()

    async def _static(self, request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if name not in self._files:
            return _refused(404, "no such file")
        content, kind = self._files[name]
        return Response(content, media_type=kind)

    def _posted(
        self, act: Callable[[Page | None, Mapping[str, Any]], Awaitable[dict[str, Any]]]
    ) -> Callable[[Request], Awaitable[Response]]:
        """Return the endpoint of a command: checks token, content, number, then ``act``."""

        async def endpoint(request: Request) -> Response:
            scheme, _, given = request.headers.get("authorization", "").partition(" ")
            if scheme != "Bearer" or not self._token.fits(given):
                return _refused(
                    401,
                    "this page is read-only: its token is missing or belongs "
                    "to another start of the console; open the address that the console printed",
                )
            kind = request.headers.get("content-type", "").partition(";")[0].strip()
            if kind != "application/json":
                return _refused(415, "a command must be JSON, with Content-Type application/json")
            body = b""
            async for part in request.stream():
                body += part
                if len(body) > LONGEST_BODY:
                    return _refused(413, f"the command is longer than {LONGEST_BODY} bytes")
            try:
                message = json.loads(body)
                page_key, number = message.pop("page"), message.pop("number")
            except (ValueError, KeyError, AttributeError, TypeError, RecursionError):
                return _refused(
                    400,
                    "the request is not a command: it must be JSON with the fields page and number",
                )
            if not isinstance(page_key, str) or type(number) is not int:
                return _refused(400, "page must be a text, number a whole number")
            page = self._hub.controls.page(page_key)
            stop = message.get("command") == Command.STOP.value
            replayed = page is not None and self._hub.controls.replayed(page, number)
            if replayed and not stop:
                return _refused(409, "this command was already received")
            try:
                if page is None or not stop:
                    return _json(await act(page, message))
                before, sending = page.stop
                # A second order of the same STOP would be a second press of the button, but a STOP
                # that the run did not take is sent to it again.
                if sending is None or before != number or _failed(sending):
                    sending = asyncio.ensure_future(act(page, message))
                    page.stop = number, sending
                return _json(await asyncio.shield(sending))
            except Refusal as error:
                return _json({"words": str(error), **error.details}, 409)
            except StartError as error:
                return _refused(409, str(error))

        return endpoint

    async def _command(self, page: Page | None, message: Mapping[str, Any]) -> dict[str, Any]:
        """Send a command; meanwhile the messages to pages wait."""
        self._commands += 1
        self._calm.clear()
        try:
            return await self._sent(page, message)
        finally:
            self._commands -= 1
            if not self._commands:
                self._calm.set()

    async def _sent(self, page: Page | None, message: Mapping[str, Any]) -> dict[str, Any]:
        """Send a command to a run; `stop` needs neither controls nor page nor run."""
        command = _COMMANDS.get(str(message.get("command")))
        if command is None:
            raise Refusal(f"unknown command; known are {', '.join(_COMMANDS)}")
        if command is not Command.STOP:
            self._require_controls(page)
        prompt, text = message.get("prompt", 0), message.get("text", "")
        if type(prompt) is not int or not isinstance(text, str):
            raise Refusal("prompt must be a whole number, text a text")
        who = f"the console, {page.name}" if page is not None else "the console"
        if command is Command.STOP and message.get("run") is None:
            return await self._stop(page, who)
        key = str(message.get("run"))
        if page is not None:
            self._hub.claim(page, key)
        words = await self._hub.command(key, command, who, prompt, text)
        return {"words": words}

    async def _stop(self, page: Page | None, who: str) -> dict[str, Any]:
        shown = None if page is None else self._hub.run_of(page)
        sent, failed = await self._hub.stop(who)
        runs = [each.key for each in sent if each.key in self._hub.runs]
        if page is not None and runs:
            mine = shown is not None and shown.key in runs
            if not mine:
                page.run = None
            self._hub.claim(page, shown.key if shown is not None and mine else runs[0])
        names = [program_words(each.about) for each in sent]
        if failed:
            words = "; ".join(
                f"{name}: {failed[each.key]}"
                for each, name in zip(sent, names, strict=True)
                if each.key in failed
            )
            raise Refusal(words, unconfirmed=list(failed))
        if unheard := self._hub.unheard:
            late = f"{unheard} more, which connects to a bench or hangs, does not answer"
            remedy = "stop it at its terminal, or with `rig off BENCH`"
            raise Refusal(f"{', '.join([*names, late])}: {remedy}", unconfirmed=[])
        return {"words": ", ".join(names), "stopped": [each.key for each in sent]}

    async def _off(self, page: Page | None, message: Mapping[str, Any]) -> dict[str, Any]:
        """Make a bench safe, as `rig off`; it only takes power off, so that any page may."""
        bench = message.get("bench")
        known = {str(run.about["bench_file"]) for run in self._hub.runs.values()}
        if not isinstance(bench, str) or bench not in known | set(self._hub.starter.benches):
            raise Refusal("this bench is unknown; choose a bench that the page lists")
        return await self._hub.starter.off(bench)

    async def _controls(self, page: Page | None, message: Mapping[str, Any]) -> dict[str, Any]:
        if page is None:
            raise Refusal("this page is not connected to the console; wait until it is connected")
        before = self._hub.controls.holder
        self._hub.controls.holder = page
        if before is not None and before is not page:
            self._hub.note(f"{page.name} took the controls from {before.name}")
        return {"words": "This page now holds the controls"}

    async def _dry_run(self, page: Page | None, message: Mapping[str, Any]) -> dict[str, Any]:
        self._require_controls(page)
        return await self._hub.starter.dry_run(Wish.of(message))

    async def _start(self, page: Page | None, message: Mapping[str, Any]) -> dict[str, Any]:
        self._require_controls(page)
        typed = str(message.get("typed_bench", ""))
        folder = self._hub.starter.start(str(message.get("shown")), typed)
        assert page is not None
        self._hub.follow_up(page, Path(os.path.abspath(folder)))
        return {"words": f"The run was started; its folder is {folder}"}

    async def _resume(self, page: Page | None, message: Mapping[str, Any]) -> dict[str, Any]:
        self._require_controls(page)
        run = self._hub.runs.get(str(message.get("run")))
        if run is None or not run.over:
            raise Refusal("this run is unknown or has not ended; choose a run that has ended")
        if not run.closed:
            raise Refusal(
                "the program of this run is still writing the page of the run; wait a few seconds"
            )
        typed, operator = str(message.get("typed_bench", "")), str(message.get("operator", ""))
        self._hub.starter.resume(run.about, typed, operator)
        assert page is not None
        self._hub.follow_up(page, run.folder)
        return {"words": "Started again: the run continues at its first unfinished stage"}

    def _require_controls(self, page: Page | None) -> None:
        holder = self._hub.controls.holder
        if page is None or page is not holder:
            who = "no page" if holder is None else holder.name
            raise Refusal(f"{who} holds the controls; take the controls first")

    async def _live(self, socket: WebSocket) -> None:
        if self._greeting >= MOST_GREETING:
            await socket.close(1013)
            return
        self._greeting += 1
        try:
            await socket.accept()
            hello = await asyncio.wait_for(socket.receive_json(), HELLO_S)
            may = self._token.fits(str(hello.get("token", "")))
        except (WebSocketDisconnect, TimeoutError, ValueError, KeyError, AttributeError):
            with suppress(RuntimeError, WebSocketDisconnect):
                await socket.close(1008, "a page must send its token first")
            return
        finally:
            self._greeting -= 1
        if not self._hub.controls.room(may):
            with suppress(RuntimeError, WebSocketDisconnect):
                await socket.close(1013, "too many pages are open; close a page")
            return
        page = self._hub.controls.open()
        self._hub.keep(page, hello.get("shown"), hello.get("own"))
        if may:
            self._hub.controls.admit(page)
        reading = asyncio.create_task(_read_views(socket, page))
        try:
            with suppress(WebSocketDisconnect):
                await _send(socket, {"hello": {"page": page.key, "name": page.name}})
                await self._push(socket, page, reading)
        finally:
            reading.cancel()
            await asyncio.wait([reading])
            self._hub.controls.close(page)

    async def _push(self, socket: WebSocket, page: Page, reading: asyncio.Task[None]) -> None:
        """Send state and charts to a page every few ticks, without delay by other pages."""
        view = View(self._hub, page)
        while not reading.done():
            async with self._turn:
                # Requests are read between two pages, and a command goes before the next page.
                await asyncio.sleep(0)
                if self._commands:
                    with suppress(TimeoutError):
                        await asyncio.wait_for(self._calm.wait(), LONGEST_YIELD_S)
                state, charts = {"state": view.state()}, view.charts()
            await _send(socket, state)
            if charts is not None:
                await socket.send_bytes(charts)
            for _ in range(_PUSH_EVERY):
                await self._hub.ticked.wait()


async def _read_views(socket: WebSocket, page: Page) -> None:
    """Read which run and charts a page requests, until it is closed or sends an invalid message."""
    while True:
        try:
            message = dict(await socket.receive_json())
        except (WebSocketDisconnect, ValueError, KeyError, TypeError):
            return
        run, window_s, pixels = message.get("run"), message.get("window_s"), message.get("pixels")
        chosen = run if isinstance(run, str) else None
        if chosen is None and page.run is not None:
            page.kept, page.own = None, False
        page.run = chosen
        if isinstance(window_s, int | float) and 0 <= window_s <= _LONGEST_WINDOW_S:
            page.window_s = float(window_s)
        if type(pixels) is int and 0 < pixels <= 4096:
            page.pixels = pixels


def _failed(task: asyncio.Future[Any]) -> bool:
    return task.done() and (task.cancelled() or task.exception() is not None)


def _refused(status: int, words: str) -> Response:
    return _json({"words": words}, status)


def _json(content: Mapping[str, Any], status: int = 200) -> Response:
    """Return an answer as JSON in ASCII; escapes also encode text that is not valid Unicode."""
    return Response(json.dumps(content), status, media_type="application/json")


async def _send(socket: WebSocket, message: Mapping[str, Any]) -> None:
    """Send JSON in ASCII, whose escapes can also encode text that is not valid Unicode."""
    await socket.send_text(json.dumps(message))


HOST = "127.0.0.1"


def serve(
    starter: Starter, only: frozenset[str], port: int, announce: Callable[[str], None]
) -> None:
    """Serve the console until SIGINT or SIGTERM."""
    try:
        hub = Hub(starter, only)
    except OSError as error:
        raise InputError(f"the console cannot reach programs: {error}") from error
    with _listening(port) as listener:
        port = listener.getsockname()[1]
        token = Token()
        hosts = frozenset({f"{HOST}:{port}", f"localhost:{port}"})
        console = Console(hub, token, hosts)
        config = uvicorn.Config(
            console.app,
            log_level="warning",
            access_log=False,
            ws="wsproto",
            http=bounded(),
            backlog=BURST,
            loop="asyncio",
            timeout_graceful_shutdown=1,
            server_header=False,
            date_header=False,
        )
        announce(f"http://{HOST}:{port}/#token={token.text}")
        server = _Server(config)

        def end() -> None:
            server.should_exit = True

        console.broken = end
        server.run(sockets=[listener])
        if console.failure is not None:
            raise console.failure


class _Server(uvicorn.Server):
    """Server whose queue in the system is longer than the burst that it accepts at once."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for listener in sockets or ():
            listener.listen(QUEUE)


def _listening(port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((HOST, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise InputError(
            f"port {port}: {error.strerror}; another console may use this port; give --port 0 "
            "for a free port"
        ) from error
    return listener
