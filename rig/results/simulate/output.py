"""What ``rig simulate`` leaves behind: text for the terminal, result file, report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from identification.plots.simulated import simulated
from identification.simulate.score import Sums
from rig.common.errors import InputError
from rig.common.input_files import source_name
from rig.common.places import write_json, write_text
from rig.common.tables import number, percent, table
from rig.results.diagnose.model_bench import BENCH_FILE, base_bench, bench_text, model_bench
from rig.results.document import Picture, Table
from rig.results.report import provenance_tables, render, save
from rig.results.simulate.predict import error_record, error_table
from rig.results.simulate.predict import pictures as prediction_pictures
from rig.results.simulate.simulate import Case, Simulation

SIMULATE_SCHEMA = "loadrig.simulate/1"
RESULT_FILE = "simulate.json"
_SHOWN_PER_ROLE = 3
_FRICTION = {1.0: "as fitted", 0.5: "half of it", 0.0: "none"}


def text(found: Simulation) -> str:
    """Return the pooled errors of every model for the terminal."""
    at = f"at {number(found.bandwidth_Hz, 3)} Hz"
    cells = error_table(found.predictions, found.unit)
    blocks = [f"equation errors {at}, in motion\n{table(cells.header, cells.rows, cells.right)}"]
    if found.cases:
        cells = pooled_table(found)
        head = f"closed loop, simulated from the first sample; torque {at}"
        blocks.append(f"{head}\n{table(cells.header, cells.rows, cells.right)}")
    return "\n\n".join(blocks + [f"note: {note}" for note in _left_out(found)])


def _left_out(found: Simulation) -> list[str]:
    """Return what the closed loop does not show."""
    if not found.cases:
        return [
            "no closed loop: the controller of these recordings is not declared (`controller:` in "
            "a campaign)"
        ]
    if any(case.model.corrected.effects for case in found.cases):
        return [
            "the closed loop is simulated without the effects; a simulated bench made of the "
            "result has them"
        ]
    return []


def pooled_table(found: Simulation) -> Table:
    """Return one row per model, share of friction and role."""
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


def record(found: Simulation) -> dict[str, Any]:
    """Return the record of ``rig simulate --json``."""
    return {
        **found.provenance.record(SIMULATE_SCHEMA),
        "unit": found.unit,
        "angle_unit": "rad" if _rotary(found) else "m",
        "bandwidth_Hz": found.bandwidth_Hz,
        "equations": error_record(found.predictions, found.unit),
        "cases": [_case_record(found, case) for case in found.cases],
    }


def write(folder: Path, source: Path, found: Simulation, json_file: Path | None) -> Path:
    """Write result file, figures, report and the model as a bench into ``folder``; return the page.

    The result file goes to ``json_file`` as well where that is given.

    Raises:
        InputError: A place cannot be written.
    """
    predicted = prediction_pictures(found.predictions, found.unit)
    errors = error_table(found.predictions, found.unit)
    sections: list[dict[str, Any]] = [
        {"title": "Equation errors", "table": errors, "pictures": predicted}
    ]
    notes = [
        f"Equation errors are over samples in motion, at {number(found.bandwidth_Hz, 4)} Hz.",
        *_left_out(found),
    ]
    pictures = list(predicted)
    if found.cases:
        simulated_ones = _pictures(found)
        pictures += simulated_ones
        sections += [
            {"title": "Closed loop", "table": pooled_table(found), "pictures": []},
            {"title": "Recordings", "table": _recording_table(found), "pictures": simulated_ones},
        ]
        notes += [
            "The loop is simulated from the first sample on: only the command, the supply and "
            "declared loads enter.",
            f"Errors of angle are over all samples; those of torque at "
            f"{number(found.bandwidth_Hz, 4)} Hz.",
        ]
    bench, said = _bench(source, found)
    notes += said
    page = render(
        "sections.html.j2",
        title=f"Simulation of {source_name(source)}",
        subtitle=f"Model: {', '.join(dict.fromkeys(str(one.file) for one in found.predictions))}",
        notes=notes,
        sections=sections,
        **provenance_tables(found.provenance),
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        save(pictures, folder)
        for place in filter(None, (folder / RESULT_FILE, json_file)):
            write_json(place, record(found))
        if bench is not None:
            write_text(folder / BENCH_FILE, bench)
        path = folder / "report.html"
        write_text(path, page)
    except OSError as error:
        places = " or ".join(str(place) for place in (folder, json_file) if place)
        raise InputError(
            f"{places}: cannot be written: {error.strerror}; give --out or --json another place"
        ) from error
    return path


def _bench(source: Path, found: Simulation) -> tuple[str | None, list[str]]:
    """Return the first model as a bench file, or None, and what to say of it."""
    try:
        constants = found.dataset.recordings[0].bench
        bench, left_out = model_bench(base_bench(source), found.models[0].corrected, constants)
        return bench_text(bench, left_out), [
            f"{BENCH_FILE} beside this page is the model as a simulated bench.",
            *left_out,
        ]
    except InputError as error:
        return None, list(error.problems)


def _rotary(found: Simulation) -> bool:
    return found.dataset.recordings[0].bench.motion == "rotary"


def _errors(found: Simulation) -> tuple[str, str, str]:
    rotary = _rotary(found)
    return (
        f"{'torque' if rotary else 'force'} error ({found.unit})",
        "relative",
        "angle error (mrad)" if rotary else "position error (um)",
    )


def _cells(found: Simulation, sums: Sums) -> tuple[str, str, str]:
    scale = 1e3 if _rotary(found) else 1e6
    return (
        number(sums.torque_rms, 4),
        percent(100.0 * sums.torque_relative),
        number(scale * sums.angle_rms, 4),
    )


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


def _recording_table(found: Simulation) -> Table:
    first = found.cases[0]
    rows = tuple(
        (r.name, r.role, *_cells(found, first.sums[r.name])) for r in found.dataset.recordings
    )
    return Table(("recording", "role", *_errors(found)), rows, (2, 3, 4))


def _pictures(found: Simulation) -> list[Picture]:
    pairs = list(zip(found.prepared, found.responses, strict=True))
    shown = [
        pair
        for role in ("fit", "validate")
        for pair in [pair for pair in pairs if pair[0].recording.role == role][:_SHOWN_PER_ROLE]
    ]
    return [
        Picture.of(
            f"simulated_{p.recording.name}",
            f"{p.recording.name}: measured and simulated",
            simulated(p, response),
        )
        for p, response in shown
    ]
