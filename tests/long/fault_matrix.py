"""Every fault in every phase of a run, on each transport: what happened, held against what must.

As a script (`python -m tests.long.fault_matrix`, two minutes) it goes through all of them, prints
the tables and writes them to out/fault_matrix.md; with words given, it goes only through what holds
one of them, and prints; with the word `stops` it only prints the table of the stops. Times are
simulated; "off" is when the simulated power stage went off for good, if no current flows in the
simulated motor and the joint rests at the end.
"""

import contextlib
import io
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from rig.cli.entry import status
from rig.runs.mcap.layout import CLOCK_METADATA, decode_frames
from rig.runs.mcap.reader import Log, read_run
from rig.runs.recover import recover

from .fault_cases import BRAKE_S, CASES, EMPTY, PHASES, STATES, Case, Must, Transport, fault
from .fault_cases_dbc import DBC
from .fault_cases_serial import SERIAL

SEQUENCE = "sequence: 1\nname: matrix\nstages:\n" + EMPTY
LOG_GAP_S = 0.2
PAGE = Path("out/fault_matrix.md")


TRANSPORTS: Mapping[str, Transport] = {
    "CANopen": Transport("practical", CASES),
    "EPOS serial": Transport("practical_serial", SERIAL, in_reaction="not OPERATION ENABLED"),
    "CAN frames of its own (DBC)": Transport(
        "practical_dbc",
        DBC,
        tuple(state for state in STATES if state != "switched_on"),
        0x31,
        "0041h",
    ),
}


@dataclass(frozen=True)
class Cell:
    """What came of one fault in one phase."""

    text: str
    problems: tuple[str, ...]


def run_case(case: Case, phase: str, bench: str, folder: Path) -> Cell:
    """Run one fault in one phase."""
    after_s = case.excite_s if phase == "excite" else PHASES[phase]
    rows = [{**row, "phase": phase, "after_s": after_s} for row in case.rows]
    sequence = SEQUENCE.replace(EMPTY, case.stage)
    return run_rows(rows, case.must(phase), bench, folder, sequence)


def run_rows(
    rows: list[dict[str, Any]], must: Must, bench: str, folder: Path, sequence: str = SEQUENCE
) -> Cell:
    """Run a schedule in a new folder and compare with what must come of it."""
    folder.mkdir(parents=True)
    expect = {"exit_status": must.exit_status, "words": must.words}
    if must.within_s is not None:
        expect["deenergised_within_s"] = must.within_s
    schedule = {"faults": 1, "rows": [{**row, "expect": expect} for row in rows]}
    (folder / "faults.yaml").write_text(yaml.safe_dump(schedule))
    (folder / "sequence.yaml").write_text(sequence)
    run = folder / "run"
    arguments = ["run", str(folder / "sequence.yaml"), "--bench", bench, "--yes", "--out", str(run)]
    arguments += ["--faults", str(folder / "faults.yaml")]
    code = _run_and_die(arguments, folder) if must.exit_status < 0 else _run(arguments)
    findings = json.loads((run / "faults.json").read_text())["faults"]
    log = (
        recover(run) and read_run(run / "recording.mcap")
        if code < 0
        else read_run(run / "recording.mcap")
    )
    record = json.loads((run / "run.json").read_text())
    problems = list(_problems(must, code, findings, log, record))
    off = findings[-1]["off_after_s"]
    rode = code == 0 and must.within_s is None
    text = f"{code}" if rode else f"{code}, {off:.2f} s" if off is not None else f"{code}, ON"
    if not rode and not must.verified:
        text += "*"
    if case_moves(rows):
        text += f", {findings[-1]['peak_deg_s']:.0f} deg/s, {findings[-1]['travel_deg']:.1f} deg"
    return Cell(text + (" !!" if problems else ""), tuple(problems))


def case_moves(rows: list[dict[str, Any]]) -> bool:
    """Return whether a fault makes the joint run away, so that its motion is shown."""
    return any(row["fault"] in ("velocity_sign", "position_sign", "phases_swapped") for row in rows)


def _run(arguments: list[str]) -> int:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return status(arguments)


def _run_and_die(arguments: list[str], folder: Path) -> int:
    code = "import sys; from rig.cli.entry import status; sys.exit(status(sys.argv[1:]))"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, cwd=folder
    ).returncode


def _problems(
    must: Must, code: int, findings: list[dict[str, Any]], log: Log, record: dict[str, Any]
) -> Iterator[str]:
    for finding in findings:
        yield from finding["remarks"]
        if finding["applied_s"] is None:
            return
    if code != must.exit_status:
        yield f"exit status {code}, must be {must.exit_status}"
    if (findings[-1]["off_after_s"] is None) is not must.stays_on:
        yield (
            "the drive is still energised"
            if not must.stays_on
            else "the drive is off, and must be on"
        )
    if code >= 0 and record["de_energised"] is not must.verified and record["state"] != "running":
        yield f"run.json says de_energised {record['de_energised']}, must be {must.verified}"
    zero_ns = int(log.metadata.get(CLOCK_METADATA, {}).get("zero_ns", 0))
    last_s = (
        max(
            (frame.time_ns for m in log.messages["/frames"] for frame in decode_frames(m.data)),
            default=0,
        )
        + zero_ns
    ) / 1e9
    if last_s < findings[0]["applied_s"] - LOG_GAP_S:
        yield f"the log ends at {last_s:.3f} s, the fault came at {findings[0]['applied_s']:.3f} s"
    if log.damage is None and code >= 0 and log.events[-1].get("message") != record["message"]:
        yield f"the log's last words are {log.events[-1]}"


def state_rows(state: str, transport: Transport) -> tuple[list[dict[str, Any]], Must]:
    """Return the schedule that lets the drive fault in a 402 state, and what must follow."""
    fails = dict(fault("drive", "fault", value=transport.code))
    words = f"{transport.code:04X}h"
    row = fails | {"state": state}
    lead = {"phase": "excite", "after_s": 0.1}
    if state == "quick_stop_active":
        return [{**fault("operator", "stop"), **lead}, row | {"after_s": 0.005}], Must(
            3, "stopped", BRAKE_S
        )
    if state == "fault_reaction":
        before = fails | {"value": transport.code + 0x10} | lead
        return [before, row | {"after_s": 0.005}], Must(4, transport.in_reaction, BRAKE_S)
    if state == "switch_on_disabled":
        return [fails | {"phase": "prompt"}], Must(4, words, 0.0)
    return [row], Must(4, words, BRAKE_S)


def matrix(folder: Path, words: list[str]) -> tuple[list[str], list[str]]:
    """Run everything whose name holds one of the words; return tables and problems."""
    lines: list[str] = []
    problems: list[str] = []
    for line, transport in TRANSPORTS.items():
        lines += [
            f"### {line}",
            "",
            f"| fault | {' | '.join(PHASES)} |",
            "|---" * (len(PHASES) + 1) + "|",
        ]
        for name, case in transport.cases.items():
            if not any(word in name for word in words):
                continue
            cells = {
                p: run_case(case, p, transport.bench, folder / f"{line} {name} {p}") for p in PHASES
            }
            lines.append(f"| {name} | {' | '.join(cell.text for cell in cells.values())} |")
            problems += [
                f"{line}: {name}, {p}: {problem}"
                for p, cell in cells.items()
                for problem in cell.problems
            ]
            print(lines[-1], flush=True)
        states = transport.states
        cells = {
            s: run_rows(*state_rows(s, transport), transport.bench, folder / f"{line} {s}")
            for s in states
        }
        lines += [
            "",
            f"| drive fault in | {' | '.join(states)} |",
            "|---" * (len(states) + 1) + "|",
        ]
        lines += [f"| | {' | '.join(cell.text for cell in cells.values())} |", ""]
        problems += [
            f"{line}: fault in {s}: {problem}"
            for s, cell in cells.items()
            for problem in cell.problems
        ]
        print(lines[-2], flush=True)
    return lines, problems


ENDS: Mapping[str, tuple[Mapping[str, Any], ...]] = {
    "ramp: stop of the operator (605Ah = 2)": (fault("operator", "stop"),),
    "ramp of the drive: drive fault": (fault("drive", "fault", value=0x31),),
    "cut from motion: stop with 605Ah = 0": (
        fault("drive", "quick_stop_option", value=0),
        fault("operator", "stop"),
    ),
    "cut: speed loop of the wrong sign": (fault("drive", "velocity_sign"),),
    "cut: position loop of the wrong sign": (fault("drive", "position_sign"),),
    "cut: motor phases swapped": (fault("drive", "phases_swapped"),),
    "watchdog: the host is silent": (fault("bus", "lost", frames={"device": "host"}, count=0),),
}
"""What ends a motion, and the faults that cause it."""


def stops(folder: Path) -> list[str]:
    """Return the table of the stops of each transport, from a motion of about 45 deg/s: the time
    until the power is off, the true travel until the joint rests, and the true peak speed.
    """
    lines = [f"| stop | {' | '.join(TRANSPORTS)} |", "|---" * (len(TRANSPORTS) + 1) + "|"]
    for name, rows in ENDS.items():
        cells = [
            stop_cell(transport, rows, folder / f"{line} {name[:8]} {n}")
            for n, (line, transport) in enumerate(TRANSPORTS.items(), len(lines) * 10)
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    return lines


def stop_cell(transport: Transport, rows: tuple[Mapping[str, Any], ...], folder: Path) -> str:
    """Return time, travel and peak speed of one stop; empty if the bench has no such fault."""
    folder.mkdir(parents=True)
    (folder / "sequence.yaml").write_text(SEQUENCE)
    timed = [{**row, "phase": "excite", "after_s": 0.25} for row in rows]
    (folder / "faults.yaml").write_text(yaml.safe_dump({"faults": 1, "rows": timed}))
    run = folder / "run"
    arguments = ["run", str(folder / "sequence.yaml"), "--bench", transport.bench, "--yes"]
    if _run([*arguments, "--out", str(run), "--faults", str(folder / "faults.yaml")]) == 2:
        return ""
    found = json.loads((run / "faults.json").read_text())["faults"][-1]
    off = "stays on" if found["off_after_s"] is None else f"{found['off_after_s']:.3f} s"
    return f"{off}, {found['travel_deg']:.2f} deg, {found['peak_deg_s']:.0f} deg/s"


def main() -> int:
    """Run the matrix, print and write it; with words given, only print the rows that hold one."""
    words = sys.argv[1:]
    with tempfile.TemporaryDirectory() as folder:
        table = stops(Path(folder)) if words in ([], ["stops"]) else []
        if words == ["stops"]:
            return 0
        lines, problems = matrix(Path(folder), words or [""])
    for problem in problems:
        print(problem)
    if words:
        return 1 if problems else 0
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text("\n".join([*table, "", *lines]), encoding="utf-8")
    cells = sum(len(t.cases) * len(PHASES) + len(t.states) for t in TRANSPORTS.values())
    print(f"{cells} cells on {len(TRANSPORTS)} transports, {len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
