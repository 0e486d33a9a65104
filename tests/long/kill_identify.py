"""A Figure 10 run that was killed and resumed identifies as well as one that was not.

python tests/long/kill_identify.py [--kills N]

``rig run figure10`` on the simulated bench is killed with SIGKILL at a random share of its
recording, then resumed and identified. Each of the nine 90 % intervals must have a value in common
with that of an uninterrupted run of the same seed; two honest ones miss each other in 2 % of cases,
and this passes where at most 5 % do.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rig.cli.entry import status
from rig.common.tables import table
from rig.config.bench import load_bench
from rig.runs.recorded_inputs import true_parameters
from rig.runs.run import read_record

MISSES = 0.05
_CONTROLLER = "import sys; from rig.cli.entry import status; sys.exit(status(sys.argv[1:]))"
Parameters = dict[str, dict[str, Any]]


def quietly(*words: str) -> None:
    """Run a command; what it says is only shown where it fails."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = status(list(words))
    if code:
        raise SystemExit(f"rig {' '.join(words)} ended with status {code}: {said.getvalue()}")


def identified(run: Path) -> Parameters:
    """Identify a run."""
    result = run / "result.json"
    quietly("identify", str(run), "--json", str(result))
    parameters: Parameters = json.loads(result.read_text())["parameters"]
    return parameters


def killed(run: Path, seed: int, size: int) -> str:
    """Run and kill once the recording has ``size`` bytes; return where that was."""
    words = ["run", "figure10", "--yes", "--seed", str(seed), "--out", str(run)]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen([sys.executable, "-c", _CONTROLLER, *words], **pipes) as controller:
        recording = run / "recording.mcap"
        while not (recording.exists() and recording.stat().st_size >= size):
            if controller.poll() is not None:
                raise SystemExit(
                    f"the run ended with status {controller.returncode} before it was killed"
                )
            time.sleep(0.002)
        os.kill(controller.pid, signal.SIGKILL)
    done = [stage.name for stage in read_record(run).stages if stage.state == "done"]
    return f"after {', '.join(done)}" if done else "in the first stage"


def main() -> int:
    """Print one row a kill; 1 where too many intervals miss those of the uninterrupted runs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=10)
    kills = parser.parse_args().kills
    machine = load_bench("practical").value.mock
    assert machine is not None
    truth = true_parameters(machine)
    moments, rows, apart, held, held_whole = random.Random(0), [], 0, 0, 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for seed in range(kills):
            whole, torn = folder / f"whole{seed}", folder / f"torn{seed}"
            quietly("run", "figure10", "--yes", "--seed", str(seed), "--out", str(whole))
            share = moments.uniform(0.02, 0.95)
            where = killed(torn, seed, round(share * (whole / "recording.mcap").stat().st_size))
            quietly("resume", str(torn), "--yes")
            a, b = identified(whole), identified(torn)
            missed = [n for n in truth if a[n]["low"] > b[n]["high"] or b[n]["low"] > a[n]["high"]]
            apart += len(missed)
            held += sum(b[n]["low"] <= true <= b[n]["high"] for n, true in truth.items())
            held_whole += sum(a[n]["low"] <= true <= a[n]["high"] for n, true in truth.items())
            rows.append([str(seed), f"{share:.0%}", where, ", ".join(missed) or "none"])
            print(".", end="", flush=True)
    print()
    print(table(["seed", "killed at", "resumed", "intervals that miss"], rows))
    total = kills * len(truth)
    print(
        f"{apart} of {total} pairs of intervals miss each other; the truth lies in {held} of the "
        f"resumed runs' {total}"
    )
    print(f"intervals, and in {held_whole} of the uninterrupted ones'")
    return 1 if apart > MISSES * total else 0


if __name__ == "__main__":
    sys.exit(main())
