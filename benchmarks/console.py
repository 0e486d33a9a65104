"""From STOP on the page to the drive read back as off, and the lateness of the control loop with
pages that watch and without.

python benchmarks/console.py latency [--bench BENCH ...] [--presses 100] [--realtime]
python benchmarks/console.py latency --wire WIRE ... [--presses 100]
python benchmarks/console.py lateness [--seconds 80]
python benchmarks/console.py crowd [--presses 20] [--connections 300]

A console, the runs and this script are processes of their own. A press is a POST request, as the
page sends it; it goes from the console through the run's control socket to the control loop. All
times are of the monotonic clock of this computer, which its processes share.

With --wire the bench is one more process, behind pseudo-terminals or a loopback socket, and states
when the power stage of its drive went off.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from console_page import Console

from rig.common.tables import table

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.long.benches import TRANSPORTS, Bench, bench_process

BENCHES = ("practical", "practical_serial", "odrive_can")
SPREAD_S = 1.2
"""A press comes at a random moment of this length after the first excitation began."""
UNKNOWN = "this run is unknown"
"""Part of the answer until the console has found the run."""
TAKEN = '{"words": "taken"}'
WIRE_HZ = {"serial": 100}
"""Control cycle where it is not 250 Hz."""
WATCHED_S = 5.0
"""Length of each part with and without pages."""
PAGES = 3
POINTS = (50.0, 99.0, 99.9)


@dataclass
class Desk:
    """What was started: a console, a process that runs, and what they report.

    Attributes:
        console: The console.
        lines: The lines of the process that runs.
    """

    console: Console
    lines: Iterator[dict[str, Any]]


@contextmanager
def started(
    bench: str, count: int, realtime: bool, log: bool, wire: Bench | None = None
) -> Iterator[Desk]:
    """Start a console and a process that runs."""
    with ExitStack() as stack:
        runtime = stack.enter_context(tempfile.TemporaryDirectory(prefix="rig-", dir="/tmp"))
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        environment = {} if wire is None else wire.env
        console = Console(runtime, str(folder / "runs"), environment)
        stack.callback(console.process.wait)
        stack.callback(console.process.terminate)
        if wire is not None:
            bench = str(
                wire.write_file(
                    folder, cycle_Hz=WIRE_HZ.get(wire.transport, 250), sample_age_ms=500
                )
            )
        script = Path(__file__).with_name("console_host.py")
        run = subprocess.Popen(
            [sys.executable, script, bench, str(count), str(int(realtime)), str(int(log))],
            stdout=subprocess.PIPE,
            text=True,
            env=console.environment,
        )
        stack.callback(run.wait)
        # A process that is told to stop begins its next run: it has to be killed.
        stack.callback(run.kill)
        assert run.stdout is not None
        yield Desk(console, map(json.loads, run.stdout))


def latency(bench: str, presses: int, realtime: bool, wire: Bench | None = None) -> list[str]:
    """Press STOP in many runs, each at a random moment of its motion; return a row of the table."""
    chance = random.Random(0)
    off, answered, device = [], [], []
    phases, unverified, unconfirmed, faults, ended = Counter[str](), 0, 0, 0, 0
    parts: list[list[float]] = [[], [], []]
    with started(bench, presses, realtime, False, wire) as desk:
        for _ in range(presses):
            run = next(desk.lines)["run"]
            if "phase" not in (begun := next(desk.lines)) or "known_ns" in begun:
                ended += 1
                continue
            time.sleep(chance.uniform(0.0, SPREAD_S))
            words = UNKNOWN
            while UNKNOWN in words:
                pressed, taken, words = desk.console.stop(run)
            end = next(desk.lines)
            if "taken_ns" not in end:
                # The run had ended by itself: a bench that this computer held up.
                ended += 1
                continue
            unconfirmed += words != TAKEN
            off.append((end["known_ns"] - pressed) * 1e-6)
            stood = end.get("stood_ns", end["known_ns"])
            marks = [pressed, end["taken_ns"], stood, end["known_ns"]]
            for part, (begin, finish) in zip(parts, pairwise(marks), strict=True):
                part.append((finish - begin) * 1e-6)
            answered.append((taken - pressed) * 1e-6)
            phases[end["phase"]] += 1
            unverified += not end["verified"]
            faults += end["ending"] != "stopped"
            if not end["verified"] or end["ending"] != "stopped":
                print(end["message"], file=sys.stderr)
            if wire is not None:
                after_s = wire.account().off_after_s(pressed)
                device.append(np.inf if after_s is None else 1e3 * after_s)
    return [
        bench,
        "real" if realtime else "simulated",
        str(len(off)),
        *(f"{np.percentile(off, point):.0f}" for point in (50, 99, 100)),
        f"{np.percentile(device, 99):.0f}" if device else "-",
        f"{np.percentile(answered, 99):.0f}",
        *("{:.0f}, {:.0f}".format(*np.percentile(part, (50, 99))) for part in parts),
        str(unverified),
        str(unconfirmed),
        str(faults),
        str(ended),
        ", ".join(f"{name} {n}" for name, n in phases.most_common()),
    ]


def latencies(given: argparse.Namespace) -> None:
    """Print one table of all benches and wires."""
    rows = []
    for wire in given.wire or ():
        with bench_process(wire) as bench:
            rows.append(latency(wire, given.presses, True, bench))
    for name in given.bench or (() if given.wire else BENCHES):
        rows.append(latency(name, given.presses, given.realtime))
    heads = ["bench", "time", "presses", "p50 ms", "p99 ms", "most ms", "at the device p99"]
    heads += ["answer p99 ms", "to the loop p50, p99", "ramp", "off and read back"]
    heads += ["not off", "not confirmed", "fault meanwhile", "ended before", "phases"]
    print(table(heads, rows, right=list(range(2, len(heads) - 1))))
    _print_load()


def lateness(seconds: float) -> None:
    """Print the lateness of one run in parts with and without pages, and the console's load."""
    with started("practical", 1, True, True) as desk:
        console = desk.console
        run = next(desk.lines)["run"]
        next(desk.lines)
        watched, load = [], []
        counts: list[int] = []
        process = psutil.Process(console.process.pid)
        for _ in range(max(1, round(seconds / 2 / WATCHED_S))):
            time.sleep(WATCHED_S)
            ending = threading.Event()
            given = (ending, counts)
            pages = [threading.Thread(target=console.watch, args=given) for _ in range(PAGES)]
            for page in pages:
                page.start()
            time.sleep(1.0)
            began, used = time.monotonic_ns(), sum(process.cpu_times()[:2])
            time.sleep(WATCHED_S)
            ended = time.monotonic_ns()
            load.append((sum(process.cpu_times()[:2]) - used) / ((ended - began) * 1e-9))
            watched.append((began, ended))
            ending.set()
            for page in pages:
                page.join()
        console.stop(run)
        next(desk.lines)
        late = np.array(next(desk.lines)["late"], dtype=np.float64)
    inside = np.zeros(len(late), dtype=bool)
    for begin, end in watched:
        inside |= (late[:, 0] >= begin) & (late[:, 0] <= end)
    # Parts as long before each watched one.
    before = np.zeros(len(late), dtype=bool)
    for begin, _ in watched:
        start = begin - (WATCHED_S + 1.0) * 1e9
        before |= (late[:, 0] >= start) & (late[:, 0] <= begin - 1e9)
    rows = []
    for point in POINTS:
        with_pages, without = (
            np.percentile(late[part, 1], point) * 1e-3 for part in (inside, before)
        )
        ratio = with_pages / max(without, 1e-9)
        rows.append([f"p{point:g}", f"{without:.0f}", f"{with_pages:.0f}", f"{ratio:.2f}"])
    print(table(["lateness", "no page, us", f"{PAGES} pages, us", "ratio"], rows, right=[1, 2, 3]))
    print(f"cycles: {before.sum()} without, {inside.sum()} with {PAGES} pages")
    print(f"sent to each page: {np.mean(counts) / (WATCHED_S + 1.0) / 1e3:.0f} kB/s")
    print(f"load of the console with {PAGES} pages: {100 * float(np.mean(load)):.1f} % of a core")
    _print_load()


def crowds(presses: int, count: int) -> None:
    """Print the time from STOP to its answer, without other connections and with many of each
    kind: idle, reading pages, pages without the token, and pages with it.
    """
    rows = []
    for kind in ("none", "idle", "requests", "pages", "pages with the token"):
        with started("practical", presses, True, False) as desk, ExitStack() as stack:
            if kind != "none":
                token = desk.console.token if kind.endswith("token") else ""
                ending = threading.Event()
                crowd = threading.Thread(
                    target=desk.console.crowd, args=(kind, count, token, ending)
                )
                crowd.start()
                stack.callback(crowd.join)
                stack.callback(ending.set)
                time.sleep(3.0)
            answers, unconfirmed = [], 0
            for _ in range(presses):
                run = next(desk.lines)["run"]
                next(desk.lines)
                words = UNKNOWN
                while UNKNOWN in words:
                    pressed, taken, words = desk.console.stop(run)
                unconfirmed += words != TAKEN
                answers.append((taken - pressed) * 1e-6)
                next(desk.lines)
        points = (f"{np.percentile(answers, point):.0f}" for point in (50, 90, 100))
        rows.append([kind, str(len(answers)), *points, str(unconfirmed)])
    heads = [f"{count} connections", "presses", "p50 ms", "p90 ms", "most ms", "not confirmed"]
    print(table(heads, rows, right=[1, 2, 3, 4, 5]))
    _print_load()


def _print_load() -> None:
    print(f"load of the computer (1 min): {os.getloadavg()[0]:.1f} of {os.cpu_count()} cores")


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["latency", "lateness", "crowd"])
    parser.add_argument("--bench", action="append")
    parser.add_argument("--wire", action="append", choices=sorted(TRANSPORTS))
    parser.add_argument("--presses", type=int, default=100)
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("--seconds", type=float, default=80.0)
    parser.add_argument("--connections", type=int, default=300)
    given = parser.parse_args()
    if given.what == "crowd":
        crowds(given.presses, given.connections)
    elif given.what == "lateness":
        lateness(given.seconds)
    else:
        latencies(given)


if __name__ == "__main__":
    main()
