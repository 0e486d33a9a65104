"""What is held against what must be, once something has befallen the process of a run."""

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.clock import NS
from rig.common.errors import InputError
from rig.runs.mcap.layout import CLOCK_METADATA, decode_frames
from rig.runs.mcap.reader import Log, read_run
from rig.runs.recover import recover
from rig.wiring.guardian import REPORT_FILE

from .benches import Account, Bench
from .console import Console, unwrapped
from .process_cases import CYCLING, LOG_GAP_S, STATES, SUSPENDED_S, TOLD_S, Must

VERDICT = r"the drive is de-energised \(read back|could NOT be verified"
BUSY = re.compile(
    "sample age|lateness of|heartbeat|no SDO response|no correct answer|following error|8130h|did "
    "not start|"
    "encoder against|tripped: "
)
"""Words of a run on a computer that is too busy for it."""
_SHOWN = 240


class MissedError(Exception):
    """What was to happen in a phase did not happen in it."""


@dataclass
class Scene:
    """A run that something is about to befall.

    Attributes:
        column: What happens.
        phase: When.
        bench: The bench.
        folder: Of the cell; the run is in ``disk``.
        disk: A file system of its own, which can be filled.
        console: The run's terminal.
        second: The other program, if there is one.
        also: What else went wrong.
    """

    column: str
    phase: str
    bench: Bench
    folder: Path
    disk: Path
    console: Console
    second: Console | None = None
    also: list[str] = field(default_factory=list)

    @property
    def guarded(self) -> bool:
        """Whether the guardian must take the power off, as the run cannot."""
        return self.bench.transport == "serial" and self.column in (
            "SIGKILL",
            "suspended 2 s",
            "adapter out 2 s",
        )

    @property
    def run(self) -> Path:
        """The run folder."""
        return self.disk / "run"

    @property
    def report(self) -> Path:
        """The guardian's."""
        return self.run / REPORT_FILE


def last_words(text: str) -> str:
    return " / ".join(line.strip() for line in text.splitlines() if line.strip())[-_SHOWN:]


def problems(scene: Scene, must: Must, ns: int, account: Account) -> Iterator[str]:
    """Yield what is not as it must be."""
    console = scene.console
    text = console.text()
    yield from scene.also
    if console.status not in must.statuses:
        right = " or ".join(map(str, must.statuses))
        yield f"exit status {console.status}, must be {right}: {last_words(console.text(ns))}"
    if console.stops and scene.column not in ("suspended 2 s", "both frozen"):
        yield f"it was stopped by signal {console.stops}, and stood"
    if "Traceback (most recent call last)" in text:
        yield f"a traceback: {last_words(text)}"
    if console.status == 2 and 2 in must.statuses and not scene.run.exists():
        # Refused as it cannot be answered: nothing was begun.
        return
    yield from _power(scene, must, ns, account)
    yield from _told(scene, must, ns, account)
    yield from _recording(scene, must, ns, account)
    yield from _record(scene, must, account)
    if scene.second is not None:
        yield from _second(scene.second, console.pid)


def _power(scene: Scene, must: Must, ns: int, account: Account) -> Iterator[str]:
    """Hold the power stage against its time limit."""
    if must.stays_on:
        return
    off_s = account.off_after_s(ns)
    if off_s is None:
        yield "the drive is still energised"
    elif scene.guarded and account.on_at(ns) and not verified(scene.report):
        yield "the guardian has not written that it took the power off and read that back"
    elif must.off_s is not None and scene.console.status != 0 and off_s > must.off_s:
        yield f"off after {off_s:.3f} s, limit {must.off_s:g} s"
    elif scene.console.status == 0:
        ends = [notice["ns"] for notice in scene.console.notices if notice["phase"] == "release"]
        late_s = account.off_after_s(ends[-1]) if ends else 0.0
        if late_s is None or late_s > 0.5:
            yield f"off {late_s} s after the last stage"


def verified(report: Path) -> bool:
    """Whether the guardian has written that the drive is off."""
    try:
        return json.loads(report.read_text())["safe"]["verified"] is True
    except (OSError, ValueError):
        return False


def recorded_until_ns(log: Log) -> int:
    """Return when the last recorded frame was on the wire; 0 if there is none."""
    frames = (frame.time_ns for m in log.messages["/frames"] for frame in decode_frames(m.data))
    last = max(frames, default=None)
    return 0 if last is None else int(log.metadata[CLOCK_METADATA]["zero_ns"]) + last


def _told(scene: Scene, must: Must, ns: int, account: Account) -> Iterator[str]:
    """Hold what the operator sees against what is so."""
    if not must.told:
        return
    console = scene.console
    said = unwrapped(console.text(ns))
    if must.words and not re.search(must.words, said):
        yield f"the terminal does not say {must.words!r}: {last_words(said)}"
    last = [match.group() for match in re.finditer(VERDICT, said)]
    if not last:
        yield f"the terminal does not say how the drive was left: {last_words(said)}"
        return
    verified = "read back" in last[-1]
    if must.verified is not None and verified is not must.verified:
        yield f"it says {last[-1]!r}, must be {'read back' if must.verified else 'not verified'}"
    if verified and account.on:
        yield "it says that the drive is off, and it is not"
    if not verified and "main supply" not in said:
        yield "it does not say what to do about a drive that may be on"
    told_ns = console.said_ns(VERDICT, ns)
    limit_s = TOLD_S + (SUSPENDED_S if scene.column == "suspended 2 s" else 0.0)
    if (
        scene.phase in CYCLING
        and console.status != 0
        and told_ns is not None
        and told_ns - ns > limit_s * NS
    ):
        yield f"it says so {(told_ns - ns) / NS:.2f} s later, limit {limit_s:g} s"


def _recording(scene: Scene, must: Must, ns: int, account: Account) -> Iterator[str]:
    """Recover a copy, and hold its end against the last that was on the wire before it happened."""
    (scene.disk / "filler").unlink(missing_ok=True)
    if scene.column == "folder deleted":
        return
    copy = scene.folder / "copy"
    try:
        shutil.copytree(scene.run, copy)
        recovered = recover(copy).record
        log = read_run(copy / "recording.mcap")
    except (InputError, OSError, ValueError) as error:
        yield f"the recording cannot be read: {error}"
        return
    if not any(event["event"] == "prompt" for event in log.events):
        yield "the recording does not even hold the prompt"
    if scene.phase in CYCLING:
        end = recorded_until_ns(log)
        last = max((heard for heard in account.heard_ns if heard <= ns), default=0)
        if (last - end) / NS > LOG_GAP_S:
            yield (
                f"the recording ends {(last - end) / NS:.3f} s before the last that was on the wire"
            )
    wrong = {"running"} | ({"done"} - set(must.record))
    if scene.console.status not in (0, None) and recovered.state in wrong:
        yield f"recovered, the run is {recovered.state}"


def _record(scene: Scene, must: Must, account: Account) -> Iterator[str]:
    """Hold run.json against what happened."""
    status = scene.console.status
    if scene.column == "folder deleted":
        return
    try:
        record: dict[str, Any] = json.loads((scene.run / "run.json").read_text())
    except (OSError, ValueError) as error:
        yield f"run.json cannot be read: {error}"
        return
    ended_as = [status] if status in must.statuses else must.statuses
    wanted = must.record or tuple(STATES[number] for number in ended_as if number in STATES)
    if record["state"] not in wanted:
        yield f"run.json says {record['state']!r}, must be {' or '.join(wanted)}"
    if record["state"] == "running":
        return
    off = record["de_energised"]
    if off is True and account.on:
        yield "run.json says that the drive is off, and it is not"
    if must.verified is not None and off is not must.verified:
        yield f"run.json says de_energised {off}, must be {must.verified}"
    ended = {notice["stage"] for notice in scene.console.notices if notice["phase"] == "release"}
    for stage in record["stages"]:
        if stage["state"] == "running":
            yield f"run.json says that stage {stage['name']} is running, and the run has ended"
        if stage["state"] == "done" and scene.console.notices and stage["name"] not in ended:
            yield f"run.json says that stage {stage['name']} is done, and it was not"
    if status == 0 and any(stage["state"] != "done" for stage in record["stages"]):
        yield "run.json says that not all stages are done"


def _second(second: Console, holder: int) -> Iterator[str]:
    """Hold the other program against what a second one must do."""
    said = unwrapped(second.text())
    if second.status != 4:
        yield f"the second program ended with {second.status}, must be 4: {last_words(said)}"
    if not re.search(rf"\b{holder}\b", said) or "run" not in said:
        yield (
            f"the second program does not name the holder (run, process {holder}): "
            f"{last_words(said)}"
        )
    if "Traceback (most recent call last)" in said:
        yield "a traceback of the second program"
