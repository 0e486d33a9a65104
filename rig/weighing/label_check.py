"""Checks after a run that every stage's mass is the mass on its label."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from identification.recording import Dataset, Recording
from rig.config.sequence import Array
from rig.planning.reference import Reference
from rig.runs.run_record import Weighing
from rig.weighing.friction_level import friction_level
from rig.weighing.weight_check import LoadedLevel, suspects


def off_label(dataset: Dataset, reference: Reference | None = None) -> list[Weighing]:
    """Find the recordings of a run or campaign whose mass differs from their label.

    Without a reference, the check of a stage requires further stages of two different masses.

    Returns:
        The recordings whose label is or may be wrong; also empty if nothing can be compared.
    """
    return suspects(_levels(dataset.recordings), reference)


def comparable(dataset: Dataset, reference: Reference | None = None) -> bool:
    """Whether masses can be judged: by a reference, or by at least two loaded stages if the stages
    have at least two different masses.
    """
    masses = [recording.weight_mass for recording in dataset.recordings if not recording.hot_fire]
    return reference is not None or (
        len(set(masses)) >= 2 and sum(mass > 0 for mass in masses) >= 2
    )


def _levels(recordings: Iterable[Recording]) -> list[LoadedLevel]:
    found = []
    for recording in recordings:
        angle, torque = recording.channels.get("angle"), joint_torque(recording)
        rotary = recording.bench.motion == "rotary"
        if (
            angle is None
            or torque is None
            or recording.known_load
            or recording.hot_fire
            or not rotary
        ):
            continue
        level = friction_level(angle, torque, recording.period)
        if level is not None:
            found.append(LoadedLevel(recording.name, recording.weight_mass, level))
    return found


def joint_torque(recording: Recording) -> Array | None:
    """Return the torque at the joint, N m, or None if it was not measured."""
    torque, current = recording.channels.get("torque"), recording.channels.get("current")
    if torque is not None:
        return torque
    constant = recording.bench.torque_constant
    if current is None or constant is None:
        return None
    return np.asarray(current * constant * recording.bench.gear_ratio)
