"""``kill -9`` of the controller of an EPOS4 on a serial line, which has no watchdog: the guardian must stop the drive.

The simulated bench answers behind two pseudo-terminals, in real time and in a process of its own; the controller is
`rig run` on a bench file that names them as real ports. It is killed in every phase of a run, and at random moments.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

import drivers.mock
from drivers.mock.amt21 import SimulatedAmt21
from drivers.mock.bench import simulated_bench
from drivers.mock.epos_serial import SimulatedEposPort
from drivers.mock.power_state import POWERED, State
from drivers.mock.pty import RealTimeBench
from drivers.mock.timer import Timer
from rig.bench import load_bench
from rig.guardian import REPORT_FILE
from rig.packaged import resolve
from rig.recover import recover

from .fault_cases import PHASES

STOP_S = 0.25
"""The kernel closes the pipe and the guardian wakes, on a busy machine; then the ramp, and 20 ms to settle."""
AFTER_S = 1.5
_WITHOUT_POWER = ("prompt", "prepare", "enable", "disable", "any")
_STEP_NS = 50_000_000
LATEST_S = 2.2
_PATIENCE = 4
SEQUENCE = """\
sequence: 1
name: guarded
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 4, frequency_Hz: 2}], duration_s: 0.8,
     center_deg: 8, ramp_in_s: 0.1, ramp_out_s: 0.2, settle_s: 0.05}
"""
_CONTROLLER = """
import dataclasses, os, signal, sys, threading, time
import rig.commands.run as run
from rig.cli import status

where, after_s = sys.argv.pop(1), float(sys.argv.pop(1))
names = {"load": "prompt", "release": "disable"}
execute = run.execute

def die():
    print(time.monotonic_ns(), flush=True)
    os.kill(os.getpid(), signal.SIGKILL)

def observe(stage, phase):
    name = names.get(phase.value, phase.value)
    if name == where or (name, where) in (("excite", "ramp_out"), ("prepare", "any")):
        threading.Timer(after_s + (0.6 if where == "ramp_out" else 0.0), die).start()

def watched(inputs, plan, devices, *more):
    # On a busy machine the run would end before it is killed.
    limits = dataclasses.replace(plan.limits, lateness=1.0, sample_age=1.0, encoder_disagreement=1.0)
    plan = dataclasses.replace(plan, limits=limits)
    return execute(inputs, plan, dataclasses.replace(devices, observer=observe), *more)

run.execute = watched
sys.exit(status(sys.argv[1:]))
"""


def twin() -> None:
    """Be the bench: print the paths of its ports, then answer each line of input with what the drive has done."""
    bench = simulated_bench(load_bench("practical_serial").value.mock, 0)  # type: ignore[arg-type]
    ports = RealTimeBench(bench.clock)
    paths = [
        ports.open_pty(SimulatedEposPort(bench.bus, bench.clock, bench.drive)),
        ports.open_pty(SimulatedAmt21(bench.clock, bench.sampler)),
    ]
    changes: list[tuple[int, bool]] = [(time.monotonic_ns(), False)]

    def entered(state: State) -> None:
        changes.append((time.monotonic_ns(), state in POWERED))

    def keep_up() -> None:
        # Asked after a long pause, the machine would take long to catch up, and the answer come too late.
        bench.drive.refresh()
        timer.start(bench.clock.now_ns() + _STEP_NS)

    timer = Timer(bench.clock, keep_up)
    keep_up()
    bench.clock.sleep_until_ns(bench.clock.now_ns() + _STEP_NS)
    bench.drive.entered.append(entered)
    with ports:
        print(json.dumps(paths), flush=True)
        for _ in sys.stdin:
            print(json.dumps(changes), flush=True)
    bench.bus.shutdown()


@dataclass
class Result:
    """What one kill left behind: whether there was power, how long it took to end, and what the guardian wrote."""

    where: str
    powered: bool
    off_s: float | None
    report: dict[str, Any] | None
    samples: int

    @property
    def problems(self) -> Iterator[str]:
        """Yield what is wrong."""
        if self.off_s is None:
            yield "the drive is still energised"
        elif self.off_s > STOP_S:
            yield f"off after {self.off_s:.3f} s, limit {STOP_S:g} s"
        if self.powered and not (self.report and self.report["safe"]["verified"]):
            yield f"the guardian wrote {self.report}"

    def __str__(self) -> str:
        """Return it in one line."""
        off = "ON" if self.off_s is None else f"off after {self.off_s:.3f} s"
        wrote = "nothing" if self.report is None else self.report["safe"]["state"]
        return f"{self.where}: {'powered' if self.powered else 'no power'}, {off}; guardian wrote {wrote}"


class RunError(Exception):
    """A controller did not live to be killed."""


@contextmanager
def bench_process(folder: Path) -> Iterator[tuple[Any, Path]]:
    """Start the twin; yields its process and a bench file that names its ports."""
    arguments = [sys.executable, "-m", "tests.long.guardian", "--twin"]
    with subprocess.Popen(arguments, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        drive, encoder = json.loads(process.stdout.readline())
        bench = yaml.safe_load(resolve("practical_serial", "benches").read_text())
        del bench["mock"]
        bench["bus"]["port"], bench["encoder"]["port"] = drive, encoder
        bench["servo"]["eds"] = str(Path(drivers.mock.__file__).with_name("drive.eds"))
        # Slow and patient, since the machine may be busy with other things; the guardian is on trial, not its timing.
        bench["cycle_Hz"] = 100
        bench["limits"] |= {"sample_age_ms": 150, "lateness_ms": 50}
        path = folder / "bench.yaml"
        path.write_text(yaml.safe_dump(bench))
        (folder / "sequence.yaml").write_text(SEQUENCE)
        yield process, path
        process.stdin.close()


def kill(process: Any, bench: Path, run: Path, where: str, after_s: float) -> Result:
    """Run a controller that is killed so long after a phase begins, and see what the drive does.

    Raises:
        RunError: It ended before, as on a machine that is too busy to answer in time.
    """
    arguments = ["run", str(bench.parent / "sequence.yaml"), "--bench", str(bench), "--yes", "--no-first-pass"]
    controller = subprocess.Popen(
        [sys.executable, "-c", _CONTROLLER, where, str(after_s), *arguments, "--out", str(run)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    with controller:
        assert controller.stdout is not None
        said = controller.stdout.read().split()
        code = controller.wait()
    if code != -signal.SIGKILL:
        raise RunError(f"the controller ended with status {code} before it was killed")
    killed_ns = int(said[-1])
    time.sleep(AFTER_S)
    process.stdin.write("\n")
    process.stdin.flush()
    changes = json.loads(process.stdout.readline())
    powered = [on for when, on in changes if when <= killed_ns][-1]
    if not powered and where not in _WITHOUT_POWER:
        raise RunError("the run was over, though not its process")
    last_ns, on = changes[-1]
    off_s = None if on else max(0.0, (last_ns - killed_ns) / 1e9) if powered else 0.0
    report = run / REPORT_FILE
    samples = recover(run).samples
    return Result(where, powered, off_s, json.loads(report.read_text()) if report.exists() else None, samples)


def main() -> int:
    """Kill in every phase, then at random moments; print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--twin", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--kills", type=int, default=20, help="at random moments, beside those in every phase")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.twin:
        twin()
        return 0
    moments = random.Random(options.seed)
    plan = list(PHASES.items()) + [("any", moments.uniform(0.0, LATEST_S)) for _ in range(options.kills)]
    results: list[Result] = []
    failed = 0
    with tempfile.TemporaryDirectory() as folder, bench_process(Path(folder)) as (process, bench):
        for number, (where, after_s) in enumerate(plan):
            result = None
            while result is None:
                try:
                    result = kill(process, bench, Path(folder) / f"run{number}.{failed}", where, after_s)
                except RunError as error:
                    failed += 1
                    print(f"  {error}; again", flush=True)
                    if failed > _PATIENCE * len(plan):
                        raise
            results.append(result)
            print(f"{after_s:.3f} s into {result}", *result.problems, sep="; ", flush=True)
    offs = [r.off_s for r in results if r.powered and r.off_s is not None]
    bad = sum(bool(list(r.problems)) for r in results)
    print(f"{len(results)} kills, {len(offs)} under power, off after {max(offs, default=0):.3f} s at most, {bad} bad")
    print(f"{failed} runs failed by themselves before they were killed, and were done again")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
