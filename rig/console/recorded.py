"""Serves the list of runs in the folder of this console, and the pages in these run folders."""

from __future__ import annotations

import asyncio
import glob
import json
import secrets
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from rig.common.errors import InputError
from rig.console.gate import RUN_SANDBOX, SANDBOX
from rig.console.hub import Refusal
from rig.console.starting import output_of
from rig.results.catalogue.listing import PAGES, cells
from rig.results.document import PAGE_FILE
from rig.results.run.report import REPORT_FILE
from rig.runs.catalogue.entry import Entry, Wanted, chosen, latest
from rig.runs.catalogue.index import list_runs

SHOWN: Final = 30
MOST_SHOWN: Final = 300
_FRESH_S: Final = 3.0  # time for which a list is reused, s
_HTML: Final = "text/html; charset=utf-8"


@dataclass(frozen=True)
class Choice:
    """Which of the recorded runs are listed."""

    bench: str = ""
    last: int = SHOWN

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> Choice:
        """Return the choice that a query or message states; ValueError if it is not valid."""
        bench, last = given.get("bench", ""), given.get("last", SHOWN)
        last = int(last) if isinstance(last, str) and len(last) < 10 else last
        if not isinstance(bench, str) or type(last) is not int or not 0 < last <= MOST_SHOWN:
            raise ValueError(f"bench must be a text, last a whole number from 1 to {MOST_SHOWN}")
        return cls(bench, last)

    @property
    def pattern(self) -> str | None:
        """The bench in the form that `rig runs` accepts, or None for every bench."""
        return glob.escape(self.bench) if self.bench else None


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

    async def known(self) -> Sequence[Entry]:
        """Return the runs of the last list, the earliest first; reads the folder without one."""
        if self._read_s < 0.0:
            await self._refresh()
        return self._entries

    async def constants(self, choice: Choice) -> list[str]:
        """Return the names of the constants of the runs that a choice selects."""
        entries = self._chosen(await self.known(), choice)
        return await asyncio.to_thread(self._constants, entries)

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
        if self.root.is_dir():
            try:
                entries = list_runs(self.root).entries
            except (InputError, OSError) as error:
                problem = str(error)
        self._entries, self._problem = entries, problem
        self._folders = frozenset(entry.folder for entry in entries)

    def _chosen(self, entries: Sequence[Entry], choice: Choice) -> Sequence[Entry]:
        if choice.pattern is not None:
            entries = chosen(self.root, entries, Wanted(bench=choice.pattern))
        return latest(entries, choice.last)

    def _constants(self, entries: Sequence[Entry]) -> list[str]:
        known = [entry.parsed() for entry in entries if entry.head.identified]
        return list(dict.fromkeys(name for details in known for name in details.constants))

    def _listed(self, choice: Choice) -> str:
        """Return the list as JSON in ASCII, whose escapes also encode names that are no Unicode."""
        everything = self._entries
        listed = self._chosen(everything, choice)
        benches = {entry.head.bench for entry in everything} - {""}
        found = {
            "root": str(self.root.absolute()),
            "count": len(everything),
            "problem": self._problem,
            "benches": sorted(benches),
            "constants": self._constants(listed),
            "runs": [self._row(entry) for entry in reversed(listed)],
        }
        return json.dumps(found)

    def _row(self, entry: Entry) -> dict[str, Any]:
        head, folder = entry.head, self.root / entry.folder
        known = cells(self.root, entry)
        return {
            "folder": entry.folder,
            "cells": list(known.values())[1:],
            "verdict": known["verdict"],
            "problem": head.problem,
            "identified": bool(head.identified),
            "comparable": head.kind == "run" and head.state != "running",
            "pages": [each for each in PAGES if (folder / each[0]).is_file()],
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
        return Response(content, media_type=_HTML, headers=headers)


MOST_COMPARED: Final = 6
"""Greatest number of runs in a comparison: the number of colours of the figure."""
KEPT: Final = 12
MAKE_S: Final = 180.0  # longest time, s, in which a page must be made
NICE = 10  # increase of the niceness of the process that makes a page
_SHOWN: Final = 2000


class Made:
    """Makes pages of recorded runs, one at a time, and serves the pages, read only."""

    def __init__(self, recorded: Recorded, command: Sequence[str]) -> None:
        self._recorded = recorded
        self._command = command
        self._pages: dict[str, bytes] = {}
        self._busy = asyncio.Lock()
        self.routes = [Route("/made/{key}", self._page, methods=["GET"])]

    async def compare(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Compare runs of the list (folders) with the earliest; return the address of the page."""
        given = message.get("runs")
        if not isinstance(given, list) or not all(isinstance(name, str) for name in given):
            raise Refusal("runs must be a list of folders")
        wanted = set(given)
        if not 2 <= len(wanted) <= MOST_COMPARED:
            raise Refusal(f"choose 2 to {MOST_COMPARED} runs (got {len(wanted)})")
        # Only folders in the list are opened, in the order of the list, which is that of time.
        folders = [e.folder for e in await self._recorded.known() if e.folder in wanted]
        unknown = wanted.difference(folders)
        if unknown:
            raise Refusal(f"{min(unknown)}: not in the list of runs; read the list again")
        runs = [str(self._recorded.root / folder) for folder in folders]
        return await self._make(f"Comparison of {', '.join(folders)}", "compare", "--", *runs)

    async def trend(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Follow one ``constant`` over listed runs; return the address of the page."""
        constant = message.get("constant")
        try:
            choice = Choice.of(message)
        except ValueError as error:
            raise Refusal(str(error)) from error
        if constant not in await self._recorded.constants(choice):
            raise Refusal(f"{str(constant)[:100]}: no listed run has this constant")
        options = [f"--constant={constant}", f"--last={choice.last}"]
        options += [f"--bench={choice.pattern}"] if choice.pattern is not None else []
        bench = f" on {choice.bench}" if choice.bench else ""
        name = f"Trend of {constant} over the latest {choice.last} runs{bench}"
        return await self._make(name, "trend", *options, "--", str(self._recorded.root))

    async def _make(self, name: str, *arguments: str) -> dict[str, Any]:
        if self._busy.locked():
            raise Refusal("another page is being made; try again in a few seconds")
        async with self._busy:
            with tempfile.TemporaryDirectory(prefix="loadrig-console-") as out:
                await self._run(arguments[0], "--out", out, *arguments[1:])
                try:
                    content = await asyncio.to_thread((Path(out) / PAGE_FILE).read_bytes)
                except OSError as error:
                    raise Refusal(f"no page was made: {error.strerror}; try again") from error
        key = secrets.token_urlsafe(16)
        self._pages[key] = content
        for old in list(self._pages)[:-KEPT]:
            del self._pages[old]
        return {"words": name, "page": f"/made/{key}"}

    async def _run(self, *arguments: str) -> None:
        """Run a command of ``rig runs``; Refusal if it fails, or takes too long."""
        try:
            status, words = await output_of([*self._command, "runs", *arguments], MAKE_S, NICE)
        except TimeoutError as error:
            raise Refusal(
                f"the page took more than {MAKE_S:g} s; choose fewer runs, or use `rig runs` in a "
                "terminal"
            ) from error
        except (ValueError, OSError) as error:
            raise Refusal(f"the page cannot be made: {error}") from error
        if status != 0:
            raise Refusal(words.strip()[-_SHOWN:])

    async def _page(self, request: Request) -> Response:
        content = self._pages.get(request.path_params["key"])
        if content is None:
            words = f"no such page; only the latest {KEPT} pages are kept: make the page again"
            return Response(words, status_code=404, media_type="text/plain")
        policy = {"Content-Security-Policy": SANDBOX}
        return Response(content, media_type=_HTML, headers=policy)
