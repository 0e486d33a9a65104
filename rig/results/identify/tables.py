"""Makes the tables of an identification with explanatory lines: fits, stages, recordings, other
estimators, the ladder of friction models, transfer to other recordings.
"""

from __future__ import annotations

from collections.abc import Sequence

from identification.estimate.ladder import Interval, Rung, Transfer
from identification.estimate.paper_method import Contender
from identification.model.ladder import LADDER
from identification.recording import Recording
from identification.result import Fit, Identification
from rig.common.tables import CHANGED, NO_CHANGE, interval, number, percent
from rig.results.document import Table

COMPARISON_NOTE = (
    "All searches minimise the paper's equation error, stage by stage, within common bounds; the "
    "default method then minimises the prediction errors. Failed: searches that ended more than "
    "0.1 % above the least cost found. Errors: of the worst parameter, in the median run."
)
_FIT_HEADER = ("bandwidth", "error, rms", "relative")


def fit_table(results: Sequence[Identification]) -> Table:
    """Return one row for each fit: the error of the fit, and the error on the recordings with role
    validate.
    """
    rows = []
    for result in results:
        fit = result.fit
        rows.append(
            (result.method, "all", "fit", *_fit_cells(fit, fit.train_rms, fit.train_relative))
        )
        if fit.validate_rms is not None:
            rows.append(
                (
                    result.method,
                    "all",
                    "validate",
                    *_fit_cells(fit, fit.validate_rms, fit.validate_relative),
                )
            )
    return Table(("method", "recordings", "role", *_FIT_HEADER), tuple(rows), (3, 4, 5))


def recording_fit_table(results: Sequence[Identification]) -> Table:
    """Return the error of each method on each recording."""
    rows = []
    for result in results:
        roles = {trace.recording: trace.role for trace in result.traces}
        rows += [
            (result.method, name, roles[name], *_fit_cells(fit, fit.train_rms, fit.train_relative))
            for name, fit in result.fits_by_recording.items()
        ]
    return Table(("method", "recording", "role", *_FIT_HEADER), tuple(rows), (3, 4, 5))


def stage_table(results: Sequence[Identification]) -> Table:
    """Return the number of evaluations and the final state of each stage of each method."""
    rows = tuple(
        (
            result.method,
            stage.stage,
            stage.method,
            str(stage.evaluations),
            str(stage.generations),
            f"{number(stage.cost, 4)} {stage.cost_unit}",
            "-" if stage.target is None else f"{number(stage.target)} {stage.cost_unit}",
            {None: "-", True: "yes", False: "no"}[stage.reached],
        )
        for result in results
        for stage in result.stages
    )
    header = (
        "method",
        "stage",
        "optimiser",
        "evaluations",
        "generations",
        "cost",
        "target",
        "reached",
    )
    return Table(header, rows, (3, 4, 5, 6))


def recording_table(recordings: Sequence[Recording]) -> Table:
    """Return the identified recordings, and the corrections that were made on reading."""
    rows = tuple(
        (
            r.name,
            r.role,
            r.stage,
            "gas generator" if r.hot_fire else f"{number(r.weight_mass)} kg",
            str(len(r.time)),
            f"{number(1.0 / r.period, 4)} Hz",
            "; ".join(r.notes) or "none",
        )
        for r in recordings
    )
    return Table(
        ("recording", "role", "stage", "weight", "samples", "rate", "corrections"), rows, (3, 4, 5)
    )


def comparison_table(contenders: Sequence[Contender]) -> Table:
    """Return one row for each estimator; the error column is omitted if the true values are
    unknown.
    """
    known = any(c.true_error is not None for c in contenders)
    header = (
        "estimator",
        "runs",
        "failed",
        "evaluations",
        "s",
        "cost above least",
        "error against default",
    )
    rows = [
        (
            c.name,
            str(c.runs),
            str(c.failures),
            str(c.evaluations),
            number(c.seconds, 2),
            "-" if c.excess is None else percent(100.0 * c.excess),
            "reference" if c.excess is None else f"{percent(100.0 * c.error)} ({c.worst})",
            *([_true(c)] if known else []),
        )
        for c in contenders
    ]
    return Table(
        (*header, *(["error against truth"] if known else [])), tuple(rows), (1, 2, 3, 4, 5)
    )


def ladder_table(rungs: Sequence[Rung]) -> Table:
    """Return one row for each rung of the ladder: the error of the fit, the error on the recordings
    with role validate, and the error of the simulated angle on the recordings with role validate.
    """
    first = rungs[0].result
    unit, small = first.fit.unit, "mrad" if first.motion == "rotary" else "um"
    scale = 1e3 if first.motion == "rotary" else 1e6
    header = (
        "friction",
        "terms",
        f"fit ({unit})",
        "90 %",
        f"validate ({unit})",
        "90 %",
        f"angle ({small})",
        "90 %",
        f"angle, MAE ({small})",
        "90 %",
        "best in",
    )
    rows = [
        (
            rung.friction,
            ", ".join(LADDER[rung.friction]),
            *_cells(rung.train, 1.0),
            *_cells(rung.scored, 1.0),
            *_cells(rung.angle, scale),
            *_cells(rung.angle_mae, scale),
            percent(100.0 * rung.best),
        )
        for rung in rungs
    ]
    return Table(header, tuple(rows), (2, 4, 6, 8, 10))


def ladder_notes(rungs: Sequence[Rung]) -> list[str]:
    """Return explanations of the table's columns."""
    first = rungs[0]
    where = "the recordings set aside" if first.scored is not None else "the recordings fitted"
    lines = [
        f"Torque errors are at {number(first.result.fit.bandwidth_Hz, 3)} Hz; intervals are from "
        "bootstrap draws of the recordings to fit and of the recordings to score.",
        f"Best in: share of the draws in which a rung has the least torque error on {where}.",
    ]
    if first.angle is not None:
        lines.append(
            f"Angle: rms and mean absolute error of the closed loop simulated from its command and "
            f"first sample, on {where}."
        )
    return lines


def transfer_table(found: Transfer) -> Table:
    """Return one row for each parameter: its value from either source, the difference, and whether
    the difference exceeds the joint interval.
    """
    rows = tuple(
        (
            m.name,
            number(m.first.value),
            number(m.second.value),
            number(m.difference, 3),
            "-" if m.joint is None else f"+- {number(m.joint, 3)}",
            m.unit,
            {None: "not identifiable on both", False: NO_CHANGE, True: CHANGED}[m.moved],
        )
        for m in found.parameters
    )
    return Table(
        ("parameter", "here", "there", "difference", "90 %", "unit", "finding"), rows, (1, 2, 3, 4)
    )


def transfer_notes(found: Transfer) -> list[str]:
    """Return the errors of the transfer as text."""
    fit, own = found.fit, found.own
    line = (
        "on the other source, the error of the model with the parameters of this source is "
        f"{number(fit.train_rms, 3)} {fit.unit} rms "
        f"({percent(100.0 * fit.train_relative)}) at {number(fit.bandwidth_Hz, 3)} Hz; with "
        "parameters identified on the other source it is "
        f"{number(own.train_rms, 3)} {own.unit}"
    )
    floor = found.floor
    if floor is None:
        return [
            line,
            "the noise floor of the other source is unknown: no motion is repeated under the "
            "same command",
        ]
    ways = [
        f"{count} {what}"
        for count, what in ((floor.periods, "periodic"), (floor.repeats, "repeated"))
        if count
    ]
    return [
        line,
        f"the noise floor of the other source is {number(floor.rms, 3)} {fit.unit}, from "
        f"{floor.samples} pairs of samples of {' and '.join(ways)} recordings: the error is "
        f"{number(fit.train_rms / floor.rms, 3)} times this floor",
    ]


def _fit_cells(fit: Fit, rms: float | None, relative: float | None) -> tuple[str, str, str]:
    return (
        f"{number(fit.bandwidth_Hz, 4)} Hz",
        "-" if rms is None else f"{number(rms, 4)} {fit.unit}",
        percent(None if relative is None else 100.0 * relative),
    )


def _true(c: Contender) -> str:
    return "-" if c.true_error is None else f"{percent(100.0 * c.true_error)} ({c.true_worst})"


def _cells(found: Interval | None, scale: float) -> tuple[str, str]:
    if found is None:
        return "-", "-"
    return number(scale * found.value, 3), interval(scale * found.low, scale * found.high)
