"""Registers which page holds the controls, and which commands of a page have been received."""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from rig.console.gate import MOST_PAGES, MOST_READERS


@dataclass
class Page:
    """One open page.

    Attributes:
        name: Name for the operators.
        may: Whether the page has the token of this start of the console.
        key: Value that identifies the page in commands.
        last: Number of the last command of the page.
        run: The run that the user has chosen on the page, or None.
        kept: The run that the page shows if no run was chosen.
        own: Whether the page keeps the run ``kept`` after the end of this run, because the page
            started or commanded the run, or held the controls while the run was in progress.
        beyond: Number of runs that were known at the end of the run ``kept``; None before the end
            of that run.
        started: Folder of the run that was started or continued from the page, until this run is
            found.
        before: Number of runs that were known when the run in ``started`` was started.
        window_s: Width of the charts, s; 0 for the whole run.
        pixels: Width of the charts, pixels.
    """

    name: str
    may: bool = False
    key: str = field(default_factory=lambda: secrets.token_hex(16))
    last: int = 0
    run: str | None = None
    kept: str | None = None
    own: bool = False
    beyond: int | None = None
    started: Path | None = None
    before: int = 0
    window_s: float = 30.0
    pixels: int = 400


class Controls:
    """All open pages. At most one page holds the controls.

    Attributes:
        holder: The page with the controls, or None.
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

    def take(self, page: Page) -> None:
        """Give the controls to a page even if another page holds them, because the other page may
        be frozen.
        """
        self.holder = page

    def page(self, key: str) -> Page | None:
        """Return the open page with this key, or None if there is none."""
        return self._pages.get(key)

    def replayed(self, page: Page, number: int) -> bool:
        """Return whether a command with this number or with a higher number was received before,
        and register the number.
        """
        if number <= page.last:
            return True
        page.last = number
        return False
