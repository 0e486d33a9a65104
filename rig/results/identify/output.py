"""What ``rig identify`` leaves behind: text for the terminal, result file, report."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from identification.recording import Recording
from identification.result import Identification
from rig.common.errors import InputError
from rig.common.parameter_table import Table, parameter_notes, parameter_table, pinned_notes
from rig.common.places import write_json
from rig.common.result_files import RESULT_FILE, identification_record
from rig.common.tables import number, percent, table
from rig.results.comparison_table import COMPARISON_NOTE, comparison_record, comparison_table
from rig.results.identify.identify import Outcome
from rig.results.identify.ladder import ladder_notes, ladder_record, ladder_table
from rig.results.identify.transfer import transfer_notes, transfer_record, transfer_table
from rig.results.report import write_report
from rig.results.uncertainty import uncertainty_notes, uncertainty_record, uncertainty_tables
from rig.runs.partial import partial_names

_NUMBER = re.compile(r"\d[\d.e+-]*")


def text(outcome: Outcome, truth: Mapping[str, float] | None) -> str:
    """Return the parameters, the fit and the warnings for the terminal."""
    cells = parameter_table(outcome.results, truth)
    lines = [table(cells.header, cells.rows, cells.right), ""]
    lines += [line for result in outcome.results for line in _fit_lines(result)]
    lines += pinned_notes(outcome.results)
    for result in outcome.results:
        lines += uncertainty_notes(result)
        for cells, note in uncertainty_tables(result):
            lines += ["", table(cells.header, cells.rows, cells.right), note, ""]
    if outcome.comparison:
        compared = comparison_table(outcome.comparison)
        lines += ["", table(compared.header, compared.rows, compared.right), COMPARISON_NOTE, ""]
    for title, cells, notes in _extras(outcome):
        lines += ["", title, table(cells.header, cells.rows, cells.right), *notes, ""]
    lines += reading_notes(outcome.dataset.recordings)
    lines += [f"note: {line}" for line in parameter_notes(outcome.results)]
    lines += [
        f"warning: {result.method}: {w}" for result in outcome.results for w in result.warnings
    ]
    return "\n".join(lines)


def _extras(outcome: Outcome) -> list[tuple[str, Table, list[str]]]:
    """Return title, table and notes of what was asked for beside the identification."""
    extras = []
    if outcome.ladder:
        extras.append(
            (
                "Ladder of friction models",
                ladder_table(outcome.ladder),
                ladder_notes(outcome.ladder),
            )
        )
    if outcome.transfer is not None:
        extras.append(
            ("Transfer", transfer_table(outcome.transfer), transfer_notes(outcome.transfer))
        )
    return extras


def reading_notes(recordings: Sequence[Recording]) -> list[str]:
    """Return what was corrected or doubted on reading; of notes that differ in their numbers only,
    the first.
    """
    alike: dict[str, list[str]] = {}
    for recording in recordings:
        for note in recording.notes:
            alike.setdefault(_NUMBER.sub("#", note), []).append(
                f"reading: {recording.name}: {note}"
            )
    return [
        lines[0] + (f" ({len(lines) - 1} more like this: see the report)" if len(lines) > 1 else "")
        for lines in alike.values()
    ]


def write(
    folder: Path,
    name: str,
    outcome: Outcome,
    truth: Mapping[str, float] | None,
    json_file: Path | None,
) -> Path:
    """Write result file, figures and report into ``folder``, and the result once more where asked;
    return the page.

    Raises:
        InputError: A place cannot be written.
    """
    first = outcome.results[0]
    record = identification_record(first, outcome.provenance) | uncertainty_record(first)
    record["corrections"] = {r.name: list(r.notes) for r in outcome.dataset.recordings if r.notes}
    record["partial"] = partial_names(outcome.dataset)
    if len(outcome.results) > 1:
        others = (identification_record(r, outcome.provenance) for r in outcome.results[1:])
        record["compared"] = list(others)
    if outcome.ladder:
        record["ladder"] = ladder_record(outcome.ladder)
    if outcome.transfer is not None:
        record["transfer"] = transfer_record(outcome.transfer, str(outcome.scored_on))
    if outcome.comparison:
        record["comparison"] = comparison_record(outcome.comparison)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in filter(None, (folder / RESULT_FILE, json_file)):
            write_json(path, record)
        return write_report(
            folder,
            f"Identification of {name}",
            outcome.dataset,
            outcome.results,
            outcome.provenance,
            truth,
            [
                {"title": title, "table": cells, "notes": notes}
                for title, cells, notes in _extras(outcome)
            ],
            outcome.comparison,
        )
    except OSError as error:
        places = " or ".join(str(place) for place in (folder, json_file) if place)
        raise InputError(
            f"{places}: cannot be written: {error.strerror}; give --out or --json another place"
        ) from error


def _fit_lines(result: Identification) -> list[str]:
    fit = result.fit
    line = (
        f"{result.method}: torque error {number(fit.train_rms, 3)} {fit.unit} rms "
        f"({percent(100.0 * fit.train_relative)}) at {number(fit.bandwidth_Hz, 3)} Hz"
    )
    if fit.validate_rms is not None and fit.validate_relative is not None:
        line += (
            f"; validate {number(fit.validate_rms, 3)} {fit.unit} rms "
            f"({percent(100.0 * fit.validate_relative)})"
        )
    return [f"{line}; {result.evaluations} evaluations, {result.seconds:.1f} s"]
