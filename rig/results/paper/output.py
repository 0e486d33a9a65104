"""What ``rig paper`` leaves behind: result file, figures, their data, and one page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.places import write_json, write_text
from rig.common.result_files import Provenance
from rig.results.paper import tables
from rig.results.paper.chosen import chosen
from rig.results.paper.exhibit import Exhibit, write_exhibits
from rig.results.paper.parameters import Reproduction
from rig.results.report import provenance_tables, render

PAPER_SCHEMA = "loadrig.paper/1"
RESULT_FILE = "paper.json"
PAGE_FILE = "paper.html"


def record(
    found: Reproduction,
    exhibits: Sequence[Exhibit],
    provenance: Provenance,
    figures: Mapping[str, list[str]],
) -> dict[str, Any]:
    """Return the record of ``rig paper --json``."""
    return {
        **provenance.record(PAPER_SCHEMA),
        "tables": tables.record(found),
        "wrong_basins": {method: found.wrong_basins(method) for method in found.runs},
        "figures": dict(figures),
        "remarks": tables.remarks(found),
        "findings": {exhibit.name: list(exhibit.found) for exhibit in exhibits},
        "chosen": chosen(),
    }


def write(
    folder: Path,
    found: Reproduction,
    exhibits: Sequence[Exhibit],
    provenance: Provenance,
    json_file: Path | None,
) -> Path:
    """Write result file, figures, data and page into ``folder``, and the result once more where
    asked; return the page.

    Raises:
        InputError: A place cannot be written.
    """
    page = render(
        "paper.html.j2",
        title="The paper's figures and tables, done again",
        subtitle="Load Characteristics and Modeling Methods for the Flow Regulator of a Solid "
        "Ducted Rocket",
        exhibits=exhibits,
        chosen=chosen(),
        **provenance_tables(provenance),
    )
    try:
        figures = write_exhibits(exhibits, folder)
        result = record(found, exhibits, provenance, figures)
        for place in filter(None, (folder / RESULT_FILE, json_file)):
            write_json(place, result)
        path = folder / PAGE_FILE
        write_text(path, page)
    except OSError as error:
        places = " or ".join(str(place) for place in (folder, json_file) if place)
        raise InputError(
            f"{places}: cannot be written: {error.strerror}; give --out or --json another place"
        ) from error
    return path
