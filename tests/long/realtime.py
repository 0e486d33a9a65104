"""The real-time path: Figure 10 over `slcan` on a pseudo-terminal with the machine's own clock,
then identified.

python -m tests.long.realtime [--cycle HZ] [--out DIR]

The simulated bench lives in a process of its own, as behind a real adapter; nothing is held to
simulated time, and a run takes as long as on a bench; the operator's answers are typed into its
console as the weights are hung. The limits on lateness and sample age are those of a desktop
computer. Each 90 % interval must have a value in common with that of the same run in simulated
time; what late cycles leave unidentifiable is shown as such. The machine should have nothing else
to do.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rig.common.tables import number, table
from rig.common.timing import summary
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.runs.recorded_inputs import true_parameters
from rig.runs.run_file import read_record

from .benches import Bench, bench_process
from .console import RIG, ROOT, rig

PROMPT = re.compile(r"Mass on the lever[^:\n]*: $")


def identified(run: Path) -> dict[str, dict[str, Any]]:
    """Identify a run."""
    result = run / "result.json"
    rig("identify", str(run), "--out", str(run / "identified"), "--json", str(result))
    parameters: dict[str, dict[str, Any]] = json.loads(result.read_text())["parameters"]
    return parameters


def in_real_time(folder: Path, cycle_Hz: int) -> Path:
    """Run Figure 10 over the adapter, hanging the weights it asks for; return the run's folder."""
    with bench_process("slcan") as bench:
        file = bench.write_file(folder, cycle_Hz=cycle_Hz, sample_age_ms=90)
        run = folder / "realtime"
        command = ["run", "figure10", "--bench", str(file), "--no-first-pass", "--out", str(run)]
        controller = subprocess.Popen(
            [sys.executable, *RIG, *command],
            env=os.environ | bench.env | {"PYTHONPATH": str(ROOT)},
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        bench.wait_for_host(controller.poll)
        began = time.monotonic()
        words = operate(controller, bench)
        print(f"status {controller.wait()} after {time.monotonic() - began:.1f} s of real time")
        if controller.returncode:
            raise SystemExit(words)
    return run


def operate(controller: Any, bench: Bench) -> str:
    """Be the operator: hang the mass that is asked for, then type it; return all that was said."""
    words = ""
    while letter := controller.stderr.read(1):
        words += letter
        if PROMPT.search(words):
            asked = re.findall(r"Hang ([0-9.]+) kg|Take every weight off", words)[-1] or "0"
            bench.hang(float(asked))
            controller.stdin.write(f"{asked}\n")
            controller.stdin.flush()
    controller.communicate()
    return words


def main() -> int:
    """Run both ways, print the nine side by side; 1 where an interval misses the other's."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cycle", type=int, default=250, help="cycles per second (default 250)")
    parser.add_argument("--out", type=Path, help="keep the runs here")
    options = parser.parse_args()
    machine = load_bench("practical").value.mock
    assert machine is not None
    truth = true_parameters(machine)
    with tempfile.TemporaryDirectory() as name:
        folder = options.out or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        real = in_real_time(folder, options.cycle)
        print(summary(read_record(real).parts[-1].timing))
        simulated = folder / "simulated"
        bench = str(on_simulated_bus(folder, options.cycle))
        rig("run", "figure10", "--bench", bench, "--yes", "--out", str(simulated))
        a, b = identified(real), identified(simulated)
    rows, missed = [], 0
    for parameter, true in truth.items():
        here, there = a[parameter], b[parameter]
        both = here["value"] is not None and there["value"] is not None
        apart = both and (here["low"] > there["high"] or there["low"] > here["high"])
        missed += apart
        rows.append(
            [parameter, number(true), _interval(here), _interval(there), "apart" if apart else ""]
        )
    print(table(["parameter", "true", "real time, slcan", "simulated time", ""], rows))
    return 1 if missed else 0


def _interval(found: dict[str, Any]) -> str:
    return (
        "-"
        if found["value"] is None
        else f"{found['value']:.5g} [{found['low']:.5g}, {found['high']:.5g}]"
    )


def on_simulated_bus(folder: Path, cycle_Hz: int) -> Path:
    """Write the same bench with the bus in simulated time."""
    path = folder / "simulated.yaml"
    path.write_text(
        resolve("practical", "benches")
        .read_text()
        .replace("cycle_Hz: 1000", f"cycle_Hz: {cycle_Hz}")
    )
    return path


if __name__ == "__main__":
    sys.exit(main())
