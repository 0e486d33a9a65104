"""Made-up trials and diagnoses that the workers of ``test_cluster`` can import."""

import hashlib
import os
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import psutil

from rig.results.prove import judge as judging
from rig.results.prove import run
from rig.results.prove import simulate as simulating
from rig.results.prove.judge import Judgement
from rig.results.prove.run import Made, Task, made, making
from rig.results.prove.truth import seal_truth

DIES = "PROOF_PARTS_DIES"
"""Variable with a file: the first worker that does not find it makes it and is killed."""
FIT = {"equation": "torque", "validate_baseline_rms": 2.0, "validate_final_rms": 1.0}


CAMPAIGN = """campaign: 1
bench: {motion: rotary, torque_constant: 0.1}
recordings: [{file: a.npz, channels: {time: t, angle: q, current: i}}]
"""


def seal(task: Task, seed: int) -> Made:
    with making(task.number) as where:
        for file in (where.campaign, where.reference):
            file.parent.mkdir(parents=True)
            file.write_text(CAMPAIGN)
            (file.parent / "a.npz").write_bytes(bytes((seed, task.number)))
        truth = {"effects": {name: {} for name in task.assigned[1]}, "strength": {"current": 4.0}}
        return made(seal_truth(where, where.name, truth, task.salt))


def judge(source: Path, seed: int) -> Judgement:
    """Return a diagnosis that follows from the content of the campaign's folder and the seed."""
    obey()
    files = sorted(source.parent.iterdir())
    digest = hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()
    value = int(digest[:8], 16) / 2.0**32
    estimate = {"value": value, "low": value - seed / 2.0**40, "high": 1.0, "unit": "rad"}
    where = {"coordinate": "travel since reversal", "recordings": ["a"]}
    effect = {
        "name": "backlash",
        "alias_group": [],
        "confidence": 0.5 + value / 2.0,
        "parameters": {"gap_rad": estimate},
        "where": where,
    }
    record = {
        "created": f"by process {os.getpid()}",
        "seconds": float(os.getpid()),
        "inputs": [{"file": str(f)} for f in files],
        "verdict": "named",
        "effects": [effect],
        "fit": FIT | {"noise_floor_rms": value},
        "fits": [FIT],
        "location": where,
        "parameter_shift": {"Mc": {"before": 8.0, "after": 7.0, "unit": "N m"}},
        "p_value": value,
    }
    return Judgement(record, os.getpid(), {"torque": 1.0})


def oracle_of(source: Path, names: Sequence[str]) -> Mapping[str, Any]:
    assert source.is_file()
    error = 0.7 / len(names)
    return {"equation": "torque", "baseline_rms": 2.0, "oracle_rms": error, "noise_rms": 0.3}


def floors_of(source: Path) -> Mapping[str, float]:
    return {"torque": len(source.read_bytes()) / 997.0}


def obey() -> None:
    """Be killed as the environment says; check that nobody listens beyond the loopback."""
    if DIES not in os.environ:
        return
    here = psutil.Process()
    for process in (here, *here.parents()[:1]):
        listening = (c for c in process.net_connections("inet") if c.status == psutil.CONN_LISTEN)
        assert {c.laddr.ip for c in listening} <= {"127.0.0.1"}
    try:
        Path(os.environ[DIES]).touch(exist_ok=False)
    except FileExistsError:
        return
    os.kill(os.getpid(), signal.SIGKILL)


if "PROOF_PARTS" in os.environ:
    # A process of the test, or one of its workers, which imports this module for its functions.
    run._seal, simulating.floors_of = seal, floors_of
    judging.judge, judging.oracle_of = judge, oracle_of
