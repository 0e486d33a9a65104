"""``kill -9`` of the controller at random moments, while the simulated bench lives on in a process of its own.

The bench answers behind a pseudo-terminal as an slcan adapter does, in real time; the controller is ``rig run`` on a
bench file that names python-can's ``slcan``, the path of a real adapter. Both use the machine's monotonic clock.

Every few kills the run is resumed on the same bench, which was never switched off: ``rig resume`` must begin at the
first unfinished stage and end with all of them done.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import select
import signal
import subprocess
import sys
import tempfile
import time
import tty
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import drivers.mock
from drivers.can_port import ERROR_FLAG
from drivers.mock.bench import SimulatedBench, simulated_bench
from drivers.mock.plant.constants import Machine
from drivers.mock.power_state import POWERED, State
from rig.errors import InputError
from rig.mcap_layout import decode_frames
from rig.mcap_reader import read_run
from rig.packaged import resolve
from rig.recover import recover
from rig.run import read_record

NS = 1_000_000_000
WATCH_S = 0.2
"""1016h is 0.1 s; a heartbeat is up to 25 ms old; the ramp takes 30 ms and settling 20 ms."""
LOG_GAP_S = 0.2
LATEST_S = 3.8
"""The whole run takes a little less."""
RESUME_EVERY, ATTEMPTS = 3, 8
TOO_LATE = ("sample age", "lateness", "heartbeat", "no SDO response", "following error", "joint speed")
"""What stops a run where the machine lets it wait; the last two as the target then jumps."""
SEQUENCE = """\
sequence: 1
name: kill
stages:
  - {name: first, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 1}], duration_s: 0.8,
     center_deg: 5, ramp_in_s: 0.2, ramp_out_s: 0.2, settle_s: 0.05}
  - {name: second, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 1}], duration_s: 0.8,
     center_deg: 5, ramp_in_s: 0.2, ramp_out_s: 0.2, settle_s: 0.05}
"""
CONTROLLER = "import sys; from rig.cli import status; sys.exit(status(sys.argv[1:]))"
_SYNC = 0x080


class Twin:
    """The simulated bench behind one end of a pseudo-terminal, in real time."""

    def __init__(self, terminal: int) -> None:
        self._terminal = terminal
        self._pending = b""
        self._closed = False
        self._keep = False
        self._open()
        # The first step loads the compiled machine, which takes longer than a controller waits for an answer.
        self._bench.clock.sleep_until_ns(NS // 100)
        self._bench.drive.refresh()

    def _open(self) -> None:
        self._began_ns = time.monotonic_ns()
        self._bench: SimulatedBench = simulated_bench(Machine(), 0)
        self._changes: list[tuple[int, bool]] = [(self._began_ns, False)]
        self._syncs_ns: list[int] = []
        self._bench.drive.entered.append(self._entered)

    def close(self) -> None:
        """Shut the simulated bus."""
        self._bench.bus.shutdown()

    def _entered(self, state: State) -> None:
        self._changes.append((self._began_ns + self._bench.clock.now_ns(), state in POWERED))

    def serve(self) -> None:
        """Answer until the standard input ends; a line there is answered with what the drive has done.

        Two lines have no answer: ``keep``, as the next controller meets the bench as the last one left it, not a new
        one; and ``hang`` with a mass in kg.
        """
        while True:
            readable, _, _ = select.select([self._terminal, sys.stdin], [], [], 0.0005)
            self._bench.clock.sleep_until_ns(time.monotonic_ns() - self._began_ns)
            if self._terminal in readable:
                *lines, self._pending = (self._pending + os.read(self._terminal, 4096)).split(b"\r")
                for line in lines:
                    self._obey(line)
            if sys.stdin in readable:
                line = sys.stdin.readline()
                if not line:
                    return
                if line == "keep\n":
                    self._keep = True
                    continue
                if line.startswith("hang "):
                    self._bench.machine.hang(float(line.split()[1]))
                    continue
                # Without a SYNC nobody has integrated the machine since the last change of state.
                self._bench.drive.refresh()
                speed = self._bench.machine.truth().velocity_rad_s
                answer = {"changes": self._changes, "syncs_ns": self._syncs_ns, "speed": speed}
                print(json.dumps(answer), flush=True)
            self._hand_over()

    def _obey(self, line: bytes) -> None:
        kind = line[:1]
        if kind == b"C":
            self._closed = True
        elif kind == b"O" and self._closed:
            self._closed = False
            if not self._keep:
                self.close()
                self._open()
            self._keep = False
            print("open", flush=True)
        elif kind == b"t":
            identifier, length = int(line[1:4], 16), int(line[4:5])
            if identifier == _SYNC:
                self._syncs_ns.append(time.monotonic_ns())
            self._bench.bus.transmit(identifier, bytes.fromhex(line[5 : 5 + 2 * length].decode()))

    def _hand_over(self) -> None:
        frames = self._bench.bus.collect(0.0)
        text = "".join(f"t{f.identifier:03X}{len(f.data)}{f.data.hex().upper()}\r" for f in frames if not _error(f))
        if text:
            os.write(self._terminal, text.encode())


def _error(frame: Any) -> bool:
    return bool(frame.identifier & ERROR_FLAG)


def twin() -> None:
    """Be the bench: print the terminal's name, then serve."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    print(os.ttyname(theirs), flush=True)
    bench = Twin(ours)
    bench.serve()
    bench.close()


@dataclass
class Result:
    """What one kill left behind.

    Attributes:
        moment_s: When it came, s after the bus was opened.
        powered: Whether the drive was energised.
        off_s: When it no longer was, s after the kill.
        speed: Of the joint half a second after the kill, rad/s.
        gap_s: How much older the recording's end is than the last cycle.
        pause_s: The longest pause between two cycles after that end: the machine was busy elsewhere.
        phase: Where the recording ended.
        resumed: How ``rig resume`` went; None where it was not tried, empty where it was as it should be.
    """

    moment_s: float
    powered: bool
    off_s: float | None
    speed: float
    gap_s: float | None
    pause_s: float
    phase: str
    resumed: str | None = None

    @property
    def bad(self) -> bool:
        """Whether a limit was broken. A recording is written by the control loop: while it pauses, so does that."""
        late = self.off_s is None or self.off_s > WATCH_S or self.speed > 1e-3
        return late or (self.gap_s or 0.0) - self.pause_s > LOG_GAP_S or bool(self.resumed)


def bench_file(folder: Path, terminal: str) -> Path:
    """Write a bench whose bus is the adapter behind ``terminal``; limits on timing as the machine allows."""
    eds = Path(drivers.mock.__file__).parent
    text = resolve("practical", "benches").read_text().split("mock:  ")[0]
    text = text.replace("interface: mock", f"interface: slcan, channel: {terminal}")
    for here, there in (
        ("cycle_Hz: 1000", "cycle_Hz: 250"),
        ("age_ms: 5", "age_ms: 90"),
        ("ness_ms: 25", "ness_ms: 50"),
    ):
        text = text.replace(here, there)
    text = text.replace("servo: {", f"servo: {{eds: {eds / 'drive.eds'}, ")
    text = text.replace("encoder: {", f"encoder: {{eds: {eds / 'encoder.eds'}, ")
    path = folder / "bench.yaml"
    path.write_text(text)
    return path


def worker(number: int, kills: int, folder: Path) -> list[Result]:
    """Kill that many controllers, one after another, on one bench."""
    moments = random.Random(number)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    twin_process = subprocess.Popen([sys.executable, __file__, "--twin"], text=True, **pipes)  # type: ignore[call-overload]
    results = []
    with twin_process:
        try:
            terminal = twin_process.stdout.readline().strip()
            folder.mkdir()
            bench = bench_file(folder, terminal)
            (folder / "sequence.yaml").write_text(SEQUENCE)
            for kill in range(kills):
                run, moment_s = folder / f"run{kill}", moments.uniform(0.0, LATEST_S)
                result = one(twin_process, bench, run, moment_s)
                if kill % RESUME_EVERY == 0:
                    result = replace(result, resumed=resume(twin_process, run))
                results.append(result)
        finally:
            twin_process.stdin.close()
            twin_process.wait(10)
    return results


def one(twin_process: Any, bench: Path, run: Path, moment_s: float) -> Result:
    """Start a controller, kill it, see what the drive does and what the recording holds."""
    arguments = [
        "run",
        str(bench.parent / "sequence.yaml"),
        "--bench",
        str(bench),
        "--yes",
        "--no-first-pass",
        "--out",
        str(run),
    ]
    controller = start(arguments, bench.parent)
    wait_for_open(twin_process, controller)
    time.sleep(moment_s)
    killed_ns = time.monotonic_ns()
    controller.send_signal(signal.SIGKILL)
    controller.communicate()
    time.sleep(0.5)
    twin_process.stdin.write("\n")
    twin_process.stdin.flush()
    state = json.loads(twin_process.stdout.readline())
    changes = state["changes"]
    powered = [on for when, on in changes if when <= killed_ns][-1]
    off_s = None if changes[-1][1] else max(0.0, (changes[-1][0] - killed_ns) / NS) if powered else 0.0
    syncs_ns = [when for when in state["syncs_ns"] if when <= killed_ns]
    gap_s, pause_s, phase = _recovered(run, syncs_ns)
    return Result(moment_s, powered, off_s, abs(state["speed"]), gap_s, pause_s, phase)


def start(arguments: list[str], folder: Path) -> subprocess.Popen[str]:
    """Start a controller."""
    return subprocess.Popen(
        [sys.executable, "-c", CONTROLLER, *arguments],
        env=os.environ | {"CAN_CONFIG": json.dumps({"sleep_after_open": 0.0})},
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_open(twin_process: Any, controller: subprocess.Popen[str]) -> None:
    """Wait until a controller has opened the bus."""
    while not select.select([twin_process.stdout], [], [], 0.5)[0]:
        if controller.poll() is not None:
            raise RuntimeError(f"the controller never opened the bus: {controller.communicate()[1]}")
    if twin_process.stdout.readline() != "open\n":
        raise RuntimeError("the simulated bench ended")


def resume(twin_process: Any, run: Path) -> str | None:
    """Go on with a killed run on the bench as it was left; say what is wrong with how that went.

    On a machine too busy for real time the drive's watch or a limit on time stops a run again, as they should; then it
    is resumed again.
    """
    words = ""
    for _ in range(ATTEMPTS):
        try:
            before = read_record(run)
        except InputError:
            return None
        wanted = [stage.name for stage in before.stages if stage.state != "done"]
        if not wanted:
            return None
        twin_process.stdin.write("keep\n")
        twin_process.stdin.flush()
        fault = ["--reset-fault"] if words else []
        controller = start(["resume", str(run), "--yes", "--no-first-pass", *fault], run.parent)
        wait_for_open(twin_process, controller)
        words = controller.communicate(timeout=60)[1]
        after = read_record(run)
        again = [after.stages[s.stage_index].name for s in after.segments if s.part == len(after.parts)]
        if again != wanted[: len(again)]:
            return f"did {again} instead of {wanted}"
        if controller.returncode == 0 and again == wanted:
            return ""
        if not any(late in words for late in TOO_LATE):
            break
    return f"not finished: {words.strip()}"


def _recovered(run: Path, syncs_ns: list[int]) -> tuple[float | None, float, str]:
    """Recover the recording; return how much older its end is than the last cycle on the bus, and where it ended.

    Between the two, also the longest pause from one cycle to the next. What comes before the first cycle is events,
    which are written at once.
    """
    try:
        recover(run)
    except InputError:
        return None, 0.0, "before the recording"
    log = read_run(run / "recording.mcap")
    segment = int(log.samples["segment"][-1]) if len(log.samples["segment"]) else -1
    where = {-1: "before cycling", 0: "cycling, outside excitation"}.get(segment, "in excitation")
    if not syncs_ns:
        return None, 0.0, where
    times = [frame.time_ns for message in log.messages["/frames"] for frame in decode_frames(message.data)]
    end_ns = max(times, default=syncs_ns[0])
    unrecorded = [end_ns, *(when for when in syncs_ns if when > end_ns)]
    pause_s = max((later - earlier for earlier, later in pairwise(unrecorded)), default=0) / NS
    return (syncs_ns[-1] - end_ns) / NS, pause_s, where


def main() -> int:
    """Kill, count, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--twin", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--workers", type=int, default=1, help="controllers killed at the same time")
    options = parser.parse_args()
    if options.twin:
        twin()
        return 0
    began = time.monotonic()
    share = -(-options.kills // options.workers)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(options.workers) as pool:
        futures = [pool.submit(worker, n, share, Path(folder) / f"bench{n}") for n in range(options.workers)]
        results = [result for future in futures for result in future.result()]
    return report(results, time.monotonic() - began, options.workers)


def report(results: list[Result], seconds: float, workers: int) -> int:
    """Print the figures; 1 where one of them is bad."""
    offs = [r.off_s for r in results if r.powered and r.off_s is not None]
    gaps = [r.gap_s for r in results if r.gap_s is not None]
    bad = [r for r in results if r.bad]
    print(f"{len(results)} kills in {seconds:.0f} s, {workers} at a time")
    for phase in sorted({r.phase for r in results}):
        print(f"  {sum(r.phase == phase for r in results):4d} {phase}")
    if offs:
        print(f"energised at the kill: {len(offs)}; off after {min(offs):.3f} to {max(offs):.3f} s (limit {WATCH_S})")
    if gaps:
        print(f"end of the recovered recording before the last cycle: {max(gaps):.3f} s at most (limit {LOG_GAP_S})")
        print(f"longest pause of a control loop in that time: {max(r.pause_s for r in results):.3f} s")
    resumed = [r.resumed for r in results if r.resumed is not None]
    print(f"resumed: {len(resumed)}; went on at the first unfinished stage and finished: {resumed.count('')}")
    for result in bad:
        print(f"BAD {result}")
    print(f"{len(bad)} bad")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
