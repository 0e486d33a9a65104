"""Serves the list of runs in the folder of this console, and the pages in these run folders."""

from __future__ import annotations

import asyncio
import glob
import json
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
from rig.results.catalogue.listing import PAGES, cells
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
    def of(cls, given: Mapping[str, str]) -> Choice:
        """Return the choice that a query states; ValueError if it is not valid."""
        last = given.get("last", str(SHOWN))
        if not last.isdecimal() or len(last) > 9 or not 0 < int(last) <= MOST_SHOWN:
            raise ValueError(f"last must be a whole number from 1 to {MOST_SHOWN}")
        return cls(given.get("bench", ""), int(last))

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
            "runs": [self._row(entry) for entry in reversed(listed)],
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
