"""Failures of the process, adapter, terminal and disk of a run, in every phase on every transport,
each compared with the required outcome.

`python -m tests.long.process_matrix` runs all cells, the transports in parallel, and writes the
tables to out/process_matrix.md. `--only WORDS`, names of columns, transports or phases
separated by commas, runs the cells that match all names and prints the result only.
"""

import argparse
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.clock import NS

from .benches import TRANSPORTS, Account, Bench, bench_process
from .console import RIG, ROOT, START_KEY, STOP_KEY, WITNESS, Console, Streams, rig_off, unwrapped
from .process_cases import (
    ALONE,
    ASKING,
    BACK_S,
    COLUMNS,
    CYCLING,
    LEFT_S,
    LIMITS,
    OUT_S,
    PHASES,
    SECOND_STAGE,
    SEQUENCE,
    START,
    STARTS,
    SUSPENDED_S,
    Must,
)
from .process_checks import BUSY, MissedError, Scene, last_words, problems, verified

PAGE = Path("out/process_matrix.md")
PATIENCE_S = 15.0
START_S = 40.0
STALLED_S = 1.0
SECOND_S = 0.15
"""How long a run is held at its end for a second program to ask for its bench, s; less than any
watchdog.
"""
REPEATS = 4
_READ_ONLY = (
    "unshare",
    "-m",
    "sh",
    "-c",
    'mount --bind "$0" "$0" && mount -o remount,ro,bind "$0" && exec "$@"',
)
_stopping = threading.Event()
_SIGNALS = {
    name: getattr(signal, name) for name in ("SIGHUP", "SIGTERM", "SIGTSTP", "SIGQUIT", "SIGKILL")
}


@dataclass(frozen=True)
class Cell:
    """Outcome of one failure in one phase on one transport.

    Attributes:
        text: Entry of the table.
        problems: Requirements that were not met.
        busy: Number of repeats because the machine was too busy.
    """

    text: str
    problems: tuple[str, ...]
    busy: int = 0


Cells = dict[tuple[str, str, str], Cell]
"""Outcome by column, transport and phase."""


def started(column: str, phase: str, bench: Bench, folder: Path, disk: Path) -> Scene:
    """Start a run, and whatever must stand by."""
    bench.renew()
    file = bench.write_file(folder)
    sequence = folder / "sequence.yaml"
    sequence.write_text(SEQUENCE + (SECOND_STAGE if phase == "between" else ""))
    home = folder / "home"
    home.mkdir()
    words = ["run", str(sequence), "--bench", str(file), "--out", str(disk / "run")]
    if phase == "approach":
        # Only without a first pass is there a way to go from rest.
        words.append("--no-first-pass")
    if column in STARTS:
        (stdin, stdout), sure, _ = STARTS[column]
        console = Console(
            [*words, *(["--yes"] if sure else [])], folder, bench.env, Streams(stdin, stdout)
        )
        return Scene(column, phase, bench, folder, disk, console)
    streams = Streams(
        "pipe" if column == "stdin closed" else "tty",
        "pipe" if column == "stdout closed" else "tty",
    )
    stage, name, after_s = PHASES[phase]
    gate = "" if after_s else f"{stage}/{name}"
    env = bench.env | {"HOME": str(home)}
    program, prefix = WITNESS, ()
    if column == "HOME not writable" and phase == "prompt":
        _spoil(home)
        program, prefix = RIG, (*_READ_ONLY, str(ROOT))  # type: ignore[assignment]
    console = Console(words, folder, env, streams, gate, program, prefix)
    console.hold = phase == "prompt"
    scene = Scene(column, phase, bench, folder, disk, console)
    if column == "second program":
        scene.second = Console(
            ["jog", str(file), "--to", "3"],
            folder,
            bench.env | {"WITNESS_READY": "1"},
            Streams("closed"),
            "ready",
        )
    return scene


def _spoil(home: Path) -> None:
    """Put a file where the folder was: nothing can be written below it, whoever tries."""
    shutil.rmtree(home)
    home.write_text("")


def fill(disk: Path, pid: int) -> None:
    """Leave a process no room on a file system of its own; no file may grow where it has none."""
    if not disk.is_mount():
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (0, 0))
        return
    with open(disk / "filler", "wb", buffering=0) as stream, suppress(OSError):
        while True:
            stream.write(bytes(1 << 16))
    with open(disk / "filler", "ab", buffering=0) as stream, suppress(OSError):
        while True:
            stream.write(bytes(256))


def befall(scene: Scene) -> int:
    """Let it happen; returns when, ns."""
    column, console = scene.column, scene.console
    now = time.monotonic_ns()
    if column in STARTS:
        return now
    if column in _SIGNALS:
        return console.signal(_SIGNALS[column])
    match column:
        case "adapter gone":
            return scene.bench.unplug()
        case "line garbage":
            return scene.bench.garbage(len(scene.phase))
        case "second program":
            scene.second.open_gate()
        case "terminal stalled":
            console.key(STOP_KEY)
        case "terminal gone":
            console.hang_up()
        case "stdout closed":
            console.close_stdout()
        case "stdin closed":
            console.close_stdin()
        case "disk full":
            fill(scene.disk, console.pid)
        case "HOME not writable":
            if scene.phase != "prompt":
                _spoil(scene.folder / "home")
        case "suspended 2 s":
            return console.signal(signal.SIGSTOP)
        case "adapter out 2 s":
            return scene.bench.unplug()
        case "guardian hangs":
            send(console, signal.SIGSTOP, alone=True)
        case "both frozen":
            send(console, signal.SIGSTOP)
        case "both killed":
            send(console, signal.SIGKILL)
        case "computer asleep":
            return console.signal(signal.SIGUSR2)
        case "folder deleted":
            shutil.rmtree(scene.run)
    return now


def send(console: Console, number: signal.Signals, alone: bool = False) -> None:
    """Send a signal to the guardian, and to its program unless it is alone."""
    guardians = console.guardians()
    if not guardians:
        raise MissedError("there is no guardian")
    for pid in guardians:
        os.kill(pid, number)
    if not alone:
        console.signal(number)


def switch_off(scene: Scene) -> None:
    """Use `rig off` as the operator does who finds that nobody is left."""
    scene.console.pause(LEFT_S)
    if not scene.bench.account().on:
        scene.also.append("the drive is off although nobody was left to switch it off")
    if not re.search("killed or frozen at once", unwrapped(scene.console.text())):
        scene.also.append("the run did not say before that nothing protects then")
    if problem := rig_off(scene.folder / "bench.yaml", scene.bench.env):
        scene.also.append(problem)


def reach(scene: Scene) -> None:
    """Wait until the phase is there."""
    console, second = scene.console, scene.second
    if scene.phase == START:
        return
    stage, name, after_s = PHASES[scene.phase]
    if second is not None and not second.until(lambda: second.notices or second.ended, START_S):
        raise MissedError("the second program did not start")
    if scene.phase in ASKING:
        wanted = 1 + (scene.phase == "between")
        reached = console.until(lambda: len(console.asked_ns) >= wanted or console.ended, START_S)
        console.hold = True
        console.pause(after_s)
    else:
        reached = console.until(lambda: console.at(stage, name) or console.ended, START_S)
        began = console.at(stage, name)
        if began is not None and after_s:
            left_s = after_s - (time.monotonic_ns() - began) / NS
            console.pause(max(0.0, left_s))
    if console.ended and scene.column == "HOME not writable" and scene.phase == "prompt":
        # That it never asks is what came of it.
        return
    if not reached or console.ended:
        raise MissedError(f"phase {scene.phase} was never reached: {last_words(console.text())}")


def aftermath(scene: Scene, ns: int) -> None:
    """Do what the operator does after that, until the run has ended or should have."""
    console, column = scene.console, scene.column
    if scene.second is not None and scene.phase == "disable":
        # A run that is over gives its bench to whoever asks next: it must still be there when the
        # second one asks.
        scene.second.until(lambda: scene.second is None or scene.second.ended, SECOND_S)
    if scene.phase != START and not PHASES[scene.phase][2]:
        console.open_gate()
    if scene.second is not None:
        second = scene.second
        if not second.until(lambda: second.ended, PATIENCE_S):
            scene.also.append("the second program did not end")
        console.pause(0.2)
    if column == "suspended 2 s":
        time.sleep(max(0.0, SUSPENDED_S - (time.monotonic_ns() - ns) / NS))
        console.signal(signal.SIGCONT)
    if column == "adapter out 2 s":
        console.pause(max(0.0, OUT_S - (time.monotonic_ns() - ns) / NS))
        scene.bench.plug()
    if column in ALONE:
        switch_off(scene)
    if column == "terminal stalled":
        _stalled(scene)
    console.hold = False
    stands = column != "suspended 2 s"
    patience_s = PATIENCE_S + (START_S if scene.phase == START else 0.0)
    if not console.until(lambda: console.ended or (stands and console.stops), patience_s):
        scene.also.append(f"still running {patience_s:g} s later: {last_words(console.text(ns))}")
    if column == "SIGKILL":
        console.until(scene.report.exists, 1.5 if scene.bench.transport == "serial" else 0.5)
    if scene.guarded and column == "adapter out 2 s":
        console.until(lambda: verified(scene.report) or not scene.bench.account().on, 2.0 * BACK_S)
        console.until(lambda: verified(scene.report), 0.5)
    console.pause(0.3)


def _stalled(scene: Scene) -> None:
    """Wait for the end of a run that nobody can see, then look at it."""
    console = scene.console
    if scene.phase in ASKING:
        console.pause(STALLED_S)
    else:
        state = scene.run / "run.json"
        over = console.until(
            lambda: console.ended or _state(state) not in ("", "running"), PATIENCE_S / 2
        )
        if not over:
            scene.also.append("the run does not go on while the terminal is stalled")
        if scene.bench.account().on:
            scene.also.append("the drive is on while the terminal is stalled and the run is over")
    console.key(START_KEY)


def _state(file: Path) -> str:
    try:
        return str(json.loads(file.read_text())["state"])
    except (OSError, ValueError):
        return ""


def once(column: str, phase: str, bench: Bench, folder: Path, disk: Path) -> tuple[Cell, bool]:
    """Do a cell."""
    at_start = column in STARTS
    must = STARTS[column][2] if at_start else COLUMNS[column].required(bench.transport, phase)
    scene = started(column, phase, bench, folder, disk)
    try:
        reach(scene)
        ns = befall(scene)
        aftermath(scene, ns)
        account = bench.account()
        _in_phase(scene, ns, account)
        found = tuple(problems(scene, must, ns, account))
        late = (at_start or COLUMNS[column].busy) and BUSY.search(scene.console.text(ns))
        busy = bool(late) or any(ns < when < ns + NS for when, _ in account.pauses)
        return Cell(_cell_text(scene, must, ns, account, found), found), busy
    finally:
        scene.console.close()
        if scene.second is not None:
            scene.second.close()


def _in_phase(scene: Scene, ns: int, account: Account) -> None:
    """Check that it happened where it should."""
    if scene.phase == START:
        return
    before = [notice for notice in scene.console.notices if notice["ns"] <= ns]
    stage, name, _ = PHASES[scene.phase]
    if before and (before[-1]["stage"], before[-1]["phase"]) != (stage, name):
        raise MissedError(f"it happened in phase {before[-1]['phase']}, not in {scene.phase}")
    if scene.phase in CYCLING and not account.on_at(ns):
        raise MissedError(f"the drive was off in {scene.phase}: {last_words(scene.console.text())}")


def _cell_text(scene: Scene, must: Must, ns: int, account: Account, found: Sequence[str]) -> str:
    status = scene.console.status
    text = "-" if status is None else f"{status}"
    off_s = account.off_after_s(ns)
    if status != 0 or scene.column == "SIGKILL":
        text += (
            ", ON"
            if off_s is None
            else f", {off_s:.2f} s"
            if account.ever_on(ns, ns + NS)
            else ", off"
        )
        if must.verified is False or not must.told:
            text += "*"
    return text + (" !!" if found else "")


def cell(column: str, phase: str, bench: Bench, folder: Path, disk: Path) -> Cell:
    """Do a cell, again where the machine was too busy for it or the moment was missed."""
    made = Cell("?", ("never done",))
    for attempt in range(REPEATS):
        place = folder / f"{column} {phase} {attempt}".replace(" ", "_")
        place.mkdir(parents=True)
        for entry in disk.iterdir():
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
        try:
            made, busy = once(column, phase, bench, place, disk)
        except MissedError as error:
            made, busy = Cell("? !!", (str(error),)), True
        made = replace(made, busy=attempt)
        if not made.problems or not busy:
            break
    return made


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """Make a file system of its own that can be filled; a mere folder where that is not allowed."""
    disk = folder / "disk"
    disk.mkdir(parents=True)
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=48m", "tmpfs", str(disk)], capture_output=True
    )
    if mounted.returncode:
        print(
            "no file system of its own can be mounted; a full disk is a limit on the size of "
            "files instead"
        )
    try:
        yield disk
    finally:
        if not mounted.returncode:
            subprocess.run(["umount", "-l", str(disk)], check=True)


Wanted = Callable[[str, str, str], bool]


def on_transport(transport: str, wanted: Wanted, folder: Path) -> Cells:
    """Do all cells of a transport, one after another."""
    cells: Cells = {}
    todo = [
        (name, phase)
        for name, column in COLUMNS.items()
        for phase in column.phases
        if transport in column.transports
    ] + [(start, START) for start in STARTS]
    todo = [(column, phase) for column, phase in todo if wanted(column, transport, phase)]
    if not todo:
        return cells
    with small_disk(folder) as disk, bench_process(transport) as bench:
        for column, phase in todo:
            if _stopping.is_set():
                break
            began = time.monotonic()
            made = cells[column, transport, phase] = cell(column, phase, bench, folder, disk)
            again = f", {made.busy} repeats" if made.busy else ""
            print(
                f"{transport}, {column}, {phase}: {made.text} ({time.monotonic() - began:.1f} "
                f"s{again})",
                flush=True,
            )
            for problem in made.problems:
                print(f"    {problem}", flush=True)
    return cells


def tables(cells: Cells) -> list[str]:
    """Return the tables of the page."""
    lines: list[str] = []
    rule = "|---" * (len(PHASES) + 1) + "|"
    for transport in TRANSPORTS:
        lines += [f"## {transport}", "", f"| | {' | '.join(PHASES)} |", rule]
        for column in COLUMNS:
            row = [cells.get((column, transport, phase), Cell("", ())).text for phase in PHASES]
            if any(row):
                lines.append(f"| {column} | {' | '.join(row)} |")
        lines.append("")
    lines += ["## From the start", "", f"| | {' | '.join(TRANSPORTS)} |"]
    lines.append("|---" * (len(TRANSPORTS) + 1) + "|")
    for start in STARTS:
        row = [cells.get((start, transport, START), Cell("", ())).text for transport in TRANSPORTS]
        lines.append(f"| `rig run ... {start}` | {' | '.join(row)} |")
    return [*lines, ""]


def main() -> int:
    """Do the cells; 1 where something is not as it must be."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", default="", help="words with commas between; several of one kind are alternatives"
    )
    options = parser.parse_args()
    words = [word.strip() for word in options.only.split(",") if word.strip()]
    names = [[*COLUMNS, *STARTS], [*TRANSPORTS], [*PHASES, START]]
    kinds = [[word for word in words if word in kind] for kind in names]
    if sum(map(len, kinds)) != len(words):
        parser.error(f"--only takes of {', '.join(word for kind in names for word in kind)}")

    def wanted(*place: str) -> bool:
        return all(not chosen or name in chosen for name, chosen in zip(place, kinds, strict=True))

    signal.signal(signal.SIGTERM, signal.default_int_handler)
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(len(TRANSPORTS)) as pool:
        futures = [pool.submit(on_transport, t, wanted, Path(name) / t) for t in TRANSPORTS]
        try:
            cells = {place: made for future in futures for place, made in future.result().items()}
        finally:
            _stopping.set()
    bad = sum(bool(made.problems) for made in cells.values())
    again = sum(made.busy for made in cells.values())
    lines = [
        *tables(cells),
        f"{len(cells)} cells in {(time.monotonic() - began) / 60:.1f} min; {bad} bad; {again} "
        "repeats because the machine was too busy or the moment was missed",
    ]
    print("\n".join(lines))
    if not words:
        PAGE.parent.mkdir(exist_ok=True)
        head = [f"- **{name}**: {column.words}" for name, column in COLUMNS.items()]
        text = "\n".join([*head, "", f"**Limits.** {LIMITS}", "", *lines, ""])
        PAGE.write_text(text, encoding="utf-8")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
