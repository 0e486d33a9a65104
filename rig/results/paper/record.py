"""Converts the reproduced tables and figures to the JSON record of ``rig paper --json``."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import Any

from rig.common.result_files import Provenance, finite
from rig.results.paper.chosen import chosen
from rig.results.paper.exhibit import Exhibit, files_of
from rig.results.paper.parameters import Printed, Reproduction
from rig.results.paper.tables import PRINTED, remarks

PAPER_SCHEMA = "loadrig.paper/1"
RESULT_FILE = "paper.json"


def paper_record(
    found: Reproduction, exhibits: Sequence[Exhibit], provenance: Provenance
) -> dict[str, Any]:
    """Return the record of ``rig paper --json``."""
    return {
        **provenance.record(PAPER_SCHEMA),
        "tables": {
            method: {
                name: _entry(found, method, name, printed) for name, printed in PRINTED.items()
            }
            for method in found.runs
        },
        "wrong_basins": {method: found.wrong_basins(method) for method in found.runs},
        "figures": files_of(exhibits),
        "remarks": remarks(found),
        "findings": {exhibit.name: list(exhibit.found) for exhibit in exhibits},
        "chosen": chosen(),
    }


def _entry(found: Reproduction, method: str, name: str, printed: Printed) -> dict[str, Any]:
    values, errors = found.found(method, name), found.errors(method, name)
    worst = found.worst_seed(method, name)
    return {
        "true": found.truth[name],
        "printed": printed.identified,
        "identified": finite(values[worst]),
        "error_percent": finite(errors[worst]),
        "printed_true": printed.original,
        "printed_error_percent": printed.error_percent,
        "median_error_percent": finite(statistics.median(errors.values())),
        "identifiable": all(
            result.parameters[name].identifiable for result in found.runs[method].values()
        ),
        "seeds": {str(seed): finite(value) for seed, value in values.items()},
    }
