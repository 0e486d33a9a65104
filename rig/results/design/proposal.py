"""A proposed sequence as the file that runs it, and what it pins in words."""

from __future__ import annotations

import math
from typing import Any

import yaml

from identification.design.pinning import Pinned
from rig.common.tables import percent
from rig.config.sequence import Sequence
from rig.results.design.experiment import Experiment

PROPOSAL_FILE = "proposal.yaml"


def proposal_text(experiment: Experiment, bench: str) -> str:
    """Return the sequence file of a proposal; a comment says what it was made for."""
    pinned = pinned_words(experiment.proposal.pinned)
    head = (
        f"# Proposed by `rig identify --plan` in place of {experiment.sequence.name}, bench "
        f"{bench}, seed {experiment.seed}.\n"
        f"# Nominal: {experiment.nominal_source}.\n# {pinned}.\n"
    )
    return head + yaml.safe_dump(
        plain_sequence(experiment.proposed), sort_keys=False, allow_unicode=True
    )


def plain_sequence(sequence: Sequence) -> dict[str, Any]:
    """Return a sequence as its file states it; what is at its default is left out, but for what a
    reader looks for.
    """
    given: dict[str, Any] = sequence.model_dump(mode="json", exclude_defaults=True)
    return {"sequence": sequence.sequence, **given}


def pinned_words(found: Pinned) -> str:
    """Say how many parameters are pinned, and which one the least."""
    open_names = [n for n, w in found.half_widths.items() if not math.isfinite(w)]
    if open_names:
        return f"says nothing of {', '.join(open_names)}"
    return (
        f"pins all {len(found.half_widths)}; the weakest is {found.weakest}, to "
        f"{percent(100.0 * found.worst)}"
    )
