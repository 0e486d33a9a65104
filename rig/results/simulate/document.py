"""Output of ``rig simulate`` as a document: predicted and simulated responses."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from identification.plots.signals import predicted, simulated
from identification.simulate.closed_loop import Sums
from rig.common.tables import number, percent
from rig.results.document import (
    Document,
    Note,
    Paragraph,
    Picture,
    Section,
    Table,
    few_of_each_role,
    provenance_section,
)
from rig.results.simulate.simulate import Case, Prediction, Simulation

_SHOWN_PER_ROLE = 3
_FRICTION = {1.0: "as fitted", 0.5: "half of it", 0.0: "none"}


def simulate_document(name: str, found: Simulation, beside: Sequence[str]) -> Document:
    """Return a simulation as a document.

    Args:
        name: Name of the source.
        found: The result.
        beside: Remarks on the model as a bench file.
    """
    models = dict.fromkeys(str(one.file) for one in found.predictions)
    return Document(
        f"Simulation of {name}",
        f"Model: {', '.join(models)}",
        tuple(_summary(found)),
        tuple(_sections(found, beside)),
    )


def _summary(found: Simulation) -> Iterator[Section]:
    at = f"at {number(found.bandwidth_Hz, 3)} Hz"
    yield Section(f"equation errors {at}, in motion", (_errors_of_equations(found),))
    if found.cases:
        head = f"closed loop, simulated from the first sample; torque {at}"
        yield Section(head, (_pooled(found),))
    for line in _left_out(found):
        yield Section("", (Note(line, "aside"),))


def _sections(found: Simulation, beside: Sequence[str]) -> Iterator[Section]:
    yield Section("", tuple(map(Paragraph, (*_explanations(found), *beside))))
    drawn = _predicted(found.predictions, found.unit)
    yield Section("Equation errors", (_errors_of_equations(found), *drawn))
    if found.cases:
        yield Section("Closed loop", (_pooled(found),))
        yield Section("Recordings", (_of_recordings(found), *_simulated(found)))
    yield provenance_section(found.provenance)


def _explanations(found: Simulation) -> Iterator[str]:
    at = f"at {number(found.bandwidth_Hz, 4)} Hz"
    yield f"Equation errors are over samples in motion, {at}."
    yield from _left_out(found)
    if found.cases:
        yield (
            "The closed loop is simulated from the first sample on; its inputs are only the "
            "command, the supply and the declared loads."
        )
        yield f"Errors of angle are over all samples; errors of torque are {at}."


def _left_out(found: Simulation) -> list[str]:
    """Return a remark if the closed loop is not simulated, or is simulated without the effects."""
    if not found.cases:
        return [
            "no closed loop: the controller of these recordings is not declared (`controller:` in "
            "a campaign)"
        ]
    if any(case.model.corrected.effects for case in found.cases):
        return [
            "the closed loop is simulated without the effects; a simulated bench made from the "
            "result contains the effects"
        ]
    return []


def _errors_of_equations(found: Simulation) -> Table:
    """Return one row for each model, equation and role."""
    rows = []
    units = {"transmission": "mrad" if found.rotary else "um", "voltage": "V"}
    small = 1e3 if found.rotary else 1e6
    for one in found.predictions:
        for equation in dict.fromkeys(p.equation for p in one.parts):
            errors = [one.error(equation, role) for role in ("fit", "validate")]
            scale = small if equation == "transmission" else 1.0
            cells = (number(None if e is None else scale * e, 4) for e in errors)
            effects = ", ".join(one.effects) or "none"
            rows.append((one.file.stem, effects, equation, *cells, units.get(equation, found.unit)))
    return Table(
        ("model", "effects", "equation", "rms, fit", "rms, validate", "unit"), tuple(rows), (3, 4)
    )


def _pooled(found: Simulation) -> Table:
    """Return one row for each model, share of friction and role."""
    rows = [
        (
            case.model.file.stem,
            _FRICTION[case.share],
            role,
            str(len(names)),
            *_cells(found, case.over(names)),
        )
        for case in found.cases
        for role in ("fit", "validate")
        if (names := found.names(role))
    ]
    return Table(
        ("model", "friction", "role", "recordings", *_errors(found)), tuple(rows), (3, 4, 5, 6)
    )


def _of_recordings(found: Simulation) -> Table:
    first = found.cases[0]
    rows = tuple(
        (r.name, r.role, *_cells(found, first.sums[r.name])) for r in found.dataset.recordings
    )
    return Table(("recording", "role", *_errors(found)), rows, (2, 3, 4))


def _errors(found: Simulation) -> tuple[str, str, str]:
    rotary = found.rotary
    return (
        f"{'torque' if rotary else 'force'} error ({found.unit})",
        "relative",
        "angle error (mrad)" if rotary else "position error (um)",
    )


def _cells(found: Simulation, sums: Sums) -> tuple[str, str, str]:
    scale = 1e3 if found.rotary else 1e6
    return (
        number(sums.torque_rms, 4),
        percent(100.0 * sums.torque_relative),
        number(scale * sums.angle_rms, 4),
    )


def _predicted(found: Sequence[Prediction], unit: str) -> list[Picture]:
    """Return figures of the torque equation of the first model, for a few recordings of each
    role.
    """
    parts = [p for p in found[0].parts if p.equation == "torque"]
    return [
        Picture.of(
            f"predicted_{p.recording}",
            f"{p.recording} ({p.role}): torque measured and predicted",
            predicted(p, unit),
        )
        for p in few_of_each_role(parts, lambda part: part.role, _SHOWN_PER_ROLE)
    ]


def _simulated(found: Simulation) -> list[Picture]:
    """Return figures of the closed-loop simulation of the first model, for a few recordings of each
    role.
    """
    pairs = list(zip(found.prepared, found.responses, strict=True))
    shown = few_of_each_role(pairs, lambda pair: pair[0].recording.role, _SHOWN_PER_ROLE)
    return [
        Picture.of(
            f"simulated_{p.recording.name}",
            f"{p.recording.name}: measured and simulated",
            simulated(p, response),
        )
        for p, response in shown
    ]


SIMULATE_SCHEMA = "loadrig.simulate/1"


def simulation_record(found: Simulation) -> dict[str, Any]:
    """Return the record of ``rig simulate --json``."""
    return {
        **found.provenance.record(SIMULATE_SCHEMA),
        "unit": found.unit,
        "angle_unit": "rad" if found.rotary else "m",
        "bandwidth_Hz": found.bandwidth_Hz,
        "equations": _record_errors(found),
        "cases": [_case_record(found, case) for case in found.cases],
    }


def _record_errors(found: Simulation) -> list[dict[str, object]]:
    """Return the prediction errors of each result, one entry per equation, SI units."""
    units = {"transmission": "rad" if found.rotary else "m", "voltage": "V"}
    return [
        {
            "result": str(one.file),
            "effects": list(one.effects),
            "equation": equation,
            "unit": units.get(equation, found.unit),
            "rms": one.error(equation, "fit"),
            "validate_rms": one.error(equation, "validate"),
        }
        for one in found.predictions
        for equation in dict.fromkeys(p.equation for p in one.parts)
    ]


def _case_record(found: Simulation, case: Case) -> dict[str, Any]:
    roles = {role: names for role in ("fit", "validate") if (names := found.names(role))}
    return {
        "result": str(case.model.file),
        "friction_share": case.share,
        **{role: _sums_record(case.over(names)) for role, names in roles.items()},
        "recordings": {name: _sums_record(sums) for name, sums in case.sums.items()},
    }


def _sums_record(sums: Sums) -> dict[str, float]:
    return {
        "torque_rms": sums.torque_rms,
        "torque_relative": sums.torque_relative,
        "angle_rms": sums.angle_rms,
    }
