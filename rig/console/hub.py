"""Follows all runs of one user, and passes the commands of pages to the runs."""

from __future__ import annotations

import asyncio
import math
import os
import secrets
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from drivers.clock import Clock, RealClock
from rig.console.followed import Followed, Reached
from rig.console.gate import MOST_PAGES, MOST_READERS
from rig.console.starting import Starter
from rig.terminal.control_socket import (
    PREFIX,
    RECEIVED_BEFORE,
    REPLY_BYTES,
    SUFFIX,
    VERSION,
    Command,
    MessageError,
    Order,
    bound_socket,
    decode,
    encode,
    remove_left,
    require_own_folder,
    socket_folders,
)


@dataclass
class Page:
    """One open page."""

    name: str
    may: bool = False  # whether the page has the token of this start of the console
    key: str = field(default_factory=lambda: secrets.token_hex(16))
    last: int = 0
    # Number of the last STOP, and the task that sends it to the runs and returns the answer.
    stop: tuple[int, asyncio.Future[dict[str, Any]] | None] = (-1, None)
    run: str | None = None  # the run that the user has chosen on the page, or None
    kept: str | None = None  # the run that the page shows if no run was chosen
    # Whether the page keeps the run `kept` after the end of this run, because the page started or
    # commanded the run, or held the controls while the run was in progress.
    own: bool = False
    # Number of runs that were known at the end of the run `kept`; None before the end of that run.
    beyond: int | None = None
    # Folder of the run that was started or continued from the page, until this run is found.
    started: Path | None = None
    before: int = 0  # number of runs that were known when the run in `started` was started
    window_s: float = 30.0  # width of the charts, s; 0 for the whole run
    pixels: int = 400


class Controls:
    """All open pages. At most one page is the ``holder`` of the controls; another page can become
    the holder even if this page is frozen.
    """

    def __init__(self) -> None:
        self._pages: dict[str, Page] = {}
        self._count = 0
        self.holder: Page | None = None

    @property
    def pages(self) -> Iterable[Page]:
        """All open pages."""
        return self._pages.values()

    def room(self, may: bool) -> bool:
        """Return whether one more page can be opened, with the token or without."""
        count = sum(page.may == may for page in self._pages.values())
        return count < (MOST_PAGES if may else MOST_READERS)

    def open(self) -> Page:
        """Register a new page."""
        self._count += 1
        page = Page(f"page {self._count}")
        self._pages[page.key] = page
        return page

    def close(self, page: Page) -> None:
        """Remove a page that was closed. If the closed page held the controls and exactly one other
        page has the token, that page gets the controls, for example a page after a reload;
        otherwise no page holds the controls.
        """
        self._pages.pop(page.key, None)
        if self.holder is page:
            able = [other for other in self._pages.values() if other.may]
            self.holder = able[0] if len(able) == 1 else None

    def admit(self, page: Page) -> None:
        """Register that a page has the token; the first such page gets the controls."""
        page.may = True
        if self.holder is None:
            self.holder = page

    def page(self, key: str) -> Page | None:
        """Return the open page with this key, or None if there is none."""
        return self._pages.get(key)

    def replayed(self, page: Page, number: int) -> bool:
        """Return whether this or a higher number of a command was received before; register it."""
        if number <= page.last:
            return True
        page.last = number
        return False


REPLY_S: Final = 0.25  # time after which a command without an answer is sent again, s
ATTEMPTS: Final = 4


class Unreachable(Exception):
    """The program of a run has ended, or does not answer."""


class Links:
    """Socket through which the console exchanges messages with all runs of this user."""

    def __init__(
        self, heard: Callable[[str, dict[str, Any]], None], clock: Clock | None = None
    ) -> None:
        self._heard = heard
        self._clock = clock or RealClock()
        folder = socket_folders()[0]
        require_own_folder(folder)
        remove_left(folder)
        self._path = folder / f"console-{os.getpid()}-{secrets.token_hex(4)}{SUFFIX}"
        self._socket = bound_socket(self._path)
        self._waiting: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._last = 0

    def open(self) -> None:
        """Receive messages in the running event loop."""
        asyncio.get_running_loop().add_reader(self._socket, self._read)

    def close(self) -> None:
        """Close and remove the socket."""
        with suppress(RuntimeError):
            asyncio.get_running_loop().remove_reader(self._socket)
        self._socket.close()
        with suppress(OSError):
            self._path.unlink()

    def runs(self) -> list[str]:
        """Return the paths of the control sockets of all runs of this user."""
        found: list[str] = []
        for folder in socket_folders():
            with suppress(OSError):
                if folder.is_dir():
                    require_own_folder(folder)
                    found += map(str, folder.glob(f"{PREFIX}*{SUFFIX}"))
        return sorted(found)

    def ask(self, path: str, what: str) -> None:
        """Ask a run for ``status`` or ``about``, answered to ``heard``, or Unreachable."""
        self._send(path, {"ask": what})

    async def command(
        self, path: str, run: str, command: Command, who: str, prompt: int = 0, text: str = ""
    ) -> dict[str, Any]:
        """Send a command to a run, repeatedly, until the run has answered.

        A command that waits in the queue of the run is sent again with its number, so that the run
        executes the command only once. A command that did not get into the queue, or that the run
        refused because of a later command of another program, gets a new number. So the commands
        of this console wait in the queue in the order of their numbers, and no command is refused
        because another command of this console got into the queue first.

        Returns:
            The answer: ``taken`` and, for a refused command, ``words``.

        Raises:
            Unreachable: The program is gone, or did not answer; the text states whether the run
                will execute the command later.
        """
        queued = False
        order = self._order(run, command, who, prompt, text)
        for _ in range(ATTEMPTS):
            sent, answer = await self._once(path, order)
            if answer is not None and (answer["taken"] or answer["words"] != RECEIVED_BEFORE):
                return answer
            if answer is not None and queued:
                # The command was executed when it was first sent; only the answer was lost.
                return {"taken": True, "words": ""}
            queued = queued or (sent and answer is None)
            if not queued:
                order = self._order(run, command, who, prompt, text)
        if not queued:
            raise Unreachable(
                f"the run did not accept the command within {ATTEMPTS * REPLY_S:g} s and will NOT "
                "execute it later"
            )
        raise Unreachable(
            f"the run did not answer within {ATTEMPTS * REPLY_S:g} s; the run will execute the "
            "command when it responds again"
        )

    async def _once(self, path: str, order: Order) -> tuple[bool, dict[str, Any] | None]:
        """Send a command once; return whether the run's socket took it, and the answer, or None."""
        future: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._waiting[order.number] = future
        sent = False
        try:
            sent = self._send(path, {**order.__dict__, "command": order.command.value})
            return sent, await asyncio.wait_for(future, REPLY_S)
        except TimeoutError:
            return sent, None
        finally:
            self._waiting.pop(order.number, None)

    def _order(self, run: str, command: Command, who: str, prompt: int, text: str) -> Order:
        self._last = max(self._clock.now_ns(), self._last + 1)
        return Order(command, run, self._last, who, prompt, text)

    def _send(self, path: str, message: Mapping[str, Any]) -> bool:
        """Send a message, False if the queue is full; Unreachable if the program is gone."""
        try:
            self._socket.sendto(encode(message), path)
        except (ConnectionRefusedError, FileNotFoundError) as error:
            raise Unreachable(f"the program of the run has ended ({error.strerror})") from error
        except OSError:
            return False
        return True

    def _read(self) -> None:
        while True:
            try:
                data, peer = self._socket.recvfrom(REPLY_BYTES)
                message = decode(data)
            except (OSError, MessageError):
                return
            waiting = self._waiting.get(message.get("to", 0))
            if waiting is not None and not waiting.done():
                waiting.set_result(message)
            elif isinstance(peer, str):
                self._heard(peer, message)


TICK_S: Final = 0.1
ANSWER_TICKS: Final = 10  # how long a STOP waits for programs that have not answered yet
_LOOK_S: Final = 0.5
_ENDED: Final = 5
_READS: Final = 4  # greatest number of blocks of a recording that are read in one tick
_NOTES: Final = 20
_AGAIN_S: Final = 0.5  # least time after which a run without an answer is asked again, s


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
    """A command is refused; the message states the reason."""

    def __init__(self, words: str, **details: object) -> None:
        super().__init__(words)
        self.details = details


class Hub:
    """The followed runs, and the open pages."""

    def __init__(self, starter: Starter, only: frozenset[str] = frozenset()) -> None:
        self.starter = starter
        self._only = only
        self.runs: dict[str, Followed] = {}  # runs by key, in the order in which they were found
        # Other programs that can move a bench, by key: jogs and commissionings.
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

    @property
    def unheard(self) -> int:
        """Number of programs that have not answered yet, because they connect or hang."""
        return sum(p not in self._by_path and p not in self._ignored for p in self._links.runs())

    async def stop(self, who: str) -> tuple[list[Reached], dict[str, str]]:
        """Send STOP to all in progress; return them, and why, by key, some did not confirm it."""
        if self._look(time.monotonic()) and not self.moving:
            await asyncio.sleep(TICK_S)
        sent: list[Reached] = []
        failed: dict[str, str] = {}

        async def stop(each: Reached) -> None:
            try:
                await self._send(each, Command.STOP, who)
            except Refusal as error:
                failed[each.key] = str(error)

        for _ in range(ANSWER_TICKS):
            while wave := [each for each in self.moving if each not in sent]:
                sent += wave
                await asyncio.gather(*map(stop, wave))
            if not self.unheard:
                break
            # A program that connects to its bench is known only when it answers.
            await asyncio.sleep(TICK_S)
            self._look(time.monotonic())
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
        """Let a page show the run started or continued in ``folder``, once it is found."""
        shown = self.run_of(page)
        if shown is not None:
            self.claim(page, shown.key)
        page.run, page.started, page.before = None, folder, self._found

    def keep(self, page: Page, key: object, own: object = False) -> None:
        """Let a reopened page keep its run if that is in progress, or was commanded by the page."""
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
        """Send a command to a run, return its answer; or a Refusal if there is none."""
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
        """Find new programs, drop old ended runs that no page shows; return the number asked."""
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
