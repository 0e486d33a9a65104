"""Converts a planned experiment to the JSON record of ``rig identify --plan --json``."""

from __future__ import annotations

from typing import Any

from identification.design.simulated import Intervals
from rig.common.provenance import utc_now, versions
from rig.common.result_files import finite
from rig.config.sequence import Sequence
from rig.results.design.experiment import Experiment
from rig.results.design.proposal import plain_sequence

PLAN_SCHEMA = "loadrig.plan/1"
RESULT_FILE = "plan.json"


def plan_record(experiment: Experiment, bench: str) -> dict[str, Any]:
    """Return the record of ``rig identify --plan --json``."""
    used = versions()
    return {
        "schema": PLAN_SCHEMA,
        "version": used["loadrig"],
        "versions": dict(used),
        "created": utc_now().isoformat(timespec="seconds"),
        "seconds": experiment.seconds,
        "seed": experiment.seed,
        "bench": bench,
        "nominal": {"source": experiment.nominal_source, "values": dict(experiment.nominal.values)},
        "current_noise_A": experiment.current_noise_A,
        "aimed_at": experiment.proposal.weakest,
        "present": _intervals_record(experiment.sequence, experiment.proposal.present),
        "proposed": _intervals_record(experiment.proposed, experiment.proposal.proposed),
        "fisher_half_widths": {
            n: finite(w) for n, w in experiment.proposal.predicted.half_widths.items()
        },
        "judged": experiment.proposal.judged,
        "rehearsed": experiment.proposal.identified,
    }


def _intervals_record(sequence: Sequence, found: Intervals) -> dict[str, Any]:
    return {
        "sequence": plain_sequence(sequence),
        "relative_half_widths": {name: finite(width) for name, width in found.half_widths.items()},
        "weakest": found.weakest,
    }
