"""Which run a page shows, and so which run its STOP is for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rig.console.controls import Page
from rig.console.hub import Hub
from rig.console.starting import Starter
from rig.terminal.control_messages import VERSION


class Desk:
    """A hub that hears of runs as their sockets would tell it."""

    def __init__(self, root: Path) -> None:
        self.hub = Hub(Starter(("practical",), root))
        self.hub._links.close()
        self.page = self.hub.controls.open()

    def begin(self, key: str, folder: str = "") -> None:
        about: dict[str, Any] = {
            "version": VERSION,
            "run": key,
            "folder": folder or f"/runs/{key}",
            "cycle_s": 0.001,
            "torque_per_ampere": 3.0,
            "gear_ratio": 100.0,
            "limits": [],
        }
        self.hub._heard(f"/{key}.sock", {"about": about})
        self.tell(key, ended=None)

    def tell(self, key: str, ended: object) -> None:
        self.hub._heard(f"/{key}.sock", {"status": {"ended": ended}})

    def end(self, key: str) -> None:
        self.tell(key, {"words": "done", "good": True})

    def shown(self, page: Page | None = None) -> str | None:
        run = self.hub.run_of(page or self.page)
        return None if run is None else run.key


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def test_a_run_that_begins_elsewhere_does_not_take_the_place_of_the_run(desk: Desk) -> None:
    assert desk.shown() is None
    desk.begin("mine")
    assert desk.shown() == "mine"
    desk.begin("other")
    assert desk.shown() == "mine"
    # A page that is opened now shows the newest.
    assert desk.shown(desk.hub.controls.open()) == "other"
    desk.end("mine")
    assert desk.shown() == "mine"
    desk.begin("next")
    assert desk.shown() == "next"


def test_a_run_that_was_started_from_the_page_is_shown(desk: Desk) -> None:
    desk.begin("other")
    assert desk.shown() == "other"
    desk.page.started = Path("/runs/mine")
    assert desk.shown() == "other"
    desk.begin("third")
    desk.begin("mine")
    assert desk.shown() == "mine"
    desk.end("mine")
    # A resumed run has the same folder.
    desk.page.started = Path("/runs/mine")
    assert desk.shown() == "mine"
    desk.begin("again", "/runs/mine")
    assert desk.shown() == "again"


def test_a_page_that_is_opened_after_a_run_waits_for_the_next(desk: Desk) -> None:
    desk.begin("before")
    desk.end("before")
    assert desk.shown() == "before"
    desk.begin("next")
    assert desk.shown() == "next"


def test_a_run_that_was_chosen_is_shown(desk: Desk) -> None:
    desk.begin("one")
    desk.begin("two")
    desk.page.run = "one"
    assert desk.shown() == "one"
    desk.begin("three")
    assert desk.shown() == "one"
