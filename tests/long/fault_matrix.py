"""Every fault in every phase of a run, on each transport: what happened, held against what must.

Run as a script it goes through all of them (about a minute a transport), prints the table and writes it to
docs/faults.md. Times are simulated; "off" is when the simulated power stage went off for good.
"""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from rig.cli import status
from rig.mcap_layout import decode_frames
from rig.mcap_reader import Log, read_run
from rig.recover import recover

SEQUENCE = """\
sequence: 1
name: matrix
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 4, frequency_Hz: 2}], duration_s: 0.6,
     center_deg: 8, ramp_in_s: 0.1, ramp_out_s: 0.2, settle_s: 0.05}
"""
PHASES: Mapping[str, float] = {
    "prompt": 0.0,
    "prepare": 0.005,
    "enable": 0.003,
    "approach": 0.1,
    "excite": 0.15,
    "ramp_out": 0.0,
    "hold": 0.02,
    "disable": 0.0,
}
"""Phase to how long after its start the fault comes, s."""
STATES = ("switch_on_disabled", "ready", "switched_on", "operation_enabled", "quick_stop_active", "fault_reaction")
LOG_GAP_S = 0.2
PAGE = Path(__file__).resolve().parents[2] / "docs" / "faults.md"
BEGIN, END = "<!-- matrix: written by tests/long/fault_matrix.py -->", "<!-- end of matrix -->"

BRAKE_S = 0.1
"""Trip, quick stop at 2000 deg/s^2, and up to 20 cycles until the state is read again."""
WATCH_S = 0.2
"""Heartbeat watch of 0.1 s, 25 ms between heartbeats, ramp and 20 ms to settle."""
SILENCE_S = 0.35
"""A device counts as silent after 0.2 s without its heartbeat, 50 ms apart; then as BRAKE_S."""
STANDSTILL_S = 1.1
"""A drive that stays in QUICK STOP ACTIVE is waited for 1 s, then disabled."""
LATENT_S = 1.5
"""Shows only when it is next needed, at the latest as the drive is disabled; the whole run takes 1.3 s."""


@dataclass(frozen=True)
class Must:
    """The reaction asked for: exit status, words of the run, and for what is not ridden out the time to power off.

    ``verified`` is whether the host can still read 6041h; ``stays_on`` is for a drive that nobody stops.
    """

    exit_status: int
    words: str = ""
    within_s: float | None = None
    verified: bool = True
    stays_on: bool = False


RIDES = Must(0, "all 1 stages done")


@dataclass(frozen=True)
class Case:
    """A fault: its rows in the schedule, and what must follow, by phase or for the rest of them."""

    rows: tuple[Mapping[str, Any], ...]
    rest: Must
    by_phase: Mapping[str, Must] = field(default_factory=dict)

    def must(self, phase: str) -> Must:
        """Return what must follow in this phase."""
        return self.by_phase.get(phase, self.rest)


def fault(target: str, name: str, **more: Any) -> Mapping[str, Any]:
    """Return a row of a schedule, without its time."""
    return {"target": target, "fault": name, **more}


def at(phases: str, must: Must) -> dict[str, Must]:
    """Ask for one reaction in several phases."""
    return dict.fromkeys(phases.split(), must)


NO_ANSWER = Must(4, "no SDO response", WATCH_S)
REFUSED = Must(4, "refuses", BRAKE_S)
FOUND_LATER = Must(1, "encoder against drive", 0.5)
FOUND = Must(1, "encoder against drive", BRAKE_S)
MOTION = {"device": "drive", "function": "motion"}


def _stopping(option: int) -> Case:
    rows = (fault("drive", "quick_stop_option", value=option), fault("operator", "stop"))
    within = {0: 0.05, 1: 0.35, 2: BRAKE_S, 5: STANDSTILL_S, 6: STANDSTILL_S}[option]
    return Case(rows, Must(3, "stopped by the operator", within))


CASES: Mapping[str, Case] = {
    "one frame lost": Case((fault("bus", "lost"),), RIDES, at("prompt prepare disable", NO_ANSWER)),
    "the drive's frames lost, 40 of them": Case(
        (fault("bus", "lost", frames={"device": "drive"}, count=40),),
        Must(4, "sample age", WATCH_S),
        at("enable", NO_ANSWER) | at("prompt prepare disable", replace(NO_ANSWER, verified=False)),
    ),
    "cable pulled": Case(
        (fault("bus", "lost", count=0),),
        Must(4, "sample age.*could NOT be verified", WATCH_S, verified=False),
        at("prompt prepare enable disable", Must(4, "no SDO response.*could NOT be verified", WATCH_S, verified=False)),
    ),
    "10 frames repeated": Case((fault("bus", "repeated", count=10),), RIDES),
    "a frame 3 ms late": Case((fault("bus", "late", value=0.003),), RIDES),
    "the drive's positions 20 ms late, 60 of them": Case(
        (fault("bus", "late", frames=MOTION, value=0.02, count=60),),
        Must(4, "sample age", BRAKE_S),
        at("prompt prepare enable disable", RIDES),
    ),
    "target with a bit wrong": Case(
        (fault("bus", "flipped", frames={"device": "host", "function": "output"}, value=29),), RIDES
    ),
    "position with a bit wrong": Case(
        (fault("bus", "flipped", frames=MOTION, value=29),),
        Must(1, "beyond its limit", BRAKE_S),
        at("prompt prepare enable disable", RIDES),
    ),
    "process data cut short": Case((fault("bus", "short", frames=MOTION),), RIDES),
    "bus-off": Case((fault("bus", "bus_off"),), Must(4, "bus-off.*could NOT be verified", WATCH_S, verified=False)),
    "error frames": Case(
        (fault("bus", "error_frames", count=3),), Must(4, "error frame", BRAKE_S), at("disable", RIDES)
    ),
    "host's heartbeat lost": Case(
        (fault("bus", "lost", frames={"device": "host", "function": "heartbeat"}, count=0),),
        Must(4, "8130h", WATCH_S),
        at("prompt prepare hold disable", RIDES),
    ),
    "drive's heartbeat lost": Case(
        (fault("bus", "lost", frames={"device": "drive", "function": "heartbeat"}, count=0),),
        Must(4, "sent no heartbeat", SILENCE_S),
        at("prompt prepare", Must(4, "did not report OPERATIONAL", 0.0)) | at("hold disable", RIDES),
    ),
    "EMCY": Case((fault("drive", "emcy"),), Must(4, "2310h", BRAKE_S), at("disable", RIDES)),
    "drive fault": Case(
        (fault("drive", "fault"),), Must(4, "7320h", BRAKE_S), at("disable", Must(0, "read back: fault", BRAKE_S))
    ),
    "drive restarts": Case(
        (fault("drive", "restart"),),
        Must(4, "restarted", BRAKE_S),
        at("prompt disable", RIDES) | at("prepare", Must(4, "did not report OPERATIONAL", 0.0)),
    ),
    **{f"quick stop, 605Ah = {option}": _stopping(option) for option in (0, 1, 2, 5, 6)},
    "mode refused": Case(
        (fault("drive", "mode_refused"),), RIDES, at("prompt prepare enable", Must(4, "mode of operation is 0", 0.0))
    ),
    "SDO abort": Case(
        (fault("drive", "sdo_abort"),), Must(4, "refuses", LATENT_S), at("prompt prepare enable disable", REFUSED)
    ),
    "SDO time-out": Case(
        (fault("drive", "sdo_timeout"),),
        Must(4, "no SDO response", LATENT_S),
        at("prompt prepare enable disable", NO_ANSWER),
    ),
    "encoder bit": Case((fault("encoder", "bit"),), FOUND, at("prompt prepare enable disable", RIDES)),
    "encoder jump": Case(
        (fault("encoder", "jump"),), FOUND, at("prompt prepare enable", FOUND_LATER) | at("disable", RIDES)
    ),
    "encoder frozen": Case((fault("encoder", "frozen"),), FOUND_LATER, at("hold disable", RIDES)),
    "encoder reversed": Case((fault("encoder", "reversed"),), FOUND_LATER, at("disable", RIDES)),
    "control loop hangs 0.5 s": Case(
        (fault("host", "hangs"),), Must(4, "8130h", WATCH_S), at("prompt prepare disable", RIDES)
    ),
    "controller killed": Case((fault("host", "killed"),), Must(-9, "", WATCH_S, verified=False)),
    "clock steps 1 s ahead": Case(
        (fault("host", "clock_step", value=1.0),), Must(4, "sent no heartbeat", BRAKE_S), at("disable", RIDES)
    ),
    "clock steps 1 s back": Case(
        (fault("host", "clock_step", value=-1.0),),
        Must(4, "8130h", WATCH_S),
        at("prompt prepare enable disable", RIDES),
    ),
    "recorder fails": Case((fault("host", "recorder_fails"),), Must(4, "Input/output error", 0.25)),
    "disk full": Case((fault("disk", "full"),), Must(4, "run folder cannot be written", 0.25)),
    "Ctrl-C": Case((fault("operator", "stop"),), Must(3, "stopped by the operator", BRAKE_S)),
    "prompt unanswered": Case(
        (fault("operator", "unanswered", value=30.0),), RIDES, at("prompt", Must(3, "without an answer", 0.0))
    ),
    "60 kg instead of none": Case((fault("operator", "wrong_weight", value=60.0),), RIDES),
    "300 kg instead of none": Case(
        (fault("operator", "wrong_weight", value=300.0),),
        Must(1, "beyond its limit", 0.7),
        at("approach excite ramp_out hold disable", RIDES),
    ),
}


_NOT_RUNNING = Must(4, "not OPERATION ENABLED", BRAKE_S)
_LATE = Must(4, "lateness of the control cycle", BRAKE_S)
_SERIAL: Mapping[str, Case] = {
    "drive fault": Case(
        (fault("drive", "fault"),),
        _NOT_RUNNING,
        at("prompt prepare enable", Must(4, "7320h", 0.0)) | at("disable", Must(0, "read back: fault", BRAKE_S)),
    ),
    "drive restarts": Case(
        (fault("drive", "restart"),),
        _NOT_RUNNING,
        at("prompt prepare disable", RIDES) | at("enable", Must(4, "mode of operation is 0", 0.0)),
    ),
    "control loop hangs 0.5 s": Case(
        (fault("host", "hangs"),), replace(_LATE, within_s=0.6), at("prompt prepare enable disable", RIDES)
    ),
    "controller killed": Case(
        (fault("host", "killed"),),
        Must(-9, verified=False, stays_on=True),
        at("prompt prepare enable", Must(-9, "", 0.0, verified=False)),
    ),
    "clock steps 1 s ahead": Case(
        (fault("host", "clock_step", value=1.0),), _LATE, at("prompt prepare enable disable", RIDES)
    ),
    "clock steps 1 s back": Case(
        (fault("host", "clock_step", value=-1.0),), RIDES, at("enable", Must(4, "sample age", BRAKE_S))
    ),
    "60 kg instead of none": Case(
        (fault("operator", "wrong_weight", value=60.0),),
        Must(1, "beyond its limit", 0.7),
        at("approach excite ramp_out hold disable", RIDES),
    ),
}
"""Where a serial line differs: no watchdog, no emergency messages, no heartbeats, and lower limits."""


@dataclass(frozen=True)
class Transport:
    """A packaged bench file, and which faults exist on it.

    Attributes:
        bench: Its name.
        cases: Fault to what must come of it.
        in_reaction: Words of the run whose drive faults twice.
    """

    bench: str
    cases: Mapping[str, Case]
    in_reaction: str = "4310h"


_CAN_ONLY = ("EMCY", "SDO abort", "SDO time-out")
TRANSPORTS: Mapping[str, Transport] = {
    "CANopen": Transport("practical", CASES),
    "EPOS serial": Transport(
        "practical_serial",
        {
            name: _SERIAL.get(name, case)
            for name, case in CASES.items()
            if case.rows[0]["target"] not in ("bus", "encoder") and name not in _CAN_ONLY
        },
        "not OPERATION ENABLED",
    ),
}


@dataclass(frozen=True)
class Cell:
    """What came of one fault in one phase."""

    text: str
    problems: tuple[str, ...]


def run_case(case: Case, phase: str, bench: str, folder: Path) -> Cell:
    """Run one fault in one phase."""
    rows = [{**row, "phase": phase, "after_s": PHASES[phase]} for row in case.rows]
    return run_rows(rows, case.must(phase), bench, folder)


def run_rows(rows: list[dict[str, Any]], must: Must, bench: str, folder: Path) -> Cell:
    """Run a schedule in a new folder and compare with what must come of it."""
    folder.mkdir(parents=True)
    expect = {"exit_status": must.exit_status, "words": must.words}
    if must.within_s is not None:
        expect["deenergised_within_s"] = must.within_s
    schedule = {"faults": 1, "rows": [{**row, "expect": expect} for row in rows]}
    (folder / "faults.yaml").write_text(yaml.safe_dump(schedule))
    (folder / "sequence.yaml").write_text(SEQUENCE)
    run = folder / "run"
    arguments = ["run", str(folder / "sequence.yaml"), "--bench", bench, "--yes", "--out", str(run)]
    arguments += ["--faults", str(folder / "faults.yaml")]
    code = _run_and_die(arguments, folder) if must.exit_status < 0 else _run(arguments)
    findings = json.loads((run / "faults.json").read_text())["faults"]
    log = recover(run) and read_run(run / "recording.mcap") if code < 0 else read_run(run / "recording.mcap")
    record = json.loads((run / "run.json").read_text())
    problems = list(_problems(must, code, findings, log, record))
    off = findings[-1]["off_after_s"]
    rode = code == 0 and must.within_s is None
    text = f"{code}" if rode else f"{code}, {off:.2f} s" if off is not None else f"{code}, ON"
    if not rode and not must.verified:
        text += "*"
    return Cell(text + (" !!" if problems else ""), tuple(problems))


def _run(arguments: list[str]) -> int:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return status(arguments)


def _run_and_die(arguments: list[str], folder: Path) -> int:
    code = "import sys; from rig.cli import status; sys.exit(status(sys.argv[1:]))"
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, cwd=folder).returncode


def _problems(must: Must, code: int, findings: list[dict[str, Any]], log: Log, record: dict[str, Any]) -> Iterator[str]:
    for finding in findings:
        yield from finding["remarks"]
        if finding["applied_s"] is None:
            return
    if code != must.exit_status:
        yield f"exit status {code}, must be {must.exit_status}"
    if (findings[-1]["off_after_s"] is None) is not must.stays_on:
        yield "the drive is still energised" if not must.stays_on else "the drive is off, and must be on"
    if code >= 0 and record["de_energised"] is not must.verified and record["state"] != "running":
        yield f"run.json says de_energised {record['de_energised']}, must be {must.verified}"
    last_s = max((frame.time_ns for m in log.messages["/frames"] for frame in decode_frames(m.data)), default=0) / 1e9
    if last_s < findings[0]["applied_s"] - LOG_GAP_S:
        yield f"the log ends at {last_s:.3f} s, the fault came at {findings[0]['applied_s']:.3f} s"
    if log.damage is None and code >= 0 and log.events[-1].get("message") != record["message"]:
        yield f"the log's last words are {log.events[-1]}"


def state_rows(state: str, in_reaction: str = "4310h") -> tuple[list[dict[str, Any]], Must]:
    """Return the schedule that lets the drive fault in a 402 state, and what must follow."""
    row = dict(fault("drive", "fault"), state=state)
    lead = dict(phase="excite", after_s=0.1)
    if state == "quick_stop_active":
        return [{**fault("operator", "stop"), **lead}, row | {"after_s": 0.005}], Must(3, "stopped", BRAKE_S)
    if state == "fault_reaction":
        return [{**fault("drive", "fault", value=0x4310), **lead}, row | {"after_s": 0.005}], Must(
            4, in_reaction, BRAKE_S
        )
    if state == "switch_on_disabled":
        return [{**fault("drive", "fault"), "phase": "prompt"}], Must(4, "7320h", 0.0)
    return [row], Must(4, "7320h", BRAKE_S)


def matrix(folder: Path, words: list[str]) -> tuple[list[str], list[str]]:
    """Run everything whose name holds one of the words; return the lines of the page and the problems."""
    lines: list[str] = []
    problems: list[str] = []
    for line, transport in TRANSPORTS.items():
        lines += [f"### {line}", "", f"| fault | {' | '.join(PHASES)} |", "|---" * (len(PHASES) + 1) + "|"]
        for name, case in transport.cases.items():
            if not any(word in name for word in words):
                continue
            cells = {p: run_case(case, p, transport.bench, folder / f"{line} {name} {p}") for p in PHASES}
            lines.append(f"| {name} | {' | '.join(cell.text for cell in cells.values())} |")
            problems += [f"{line}: {name}, {p}: {problem}" for p, cell in cells.items() for problem in cell.problems]
            print(lines[-1], flush=True)
        cells = {
            s: run_rows(*state_rows(s, transport.in_reaction), transport.bench, folder / f"{line} {s}") for s in STATES
        }
        lines += ["", f"| drive fault in | {' | '.join(STATES)} |", "|---" * (len(STATES) + 1) + "|"]
        lines += [f"| | {' | '.join(cell.text for cell in cells.values())} |", ""]
        problems += [f"{line}: fault in {s}: {problem}" for s, cell in cells.items() for problem in cell.problems]
        print(lines[-2], flush=True)
    return lines, problems


def main() -> int:
    """Run the matrix, print it and put it into the page; with words given, only print the rows that hold one."""
    words = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        lines, problems = matrix(Path(folder), words or [""])
    for problem in problems:
        print(problem)
    if words:
        return 1 if problems else 0
    text = PAGE.read_text()
    before, after = text.split(BEGIN)[0], text.split(END)[1]
    PAGE.write_text(before + BEGIN + "\n\n" + "\n".join(lines) + "\n" + END + after)
    cells = sum(len(t.cases) * len(PHASES) + len(STATES) for t in TRANSPORTS.values())
    print(f"{cells} cells on {len(TRANSPORTS)} transports, {len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
