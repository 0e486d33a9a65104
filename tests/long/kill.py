"""``kill -9`` of the controller at random moments, while the simulated bench lives on in a process
of its own.

The bench answers behind a pseudo-terminal as an slcan adapter does, in real time; the controller is
``rig run`` on a bench file that names python-can's ``slcan``, the path of a real adapter. Both use
the machine's monotonic clock.

Every few kills the run is resumed on the same bench, which was never switched off: ``rig resume``
must begin at the first unfinished stage and end with all of them done.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.runs.mcap.layout import decode_frames
from rig.runs.mcap.reader import read_run
from rig.runs.recover import recover
from rig.runs.run_file import read_record

from .benches import Bench, bench_process
from .console import ROOT

NS = 1_000_000_000
WATCH_S = 0.2
"""1016h is 0.1 s; a heartbeat is up to 25 ms old; the ramp takes 30 ms and settling 20 ms."""
LOG_GAP_S = 0.2
LATEST_S = 3.8
"""The whole run takes a little less."""
RESUME_EVERY, ATTEMPTS = 3, 8
TOO_LATE = (
    "sample age",
    "lateness",
    "heartbeat",
    "no SDO response",
    "following error",
    "joint speed",
)
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
CONTROLLER = "import sys; from rig.cli.entry import status; sys.exit(status(sys.argv[1:]))"


@dataclass
class Result:
    """What one kill left behind.

    Attributes:
        moment_s: When it came, s after the bus was opened.
        powered: Whether the drive was energised.
        off_s: When it no longer was, s after the kill.
        speed: Of the joint half a second after the kill, rad/s.
        gap_s: How much older the recording's end is than the last cycle.
        pause_s: The longest pause between two cycles after that end: the machine was busy
            elsewhere.
        phase: Where the recording ended.
        resumed: How ``rig resume`` went; None where it was not tried, empty where it was as it
            should be.
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
        """Whether a limit was broken.

        A recording is written by the control loop: while it pauses, so does that.
        """
        late = self.off_s is None or self.off_s > WATCH_S or self.speed > 1e-3
        return late or (self.gap_s or 0.0) - self.pause_s > LOG_GAP_S or bool(self.resumed)


def worker(number: int, kills: int, folder: Path) -> list[Result]:
    """Kill that many controllers, one after another, on one bench."""
    moments = random.Random(number)
    results = []
    folder.mkdir()
    (folder / "sequence.yaml").write_text(SEQUENCE)
    with bench_process("slcan") as bench:
        file = bench.write_file(folder, cycle_Hz=250, sample_age_ms=90)
        for kill in range(kills):
            run, moment_s = folder / f"run{kill}", moments.uniform(0.0, LATEST_S)
            result = one(bench, file, run, moment_s)
            if kill % RESUME_EVERY == 0:
                result = replace(result, resumed=resume(bench, run))
            results.append(result)
    return results


def one(bench: Bench, file: Path, run: Path, moment_s: float) -> Result:
    """Start a controller, kill it, see what the drive does and what the recording holds."""
    bench.renew()
    words = [
        "run",
        str(file.parent / "sequence.yaml"),
        "--bench",
        str(file),
        "--yes",
        "--no-first-pass",
    ]
    controller = start(bench, [*words, "--out", str(run)], file.parent)
    bench.wait_for_host(lambda: ended(controller))
    time.sleep(moment_s)
    killed_ns = time.monotonic_ns()
    controller.send_signal(signal.SIGKILL)
    controller.communicate()
    time.sleep(0.5)
    account = bench.account()
    cycles_ns = [when for when in account.heard_ns if when <= killed_ns]
    gap_s, pause_s, phase = _recovered(run, cycles_ns)
    powered, off_s = account.on_at(killed_ns), account.off_after_s(killed_ns)
    return Result(moment_s, powered, off_s, abs(account.speed), gap_s, pause_s, phase)


def start(bench: Bench, arguments: list[str], folder: Path, **pipes: Any) -> subprocess.Popen[str]:
    """Start a controller."""
    return subprocess.Popen(
        [sys.executable, "-c", CONTROLLER, *arguments],
        env=os.environ | bench.env | {"PYTHONPATH": str(ROOT)},
        cwd=folder,
        stderr=subprocess.PIPE,
        text=True,
        **{"stdout": subprocess.DEVNULL, **pipes},
    )


def ended(controller: subprocess.Popen[str]) -> str | None:
    """Return what a controller said that is no more; None for one that lives."""
    return None if controller.poll() is None else controller.communicate()[1]


def resume(bench: Bench, run: Path) -> str | None:
    """Go on with a killed run on the bench as it was left; say what is wrong with how that went.

    On a machine too busy for real time the drive's watch or a limit on time stops a run again, as
    they should; then it is resumed again.
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
        fault = ["--reset-fault"] if words else []
        controller = start(
            bench, ["resume", str(run), "--yes", "--no-first-pass", *fault], run.parent
        )
        words = controller.communicate(timeout=60)[1]
        after = read_record(run)
        again = [
            after.stages[s.stage_index].name for s in after.segments if s.part == len(after.parts)
        ]
        if again != wanted[: len(again)]:
            return f"did {again} instead of {wanted}"
        if controller.returncode == 0 and again == wanted:
            return ""
        if not any(late in words for late in TOO_LATE):
            break
    return f"not finished: {words.strip()}"


def _recovered(run: Path, cycles_ns: list[int]) -> tuple[float | None, float, str]:
    """Recover the recording; return how much older its end is than the last cycle on the bus, and
    where it ended.

    Between the two, also the longest pause from one cycle to the next. What comes before the first
    cycle is events, which are written at once.
    """
    try:
        recover(run)
    except InputError:
        return None, 0.0, "before the recording"
    log = read_run(run / "recording.mcap")
    segment = int(log.samples["segment"][-1]) if len(log.samples["segment"]) else -1
    where = {-1: "before cycling", 0: "cycling, outside excitation"}.get(segment, "in excitation")
    if not cycles_ns:
        return None, 0.0, where
    times = [
        frame.time_ns
        for message in log.messages["/frames"]
        for frame in decode_frames(message.data)
    ]
    end_ns = max(times, default=cycles_ns[0])
    unrecorded = [end_ns, *(when for when in cycles_ns if when > end_ns)]
    pause_s = max((later - earlier for earlier, later in pairwise(unrecorded)), default=0) / NS
    return (cycles_ns[-1] - end_ns) / NS, pause_s, where


def main() -> int:
    """Kill, count, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument(
        "--workers", type=int, default=1, help="controllers killed at the same time"
    )
    options = parser.parse_args()
    began = time.monotonic()
    share = -(-options.kills // options.workers)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(options.workers) as pool:
        futures = [
            pool.submit(worker, n, share, Path(folder) / f"bench{n}")
            for n in range(options.workers)
        ]
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
        print(
            f"energised at the kill: {len(offs)}; off after {min(offs):.3f} to {max(offs):.3f} s "
            f"(limit {WATCH_S})"
        )
    if gaps:
        print(
            f"end of the recovered recording before the last cycle: {max(gaps):.3f} s at most "
            f"(limit {LOG_GAP_S})"
        )
        print(
            f"longest pause of a control loop in that time: {max(r.pause_s for r in results):.3f} s"
        )
    resumed = [r.resumed for r in results if r.resumed is not None]
    print(
        f"resumed: {len(resumed)}; went on at the first unfinished stage and finished: "
        f"{resumed.count('')}"
    )
    for result in bad:
        print(f"BAD {result}")
    print(f"{len(bad)} bad")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
