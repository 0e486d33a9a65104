"""Run folders with a record and without a recording."""

import dataclasses
import json
from pathlib import Path

from rig.runs.run_record import PartRecord, RunRecord, StageRecord


def write_history(root: Path, count: int, bench: str = "mine") -> None:
    """Write runs of a bench, one a day."""
    for day in range(1, count + 1):
        write_run(root / f"{bench}-{day:02d}", day, bench)


def write_run(folder: Path, day: int, bench: str) -> None:
    """Write one run."""
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
