"""Nominal values for `rig identify --plan`: the parameters of an identification result, and the
drive loop from its recordings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from identification.design.simulated import NAMES
from identification.model.parameters import NOMINAL
from identification.recording import Recording
from rig.common.errors import InputError
from rig.common.provenance import sha256_file
from rig.planning.reference import read_identification
from rig.runs.run import load_run

_SMALLEST = 1e-12
"""Smallest plausible parameter value, SI units; the largest is its inverse."""


@dataclass(frozen=True)
class NominalValues:
    """Nominal values of a bench before an experiment.

    Attributes:
        values: The nine parameters, SI.
        source: Origin of the nominal values, as text.
        weakest: The least accurate parameter, or None if unknown.
        recordings: The recordings from which the values were identified, if the run can still be
            read.
        torque_noise: Noise of the measured torque, N m rms, or None if unknown.
    """

    values: dict[str, float]
    source: str
    weakest: str | None = None
    recordings: tuple[Recording, ...] = ()
    torque_noise: float | None = None


def nominal_values(path: Path | None) -> NominalValues:
    """Return the values of a result of `rig identify --json`; a parameter that the result does not
    determine gets the default nominal value.

    Raises:
        InputError: The file cannot be read, or is not a result of ``rig identify`` on a rotary
            bench.
    """
    if path is None:
        return NominalValues(
            dict(NOMINAL), "the paper's friction and the practical bench's inertia"
        )
    raw = read_identification(path)
    try:
        known = {n: raw["parameters"][n]["value"] for n in NAMES if n in raw["parameters"]}
        found = {n: float(v) for n, v in known.items() if v is not None}
        widths = {n: _half_width(raw["parameters"][n]) for n in known}
        noise = _torque_noise(raw.get("noise"))
        inputs = {Path(entry["file"]): str(entry["sha256"]) for entry in raw.get("inputs", [])}
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: damaged: {error}; run `rig identify` again") from error
    problems = [
        f"{path}: parameters.{n}: must be from {_SMALLEST:g} to {1 / _SMALLEST:g} (got {v:g})"
        for n, v in found.items()
        if not _SMALLEST <= v <= 1 / _SMALLEST
    ]
    if problems:
        raise InputError(problems)
    open_names = [n for n in NAMES if n not in found]
    words = f"the identification {path}"
    if open_names:
        words += f"; {', '.join(open_names)}, not determined by the result, at their default values"
    weakest = max(widths, key=lambda n: widths[n]) if widths else None
    return NominalValues({**NOMINAL, **found}, words, weakest, _recordings(inputs), noise)


def _torque_noise(noise: dict[str, Any] | None) -> float | None:
    """Return the total noise of the measured torque in a result file, N m rms, or None if the file
    states no noise.

    Raises:
        KeyError, TypeError, ValueError: The part of the file on noise is damaged.
    """
    if noise is None or noise["unit"] != "N m":
        return None
    whole = math.hypot(float(noise["torque"]), float(noise["correlated"]))
    if not math.isfinite(whole):
        raise ValueError("the torque noise of the result is not a number")
    return whole or None


def _half_width(parameter: dict[str, Any]) -> float:
    """Return a parameter's relative half width in a result file; infinite if undetermined."""
    value, low, high = (parameter[key] for key in ("value", "low", "high"))
    return math.inf if not value or low is None or high is None else 0.5 * (high - low) / abs(value)


def _recordings(inputs: dict[Path, str]) -> tuple[Recording, ...]:
    """Return the recordings of the input runs that are unchanged; recordings of changed runs are
    omitted.
    """
    out: list[Recording] = []
    for folder in sorted({file.parent for file in inputs}):
        mine = {file: digest for file, digest in inputs.items() if file.parent == folder}
        try:
            if all(sha256_file(file) == digest for file, digest in mine.items()):
                out += load_run(folder).recordings
        except (InputError, OSError):
            continue  # not a run, or no longer there: the drive is then assumed
    return tuple(out)
