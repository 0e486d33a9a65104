"""Writes a proposed sequence as a sequence file, and a message on the parameters that it
determines.
"""

from __future__ import annotations

import math
from typing import Any

import yaml

from identification.design.simulated import Intervals
from rig.common.tables import percent
from rig.config.sequence import Sequence
from rig.results.design.experiment import Experiment

PROPOSAL_FILE = "proposal.yaml"


def proposal_text(experiment: Experiment, bench: str) -> str:
    """Return the sequence file of a proposal; a comment states its purpose."""
    determined = intervals_words(experiment.proposal.proposed)
    head = (
        f"# Proposed by `rig identify --plan` in place of {experiment.sequence.name}, bench "
        f"{bench}, seed {experiment.seed}.\n"
        f"# Nominal: {experiment.nominal_source}.\n# {determined}.\n"
    )
    return head + yaml.safe_dump(
        plain_sequence(experiment.proposed), sort_keys=False, allow_unicode=True
    )


def plain_sequence(sequence: Sequence) -> dict[str, Any]:
    """Return a sequence as the mapping of its file; most keys with default values are omitted."""
    given: dict[str, Any] = sequence.model_dump(mode="json", exclude_defaults=True)
    return {"sequence": sequence.sequence, **given}


def intervals_words(found: Intervals) -> str:
    """Return a message on the number of determined parameters and on the least accurate
    parameter.
    """
    open_names = [n for n, w in found.half_widths.items() if not math.isfinite(w)]
    if open_names:
        return f"does not determine {', '.join(open_names)}"
    return (
        f"determines all {len(found.half_widths)}; the weakest is {found.weakest}, to "
        f"{percent(100.0 * found.worst)}"
    )
