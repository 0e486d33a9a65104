"""Makes pages of recorded runs on request: comparisons and trends.

`rig runs compare` and `rig runs trend` make the pages, in a separate process with a low priority,
so that neither the control loop of a run nor STOP waits for a page.
"""

from __future__ import annotations

import asyncio
import os
import secrets
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from rig.console.gate import SANDBOX
from rig.console.hub import Refusal
from rig.console.recorded import Choice, Recorded
from rig.results.files import PAGE_FILE

MOST_COMPARED: Final = 6
"""Greatest number of runs in a comparison: the number of colours of the figure."""
KEPT: Final = 12
"""Number of the latest pages that are kept."""
MAKE_S: Final = 180.0
"""Longest time, s, in which a page must be made."""
NICE = 10
"""Increase of the niceness of the process that makes a page."""
_SHOWN: Final = 2000
"""Number of characters of an error message that are shown."""


class Made:
    """Makes pages of recorded runs, one at a time, and serves the pages, read only.

    Args:
        recorded: The runs.
        command: Start of the command line of ``rig``.
    """

    def __init__(self, recorded: Recorded, command: Sequence[str]) -> None:
        self._recorded = recorded
        self._command = command
        self._pages: dict[str, bytes] = {}
        self._busy = asyncio.Lock()
        self.routes = [Route("/made/{key}", self._page, methods=["GET"])]

    async def compare(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """Compare runs of the list with the earliest of these runs.

        Args:
            message: ``runs``, their folders as listed.

        Returns:
            ``page``, the address of the page, and ``words``, the name of the page.

        Raises:
            Refusal: The request does not name 2 to :data:`MOST_COMPARED` runs of the list, or the
                runs cannot be compared.
        """
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
        """Follow one constant over the runs that are listed.

        Args:
            message: ``constant``, and ``bench`` and ``last`` as for the list.

        Returns:
            ``page``, the address of the page, and ``words``, the name of the page.

        Raises:
            Refusal: No listed run has this constant, or the choice of runs is not valid.
        """
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
        """Run a command of ``rig runs``.

        Raises:
            Refusal: The command failed, or took too long.
        """
        try:
            child = await asyncio.create_subprocess_exec(
                *self._command,
                "runs",
                *arguments,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
        except (ValueError, OSError) as error:
            raise Refusal(f"the page cannot be made: {error}") from error
        try:
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, child.pid, os.nice(0) + NICE)
            output, _ = await asyncio.wait_for(child.communicate(), MAKE_S)
        except TimeoutError as error:
            raise Refusal(
                f"the page took more than {MAKE_S:g} s; choose fewer runs, or use `rig runs` in a "
                "terminal"
            ) from error
        finally:
            if child.returncode is None:
                child.kill()
                await child.wait()
        if child.returncode != 0:
            raise Refusal(output.decode(errors="replace").strip()[-_SHOWN:])

    async def _page(self, request: Request) -> Response:
        content = self._pages.get(request.path_params["key"])
        if content is None:
            words = f"no such page; only the latest {KEPT} pages are kept: make the page again"
            return Response(words, status_code=404, media_type="text/plain")
        return Response(
            content,
            media_type="text/html; charset=utf-8",
            headers={"Content-Security-Policy": SANDBOX},
        )
