"""Follows one run: reads its state from its answers on the control socket, its record and its
recordings.

A continued run has several recordings. All are read, one after the other, so that a page keeps the
charts and events of the time before a stop.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from rig.common.errors import InputError
from rig.console.channels import CHANNELS, channel_records, shown
from rig.console.decimation import Decimation
from rig.console.event_words import event_words
from rig.console.growing import Growing, News
from rig.console.torque_speed import TorqueSpeed, curves
from rig.results.run.go_on import first_words
from rig.results.run.verdict import ACCEPTANCE_FILE, read_verdict
from rig.runs.mcap.records import DamageError
from rig.runs.run_file import read_record
from rig.runs.run_record import RUN_FILE, Ending, RunRecord

EVENTS: Final = 200
"""Greatest number of events that are shown."""
SILENT_S: Final = 1.0
"""Time without an answer after which a run counts as silent, s."""
DRIVE_STATES: Final = {
    0x00: "not ready",
    0x40: "off (switch on disabled)",
    0x21: "off (ready to switch on)",
    0x23: "switched on, no torque",
    0x27: "ENERGISED (operation enabled)",
    0x07: "quick stop: braking",
    0x0F: "fault reaction",
    0x08: "FAULT",
}
_STATE_MASK: Final = 0x6F


class Reached:
    """A program that a control socket reaches: a run, a jog or a commissioning.

    Args:
        path: Control socket of the program.
        about: Description that the program sent.
        number: Number of programs that were found up to and including this program.

    Attributes:
        key: Value that identifies the program in commands.
        status: Newest state that the program reported; None before the first report.
        gone: Whether the program is gone.
    """

    def __init__(self, path: str, about: Mapping[str, Any], number: int = 0) -> None:
        self.path = path
        self.number = number
        self.about = about
        self.key: str = about["run"]
        self.status: dict[str, Any] | None = None
        self.heard_s = time.monotonic()
        self.gone = False

    @property
    def silent_s(self) -> float:
        """Time since the program last answered, s."""
        return time.monotonic() - self.heard_s

    @property
    def over(self) -> bool:
        """Whether the program has ended its work, regularly or not."""
        return self.gone or bool(self.status and self.status["ended"])

    def hear(self, status: dict[str, Any]) -> None:
        """Store the state that the program reports."""
        self.status, self.heard_s = status, time.monotonic()


class Followed(Reached):
    """A run that the console follows.

    Args:
        path: Control socket of the run.
        about: Description that the run sent.
        number: Number of runs that were found up to and including this run.

    Attributes:
        verdict: Acceptance of the run; None while it is not judged.
        record: ``run.json``, or None until this file exists.
        events: Number and text of the newest events.
        decimation: Minima and maxima of the channels, over the recorded time of all recordings.
        continued_s: Starts of the recordings after the first, on the time axis of the charts, s.
        torque_speed: Points of torque against speed.
        curves: Friction curves of the newest identification.
        values: Value of each channel in the latest sample that was read, or None if it is not
            known.
        drive: State of the drive in this sample, as text.
        current: Whether this sample is the newest sample of this program: not while the program
            connects and its recording does not exist yet, and not while older samples are read.
        trouble: Reason why the recording cannot be read, or None if it can be read.
    """

    def __init__(self, path: str, about: Mapping[str, Any], number: int = 0) -> None:
        super().__init__(path, about, number)
        self.folder = Path(about["folder"])
        self.verdict: dict[str, Any] | None = None
        self.record: RunRecord | None = None
        self.events: list[tuple[int, str]] = []
        self.decimation = Decimation(len(CHANNELS), about["cycle_s"])
        self.torque_speed = TorqueSpeed()
        self.curves: dict[str, Any] | None = None
        self.values: list[float | None] = [None] * len(CHANNELS)
        self.drive = "not read yet"
        self.current = False
        self.trouble: str | None = None
        self.continued_s: list[float] = []
        self._channels = channel_records(about)
        self._answers = 0
        self._stamp: tuple[int, int] | None = None
        self._judged: object = None
        self._masses: object = None
        self._growing: Growing | None = None
        self._part = self._parts = 0
        self._sampled = False
        self._offset_s = 0.0
        self._count = 0

    @property
    def closed(self) -> bool:
        """Whether the program of the run has ended; after the end of the run, the program still
        writes the page of the run.
        """
        return self.gone or not os.path.exists(self.path)

    @property
    def begun(self) -> str | None:
        """Start of the newest recording of this program, UTC; None until it is known."""
        return self.record.parts[self._parts - 1].created if self.record and self._parts else None

    def parts(self) -> dict[str, tuple[object, Any]]:
        """Return version and JSON value of the parts of the run that a page shows, by name."""
        return {
            "about": (self.key, {key: v for key, v in self.about.items() if key != "run"}),
            "channels": (self.key, self._channels),
            "status": (self._answers, self.status),
            "live": (object(), self._live()),
            "curves": (self._masses, self.curves),
            "record": (self._stamp, None if self.record is None else _shown_record(self.record)),
            "verdict": (self._judged, self.verdict),
        }

    def _live(self) -> dict[str, Any]:
        return {
            "values": self.values,
            "current": self.current,
            "drive": self.drive if self.current or self.over else "not read yet",
            "silent": self.silent_s > SILENT_S and not self.over,
            "silent_s": round(self.silent_s),
            "gone": self.gone and not (self.status and self.status["ended"]),
            "closed": self.closed,
            "trouble": self.trouble,
            "time_s": round(self.decimation.latest_s, 1),
        }

    def hear(self, status: dict[str, Any]) -> None:
        """Store the state that the run reports."""
        super().hear(status)
        self._answers += 1

    def read(self) -> bool:
        """Read the new content of the run folder; return whether more content can be read
        immediately.
        """
        # A program names its recording in run.json before it reports a phase after connecting.
        connecting = self.status is None or self.status["phase"] == "connecting"
        self._read_record()
        more = self._read_recording()
        self.current = self._sampled and not (more or connecting)
        return more

    def _read_record(self) -> None:
        stamp = _stamp_of(self.folder / RUN_FILE)
        judged = (_stamp_of(self.folder / ACCEPTANCE_FILE), stamp)
        if judged != self._judged:
            self._judged, self.verdict = judged, read_verdict(self.folder)
        if stamp is None or stamp == self._stamp:
            return
        try:
            record = read_record(self.folder)
        except (OSError, InputError):
            return
        self.record, self._stamp = record, stamp
        if not self._parts or not self.closed:
            # Later recordings are those of another program, which continues the run.
            self._parts = len(record.parts)
        masses = [stage.confirmed_kg for stage in record.stages]
        if masses != self._masses:
            self._masses = masses
            self.curves = curves(record, self.folder)

    def _read_recording(self) -> bool:
        if self.record is None:
            return False
        if self._growing is None:
            self._growing = Growing(self.folder / self.record.parts[self._part].file)
        try:
            news = self._growing.read()
        except FileNotFoundError:
            return self._next_recording()
        except (OSError, DamageError, json.JSONDecodeError) as error:
            self.trouble = f"the recording cannot be read: {error}"
            return self._next_recording()
        self._take(news)
        return news.more or self._next_recording()

    def _next_recording(self) -> bool:
        """Continue with the next recording, if there is one; return whether there is one.

        On the time axis the next recording begins at a whole second, at least a second after the
        end of the recording before, so that the charts have a gap.
        """
        if self._part + 1 >= self._parts:
            return False
        self._part += 1
        self._growing = None
        self._sampled = False
        self._offset_s = float(math.ceil(self.decimation.latest_s + 1.0))
        self.continued_s.append(self._offset_s)
        self.drive = "not read yet"
        words = f"recording {self._part + 1} begins: the run is continued"
        self._note(f"{self._offset_s:.1f} s  {words}")
        return True

    def _note(self, words: str) -> None:
        self._count += 1
        self.events.append((self._count, words))
        del self.events[:-EVENTS]

    def _take(self, news: News) -> None:
        for event in news.events:
            time_s = event.get("time")
            if isinstance(time_s, int | float):
                event = {**event, "time": time_s + self._offset_s}
            self._note(event_words(event))
        if not news.samples:
            return
        self._sampled = True
        values = shown(news.samples, self.about)
        self.decimation.add(news.samples["time"] + self._offset_s, values)
        self.torque_speed.add(news.samples, self.about["torque_per_ampere"])
        # JSON has no NaN.
        self.values = [None if v != v else round(v, 5) for v in values[:, -1].tolist()]
        word = int(news.samples["statusword"][-1])
        state = word & _STATE_MASK
        self.drive = DRIVE_STATES.get(state, DRIVE_STATES.get(word & 0x4F, f"{word:04X}h"))


def _stamp_of(path: Path) -> tuple[int, int] | None:
    """Return a value that changes with each version of a file; None if there is no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_ino


def _shown_record(record: RunRecord) -> dict[str, Any]:
    """Return the part of ``run.json`` that a page shows."""
    held = record.parts[-1].devices.get("limits")
    return {
        "state": record.state,
        "message": record.message,
        "first": [] if record.state in ("running", Ending.DONE.value) else first_words(record),
        "de_energised": record.de_energised,
        "drive_state": record.drive_state,
        "warnings": record.warnings,
        "stages": [
            {"name": s.name, "load": s.stage, "state": s.state, "mass_kg": s.confirmed_kg}
            for s in record.stages
        ],
        "held": dict(held) if isinstance(held, dict) else {},
        "masses": {each.index: each.weight_kg for each in record.segments},
    }
