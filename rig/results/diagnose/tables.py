"""Tables of a diagnosis, for terminal and report."""

from __future__ import annotations

import math

from identification.diagnosis.result import Diagnosis, Fit, Location
from identification.diagnosis.verdict.statement import readable
from identification.model.parameters import parameter_title
from rig.common.tables import number, percent
from rig.results.document import Table

READABLE = {
    "rad": "deg",
    "N m/rad": "N m/deg",
    "1/rad": "%/deg",
    "A/s": "mA/min",
    "N m/s": "N m/h",
    "N/s": "N/h",
    "m/s": "mm/min",
    "m^2": "mm^2",
    "1/m": "%/m",
    "s/m": "%/(m/s)",
    "W": "kW",
}
"""Units that are shown, by the units of the records."""
_SHORT_S = 0.5
_DEG = math.degrees(1.0)


def effect_table(found: Diagnosis, motion: str) -> Table:
    """Return one row for each parameter of each effect; the names of the parameters are those for
    the motion of the bench.

    Args:
        found: The diagnosis.
        motion: ``rotary`` or ``linear``.
    """
    rows = []
    for effect in found.effects:
        lead = (effect.name, number(effect.confidence, 3))
        for name, estimate in effect.parameters.items():
            unit = READABLE.get(estimate.unit, "")
            if estimate.unit == "s" and abs(estimate.value) < _SHORT_S:
                unit = "ms"
            rows.append((*lead, parameter_title(motion, name), readable(estimate, unit)))
            lead = ("", "")
    return Table(("effect", "confidence", "parameter", "value (90 % interval)"), tuple(rows), (1,))


def rival_table(found: Diagnosis) -> Table:
    """Return the rivals of each effect, and the reason why each rival was rejected."""
    rows = tuple(
        (
            effect.name,
            rival.name,
            number(rival.confidence, 2),
            rival.why_not or "these recordings cannot reject it",
        )
        for effect in found.effects
        for rival in effect.rivals
    )
    return Table(("effect", "rival", "confidence", "why not"), rows, (2,))


def fit_table(found: Diagnosis) -> Table:
    """Return the errors of the nominal and of the corrected model, one row per equation and role;
    all errors of one equation are at one bandwidth.
    """
    fits = found.fits if found.fit in found.fits else (found.fit, *found.fits)
    rows = tuple(row for fit in fits for row in _fit_rows(fit))
    header = (
        "equation",
        "recordings",
        "rms before",
        "rms after",
        "noise floor",
        "unit",
        "bandwidth",
    )
    return Table(header, rows, (2, 3, 4, 6))


def shift_table(found: Diagnosis) -> Table:
    """Return the nominal parameters in the nominal and in the corrected model; no rows if no
    parameter changed.
    """
    if all(s.before == s.after for s in found.parameter_shift.values()):
        return Table((), (), ())
    rows = tuple(
        (
            name,
            number(s.before),
            number(s.after),
            _change(s.before, s.after),
            "" if s.unit == "1" else s.unit,
        )
        for name, s in found.parameter_shift.items()
    )
    return Table(("parameter", "before", "after", "change", "unit"), rows, (1, 2, 3))


def where_table(found: Diagnosis) -> Table:
    """Return the location of the mismatch of each effect or, without an effect, of the whole
    mismatch.
    """
    places = [(e.name, e.where) for e in found.effects]
    if not places and found.location is not None:
        places = [("the mismatch", found.location)]
    rows = tuple(
        (
            name,
            where.coordinate,
            _ranges(where),
            percent(100.0 * where.share_of_mismatch),
            _names(where.recordings),
        )
        for name, where in places
    )
    return Table(("what", "against", "where", "share of the mismatch", "recordings"), rows, (3,))


def step_table(found: Diagnosis) -> Table:
    """Return the steps of the search in their order."""
    rows = tuple(
        (
            str(k),
            s.action,
            s.name,
            "-" if s.p_value is None else f"{s.p_value:.2g}",
            number(s.gain, 3),
            s.note,
        )
        for k, s in enumerate(found.steps, 1)
    )
    return Table(("step", "what was done", "with", "p", "gain", "note"), rows, (0, 3, 4))


def _fit_rows(fit: Fit) -> list[tuple[str, ...]]:
    factor, unit = (_DEG, "deg") if fit.unit == "rad" else (1.0, fit.unit)
    pairs = [("fitted", fit.baseline_rms, fit.final_rms)]
    if fit.validate_baseline_rms is not None and fit.validate_final_rms is not None:
        pairs.append(("set aside", fit.validate_baseline_rms, fit.validate_final_rms))
    return [
        (
            fit.equation,
            role,
            *(number(factor * rms, 3) for rms in (before, after, fit.noise_floor_rms)),
            unit,
            f"{number(fit.bandwidth_Hz, 3)} Hz",
        )
        for role, before, after in pairs
    ]


def _change(before: float | None, after: float | None) -> str:
    if before is None or after is None or before == 0.0:
        return "-"
    return f"{100.0 * (after / before - 1.0):+.2f} %"


def _ranges(where: Location) -> str:
    if not where.ranges:
        return "-"
    shown, factor = ("deg", _DEG) if where.unit == "rad" else (where.unit, 1.0)
    unit = "" if shown in ("", "1") else f" {shown}"
    return (
        ", ".join(f"{low * factor:.3g} to {high * factor:.3g}" for low, high in where.ranges) + unit
    )


def _names(recordings: tuple[str, ...], shown: int = 4) -> str:
    rest = len(recordings) - shown
    return ", ".join(recordings[:shown]) + (f" and {rest} more" if rest > 0 else "")
