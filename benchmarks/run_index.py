"""Time of the index of run folders: built anew, and listed from it.

Makes one short run on the simulated bench, copies it ``--runs`` times with other dates, operators
and constants (the recording is linked, not copied), and prints folders per second for the first
list, and the time of the second one, in processes of their own as an operator starts them.

    python benchmarks/run_index.py --runs 10000
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

RIG = [sys.executable, "-c", "from rig.cli.entry import main; main()"]
SEQUENCE = """\
sequence: 1
name: short
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 2}], duration_s: 0.5,
     ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.05}
"""
CONSTANTS = {"Mc": 6.8, "Ms": 12.0, "omega_sf": 0.0557, "sigma_2": 5.35, "J": 0.204}
CONSTANTS |= {"mu_c": 0.052, "mu_s": 0.086, "omega_sL": 0.0326, "mu_2": 0.032}
_START = datetime(2026, 1, 1, tzinfo=UTC)


def make_runs(root: Path, count: int) -> None:
    """Write run folders, each with a record and an identification."""
    (root / "short.yaml").write_text(SEQUENCE)
    first = root / "runs" / "first"
    subprocess.run(
        [*RIG, "run", str(root / "short.yaml"), "--yes", "--out", str(first)],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    record = json.loads((first / "run.json").read_text())
    rng = random.Random(0)
    for number in range(1, count):
        folder = root / "runs" / f"{2026 + number // 4000}" / f"run-{number:05d}"
        folder.mkdir(parents=True)
        record["created"] = (_START + timedelta(minutes=number)).isoformat()
        record["parts"][0]["operator"] = rng.choice(("Ada", "Grace", "Emmy"))
        (folder / "run.json").write_text(json.dumps(record, indent=1))
        (folder / "identify.json").write_text(json.dumps(identification(rng), indent=1))
        os.link(first / "recording.mcap", folder / "recording.mcap")


def identification(rng: random.Random) -> dict[str, object]:
    """Return a result of ``rig identify`` with values about the truth."""
    parameters = {}
    for name, true in CONSTANTS.items():
        value = true * (1.0 + rng.gauss(0.0, 0.001))
        half = 0.00165 * true
        parameters[name] = {
            "value": value,
            "low": value - half,
            "high": value + half,
            "unit": "1",
            "identifiable": True,
            "at_bound": False,
        }
    fit = {"unit": "N m", "train_rms": 0.018}
    return {
        "schema": "loadrig.identify/1",
        "method": "default",
        "motion": "rotary",
        "parameters": parameters,
        "fit": fit,
    }


def listed(root: Path, *options: str) -> tuple[float, float]:
    """Return the seconds that a list takes, the start of the program included: on the clock, and of
    the processor, which other programs on the computer do not stretch.
    """
    before, started = _used(), time.perf_counter()
    done = subprocess.run(
        [*RIG, "runs", "list", str(root / "runs"), *options], stdout=subprocess.PIPE, check=True
    )
    seconds = time.perf_counter() - started
    assert done.stdout
    return seconds, _used() - before


def _used() -> float:
    """Return the processor time of all programs that were started and have ended, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Print the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10_000)
    count = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        make_runs(root, count)
        clock, used = listed(root)
        print(f"{count} folders, index built and listed: {clock:.2f} s, {count / clock:.0f} /s")
        print(f"  of the processor: {used:.2f} s, {count / used:.0f} /s")
        clock, used = min(listed(root) for _ in range(3))
        print(f"listed from the index: {clock:.2f} s; of the processor: {used:.2f} s")
        clock, used = listed(root, "--operator", "Ada", "--last", "20")
        print(f"the last 20 of one operator: {clock:.2f} s; of the processor: {used:.2f} s")
        size = (root / "runs" / ".runs.sqlite").stat().st_size
        print(f"index: {size / 1e6:.1f} MB")
        load = os.getloadavg()[0]
        print(f"load of the computer (1 min): {load:.1f} of {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
