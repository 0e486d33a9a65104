"""Follows all runs of the user who started the console, and passes the commands of pages to the
runs.
"""

from __future__ import annotations

import asyncio
import math
import time
from pathlib import Path
from typing import Any, Final

from rig.console.controls import Controls, Page
from rig.console.followed import Followed, Reached
from rig.console.run_link import Links, Unreachable
from rig.console.starting import Starter
from rig.terminal.control_messages import VERSION, Command

TICK_S: Final = 0.1
_LOOK_S: Final = 0.5
_ENDED: Final = 5
"""Number of runs that are kept after their end."""
_READS: Final = 4
"""Greatest number of blocks of a recording that are read in one tick."""
_NOTES: Final = 20
_AGAIN_S: Final = 0.5
"""Least time after which a run without an answer is asked again, s."""


class Questions:
    """When each run is asked again.

    The queue of a run holds about ten messages. Questions to a run that hangs must not fill this
    queue, because STOP would then not get into it.
    """

    def __init__(self) -> None:
        self._times: dict[str, tuple[float, float]] = {}

    def due(self, path: str, now_s: float) -> bool:
        """Return whether to ask a run now; if so, note the question.

        After an answer the run is asked at once. After a question without an answer, the wait is as
        long as the run had been silent at this question, but at least :data:`_AGAIN_S`.

        Args:
            path: Control socket of the run.
            now_s: Monotonic time, s.
        """
        heard_s, asked_s = self._times.get(path, (now_s, -math.inf))
        if now_s - asked_s < max(_AGAIN_S, asked_s - heard_s):
            return False
        self._times[path] = heard_s, now_s
        return True

    def answered(self, path: str) -> None:
        """Note that a run has answered."""
        self._times.pop(path, None)


class Refusal(Exception):
    """A command is refused; the message states the reason.

    Args:
        words: The reason.
        details: Further fields of the answer.
    """

    def __init__(self, words: str, **details: object) -> None:
        super().__init__(words)
        self.details = details


class Hub:
    """The followed runs, and the open pages.

    Args:
        starter: Starts runs.
        only: Names of the benches whose runs are shown; empty for all.

    Attributes:
        runs: Runs by key, in the order in which they were found.
        others: Other programs that can move a bench, by key: jogs and commissionings.
        controls: The pages.
        notes: Number and text of messages to all pages.
        ticked: Set at every tick, after which pages are informed.
    """

    def __init__(self, starter: Starter, only: frozenset[str] = frozenset()) -> None:
        self.starter = starter
        self._only = only
        self.runs: dict[str, Followed] = {}
        self.others: dict[str, Reached] = {}
        self.controls = Controls()
        self.notes: list[tuple[int, str]] = []
        self.ticked = asyncio.Event()
        self._links = Links(self._heard)
        self._by_path: dict[str, Reached] = {}
        self._ignored: set[str] = set()
        self._questions = Questions()
        self._looked_s = 0.0
        self._noted = self._found = 0

    async def follow(self) -> None:
        """Follow the runs until the task is cancelled."""
        self._links.open()
        try:
            while True:
                self._tick()
                ticked, self.ticked = self.ticked, asyncio.Event()
                ticked.set()
                await asyncio.sleep(TICK_S)
        finally:
            self._links.close()

    def note(self, words: str) -> None:
        """Show a message on all pages."""
        self._noted += 1
        self.notes.append((self._noted, words))
        del self.notes[:-_NOTES]

    @property
    def scope(self) -> str:
        """Description of the runs that are shown, by user and bench."""
        if self._only:
            return f"shows the runs of your user on {', '.join(sorted(self._only))}"
        return "shows the runs of your user on any bench"

    @property
    def moving(self) -> list[Reached]:
        """Every program in progress that can move a bench of this console."""
        return [each for each in (*self.runs.values(), *self.others.values()) if not each.over]

    async def stop(self, who: str) -> tuple[list[Reached], dict[str, str]]:
        """Send STOP to every program in progress, also to a program that began just now.

        Returns:
            The programs, and for each program that did not confirm STOP, by key, the reason.
        """
        if self._look(time.monotonic()) and not self.moving:
            await asyncio.sleep(TICK_S)
        sent: list[Reached] = []
        failed: dict[str, str] = {}

        async def stop(each: Reached) -> None:
            try:
                await self._send(each, Command.STOP, who)
            except Refusal as error:
                failed[each.key] = str(error)

        while wave := [each for each in self.moving if each not in sent]:
            sent += wave
            await asyncio.gather(*map(stop, wave))
        return sent, failed

    def run_of(self, page: Page) -> Followed | None:
        """Return the run that a page shows: the run that the user chose, else the run that was
        started from the page, else the newest run in progress, else the newest run.

        A page keeps its run until the user chooses or starts another run, so that a run that begins
        elsewhere replaces neither the run that STOP must stop nor the end state of its drive. Only
        a page that never commanded its run moves, after the end of the run, to a run that began
        after that end.
        """
        if page.run in self.runs:
            return self.runs[page.run]
        runs = list(self.runs.values())[::-1]
        mine = (run for run in runs if run.folder == page.started and run.number > page.before)
        own = next(mine, None)
        if own is not None:
            self.claim(page, own.key)
            page.started = None
        kept = self.runs.get(page.kept or "")
        if kept is None:
            kept = next((run for run in runs if not run.over), runs[0] if runs else None)
        elif kept.over and not page.own and page.beyond is not None:
            later = [run for run in runs if run.number > page.beyond]
            kept = next((run for run in later if not run.over), later[0] if later else kept)
        if kept is not None:
            same = kept.key == page.kept
            page.own = (same and page.own) or (self.controls.holder is page and not kept.over)
            since = page.beyond if same and page.beyond is not None else self._found
            page.beyond = since if kept.over else None
            page.kept = kept.key
        return kept

    def claim(self, page: Page, key: str) -> None:
        """Let a page keep a run that the page commanded, also after the end of the run."""
        if key in self.runs:
            page.kept, page.own, page.beyond = key, True, None

    def follow_up(self, page: Page, folder: Path) -> None:
        """Let a page show the run that it has started or continued in ``folder``, as soon as this
        run is found. Until then, the page shows the run that it has shown.
        """
        shown = self.run_of(page)
        if shown is not None:
            self.claim(page, shown.key)
        page.run, page.started, page.before = None, folder, self._found

    def keep(self, page: Page, key: object, own: object = False) -> None:
        """Let a page that is opened again keep the run that the page showed before its connection
        was lost, if the run is in progress or if the page commanded the run.
        """
        run = self.runs.get(key) if isinstance(key, str) else None
        if run is None:
            return
        if own is True:
            self.claim(page, run.key)
        elif not run.over:
            page.kept = run.key

    async def command(
        self, key: str, command: Command, who: str, prompt: int = 0, text: str = ""
    ) -> str:
        """Send a command to a run; return the answer of the run.

        Raises:
            Refusal: The run refused the command, did not answer, or is over.
        """
        run = self.runs.get(key)
        if run is None:
            raise Refusal("this run is unknown; choose a run that the page shows")
        return await self._send(run, command, who, prompt, text)

    async def _send(
        self, run: Reached, command: Command, who: str, prompt: int = 0, text: str = ""
    ) -> str:
        try:
            answer = await self._links.command(run.path, run.key, command, who, prompt, text)
        except Unreachable as error:
            raise Refusal(str(error)) from error
        if not answer["taken"]:
            raise Refusal(answer["words"])
        self._ask(run)
        return "taken"

    def _tick(self) -> None:
        now = time.monotonic()
        if now - self._looked_s >= _LOOK_S:
            self._looked_s = now
            self._look(now)
        for each in self.moving:
            if self._questions.due(each.path, now):
                self._ask(each)
        for run in list(self.runs.values()):
            for _ in range(_READS):
                if not run.read():
                    break
        for words in self.starter.failures():
            self.note(words)

    def _look(self, now_s: float) -> int:
        """Find new programs, and remove the oldest runs that have ended and that no page shows;
        return the number of programs that were asked who they are.
        """
        asked = 0
        for path in self._links.runs():
            known = path in self._by_path or path in self._ignored
            if not known and self._questions.due(path, now_s):
                try:
                    self._links.ask(path, "about")
                    asked += 1
                except Unreachable:
                    self._ignored.add(path)
        shown = {key for page in self.controls.pages for key in (page.run, page.kept)}
        over = [key for key, run in self.runs.items() if run.over and key not in shown]
        for key in over[:-_ENDED]:
            self._by_path.pop(self.runs.pop(key).path, None)
        for key in [key for key, each in self.others.items() if each.over]:
            self._by_path.pop(self.others.pop(key).path, None)
        return asked

    def _ask(self, run: Reached) -> None:
        try:
            self._links.ask(run.path, "status")
        except Unreachable:
            run.gone = True

    def _heard(self, path: str, message: dict[str, Any]) -> None:
        """Process a message of a run."""
        self._questions.answered(path)
        known = self._by_path.get(path)
        about = message.get("about")
        if known is None and isinstance(about, dict):
            if about.get("version") != VERSION or (self._only and about["bench"] not in self._only):
                self._ignored.add(path)
                return
            if "folder" not in about:
                other = self._by_path[path] = Reached(path, about)
                self.others[other.key] = other
                return
            self._found += 1
            run = self._by_path[path] = Followed(path, about, self._found)
            self.runs[run.key] = run
        elif known is not None and isinstance(message.get("status"), dict):
            known.hear(message["status"])
