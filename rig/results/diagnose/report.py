"""The report of a diagnosis: one self-contained page. It renders records and computes nothing."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from identification.diagnosis.result import Diagnosis, Fit, ResidualTrace
from identification.plots import mismatch
from rig.common.places import write_text
from rig.results.diagnose.diagnose import Outcome
from rig.results.diagnose.tables import (
    effect_table,
    fit_table,
    rival_table,
    shift_table,
    step_table,
    where_table,
)
from rig.results.document import Picture
from rig.results.report import provenance_tables, render, save

HEADLINES = {
    "nothing_missing": "Nothing is missing",
    "named": "What was left out has a name",
    "ambiguous": "These recordings cannot tell several names apart",
    "outside_catalogue": "Something is missing that no name of the catalogue fits",
}
_SHOWN_PER_ROLE = 4


def write_report(
    folder: Path,
    title: str,
    outcome: Outcome,
    beside: Sequence[tuple[str, str]],
    beside_notes: Sequence[str],
) -> Path:
    """Write ``report.html`` and ``figures/*.png`` of one diagnosis.

    Args:
        folder: Made if it is not there.
        title: Heading.
        outcome: What was found.
        beside: Files written beside the page, each with what it is for.
        beside_notes: What could not be written there, and why.

    Raises:
        OSError: The folder cannot be written.
    """
    found = outcome.diagnosis
    mismatched = [t for t in found.traces if t.equation == found.fit.equation]
    shown = _shown(mismatched)
    groups = {
        "curve_figures": _curve(found),
        "map_figures": _maps(found),
        "rival_figures": _rivals(found),
        "trace_figures": [_trace(trace, found) for trace in shown],
    }
    save([picture for group in groups.values() for picture in group], folder)
    hidden = len(mismatched) - len(shown)
    page = render(
        "diagnose.html.j2",
        title=title,
        subtitle=f"{len(outcome.dataset.recordings)} recordings; the test that anything is "
        f"missing at all has "
        f"p = {found.p_value:.2g}",
        verdict=found.verdict.value,
        headline=HEADLINES[found.verdict.value],
        statement=found.statement,
        effects=found.effects,
        effect_table=effect_table(found),
        where=where_table(found),
        rivals=rival_table(found),
        fits=fit_table(found),
        shifts=shift_table(found),
        steps=step_table(found),
        warnings=found.warnings,
        beside=beside,
        beside_notes=beside_notes,
        left_out=f"Figures of {hidden} more recordings are left out." if hidden else "",
        **groups,
        **provenance_tables(outcome.provenance),
    )
    path = folder / "report.html"
    write_text(path, page)
    return path


def _shown(traces: Sequence[ResidualTrace]) -> list[ResidualTrace]:
    return [
        t
        for role in ("validate", "fit")
        for t in [t for t in traces if t.role == role][:_SHOWN_PER_ROLE]
    ]


def _maps(found: Diagnosis) -> list[Picture]:
    equations = dict.fromkeys(m.equation for m in found.maps)
    return [
        Picture.of(
            f"maps_{equation}",
            f"Mismatch of the {equation} equation against each coordinate, largest share first, "
            f"with simultaneous 90 % "
            "bands, before and after the correction",
            mismatch.maps([m for m in found.maps if m.equation == equation]),
        )
        for equation in equations
    ]


def _rivals(found: Diagnosis) -> list[Picture]:
    return [
        Picture.of(
            f"rivals_{e.name}", f"{e.name} and what was considered instead", mismatch.rivals(e)
        )
        for e in found.effects
        if e.rivals
    ]


def _curve(found: Diagnosis) -> list[Picture]:
    if found.curve is None:
        return []
    caption = (
        f"What is missing, as a smooth curve over {found.curve.coordinate}; a simulation "
        f"can carry it"
    )
    return [Picture.of("missing", caption, mismatch.curve(found.curve))]


def _trace(trace: ResidualTrace, found: Diagnosis) -> Picture:
    fits: dict[str, Fit] = {fit.equation: fit for fit in (*found.fits, found.fit)}
    fit = fits.get(trace.equation)
    role = "never used for a decision" if trace.role == "validate" else "fitted"
    return Picture.of(
        f"mismatch_{trace.equation}_{trace.recording}",
        f"{trace.recording} ({role}): mismatch of the {trace.equation} equation before and after",
        mismatch.trace(trace, None if fit is None else fit.noise_floor_rms),
    )
