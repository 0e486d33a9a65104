"""Finds friction and inertia for predictions: from an identification of the bench, or the paper."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from identification.model.parameters import NOMINAL
from identification.recording import Bench as BenchConstants
from rig.common.errors import InputError
from rig.common.result_files import RESULT_FILE
from rig.planning.reference import moment_per_kg, read_identification
from rig.runs.run_file import read_record, recorded_bench

NOMINAL_ALPHA = 2.0
"""Stribeck exponent of the paper."""
RUNS = Path("runs")
"""Default folder of runs and their identifications."""

_UNLOADED_FRICTION = ("Mc", "Ms")
_LOAD_FRICTION = ("mu_c", "mu_s")


@dataclass(frozen=True)
class FrictionModel:
    """Friction and inertia of a bench for predictions.

    Attributes:
        values: The nine parameters, SI, at the joint.
        alpha: Stribeck exponent.
        moment_arm_m: Moment arm L1, m.
        moment_per_kg: Contact moment of one kilogram on the lever, N m.
        source: Origin of the values, as text.
        measured: Whether the values come from an identification.
        from_paper: Names of the parameters with values of the paper.
    """

    values: Mapping[str, float]
    alpha: float
    moment_arm_m: float
    moment_per_kg: float
    source: str
    measured: bool
    from_paper: tuple[str, ...] = ()

    def friction_measured(self, loaded: bool) -> bool:
        """Return whether the friction torques of a stage were measured on this bench.

        Args:
            loaded: Whether the stage has a load, so that its friction also depends on the load
                parameters.
        """
        needed = _UNLOADED_FRICTION + (_LOAD_FRICTION if loaded else ())
        return self.measured and not set(needed) & set(self.from_paper)


def friction_model(
    bench: BenchConstants, named: Path | None = None, runs: Path = RUNS
) -> FrictionModel:
    """Return the best known friction of a bench.

    Args:
        bench: Constants of the bench.
        named: Result of ``rig identify --json`` to use.
        runs: Folder in which the newest result of a bench with the same constants is searched if
            ``named`` is None.

    Raises:
        InputError: ``named`` cannot be read, or is not a result of ``rig identify``.
    """
    if named is not None:
        return _identified(named, bench)
    for path in _newest_first(runs):
        try:
            if recorded_bench(read_record(path.parent)) == bench:
                return _identified(path, bench)
        except InputError:
            continue  # an incomplete run folder does not state its bench
    words = (
        f"the paper's friction and the inertia {NOMINAL['J']:g} kg m^2 of the packaged benches, "
        f"because there is no identification of this bench; give a result with --identification"
    )
    arm = bench.moment_arm or 0.0
    per_kg = moment_per_kg(bench)
    return FrictionModel(
        NOMINAL, NOMINAL_ALPHA, arm, per_kg, words, measured=False, from_paper=tuple(NOMINAL)
    )


def of_another_bench(path: Path, bench: BenchConstants) -> str | None:
    """Return a warning if an identification is of a run on a bench with other constants, else None.

    Args:
        path: Result of ``rig identify --json``.
        bench: Constants of the bench for which the result is used.
    """
    try:
        recorded = recorded_bench(read_record(path.parent))
    except InputError:
        return None  # outside a run folder the bench is unknown
    if recorded == bench:
        return None
    differing = [
        f"{field.name} {_shown(getattr(recorded, field.name))}, here "
        f"{_shown(getattr(bench, field.name))}"
        for field in dataclasses.fields(bench)
        if getattr(recorded, field.name) != getattr(bench, field.name)
    ]
    return (
        f"{path}: identified on a bench with other constants ({'; '.join(differing)}); check the "
        "bench file and, if it is right, identify a run on this bench"
    )


def _shown(value: object) -> str:
    return (
        f"{value:g}" if isinstance(value, float | int) else "other" if value is not None else "none"
    )


def _newest_first(runs: Path) -> list[Path]:
    try:
        found = [(path.stat().st_mtime, path) for path in runs.glob(f"*/{RESULT_FILE}")]
    except OSError:
        return []
    return [path for _, path in sorted(found, reverse=True)]


def _identified(path: Path, bench: BenchConstants) -> FrictionModel:
    raw = read_identification(path)
    try:
        values = {name: raw["parameters"].get(name, {}).get("value") for name in NOMINAL}
        known = {
            name: float(value)
            for name, value in values.items()
            if value is not None and math.isfinite(value)
        }
        alpha = float(raw["alpha"])
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise InputError(f"{path}: damaged: {error}; run `rig identify` again") from error
    missing = [name for name in NOMINAL if name not in known]
    words = f"the identification {path}"
    if missing:
        words += f"; {', '.join(missing)}, not determined by the result, from the paper"
    arm = bench.moment_arm or 0.0
    per_kg = moment_per_kg(bench)
    return FrictionModel(
        {**NOMINAL, **known}, alpha, arm, per_kg, words, measured=True, from_paper=tuple(missing)
    )
