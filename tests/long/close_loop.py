"""Close the loop: hide an effect, run, diagnose, run the corrected model on the simulated bus,
compare the recordings.

Run from the root of the repository; takes some minutes. It fails where the corrected bench does not
reproduce the current of the recording at least twice as well as the nominal model fitted to the
same recording.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from identification.recording import Array
from rig.cli.entry import status
from rig.results.diagnose.model_bench import base_bench, model_bench
from rig.results.diagnose.model_file import model_of
from rig.runs.run import load_run

SEQUENCE = """\
sequence: 1
name: loop
stages:
  - {name: slow, stage: unloaded, tones: [{amplitude_deg: 20, frequency_Hz: 0.2}], duration_s: 20}
  - {name: fast, stage: unloaded, tones: [{amplitude_deg: 8, frequency_Hz: 0.9},
     {amplitude_deg: 4, frequency_Hz: 1.7, phase_deg: 40}], duration_s: 20}
  - {name: light, stage: loaded, weight_kg: 10, tones: [{amplitude_deg: 20, frequency_Hz: 0.2}],
     duration_s: 20}
  - {name: heavy, stage: loaded, weight_kg: 30, tones: [{amplitude_deg: 12, frequency_Hz: 0.5}],
     duration_s: 20}
"""
HIDDEN: dict[str, dict[str, float]] = {
    "asymmetric_coulomb": {"torque_Nm": 1.2},
    "gravity_imbalance": {"torque_Nm": 3.0, "zero_rad": 0.2},
    "cogging": {"torque_Nm": 0.8, "per_motor_turn": 7.0, "phase_rad": 0.5},
}
SMOOTH = 20
"""Samples over which the current is averaged before it is compared: its noise is the sensor's
own.
"""


def quietly(*arguments: str) -> None:
    """Run a command that must succeed, and keep what it says to itself."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = status(list(arguments))
    if code != 0:
        raise SystemExit(f"{' '.join(arguments)} ended with {code}: {said.getvalue()}")


def currents(folder: Path, bench: dict[str, Any], name: str, seed: int) -> list[Array]:
    """Run the sequence on a bench; return the smoothed currents of its stages, A."""
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(bench))
    run = [
        "run",
        str(folder / "loop.yaml"),
        "--bench",
        str(folder / f"{name}.yaml"),
        "--yes",
        "--seed",
        str(seed),
    ]
    quietly(*run, "--out", str(folder / name))
    window = np.full(SMOOTH, 1.0 / SMOOTH)
    return [
        np.convolve(r.channels["current"], window, "valid")
        for r in load_run(folder / name).recordings
    ]


def off(one: list[Array], other: list[Array]) -> float:
    """Return the rms difference of two runs' currents, A."""
    both = [(a[: len(b)] - b[: len(a)]) for a, b in zip(one, other, strict=True)]
    return float(np.sqrt(np.mean(np.concatenate(both) ** 2)))


def loop(folder: Path, effect: str) -> tuple[str, float, float, float]:
    """Return verdict, and the rms difference in current of corrected bench, nominal bench and a
    mere repeat, A.
    """
    (folder / "loop.yaml").write_text(SEQUENCE)
    hidden = base_bench(folder)
    hidden["mock"]["effects"] = {effect: HIDDEN[effect]}
    measured = currents(folder, hidden, "hidden", 1)
    repeat = currents(folder, hidden, "repeat", 2)
    quietly("diagnose", str(folder / "hidden"), "--out", str(folder / "diagnosis"))
    quietly("identify", str(folder / "hidden"), "--out", str(folder / "identified"))
    corrected = yaml.safe_load((folder / "diagnosis" / "bench.yaml").read_text())
    recordings = load_run(folder / "hidden").recordings
    record = json.loads((folder / "identified" / "identify.json").read_text())
    nominal, _ = model_bench(
        base_bench(folder / "hidden"), model_of(record, []), recordings[0].bench
    )
    diagnosis = json.loads((folder / "diagnosis" / "diagnose.json").read_text())
    named = ", ".join(e["name"] for e in diagnosis["effects"]) or "-"
    return (
        f"{diagnosis['verdict']}: {named}",
        off(currents(folder, corrected, "corrected", 3), measured),
        off(currents(folder, nominal, "nominal", 3), measured),
        off(repeat, measured),
    )


def main() -> int:
    """Print one line per hidden effect; exit with 1 where the loop does not close."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "effects", nargs="*", default=list(HIDDEN), help="effects to hide, each in a run of its own"
    )
    good = True
    print(
        "hidden; verdict; rms difference in current (A) of corrected bench, nominal bench, mere "
        "repeat"
    )
    for effect in parser.parse_args().effects:
        with tempfile.TemporaryDirectory() as folder:
            verdict, corrected, nominal, repeat = loop(Path(folder), effect)
        print(f"{effect}; {verdict}; {corrected:.4f}, {nominal:.4f}, {repeat:.4f}", flush=True)
        good = good and corrected <= max(0.5 * nominal, 1.5 * repeat)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
