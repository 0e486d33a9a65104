"""Random practical benches of the floor study: their files, and Figure 10 run on each or made of
the fitted model.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from identification.recording import Array, Bench, Dataset, Recording
from identification.simulation.drive_loop import respond, usual_loop
from rig.cli import entry as cli
from rig.runs.recorded_inputs import JOINT_FIELDS
from rig.runs.run_record import RECORDING_FILE

SPREAD = 0.4
"""Each of the nine lies within this share of the practical bench's value."""
COUNTS = tuple(2**k for k in range(12, 17))
"""Counts per motor turn."""
FULL_SCALE_A = 25.0
"""Of the current sensor: the drive's current limit."""
NOISE_SHARE = (0.002, 0.01)
"""Rms noise of the logged current over full scale."""
_STREAM = 20261120
WEIGHTS_KG = (0.0, 30.6)
PERIOD_S, STAGE_S, RAMP_S = 1e-3, 20.0, 1.0
_BENCH = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095)


def random_bench(template: str, seed: int) -> dict[str, Any]:
    """Return a practical bench drawn from ``seed``; static friction is drawn again where it falls
    below Coulomb's.
    """
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
    """Run the Figure 10 sequence on a bench through the whole simulated chain, once; return the
    run's folder.

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
        options = ["--yes", "--bench", str(file), "--seed", str(seed), "--out", str(run)]
        status = cli.status(["run", "figure10", *options])
    if status != 0:
        raise SystemExit(f"bench {seed}: rig run ended with status {status}:\n{said.getvalue()}")
    (run / "done").touch()
    return run


def figure10_command() -> Array:
    """20 deg at 0.2 Hz with a second to fade in and out, rad."""
    time = PERIOD_S * np.arange(round(STAGE_S / PERIOD_S))
    fade = 0.5 - 0.5 * np.cos(np.pi * np.clip(np.minimum(time, STAGE_S - time) / RAMP_S, 0.0, 1.0))
    return np.asarray(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time) * fade)


def of_the_model(bench: Mapping[str, Any], seed: int) -> tuple[dict[str, float], Dataset]:
    """Return the true values and Figure 10 as the fitted model itself makes it, under a usual
    drive's loop.

    Half of the current noise's power is in the torque itself, half in its measurement.
    """
    rng = np.random.default_rng([seed, _STREAM, 1])
    joint, sensing = bench["mock"]["joint"], bench["mock"]["sensing"]
    truth = {name: float(joint[field]) for name, field in JOINT_FIELDS.items()}
    ampere = _BENCH.torque_constant * _BENCH.gear_ratio if _BENCH.torque_constant else 1.0
    count = 2.0 * np.pi / (sensing["motor_counts_per_turn"] * _BENCH.gear_ratio)
    command, recordings = figure10_command(), []
    for weight in WEIGHTS_KG:
        noise = (
            ampere * sensing["current_noise_A"] * 0.5**0.5 * rng.standard_normal((2, len(command)))
        )
        moment = _BENCH.contact_force(weight) * (_BENCH.moment_arm or 0.0)
        loop = usual_loop(truth["J"], ampere * FULL_SCALE_A, count)
        out = respond(command, PERIOD_S, truth, moment, 2.0, loop, noise[0])
        channels = {
            "time": PERIOD_S * np.arange(len(command)),
            "command": command,
            "motor_angle": np.floor(out.angle / count + rng.uniform()) * count * _BENCH.gear_ratio,
            "current": (out.torque + noise[1]) / ampere,
        }
        recordings.append(
            Recording(
                name=f"{weight:g} kg",
                channels=channels,
                bench=_BENCH,
                stage="loaded" if weight else "unloaded",
                weight_mass=weight,
                averaged=frozenset({"current"}),
            )
        )
    return truth, Dataset(tuple(recordings))
