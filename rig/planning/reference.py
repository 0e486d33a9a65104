"""Reads an identification of the bench as the reference for the weight check."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from identification.model.friction import load_coefficient, system_friction
from identification.recording import Bench
from rig.common.errors import InputError
from rig.common.places import read_json
from rig.common.provenance import IDENTIFY_SCHEMA
from rig.config.sequence import Array

NEEDED = ("Mc", "Ms", "omega_sf", "sigma_2", "mu_c", "mu_s", "omega_sL", "mu_2")
_SIGMA_OF_90 = 1.6449
LARGEST_ALPHA = 100.0


@dataclass(frozen=True)
class Reference:
    """Friction of a bench from an accepted identification."""

    values: Mapping[str, float]
    sigmas: Mapping[str, float]
    alpha: float
    moment_per_kg: float
    source: str

    def unloaded(self, speed: Array) -> Array:
        """Return the friction without a weight, N m, at speeds >= 0 (eq. 9)."""
        return system_friction(speed, self.values, self.alpha)

    def per_kg(self, speed: Array) -> Array:
        """Return the friction that one kilogram adds, N m (eq. 12, 13)."""
        return self.moment_per_kg * load_coefficient(speed, self.values, self.alpha)

    def shifted(self, name: str) -> Reference:
        """Return a copy in which one parameter is larger by its standard error."""
        values = {**self.values, name: self.values[name] + self.sigmas[name]}
        return Reference(values, self.sigmas, self.alpha, self.moment_per_kg, self.source)


def moment_per_kg(bench: Bench) -> float:
    """Return the contact moment of one kilogram on the lever, N m (eq. 13, 17)."""
    return bench.contact_force(1.0) * (bench.moment_arm or 0.0)


def load_reference(path: Path, bench: Bench) -> Reference:
    """Read a result of ``rig identify`` as reference; InputError without what the check needs."""
    found, alpha = _stated(path, NEEDED, ("value", "low", "high"))
    problems = [
        f"{path}: parameters.{name}: not identified; the weight check needs the result of a run "
        f"with an unloaded and a loaded stage"
        for name in NEEDED
        if not all(map(math.isfinite, found.get(name, [math.nan])))
    ]
    if problems:
        raise InputError(problems)
    values = {name: value for name, (value, _, _) in found.items()}
    sigmas = {name: 0.5 * (high - low) / _SIGMA_OF_90 for name, (_, low, high) in found.items()}
    return Reference(values, sigmas, alpha, moment_per_kg(bench), str(path))


def read_identification(path: Path) -> dict[str, Any]:
    """Read a result of ``rig identify`` on a rotary bench, or raise an InputError."""
    raw = read_json(path)
    if not isinstance(raw, dict) or raw.get("schema") != IDENTIFY_SCHEMA:
        found = raw.get("schema") if isinstance(raw, dict) else type(raw).__name__
        raise InputError(
            f"{path}: schema: must be that of a result of `rig identify`, {IDENTIFY_SCHEMA} (got "
            f"{found!r})"
        )
    if "motion" not in raw:
        raise InputError(f"{path}: damaged: no 'motion'; run `rig identify` again")
    if raw["motion"] != "rotary":
        raise InputError(
            f"{path}: motion: the result must be of a rotary bench (got {raw['motion']!r})"
        )
    alpha = raw.get("alpha", 2.0)
    if (
        isinstance(alpha, bool)
        or not isinstance(alpha, int | float)
        or not 0.0 < alpha <= LARGEST_ALPHA
    ):
        raise InputError(
            f"{path}: alpha: must be above 0 and at most {LARGEST_ALPHA:g} (got {alpha!r})"
        )
    return raw


def read_values(path: Path, names: Iterable[str]) -> tuple[dict[str, float], float]:
    """Return determined values, SI units, and the Stribeck exponent of a result, or InputError."""
    found, alpha = _stated(path, names, ("value",))
    return {name: value for name, (value,) in found.items() if math.isfinite(value)}, alpha


def _stated(
    path: Path, names: Iterable[str], keys: tuple[str, ...]
) -> tuple[dict[str, list[float]], float]:
    """Return these keys of the parameters that have all of them, and the Stribeck exponent."""
    raw = read_identification(path)
    try:
        stated = {n: [raw["parameters"].get(n, {}).get(key) for key in keys] for n in names}
        found = {n: [float(v) for v in row] for n, row in stated.items() if None not in row}
        return found, float(raw["alpha"])
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(f"{path}: damaged: {error}; run `rig identify` again") from error
