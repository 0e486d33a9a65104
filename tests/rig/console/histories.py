"""Run folders with a record and an identification, and without a recording."""

import dataclasses
import json
from pathlib import Path

import numpy as np

from rig.runs.run_record import PartRecord, RunRecord, StageRecord

TRUE = {"Mc": 6.8, "Ms": 12.0, "J": 0.2}
SHARE = 0.01
"""Half width of the intervals over the value."""


def write_history(root: Path, count: int, step: float = 0.0, bench: str = "mine") -> list[str]:
    """Write runs of a bench, one a day, and return their folders. From the middle on, Mc is off by
    so many half widths of its interval.
    """
    rng = np.random.default_rng(3)
    names = [f"{bench}-{number + 1:02d}" for number in range(count)]
    for number, name in enumerate(names):
        shares = dict(zip(TRUE, rng.normal(0.0, 0.3 * SHARE, len(TRUE)).tolist(), strict=True))
        shares["Mc"] += step * SHARE * (number >= count // 2)
        write_run(root / name, number + 1, shares, bench)
    return names


def write_run(folder: Path, day: int, shares: dict[str, float], bench: str) -> None:
    """Write one run whose constants are off the truth by some shares; without shares it is not
    identified.
    """
    created = f"2026-11-{day:02d}T08:00:00+00:00"
    servo = {"name": "drive", "serial_number": 7, "revision": 1, "software_version": "1"}
    source = {"file": f"{bench}.yaml", "sha256": bench}
    record = RunRecord(
        name="short",
        created=created,
        seed=day,
        simulated=True,
        realtime=False,
        cycle_s=0.001,
        versions={},
        inputs={"bench.yaml": source, "sequence.yaml": {**source, "file": "short.yaml"}},
        bench={
            "motion": "rotary",
            "torque_constant": 0.03,
            "back_emf_constant": 0.03,
            "resistance": 1.5,
            "inductance": 0.001,
            "gear_ratio": 100.0,
            "moment_arm": 0.1,
            "lever_ratio": 10.0,
            "supply_voltage": 60.0,
            "gravity": 9.81,
            "gas_generator": None,
        },
        stages=[StageRecord("empty", "unloaded", 0.0, 1, 500, "done", 0.0)],
        parts=[PartRecord("recording.mcap", created, day, "Ada", {}, {"servo": servo}, "done")],
        state="done",
        message="all 1 stages done",
    )
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(json.dumps(dataclasses.asdict(record)))
    if not shares:
        return
    parameters = {
        name: {
            "value": true * (1.0 + shares[name]),
            "low": true * (1.0 + shares[name] - SHARE),
            "high": true * (1.0 + shares[name] + SHARE),
            "unit": "N m",
        }
        for name, true in TRUE.items()
    }
    found = {"schema": "loadrig.identify/1", "method": "default", "parameters": parameters}
    fit = {"unit": "N m", "train_rms": 0.02}
    (folder / "identify.json").write_text(json.dumps({**found, "fit": fit}))
