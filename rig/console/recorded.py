"""Serves the list of runs in the folder of this console, and the pages in these run folders."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any, Final

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from rig.common.errors import InputError
from rig.results.catalogue.show import PAGES
from rig.results.catalogue.words import begun, masses, operators, state, verdict
from rig.runs.catalogue.entry import Entry
from rig.runs.catalogue.index import list_runs

SHOWN: Final = 30
"""Greatest number of runs in the list; the list has the latest runs."""
_FRESH_S: Final = 3.0
"""Time for which a list is reused, s."""
_KINDS: Final = {".html": "text/html; charset=utf-8", ".pdf": "application/pdf"}
_POLICY: Final = (
    "sandbox allow-popups; default-src 'none'; style-src 'unsafe-inline'; img-src data:"
)
"""Content security policy of a page from a run folder: the page may show its own pictures, but
cannot run scripts or load other content.
"""


class Recorded:
    """Lists the runs of a folder, and serves the pages in the run folders, read only.

    Args:
        root: The folder.
    """

    def __init__(self, root: Path) -> None:
        self._root = root
        self._held = asyncio.Lock()
        self._made: dict[str, Any] = {}
        self._made_s = -_FRESH_S
        self._folders: frozenset[str] = frozenset()
        self.routes = [
            Route("/recorded", self._list, methods=["GET"]),
            Route("/recorded/{path:path}", self._page, methods=["GET"]),
        ]

    async def _list(self, request: Request) -> Response:
        # One list at a time, however many pages ask; the folders are read beside the event loop.
        async with self._held:
            if time.monotonic() - self._made_s >= _FRESH_S:
                self._made = await asyncio.to_thread(self._read)
                self._made_s = time.monotonic()
        return JSONResponse(self._made)

    def _read(self) -> dict[str, Any]:
        entries: list[Entry] = []
        problem = ""
        if self._root.is_dir():
            try:
                entries = list_runs(self._root, details=False).entries
            except (InputError, OSError) as error:
                problem = str(error)
        self._folders = frozenset(entry.folder for entry in entries)
        latest = entries[: -SHOWN - 1 : -1]
        return {
            "root": str(self._root.absolute()),
            "count": len(entries),
            "problem": problem,
            "runs": [self._row(entry) for entry in latest],
        }

    def _row(self, entry: Entry) -> dict[str, Any]:
        head, folder = entry.head, self._root / entry.folder
        return {
            "folder": entry.folder,
            "begun": begun(head),
            "bench": head.bench + ("" if head.simulated in (True, None) else " (REAL)"),
            "sequence": head.sequence,
            "operator": operators(head),
            "masses": masses(head),
            "state": state(self._root, entry),
            "verdict": verdict(head),
            "problem": head.problem,
            "pages": [each for each in PAGES if (folder / each[0]).is_file()],
        }

    async def _page(self, request: Request) -> Response:
        path = str(request.path_params["path"])
        # The longest fitting name, because the page of a diagnosis has the name of another page, in
        # a folder of its own.
        fitting = [name for name, _ in PAGES if path.endswith(f"/{name}")]
        name = max(fitting, key=len, default="")
        folder = path.removesuffix(f"/{name}") or "."
        if not name or folder not in self._folders:
            return Response("no such page", status_code=404, media_type="text/plain")
        try:
            content = await asyncio.to_thread((self._root / folder / name).read_bytes)
        except OSError as error:
            words = f"{name}: {error.strerror}"
            return Response(words, status_code=404, media_type="text/plain")
        headers = {"Content-Security-Policy": _POLICY}
        if name.endswith(".pdf"):
            # A browser's own viewer does not work in the sandbox.
            headers["Content-Disposition"] = f'attachment; filename="{name}"'
        return Response(content, media_type=_KINDS[Path(name).suffix], headers=headers)
