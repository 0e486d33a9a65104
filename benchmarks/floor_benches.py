"""Random practical benches of the floor study: their files, and the Figure 10 run on each."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from rig import cli
from rig.run import RECORDING_FILE
from rig.truth import JOINT_FIELDS

SPREAD = 0.4
"""Each of the nine lies within this share of the practical bench's value."""
COUNTS = tuple(2**k for k in range(12, 17))
"""Counts per motor turn."""
FULL_SCALE_A = 25.0
"""Of the current sensor: the drive's current limit."""
NOISE_SHARE = (0.002, 0.01)
"""Rms noise of the logged current over full scale."""
_STREAM = 20261120


def random_bench(template: str, seed: int) -> dict[str, Any]:
    """Return a practical bench drawn from ``seed``; static friction is drawn again where it falls below Coulomb's."""
    rng = np.random.default_rng([seed, _STREAM])
    bench: dict[str, Any] = yaml.safe_load(template)
    joint, sensing = bench["mock"]["joint"], bench["mock"]["sensing"]
    nominal = dict(joint)
    while True:
        for name in JOINT_FIELDS.values():
            joint[name] = float(nominal[name] * rng.uniform(1.0 - SPREAD, 1.0 + SPREAD))
        if joint["Ms_N_m"] > joint["Mc_N_m"] and joint["mu_s"] > joint["mu_c"]:
            break
    counts = int(rng.choice(COUNTS))
    bench["servo"]["counts_per_motor_turn"] = sensing["motor_counts_per_turn"] = counts
    sensing["current_noise_A"] = float(FULL_SCALE_A * rng.uniform(*NOISE_SHARE))
    bench["name"] = f"random{seed}"
    return bench


def record(bench: Mapping[str, Any], seed: int, folder: Path) -> Path:
    """Run the Figure 10 sequence on a bench through the whole simulated chain, once; return the run's folder.

    Raises:
        SystemExit: The run did not end well.
    """
    run = folder / f"{bench['name']}-{seed}"
    if (run / RECORDING_FILE).is_file() and (run / "done").is_file():
        return run
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{run.name}.yaml"
    file.write_text(yaml.safe_dump(dict(bench)), encoding="utf-8")
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        status = cli.status(
            ["run", "figure10", "--bench", str(file), "--yes", "--seed", str(seed), "--out", str(run)]
        )  # fmt: skip
    if status != 0:
        raise SystemExit(f"bench {seed}: rig run ended with status {status}:\n{said.getvalue()}")
    (run / "done").touch()
    return run
