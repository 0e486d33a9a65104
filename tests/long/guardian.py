"""``kill -9`` of the controller of an EPOS4 on a serial line, which has no watchdog: the guardian
must stop the drive.

The simulated bench answers behind two pseudo-terminals, in real time and in a process of its own;
the controller is `rig run` on a bench file that names them as real ports. It is killed in every
phase of a run, and at random moments.
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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.runs.recover import recover
from rig.wiring.guardian import REPORT_FILE

from .benches import Bench, bench_process
from .fault_cases import PHASES

STOP_S = 0.25
"""The kernel closes the pipe and the guardian wakes, on a busy machine; then the ramp, and 20 ms to
settle.
"""
AFTER_S = 1.5
_WITHOUT_POWER = ("prompt", "prepare", "enable", "disable", "any")
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
import rig.cli.commands.run as run
from rig.cli.entry import status

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
    wide = {"lateness": 1.0, "sample_age": 1.0, "encoder_disagreement": 1.0}
    limits = dataclasses.replace(plan.limits, **wide)
    plan = dataclasses.replace(plan, limits=limits)
    return execute(inputs, plan, dataclasses.replace(devices, observer=observe), *more)

run.execute = watched
sys.exit(status(sys.argv[1:]))
"""


@dataclass
class Result:
    """What one kill left behind: whether there was power, how long it took to end, and what the
    guardian wrote.
    """

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
        return (
            f"{self.where}: {'powered' if self.powered else 'no power'}, {off}; guardian wrote "
            f"{wrote}"
        )


class RunError(Exception):
    """A controller did not live to be killed."""


def kill(bench: Bench, file: Path, run: Path, where: str, after_s: float) -> Result:
    """Run a controller that is killed so long after a phase begins, and see what the drive does.

    Raises:
        RunError: It ended before, as on a machine that is too busy to answer in time.
    """
    bench.renew()
    arguments = [
        "run",
        str(file.parent / "sequence.yaml"),
        "--bench",
        str(file),
        "--yes",
        "--no-first-pass",
    ]
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
    account = bench.account()
    powered = account.on_at(killed_ns)
    if not powered and where not in _WITHOUT_POWER:
        raise RunError("the run was over, though not its process")
    off_s = account.off_after_s(killed_ns)
    report = run / REPORT_FILE
    samples = recover(run).samples
    return Result(
        where, powered, off_s, json.loads(report.read_text()) if report.exists() else None, samples
    )


def main() -> int:
    """Kill in every phase, then at random moments; print what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--kills", type=int, default=20, help="at random moments, beside those in every phase"
    )
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    moments = random.Random(options.seed)
    plan = list(PHASES.items()) + [
        ("any", moments.uniform(0.0, LATEST_S)) for _ in range(options.kills)
    ]
    results: list[Result] = []
    failed = 0
    with tempfile.TemporaryDirectory() as folder, bench_process("serial") as bench:
        file = bench.write_file(Path(folder))
        (Path(folder) / "sequence.yaml").write_text(SEQUENCE)
        for number, (where, after_s) in enumerate(plan):
            result = None
            while result is None:
                try:
                    result = kill(
                        bench, file, Path(folder) / f"run{number}.{failed}", where, after_s
                    )
                except RunError as error:
                    failed += 1
                    print(f"  {error}; again", flush=True)
                    if failed > _PATIENCE * len(plan):
                        raise
            results.append(result)
            print(f"{after_s:.3f} s into {result}", *result.problems, sep="; ", flush=True)
    offs = [r.off_s for r in results if r.powered and r.off_s is not None]
    bad = sum(bool(list(r.problems)) for r in results)
    print(
        f"{len(results)} kills, {len(offs)} under power, off after {max(offs, default=0):.3f} s "
        f"at most, {bad} bad"
    )
    print(f"{failed} runs failed by themselves before they were killed, and were done again")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
