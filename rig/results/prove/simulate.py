"""Simulates the campaign of a blind trial, and computes the strength of its effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drivers.mock.plant.machine import SimulatedMachine
from drivers.mock.without_bus import Samples, record
from rig.results.prove.draw import Rig
from rig.results.prove.excitation import CYCLE_S, NOTHING_FIXED, Array, Experiment

MOVING_RAD_S = 0.02
SETTLE_S = 0.5
"""Time under power before each recording, s."""
CHANNELS = ("current", "voltage", "supply_voltage", "motor_angle", "angle", "temperature")


class Recorded(NamedTuple):
    """One recording of a campaign; ``start_s`` is the time from the start of the campaign to the
    start of the recording.
    """

    experiment: Experiment
    start_s: float
    samples: Samples


def campaign(rig: Rig, plan: Sequence[Experiment]) -> list[Recorded]:
    """Simulate all experiments, one after another on one plant that keeps its temperature, wear and
    state.
    """
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
        floor = _quantum(getattr(first, name)) / np.sqrt(12.0)
        found[name] = float(_rms([_gap(name, a, b) for a, b in pairs]) / max(noise, floor))
    return found


def _gap(name: str, a: Samples, b: Samples) -> Array:
    """Return the difference of two recordings of one experiment in a channel, at the samples that
    can be compared.
    """
    difference = np.asarray(getattr(a, name) - getattr(b, name), dtype=np.float64)
    if name not in ("current", "voltage"):
        return difference
    return difference[np.minimum(np.abs(a.velocity), np.abs(b.velocity)) > MOVING_RAD_S]


def _rms(parts: Sequence[Array]) -> float:
    joined = np.concatenate(parts)
    return float(np.sqrt(np.mean(np.square(joined)))) if joined.size else 0.0


def _quantum(values: Array) -> float:
    """Return the smallest step between two different values of a channel."""
    steps = np.diff(np.unique(values))
    return float(steps.min()) if steps.size else 1e-3
