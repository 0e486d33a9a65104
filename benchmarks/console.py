"""From STOP on the page to the drive read back as off, and the lateness of the control loop with
pages that watch and without.

python benchmarks/console.py latency [--bench BENCH ...] [--presses 100] [--realtime]
python benchmarks/console.py lateness [--seconds 80]

A console, the runs and this script are processes of their own. A press is a POST request, as the
page sends it; it goes from the console through the run's control socket to the control loop. All
times are of the monotonic clock of this computer, which its processes share.
"""

from __future__ import annotations

import argparse
import base64
import dataclasses
import http.client
import json
import os
import random
import re
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from rig.common.phase import Phase
from rig.common.sample import Sample
from rig.common.tables import table
from rig.common.timing import Histogram
from rig.config.bench import load_bench
from rig.config.configuration import load_located
from rig.config.sequence import Sequence
from rig.control.operator import AutomaticOperator
from rig.control.progress import RunProgress
from rig.control.remote import observed, reachable
from rig.control.session import Inputs, execute
from rig.planning import plan as planning
from rig.planning.limits import Limits
from rig.planning.plan import make_plan
from rig.runs.run import create_folder
from rig.terminal.screen import Screen
from rig.terminal.stop_button import StopButton
from rig.wiring import teardown
from rig.wiring.connect import connect

SEQUENCE = """\
sequence: 1
name: pressed
limits: {speed_deg_s: 20}
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 2, frequency_Hz: 1}], repeats: 300,
     duration_s: 1, ramp_in_s: 0.2, ramp_out_s: 0.2, settle_s: 0.2}
"""
BENCHES = ("practical", "practical_serial", "odrive_can")
SPREAD_S = 1.2
"""A press comes at a random moment of this length after the first excitation began."""
UNKNOWN = "this run is unknown"
TAKEN = '{"words": "taken"}'
"""Part of the answer until the console has found the run."""
WATCHED_S = 5.0
"""Length of each part with and without pages."""
PAGES = 3
POINTS = (50.0, 99.0, 99.9)


class TimedOperator(AutomaticOperator):
    """Notes when the final state of the drive is known."""

    def result(self, words: str, good: bool) -> None:
        """Note the moment, then show as usual."""
        self.known_ns = time.monotonic_ns()
        super().result(words, good)


class Announcer:
    """Prints the first beginning of an excitation, and passes every phase on."""

    def __init__(self, following: Callable[[str, Phase], None] | None) -> None:
        self._following = following
        self._said = False

    def __call__(self, stage: str, phase: Phase) -> None:
        """Note the start of a phase."""
        if self._following is not None:
            self._following(stage, phase)
        if phase is Phase.EXCITE and not self._said:
            self._said = True
            say(phase=phase.value)


def host(bench_name: str, count: int, realtime: bool, log: bool) -> None:
    """Run the sequence ``count`` times, and print one line of JSON per event: the process that is
    pressed.
    """
    # The computer is shared while this is measured; lateness is recorded, and ends no run.
    limits = planning._limits
    planning._limits = lambda values, bench: _patient(limits(values, bench))
    marks: dict[str, int] = {}
    _noted(marks)
    late: list[tuple[int, int]] = []
    if log:
        note = Histogram.note
        Histogram.note = lambda self, value: (  # type: ignore[method-assign]
            late.append((time.monotonic_ns(), value)),
            note(self, value),
        )[1]
    bench = load_bench(bench_name)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "pressed.yaml"
        path.write_text(SEQUENCE)
        sequence = load_located(path, Sequence)
        plan = make_plan(sequence, bench)
        inputs = Inputs(bench, sequence, 0, realtime)
        for number in range(count):
            folder = Path(name) / str(number)
            marks.clear()
            screen = Screen()
            with (
                StopButton() as stop,
                reachable(stop, screen, inputs, plan, folder, required=True) as control,
                create_folder(folder, "benchmark"),
                connect(bench, 0, realtime) as devices,
            ):
                assert control is not None
                operator = TimedOperator(screen=screen, control=control)
                progress = RunProgress(plan.cycle_s, plan.duration_s, screen)
                say(run=control.run)
                devices = observed(devices, control, progress)
                devices = dataclasses.replace(devices, observer=Announcer(devices.observer))
                _, outcome = execute(inputs, plan, devices, folder, operator, stop, _silent)
            phase = re.search(r"phase ([^:]+):", outcome.message)
            say(
                **marks,
                known_ns=operator.known_ns,
                verified=outcome.safe.verified,
                ending=outcome.ending.value,
                phase=phase[1] if phase else "",
            )
    say(late=late[::2])


def _noted(marks: dict[str, int]) -> None:
    """Note when the loop takes a press, and when the shaft stands, ns."""
    press, wait = StopButton.press, teardown._wait_for_standstill

    def pressed(button: StopButton, cause: str = "") -> None:
        marks.setdefault("taken_ns", time.monotonic_ns())
        press(button, cause)

    def stood(*given: Any) -> None:
        wait(*given)
        marks["stood_ns"] = time.monotonic_ns()

    StopButton.press = pressed  # type: ignore[method-assign]
    teardown._wait_for_standstill = stood


def _patient(limits: Limits) -> Limits:
    return dataclasses.replace(limits, lateness=60.0)


def _silent(stage: str, cycles: int, sample: Sample) -> None:
    pass


def say(**values: object) -> None:
    """Print one line of JSON."""
    print(json.dumps(values), flush=True)


class Console:
    """A console that was started, as a page sees it."""

    def __init__(self, runtime: str, folder: str) -> None:
        self.environment = {**os.environ, "XDG_RUNTIME_DIR": runtime}
        entry = "from rig.cli.entry import main; main()"
        self.process = subprocess.Popen(
            [sys.executable, "-c", entry, "console", "--port", "0", "--runs", f"{folder}/runs"],
            stdout=subprocess.PIPE,
            text=True,
            env=self.environment,
        )
        assert self.process.stdout is not None
        address = [self.process.stdout.readline() for _ in range(2)][1].split()[-1]
        self.port = int(re.search(r":(\d+)/", address)[1])  # type: ignore[index]
        self.token = address.partition("#token=")[2]
        self.number = 0

    def stop(self, run: str) -> tuple[int, int, str]:
        """Press STOP; return when it was pressed and when that was answered, ns, and the answer."""
        self.number += 1
        host = f"127.0.0.1:{self.port}"
        connection = http.client.HTTPConnection(host, timeout=10)
        body = {"page": "", "number": self.number, "run": run, "command": "stop"}
        pressed = time.monotonic_ns()
        connection.request(
            "POST",
            "/command",
            json.dumps(body),
            {
                "Origin": f"http://{host}",
                "Authorization": f"Bearer {self.token}",
                "Content-Type": "application/json",
            },
        )
        words = connection.getresponse().read().decode()
        answered = time.monotonic_ns()
        connection.close()
        return pressed, answered, words

    def watch(self, ending: threading.Event, counts: list[int]) -> None:
        """Read all that a page is sent until the event; add its bytes to ``counts``."""
        host = f"127.0.0.1:{self.port}"
        with socket.create_connection(("127.0.0.1", self.port)) as page:
            key = base64.b64encode(os.urandom(16)).decode()
            page.sendall(
                f"GET /live HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
                f"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                f"Sec-WebSocket-Key: {key}\r\n\r\n".encode()
            )
            page.recv(4096)
            for message in ({"token": ""}, {"window_s": 30, "pixels": 500}):
                page.sendall(_frame(json.dumps(message).encode()))
            count = 0
            while not ending.is_set():
                if select.select([page], [], [], 0.5)[0]:
                    count += len(page.recv(1 << 16))
        counts.append(count)


def _frame(data: bytes) -> bytes:
    """Return a text frame of a client, RFC 6455, masked with zeros."""
    return bytes([0x81, 0x80 | len(data), 0, 0, 0, 0]) + data


@contextmanager
def started(bench: str, count: int, realtime: bool, log: bool) -> Iterator[tuple[Console, Any]]:
    """Start a console and a process that runs; yields the console and the lines of the other."""
    with ExitStack() as stack:
        runtime = stack.enter_context(tempfile.TemporaryDirectory(prefix="rig-", dir="/tmp"))
        console = Console(runtime, stack.enter_context(tempfile.TemporaryDirectory()))
        stack.callback(console.process.wait)
        stack.callback(console.process.terminate)
        options = [bench, str(count), str(int(realtime)), str(int(log))]
        run = subprocess.Popen(
            [sys.executable, __file__, "host", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=console.environment,
        )
        stack.callback(run.wait)
        # A process that is told to stop begins its next run: it has to be killed.
        stack.callback(run.kill)
        assert run.stdout is not None
        yield console, map(json.loads, run.stdout)


def latency(bench: str, presses: int, realtime: bool) -> list[str]:
    """Press STOP in many runs, each at a random moment of its motion; return a row of the table."""
    chance = random.Random(0)
    off, answered, phases, unverified, unconfirmed = [], [], Counter[str](), 0, 0
    parts: list[list[float]] = [[], [], []]
    with started(bench, presses, realtime, False) as (console, lines):
        for _ in range(presses):
            run = next(lines)["run"]
            next(lines)
            time.sleep(chance.uniform(0.0, SPREAD_S))
            words = UNKNOWN
            while UNKNOWN in words:
                pressed, taken, words = console.stop(run)
            unconfirmed += words != TAKEN
            end = next(lines)
            off.append((end["known_ns"] - pressed) * 1e-6)
            marks = [pressed, end["taken_ns"], end["stood_ns"], end["known_ns"]]
            for part, (begin, finish) in zip(parts, pairwise(marks), strict=True):
                part.append((finish - begin) * 1e-6)
            answered.append((taken - pressed) * 1e-6)
            phases[end["phase"]] += 1
            unverified += not end["verified"] or end["ending"] != "stopped"
    return [
        bench,
        "real" if realtime else "simulated",
        str(len(off)),
        *(f"{np.percentile(off, point):.0f}" for point in (50, 99, 100)),
        f"{np.percentile(answered, 99):.0f}",
        *("{:.0f}, {:.0f}".format(*np.percentile(part, (50, 99))) for part in parts),
        str(unverified),
        str(unconfirmed),
        ", ".join(f"{name} {n}" for name, n in phases.most_common()),
    ]


def lateness(seconds: float) -> None:
    """Print the lateness of one run in parts with and without pages, and the console's load."""
    with started("practical", 1, True, True) as (console, lines):
        run = next(lines)["run"]
        next(lines)
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
        next(lines)
        late = np.array(next(lines)["late"], dtype=np.float64)
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
    print(f"load of the computer (1 min): {os.getloadavg()[0]:.1f} of {os.cpu_count()} cores")


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["latency", "lateness", "host"])
    parser.add_argument("rest", nargs="*")
    parser.add_argument("--bench", action="append")
    parser.add_argument("--presses", type=int, default=100)
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("--seconds", type=float, default=80.0)
    given = parser.parse_args()
    if given.what == "host":
        bench, count, realtime, log = given.rest
        host(bench, int(count), realtime == "1", log == "1")
    elif given.what == "lateness":
        lateness(given.seconds)
    else:
        rows = [latency(b, given.presses, given.realtime) for b in given.bench or BENCHES]
        heads = ["bench", "time", "presses", "p50 ms", "p99 ms", "most ms", "answer p99 ms"]
        heads += ["to the loop p50, p99", "ramp", "off and read back"]
        heads += ["not off", "not confirmed", "phases"]
        print(table(heads, rows, right=[2, 3, 4, 5, 6, 7, 8, 9, 10, 11]))
        print(f"load of the computer (1 min): {os.getloadavg()[0]:.1f} of {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
