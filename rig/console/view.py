"""Messages to one page: the parts of the state that changed, as JSON, and the new intervals of the
charts.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from rig.console.controls import Page
from rig.console.followed import Followed, Reached
from rig.console.hub import Hub

_HEAD: Final = struct.Struct("<I")


class View:
    """Record of what one page has received.

    Args:
        hub: The runs.
        page: The page.
    """

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
            "moving": _same([_moving(each) for each in hub.moving]),
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
        """Add the events, notes and points that the page has not received."""
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
            changed["points"] = {
                "from": count,
                "rows": np.round(found.points[count:], 3).tolist(),
            }
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


def _moving(each: Reached) -> dict[str, Any]:
    stopping = bool(each.status and each.status["stopping"])
    return {"key": each.key, "name": program_words(each.about), "stopping": stopping}


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
