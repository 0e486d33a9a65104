"""Simulates the campaign of a blind trial, and computes the strength of its effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.without_bus import Samples, record
from identification.diagnosis.joint import Joint
from identification.diagnosis.within_limits import choose, views_and_fit
from identification.recording import RecordingError
from rig.common.places import replacing, write_text
from rig.results.prove.draw import Rig
from rig.results.prove.excitation import CYCLE_S, NOTHING_FIXED, Array, Experiment, FixedWeight
from rig.results.prove.truth import CAMPAIGN_FILE
from rig.runs.recorded_inputs import true_parameters
from rig.sources import load_source

MOVING_RAD_S = 0.02
SETTLE_S = 0.5  # time under power before each recording, s
CHANNELS = ("current", "voltage", "supply_voltage", "motor_angle", "angle", "temperature")


class Recorded(NamedTuple):
    """One recording; ``start_s`` is its start since the start of the campaign."""

    experiment: Experiment
    start_s: float
    samples: Samples


def campaign(rig: Rig, plan: Sequence[Experiment]) -> list[Recorded]:
    """Simulate all experiments on one plant that keeps temperature, wear and state."""
    machine = SimulatedMachine(rig.machine, np.random.default_rng(rig.seed))
    done = []
    clock_s, turning = 0.0, None
    for experiment, pause_s in zip(plan, rig.pauses_s, strict=True):
        machine.power(False)
        machine.hang(experiment.weight_kg)
        if experiment.fixed is not None or turning is not None:
            machine.fix_weight(*(experiment.fixed or NOTHING_FIXED))
        turning = experiment.fixed
        machine.rest(pause_s)
        machine.power(True)
        record(machine, np.zeros(round(SETTLE_S / CYCLE_S)), CYCLE_S)
        clock_s += pause_s + SETTLE_S
        samples = record(machine, experiment.command, CYCLE_S)
        done.append(Recorded(experiment, round(clock_s, 3), samples))
        clock_s += len(experiment.command) * CYCLE_S
    return done


def reference_of(rig: Rig, plan: Sequence[Experiment]) -> list[Recorded]:
    """Return the reference simulation of a trial: the same commands and noise without effects."""
    return campaign(rig._replace(machine=replace(rig.machine, effects={})), plan)


def strength(injected: Sequence[Recorded], reference: Sequence[Recorded]) -> dict[str, float]:
    """Compare a campaign with its reference simulation.

    Current and voltage are compared only where the joint moves in both campaigns: the current that
    holds a joint at rest depends on how the joint came to rest, down to a single encoder count.

    Returns:
        For each channel, the rms difference over the channel's noise. The noise is the rms
        difference of two recordings of one experiment in the reference simulation, over sqrt(2),
        and at least the quantisation noise of the channel.
    """
    first, last = reference[0].samples, reference[-1].samples
    assert np.array_equal(first.command, last.command)
    pairs = [(a.samples, b.samples) for a, b in zip(injected, reference, strict=True)]
    found = {}
    for name in CHANNELS:
        noise = _rms([_gap(name, first, last)]) / np.sqrt(2.0)
        steps = np.diff(np.unique(getattr(first, name)))
        floor = (steps.min() if steps.size else 1e-3) / np.sqrt(12.0)
        found[name] = float(_rms([_gap(name, a, b) for a, b in pairs]) / max(noise, floor))
    return found


def _gap(name: str, a: Samples, b: Samples) -> Array:
    """Return the difference of two recordings of one experiment where they can be compared."""
    difference = np.asarray(getattr(a, name) - getattr(b, name), dtype=np.float64)
    if name not in ("current", "voltage"):
        return difference
    return difference[np.minimum(np.abs(a.velocity), np.abs(b.velocity)) > MOVING_RAD_S]


def _rms(parts: Sequence[Array]) -> float:
    joined = np.concatenate(parts)
    return float(np.sqrt(np.mean(np.square(joined)))) if joined.size else 0.0


AVERAGED = ("current", "voltage")
_GRAVITY = ("mass", "length", "zero")


def write(
    folder: Path, machine: Machine, recorded: Sequence[Recorded], packed: bool = True
) -> Path:
    """Write a campaign; return the campaign file.

    All time stamps are of one clock, so that the first time stamp of each recording is the start
    of the recording in the campaign.

    ``machine``: the plant; only its nominal constants are written. ``packed``: whether to compress
    the recordings; compression takes half as long as their simulation.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for entry in recorded:
        samples = entry.samples
        columns = {"time": entry.start_s + samples.time, "command": samples.command}
        columns |= {name: getattr(samples, name) for name in CHANNELS}
        with (
            replacing(folder / f"{entry.experiment.name}.npz") as draft,
            draft.open("wb") as stream,
        ):
            (np.savez_compressed if packed else np.savez)(stream, allow_pickle=False, **columns)
    path = folder / CAMPAIGN_FILE
    write_text(path, yaml.safe_dump(description(machine, recorded), sort_keys=False))
    return path


def description(machine: Machine, recorded: Sequence[Recorded]) -> dict[str, Any]:
    """Return the content of the campaign file: what an engineer knows of the bench."""
    motor, joint = machine.motor, machine.joint
    channels: dict[str, Any] = {name: name for name in ("time", "command", *CHANNELS)}
    channels |= {name: {"column": name, "average": True} for name in AVERAGED}

    def fixed(weight: FixedWeight | None) -> dict[str, Any]:
        return {} if weight is None else {"gravity": dict(zip(_GRAVITY, weight, strict=True))}

    return {
        "campaign": 1,
        "bench": {
            "motion": "rotary",
            "torque_constant": motor.torque_constant_N_m_A,
            "back_emf_constant": motor.back_emf_constant_V_s_rad,
            "resistance": motor.resistance_ohm,
            "inductance": motor.inductance_H,
            "gear_ratio": motor.gear_ratio,
            "moment_arm": joint.moment_arm_m,
            "lever_ratio": joint.lever_ratio,
            "gravity": joint.gravity_m_s2,
        },
        "defaults": {"channels": channels},
        "recordings": [
            {
                "file": f"{entry.experiment.name}.npz",
                "stage": "loaded" if entry.experiment.weight_kg else "unloaded",
                "weight_mass": entry.experiment.weight_kg,
                **fixed(entry.experiment.fixed),
                "role": entry.experiment.role,
            }
            for entry in recorded
        ],
    }


def residual_rms(joint: Joint) -> dict[str, float]:
    """Return the residual of a fit in each equation, in the equation's unit."""
    out = {}
    for equation in joint.equations:
        rows = joint.residual[joint.stack.part(equation.name)]
        out[equation.name] = equation.sigma * math.sqrt(float(np.mean(rows**2)))
    return out


def floors_of(campaign: Path) -> dict[str, float]:
    """Return the nominal model's residual on a campaign without effects; empty if not fitted."""
    dataset = load_source(campaign)
    try:
        dataset, bandwidth, _ = choose(dataset, None)
        _, joint = views_and_fit(dataset, bandwidth)
    except RecordingError:
        return {}
    # The floor is at least the noise of a row: where little moves, rounding errors may cancel.
    sigma = {e.name: e.sigma for e in joint.equations}
    return {name: max(rms, sigma[name]) for name, rms in residual_rms(joint).items()}


def left_over(left: Mapping[str, float], floor: Mapping[str, float]) -> dict[str, float]:
    """Return what exceeds the noise floor, over the noise floor, for each equation."""
    return {
        name: math.sqrt(max(left[name] ** 2 - floor[name] ** 2, 0.0)) / floor[name]
        for name in left
        if floor.get(name, 0.0) > 0.0
    }


def truth_of(rig: Rig) -> dict[str, Any]:
    """Return the sealed content of a trial."""
    return {
        "effects": as_recorded(rig.machine.effects),
        "parameters": true_parameters(rig.machine),
        "maker": {
            "machine": asdict(rig.machine),
            "pauses_s": rig.pauses_s,
            "gravity": rig.gravity,
            "seed": rig.seed,
        },
    }


def as_recorded(effects: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """Return the effects with times from the start of a recording, not from power-on."""
    out = {name: dict(parameters) for name, parameters in effects.items()}
    if "encoder_slip" in out:
        out["encoder_slip"]["at_s"] -= SETTLE_S
    if "load_swing" in out:
        out["load_swing"]["fraction"] *= math.exp(-SETTLE_S / out["load_swing"]["decay_s"])
    return out
