"""Adds the uncertainty of known constants, such as the torque constant, to the uncertainty of the
estimates.

The fit takes torque constant, gear ratio, weights and similar constants as exact. Each uncertain
constant is raised and lowered by its standard deviation, and the equation error is solved for the
raised and for the lowered value. Half the difference of the two solutions, d, is the effect of one
standard deviation to first order; d d' is added to the covariance of the estimates. The errors of
the constants are taken as independent of each other and of the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from identification.numerics.spread import Spread
from identification.prepare import Prepared, prepare
from identification.recording import Recording
from identification.result import KnownConstant

Solve = Callable[[Sequence[Prepared]], Mapping[str, float]]
"""Function that solves the equation error of prepared recordings and returns values by name."""


class Constant(NamedTuple):
    """One uncertain constant: its place in a recording, its value and standard deviation."""

    place: str
    value: float
    uncertainty: float


def uncertain_constants(recordings: Sequence[Recording]) -> tuple[Constant, ...]:
    """Return the uncertain constants of the recordings, without duplicates.

    Constants of several recordings with the same place, value and uncertainty are one constant,
    such as a weight that was hung several times.
    """
    found: dict[Constant, None] = {}
    for recording in recordings:
        for place, uncertainty in recording.uncertainties.items():
            found[Constant(place, _read(recording, place), uncertainty)] = None
    return tuple(found)


def shifts_of_constants(active: Sequence[Prepared], solve: Solve) -> tuple[KnownConstant, ...]:
    """Return the effect of one standard deviation of each uncertain constant on the estimates.

    Args:
        active: Recordings to fit, prepared.
        solve: Function that solves the equation error of the recordings.

    Raises:
        RecordingError: The fit fails with a constant raised or lowered by its standard deviation.
    """
    found = []
    for constant in uncertain_constants([p.recording for p in active]):
        low, high = (
            solve([prepare(_moved(p.recording, constant, side), p.bandwidth_Hz) for p in active])
            for side in (-1.0, 1.0)
        )
        shifts = {name: 0.5 * (high[name] - low[name]) for name in high if name in low}
        found.append(KnownConstant(*constant, shifts))
    return tuple(found)


def with_constants(spread: Spread, constants: Sequence[KnownConstant]) -> Spread:
    """Return the covariance of the estimates, with the covariance due to the constants added."""
    covariance = spread.covariance
    for constant in constants:
        d = np.array([constant.shifts.get(name, 0.0) for name in spread.names])
        covariance = covariance + np.outer(d, d)
    return replace(spread, covariance=covariance)


def _moved(recording: Recording, constant: Constant, side: float) -> Recording:
    """Return the recording with a constant changed by its standard deviation; unchanged if the
    recording does not contain the constant.
    """
    place, value, uncertainty = constant
    if recording.uncertainties.get(place) != uncertainty or _read(recording, place) != value:
        return recording
    section, _, name = place.rpartition(".")
    moved: Any = {name: value + side * uncertainty}
    if section:
        moved = {section: replace(getattr(recording, section), **moved)}
    return replace(recording, **moved)


def _read(recording: Recording, place: str) -> float:
    value: Any = recording
    for name in place.split("."):
        value = getattr(value, name)
    return float(value)
