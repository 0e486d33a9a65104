"""What the uncertainty of known constants does to the estimates.

The fit takes torque constant, gear ratio, weights and their like as given. Each that is uncertain
is raised and lowered by its standard deviation, the equation error is solved again, and half the
difference is the standard deviation that it adds to each parameter, to first order. The constants'
errors count as independent of each other and of the noise; priors do not lessen the shifts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from identification.estimate.default import by_load, solve_stages
from identification.prepare import prepare
from identification.recording import Dataset, Recording
from identification.result import Identification, KnownConstant, Parameter

NORMAL_90 = 1.6448536269514722
"""Half width of a 90 % interval over the standard deviation."""
SIGNED = frozenset({"offset"})
"""Parameters that may be negative."""


class _Constant(NamedTuple):
    """One uncertain constant: its place in a recording, its value and standard deviation."""

    place: str
    value: float
    uncertainty: float


def uncertain_constants(recordings: Sequence[Recording]) -> tuple[_Constant, ...]:
    """Return the uncertain constants of recordings, each once.

    Constants of several recordings that agree in place, value and uncertainty are one, such as a
    weight that was hung several times.
    """
    found: dict[_Constant, None] = {}
    for recording in recordings:
        for place, uncertainty in recording.uncertainties.items():
            found[_Constant(place, _read(recording, place), uncertainty)] = None
    return tuple(found)


def with_uncertain_constants(result: Identification, dataset: Dataset) -> Identification:
    """Return a result whose intervals hold the uncertainty of the known constants as well.

    Args:
        result: Identification of the dataset.
        dataset: Its recordings; only those to fit count.

    Raises:
        RecordingError: The fit fails with a constant at the end of its uncertainty.
    """
    fitted = dataset.part("fit")
    added = []
    for constant in uncertain_constants(fitted):
        low, high = (_solved(fitted, dataset, constant, side, result) for side in (-1.0, 1.0))
        shifts = {n: 0.5 * (high[n] - low[n]) for n in high if n in low and n in result.parameters}
        added.append(KnownConstant(*constant, shifts))
    if not added:
        return result
    parameters = {n: _widened(p, added) for n, p in result.parameters.items()}
    return replace(result, parameters=parameters, known_constants=tuple(added))


def _solved(
    fitted: Sequence[Recording],
    dataset: Dataset,
    constant: _Constant,
    side: float,
    result: Identification,
) -> Mapping[str, float]:
    moved = [_moved(r, constant, side) for r in fitted]
    prepared = [prepare(r, result.fit.bandwidth_Hz) for r in moved]
    model = replace(dataset.model, friction=result.friction)
    return solve_stages(*by_load(prepared), model, lambda _stage, _share: None)[0]


def _moved(recording: Recording, constant: _Constant, side: float) -> Recording:
    """Return the recording with a constant moved by its standard deviation, where it has it."""
    place, value, uncertainty = constant
    if recording.uncertainties.get(place) != uncertainty or _read(recording, place) != value:
        return recording
    section, _, name = place.rpartition(".")
    if not section:
        return replace(recording, **{name: value + side * uncertainty})  # type: ignore[arg-type]
    inside: Any = getattr(recording, section)
    return replace(recording, **{section: replace(inside, **{name: value + side * uncertainty})})


def _read(recording: Recording, place: str) -> float:
    value: Any = recording
    for name in place.split("."):
        value = getattr(value, name)
    return float(value)


def _widened(parameter: Parameter, added: Sequence[KnownConstant]) -> Parameter:
    """Return a parameter whose interval holds the shifts; those that were given stay as they
    are.
    """
    own = NORMAL_90 * math.hypot(*(c.shifts.get(parameter.name, 0.0) for c in added))
    value, low, high = parameter.value, parameter.low, parameter.high
    if value is None or low is None or high is None or not high > low:
        return parameter
    least = value - math.hypot(value - low, own)
    if low >= 0.0 and parameter.name not in SIGNED:
        least = max(least, 0.0)
    return replace(parameter, low=least, high=value + math.hypot(high - value, own))
