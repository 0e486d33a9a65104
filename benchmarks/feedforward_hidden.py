"""Feed-forward on joints that hide physics: what its gains and pulses do where the joint is not
what they presume.

The true nominal parameters on soft gains under 3000 N, one effect of the catalogue hidden at a
time; a sine and a slow ramp without feed-forward and with it. Speed is judged as a mean over 20 ms,
over the cycles in which it should move.

    python benchmarks/feedforward_hidden.py
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import yaml

from identification.model.parameters import NOMINAL
from identification.recording import Recording
from identification.signals import REST_RAD_S, track
from rig.common.provenance import IDENTIFY_SCHEMA
from rig.common.tables import table
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.sequence import load_sequence
from rig.control.session import run_simulated
from rig.planning.feedforward import load_feedforward
from rig.runs.run import bench_constants

HIDDEN: tuple[dict[str, dict[str, float]], ...] = (
    {},
    {"friction_memory": {"time_s": 0.001}},
    {"friction_memory": {"time_s": 0.02}},
    {"dwell_static_friction": {"growth_Nm": 3.0, "time_s": 0.5}},
    {"presliding": {"stiffness_Nm_rad": 1e5}},
    {"presliding": {"stiffness_Nm_rad": 2e4}},
    {"backlash": {"gap_rad": 0.002}},
    {"compliance": {"stiffness_Nm_rad": 1e6}},
    {"compliance": {"stiffness_Nm_rad": 1e5}},
    {"compliance": {"stiffness_Nm_rad": 2e4}},
)
ROTOR_KG_M2 = 1e-5
"""Half of the joint's inertia, through the gear; shows only where the transmission gives."""
SPAN = 20
SEQUENCE = """\
sequence: 1
name: hidden
stages:
  - {name: sine, stage: loaded, weight_kg: 30.6, tones: [{amplitude_deg: 20, frequency_Hz: 0.2}],
     duration_s: 7}
  - {name: ramp, stage: loaded, weight_kg: 30.6, ramp: {travel_deg: 5, speed_deg_s: 1,
     rest_s: 0.5}, duration_s: 11}
"""


def unsteadiness(recording: Recording) -> float:
    """Return the rms difference of mean speed and commanded speed, rad/s."""
    padded = np.pad(recording.channels["angle"], (SPAN // 2, SPAN - SPAN // 2), mode="edge")
    speed = (padded[SPAN:] - padded[:-SPAN]) / (SPAN * recording.period)
    commanded = np.gradient(recording.channels["command"], recording.period)
    moving = np.abs(commanded) > REST_RAD_S
    return float(np.sqrt(np.mean((speed - commanded)[moving] ** 2)))


def main() -> None:
    """Run, compare, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bench", default="practical_soft")
    arguments = parser.parse_args()
    raw = yaml.safe_load(resolve(arguments.bench, "benches").read_text(encoding="utf-8"))
    cells = []
    for effects in HIDDEN:
        with tempfile.TemporaryDirectory() as name:
            scratch = Path(name)
            raw["mock"]["effects"] = effects
            raw["mock"]["motor"]["rotor_inertia_kg_m2"] = ROTOR_KG_M2
            (scratch / "bench.yaml").write_text(yaml.safe_dump(raw))
            (scratch / "hidden.yaml").write_text(SEQUENCE)
            known = {"schema": IDENTIFY_SCHEMA, "motion": "rotary", "alpha": 2.0}
            known["parameters"] = {key: {"value": value} for key, value in NOMINAL.items()}
            (scratch / "known.json").write_text(json.dumps(known))
            bench, plan = (
                load_bench(str(scratch / "bench.yaml")),
                load_sequence(scratch / "hidden.yaml"),
            )
            model = load_feedforward(scratch / "known.json", bench_constants(bench.value))
            runs = [
                run_simulated(bench, plan, arguments.seed, scratch / f"run{k}", fed)
                for k, fed in enumerate((None, model))
            ]
        words = "; ".join(f"{key} {value:g}" for p in effects.values() for key, value in p.items())
        for pair in zip(*(run.recordings for run in runs), strict=True):
            tracked = [track(r) for r in pair]
            cells.append(
                [
                    f"{' '.join(effects) or 'nothing'} {words}".strip(),
                    pair[0].name,
                    *(f"{1e3 * t.rms:.3f}" for t in tracked),
                    *(f"{1e3 * t.largest:.2f}" for t in tracked),
                    *(f"{100.0 * t.waiting:.0f}" for t in tracked),
                    *(f"{1e3 * unsteadiness(r):.1f}" for r in pair),
                ]
            )
    header = [
        "hidden",
        "stage",
        "rms mrad",
        "after",
        "largest",
        "after",
        "waits %",
        "after",
        "speed mrad/s",
        "after",
    ]
    print(table(header, cells, right=range(2, 10)))


if __name__ == "__main__":
    main()
