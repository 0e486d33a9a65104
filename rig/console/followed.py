"""Follows one run, also a continued one: by its answers, its record and its recordings."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from identification.model.friction import load_coefficient, system_friction
from identification.recording import Array
from rig.common.errors import InputError
from rig.planning.predicted_load import FrictionModel, friction_model
from rig.results.run.go_on import ACCEPTANCE_FILE, first_words, read_verdict
from rig.runs.decimation import Decimation
from rig.runs.mcap.layout import EVENT_TOPIC, SAMPLE_TOPIC, decode_samples
from rig.runs.mcap.reader import START, DamageError, RecordFile, require_samples
from rig.runs.run_file import read_record, recorded_bench
from rig.runs.run_record import RUN_FILE, Ending, RunRecord

DEG = 180.0 / math.pi


class Channel(NamedTuple):
    """Channel of one chart."""

    name: str
    label: str
    unit: str
    scale: float = 1.0


CHANNELS = (
    Channel("angle", "Joint angle", "deg", DEG),
    Channel("command", "Commanded angle", "deg", DEG),
    Channel("error", "Tracking error", "deg", DEG),
    Channel("velocity", "Joint speed", "deg/s", DEG),
    Channel("torque", "Joint torque", "N m"),
    Channel("current", "Motor current", "A"),
    Channel("following_error", "Following error of the drive", "deg", DEG),
    Channel("disagreement", "Encoder against drive", "deg", DEG),
    Channel("voltage", "Motor voltage", "V"),
    Channel("supply_voltage", "Supply voltage", "V"),
    Channel("temperature", "Temperature of the drive", "deg C"),
    Channel("pressure", "Chamber pressure", "MPa", 1e-6),
)


def shown(samples: Mapping[str, Array], about: Mapping[str, Any]) -> Array:
    """Return the channels in their units of display, shape (channels, n)."""
    derived = {
        "error": samples["angle"] - samples["command"],
        "torque": samples["current"] * about["torque_per_ampere"],
        "disagreement": samples["motor_angle"] / about["gear_ratio"] - samples["angle"],
    }
    return np.stack([(derived | {**samples})[c.name] * c.scale for c in CHANNELS])


_WORDS: Mapping[str, Callable[[Mapping[str, Any]], str]] = {
    "prompt": lambda e: f"{e['stage']}: the operator is asked for the weight; the drive is off",
    "answer": lambda e: f"{e['stage']}: {e['weight_kg']:g} kg confirmed",
    "repeat": lambda e: f"{e['stage']}: the stage will be repeated",
    "stage start": lambda e: f"{e['stage']}: the stage begins",
    "first pass": lambda e: f"{e['stage']}: first pass at {100 * e['amplitude']:.0f} % amplitude",
    "weight check": lambda e: f"{e['stage']}: weight check: {e['verdict']}. {e['message']}",
    "segment": lambda e: f"{e['stage']}: excitation {e['number']} begins",
    "stage end": lambda e: f"{e['stage']}: the stage is done; the drive is off",
    "paused": lambda e: f"{e['stage']}: pause; the drive is off",
    "go on": lambda e: f"{e['stage']}: the run continues",
    "abort": lambda e: f"{e['stage']}: the operator aborted the run",
    "ignition": lambda e: f"{e['stage']}: ignition",
    "fault reset": lambda e: (
        f"{e['stage']}: the fault of the drive is cleared; the drive is still off"
    ),
}


def event_words(event: Mapping[str, Any]) -> str:
    """Return an event with its time as one line; of an unknown event, its name and details."""
    name = str(event.get("event"))
    try:
        words = _WORDS[name](event)
    except (KeyError, TypeError, ValueError):
        details = ", ".join(
            f"{key} {value}" for key, value in event.items() if key not in ("time", "event")
        )
        words = f"{name}: {event['message']}" if "message" in event else f"{name} {details}".strip()
    time = event.get("time")
    return f"{time:.1f} s  {words}" if isinstance(time, float | int) else words


READ_BYTES = 1 << 19
"""Bytes after which a call reads no further record, so that the console is not blocked."""


class News(NamedTuple):
    """Content that was added to a recording."""

    # Arrays of shape (n,), by field of `Sample`; empty without samples.
    samples: Mapping[str, Array]
    events: tuple[Mapping[str, Any], ...]  # events, each with `time` and `event`
    more: bool  # whether more content can be read immediately


class Growing:
    """A recording that may still grow."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset: int | None = START

    def read(self) -> News:
        """Read the records added since the last call; raises OSError, DamageError."""
        found: dict[str, list[bytes]] = {SAMPLE_TOPIC: [], EVENT_TOPIC: []}
        begun, more = self._offset, False
        with RecordFile(self._path) as recording:
            while begun is not None and self._offset is not None and not more:
                piece = recording.at(self._offset)
                if piece is None:
                    break
                for topic, message in piece.messages:
                    if topic in found:
                        found[topic].append(message.data)
                self._offset = piece.following
                more = self._offset is not None and self._offset - begun >= READ_BYTES
        events = tuple(json.loads(content) for content in found[EVENT_TOPIC])
        samples = found[SAMPLE_TOPIC]
        require_samples(samples)
        return News(decode_samples(b"".join(samples)) if samples else {}, events, more)


BLOCK = 10  # number of samples that are averaged for one point
MOST = 3000  # greatest number of points; beyond this number, every second point is dropped
_SPEEDS = 121


class TorqueSpeed:
    """Points of torque against speed; a new ``version`` if some were dropped."""

    def __init__(self) -> None:
        self.points: Array = np.empty((0, 3))
        self.version = 0
        self._stride = 1
        self._skipped = 0
        self._rest: Array = np.empty((0, 3))

    def add(self, samples: Mapping[str, Array], torque_per_ampere: float) -> None:
        """Add samples of excitations, arrays (n,) by field; torque per current in N m/A."""
        moving = samples["segment"] > 0
        if not moving.any():
            return
        columns = (
            samples["velocity"][moving] * DEG,
            samples["current"][moving] * torque_per_ampere,
            samples["segment"][moving],
        )
        rows = np.concatenate([self._rest, np.stack(columns, axis=1)])
        blocks = len(rows) // BLOCK
        self._rest = rows[blocks * BLOCK :]
        means = rows[: blocks * BLOCK].reshape(blocks, BLOCK, 3)
        # A block with samples of two excitations is left out.
        means = means[means[:, 0, 2] == means[:, -1, 2]].mean(axis=1)
        kept = means[self._skipped % self._stride :: self._stride]
        self._skipped = (self._skipped - len(means)) % self._stride
        self.points = np.concatenate([self.points, kept])
        while len(self.points) > MOST:
            self.points = self.points[::2]
            self._stride *= 2
            self.version += 1


def measured_friction(record: RunRecord, folder: Path) -> FrictionModel | None:
    """Return the friction by the newest identification of the bench beside the run folder."""
    try:
        model = friction_model(recorded_bench(record), runs=folder.parent)
    except InputError:
        return None
    return model if model.measured else None


def curves(record: RunRecord, model: FrictionModel | None) -> dict[str, Any] | None:
    """Return friction curves under the masses of a run, or None without a model."""
    if model is None:
        return None
    speeds = np.linspace(0.0, 2.0, _SPEEDS)[1:]
    system = system_friction(speeds, model.values, model.alpha)
    load = model.moment_per_kg * load_coefficient(speeds, model.values, model.alpha)
    masses = {s.confirmed_kg for s in record.stages if s.confirmed_kg is not None}
    lines = [
        {"mass_kg": mass, "torque": np.round(system + mass * load, 4).tolist()}
        for mass in sorted(masses)
    ]
    return {"source": model.source, "speed": np.round(speeds * DEG, 4).tolist(), "lines": lines}


EVENTS: Final = 200
SILENT_S: Final = 1.0  # time without an answer after which a run counts as silent, s
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
    """A run, jog or commissioning that a control socket reaches, and the state it reported."""

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
    """A run that the console follows."""

    def __init__(self, path: str, about: Mapping[str, Any], number: int = 0) -> None:
        super().__init__(path, about, number)
        self.folder = Path(about["folder"])
        self.verdict: dict[str, Any] | None = None
        self.record: RunRecord | None = None
        self.events: list[tuple[int, str]] = []
        self.decimation = Decimation(len(CHANNELS), about["cycle_s"])
        self.torque_speed = TorqueSpeed()
        self.curves: dict[str, Any] | None = None
        # Value of each channel in the latest sample that was read, or None if it is not known.
        self.values: list[float | None] = [None] * len(CHANNELS)
        self.drive = "not read yet"
        # Whether this sample is the newest sample of this program: not while the program connects
        # and its recording does not exist yet, and not while older samples are read.
        self.current = False
        # Reason why the recording cannot be read, or None if it can be read.
        self.trouble: str | None = None
        # Starts of the recordings after the first, on the time axis of the charts, s.
        self.continued_s: list[float] = []
        limits = {row["channel"]: row for row in about["limits"]}

        def end(channel: Channel, name: str) -> float | None:
            value = limits.get(channel.name, {}).get(name)
            return None if value is None else value * channel.scale

        self._channels = [
            {
                "name": channel.name,
                "label": channel.label,
                "unit": channel.unit,
                "low": end(channel, "low"),
                "high": end(channel, "high"),
            }
            for channel in CHANNELS
        ]
        self._answers = 0
        self._stamp: tuple[int, int] | None = None
        self._judged: object = None
        self._masses: object = None
        self._friction: FrictionModel | None = None
        self._growing: Growing | None = None
        self._part = self._parts = 0
        self._sampled = False
        self._offset_s = 0.0
        self._count = 0

    @property
    def closed(self) -> bool:
        """Whether the program of the run has ended, which writes the page after the run."""
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
        """Read the new content of the run folder; return whether more can be read immediately."""
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
        if len(record.parts) < self._parts:
            return  # the folder was used again for another run
        if self.record is None:
            # All results beside the run are read: once, before anything moves.
            self._friction = measured_friction(record, self.folder)
        self.record, self._stamp = record, stamp
        if not self._parts or not self.closed:
            # Later recordings are those of another program, which continues the run.
            self._parts = len(record.parts)
        masses = [stage.confirmed_kg for stage in record.stages]
        if masses != self._masses:
            self._masses = masses
            self.curves = curves(record, self._friction)

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
        """Continue with the next recording, if any, at least 1 s later on the time axis."""
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
