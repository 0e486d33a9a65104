"""What ``rig diagnose`` leaves behind: text for the terminal, result file, report, the corrected
model.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

from rig.common.errors import InputError
from rig.common.input_files import source_name
from rig.common.places import write_json
from rig.common.tables import table
from rig.results.diagnose.diagnose import Outcome, as_json
from rig.results.diagnose.files import Beside, write_beside
from rig.results.diagnose.report import write_report
from rig.results.diagnose.tables import (
    effect_table,
    fit_table,
    rival_table,
    shift_table,
    where_table,
)
from rig.results.document import Table
from rig.results.sections import reading_notes

RESULT_FILE = "diagnose.json"
VERDICTS = {
    "nothing_missing": "nothing missing",
    "named": "named",
    "ambiguous": "ambiguous",
    "outside_catalogue": "outside the catalogue",
}
_WIDTH = 110


def text(outcome: Outcome) -> str:
    """Return verdict, effects, errors, shifts and warnings for the terminal."""
    found = outcome.diagnosis
    blocks = [f"verdict: {VERDICTS[found.verdict.value]}\n{textwrap.fill(found.statement, _WIDTH)}"]
    blocks += [
        textwrap.fill(f"{e.name}: {e.statement}", _WIDTH)
        for e in found.effects
        if e.statement not in found.statement
    ]
    tables = (effect_table, where_table, rival_table, fit_table, shift_table)
    blocks += [_shown(cells) for made in tables if (cells := made(found)).rows]
    blocks += [
        textwrap.fill(f"to split {', '.join(e.alias_group)}: {e.separating_experiment}", _WIDTH)
        for e in found.effects
        if len(e.alias_group) > 1
    ]
    lines = reading_notes(outcome.dataset.recordings) + [f"warning: {w}" for w in found.warnings]
    return "\n\n".join([*blocks, *(["\n".join(lines)] if lines else [])])


def write(
    folder: Path, source: Path, outcome: Outcome, json_file: Path | None
) -> tuple[Path, Beside]:
    """Write result file, figures, report and corrected model into ``folder``, and the result once
    more where asked.

    Returns:
        The page, and what lies beside it.

    Raises:
        InputError: A place cannot be written.
    """
    record = as_json(outcome)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in filter(None, (folder / RESULT_FILE, json_file)):
            write_json(path, record)
        beside = write_beside(folder, source, outcome, record)
        page = write_report(
            folder, f"Diagnosis of {source_name(source)}", outcome, beside.files, beside.notes
        )
    except OSError as error:
        places = " or ".join(str(place) for place in (folder, json_file) if place)
        raise InputError(
            f"{places}: cannot be written: {error.strerror}; give --out or --json another place"
        ) from error
    return page, beside


def _shown(cells: Table) -> str:
    return table(cells.header, cells.rows, cells.right)
