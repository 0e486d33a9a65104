"""What one page is sent: state as JSON, only what changed, and the new part of its charts."""

from __future__ import annotations

import dataclasses
import json
import struct
from typing import Any, Final

import numpy as np

from rig.console.controls import Page
from rig.console.followed import Followed
from rig.console.hub import Hub

_HEAD: Final = struct.Struct("<I")


class View:
    """What a page has been sent so far.

    Args:
        hub: The runs.
        page: The page.
    """

    def __init__(self, hub: Hub, page: Page) -> None:
        self._hub = hub
        self._page = page
        self._sent: dict[str, str] = {}
        self._events = self._notes = 0
        self._run: str | None = None
        self._level: tuple[int, float] | None = None
        self._next = 0
        self._latest_s = 0.0
        self._points = (0, 0)

    def state(self) -> dict[str, Any]:
        """Return the state, without the parts that are as they were sent last."""
        hub, page = self._hub, self._page
        run = hub.run_of(page)
        key = None if run is None else run.key
        if key != self._run:
            self._run, self._events, self._level, self._points = key, 0, None, (0, 0)
            self._sent.clear()
        holder = hub.controls.holder
        parts: dict[str, Any] = {
            "runs": [_listed(each) for each in hub.runs.values()],
            "controls": {
                "holder": None if holder is None else holder.name,
                "yours": holder is page,
                "may": page.may,
            },
            "choices": hub.starter.choices(),
        }
        if run is None:
            parts["run"] = None
        else:
            parts |= _parts(run)
        changed = {}
        for name, value in parts.items():
            text = json.dumps(value)
            if self._sent.get(name) != text:
                self._sent[name] = text
                changed[name] = value
        self._add_new(changed, run)
        return changed

    def _add_new(self, changed: dict[str, Any], run: Followed | None) -> None:
        """Add events, notes and points that the page does not have yet."""
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
        """Return the new intervals of the charts, or None.

        A header of JSON after its length, then for each channel the minima and the maxima as 32-bit
        floats. The last interval of each message is sent again with the next one, as it may not
        have been complete.
        """
        run = self._hub.run_of(self._page)
        if run is None or run.key != self._run:
            return None
        decimation, page = run.decimation, self._page
        window_s = page.window_s or max(decimation.latest_s, 1.0)
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
            }
        ).encode()
        head += b" " * (-len(head) % 4)
        values = np.stack([found.low, found.high], axis=1).astype("<f4")
        return _HEAD.pack(len(head)) + head + values.tobytes()


def _listed(run: Followed) -> dict[str, Any]:
    about = run.about
    return {
        "key": run.key,
        "name": about["name"],
        "bench": about["bench"],
        "real": about["real"],
        "over": run.over,
        "folder": run.folder.name,
    }


def _parts(run: Followed) -> dict[str, Any]:
    """Return what a page shows of a run, in parts that change at different times."""
    record = run.record
    return {
        "run": run.key,
        "about": {key: value for key, value in run.about.items() if key != "run"},
        "channels": run.channels(),
        "status": run.status,
        "live": {
            "values": run.values,
            "drive": run.drive,
            "silent": run.silent and not run.over,
            "gone": run.gone and not (run.status and run.status["ended"]),
            "trouble": run.trouble,
            "time_s": round(run.decimation.latest_s, 1),
        },
        "curves": run.curves,
        "record": None
        if record is None
        else {
            "state": record.state,
            "message": record.message,
            "de_energised": record.de_energised,
            "drive_state": record.drive_state,
            "warnings": record.warnings,
            "stages": [
                {"name": s.name, "load": s.stage, "state": s.state, "mass_kg": s.confirmed_kg}
                for s in record.stages
            ],
            "weights": record.weights,
            "held": _held(run),
            "segments": [dataclasses.asdict(s)["stage"] for s in record.segments],
        },
    }


def _held(run: Followed) -> dict[str, Any]:
    """Return the limits that the drive held before the run."""
    assert run.record is not None
    limits = run.record.parts[-1].devices.get("limits")
    return dict(limits) if isinstance(limits, dict) else {}
