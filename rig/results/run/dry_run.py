"""``rig run --dry-run``: predicts motion and peaks of a run without connecting to the bench."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from identification.model.parameters import UNITS_ROTARY
from rig.common.provenance import utc_now, versions
from rig.common.tables import percent, table
from rig.config.acceptance import NOTHING_MISSING, Bound, Limit, Range
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.planning.plan import describe
from rig.planning.predicted_load import PredictedLoad, moves_to_start
from rig.wiring.devices import Watcher, watcher_of

NOT_JUDGED = (
    "acceptance: neither the sequence nor --acceptance states limits, so the run will not be judged"
)


def _quantity(limit: Limit) -> tuple[str, str, str]:
    """Return what is limited, the permitted values, and their unit, as text."""
    if isinstance(limit, Bound):
        sign = f"{'<' if limit.below else '>'}{'=' if limit.inclusive else ''}"
        name = f"{limit.measure} {limit.statistic}".strip()
        return name, f"{sign} {limit.value:g}", limit.unit or "-"
    if isinstance(limit, Range):
        permitted = f"{limit.low:g} to {limit.high:g}"
        if math.isinf(limit.low):
            permitted = f"<= {limit.high:g}"
        elif math.isinf(limit.high):
            permitted = f">= {limit.low:g}"
        return f"{limit.name}, 90 % interval", permitted, UNITS_ROTARY[limit.name] or "-"
    if limit.text == NOTHING_MISSING:
        return "diagnosis", limit.text, "-"
    return "weight check", "passed", "-"


def acceptance_record(limits: Sequence[Limit]) -> list[dict[str, Any]]:
    """Return the acceptance limits as JSON values."""
    return [
        {"limit": limit.text, "quantity": name, "permitted": permitted, "unit": unit}
        for limit in limits
        for name, permitted, unit in [_quantity(limit)]
    ]


SCHEMA = "loadrig.dry_run/1"
PROMPT_S = 60.0  # assumed time for hanging a weight and answering the prompt, s
NOT_PREDICTED = (
    "The peaks do not contain the torque that the drive's loops add when the joint breaks "
    "away, or sticks and slips; on the simulated benches this is up to a fifth."
)


@dataclass(frozen=True)
class DryRun:
    """Result of a dry run."""

    bench: Document[Bench]
    load: PredictedLoad
    watcher: Watcher
    # Time of the moves to the starts of the excitations, s; the first move is from 0 deg.
    moves_s: float
    prompts: int  # number of prompts that an operator must answer
    acceptance: tuple[Limit, ...]
    acceptance_source: str

    @property
    def duration_s(self) -> float:
        """Total duration, with the assumed time for prompts, s."""
        return self.load.plan.duration_s + self.moves_s + self.prompts * PROMPT_S


def dry_run(
    bench: Document[Bench],
    load: PredictedLoad,
    asks: bool,
    acceptance: tuple[Limit, ...],
    acceptance_source: str,
) -> DryRun:
    """Compute motion, peaks and duration of a run.

    ``asks``: whether an operator must answer the prompts.
    """
    plan = load.plan
    cycles = sum(len(move) for stage in plan.stages for move in moves_to_start(stage, plan))
    prompts = len(plan.stages) if asks else 0
    watcher, moves_s = watcher_of(bench.value), cycles * plan.cycle_s
    return DryRun(bench, load, watcher, moves_s, prompts, acceptance, acceptance_source)


def describe_dry_run(run: DryRun) -> str:
    """Return the dry run as text for the terminal."""
    judged = NOT_JUDGED
    if count := len(run.acceptance):
        head = (
            f"acceptance: when all stages are done, the run is judged by its completeness and "
            f"{count} {'limit' if count == 1 else 'limits'} of {run.acceptance_source}"
        )
        header = ("acceptance limit", "permitted", "unit")
        judged = f"{head}\n{table(header, [_quantity(limit) for limit in run.acceptance])}"
    peaks = [
        [
            peak.stage,
            peak.part,
            f"{peak.torque_N_m:.2f}",
            f"{peak.torque_limit_N_m:g}",
            percent(100.0 * peak.torque_share),
            f"{peak.current_A:.2f}",
            f"{peak.current_limit_A:g}",
            percent(100.0 * peak.current_share),
        ]
        for peak in run.load.peaks
    ]
    titles = ("stage", "part", "peak N m", "limit N m", "share", "peak A", "limit A", "share")
    asked = f"{run.prompts} prompts, {PROMPT_S:g} s assumed for each"
    minutes, seconds = divmod(round(run.duration_s), 60)
    lines = [
        describe(run.load.plan),
        "",
        judged,
        "",
        f"Predicted from {run.load.model.source}. {NOT_PREDICTED}",
        table(titles, peaks, right=range(2, 8)),
        "",
        f"watched by: {run.watcher.words}",
        f"duration: about {minutes} min {seconds} s: {run.load.plan.duration_s:.1f} s in motion "
        f"and at rest, {run.moves_s:.1f} s of moves to the start, "
        f"{asked if run.prompts else 'no prompt'}",
        *(f"warning: {text}" for text in run.load.warnings),
        *(f"problem: {text}" for text in run.load.problems),
    ]
    return "\n".join(lines)


def dry_run_record(run: DryRun) -> dict[str, Any]:
    """Return the dry run as the record of ``--json``."""
    bench, load = run.bench.value, run.load
    return {
        "schema": SCHEMA,
        "created": utc_now().isoformat(timespec="seconds"),
        "versions": versions(),
        "bench": bench.name,
        "bench_file": str(run.bench.path),
        "real": not bench.simulated,
        "sequence": load.plan.name,
        "predicted_from": load.model.source,
        "identified": load.model.measured,
        "predicted": [dataclasses.asdict(peak) for peak in load.peaks],
        "watched_by": run.watcher.kind,
        "watch_s": run.watcher.after_s,
        "under_power_s": load.plan.duration_s,
        "moves_s": run.moves_s,
        "prompts": run.prompts,
        "acceptance": acceptance_record(run.acceptance),
        "duration_s": run.duration_s,
        "warnings": load.warnings,
        "problems": load.problems,
        "good": not load.problems,
    }
