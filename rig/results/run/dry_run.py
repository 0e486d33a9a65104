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


def _acceptance_rows(limits: Sequence[Limit]) -> list[tuple[str, str, str]]:
    return [_row(limit) for limit in limits]


def _row(limit: Limit) -> tuple[str, str, str]:
    if isinstance(limit, Bound):
        sign = f"{'<' if limit.below else '>'}{'=' if limit.inclusive else ''}"
        name = f"{limit.measure} {limit.statistic}".strip()
        return name, f"{sign} {limit.value:g}", limit.unit or "-"
    if isinstance(limit, Range):
        return f"{limit.name}, 90 % interval", _range(limit), UNITS_ROTARY[limit.name] or "-"
    if limit.text == NOTHING_MISSING:
        return "diagnosis", limit.text, "-"
    return "weight check", "passed", "-"


def _range(limit: Range) -> str:
    if math.isinf(limit.low):
        return f"<= {limit.high:g}"
    if math.isinf(limit.high):
        return f">= {limit.low:g}"
    return f"{limit.low:g} to {limit.high:g}"


def _describe_acceptance(limits: Sequence[Limit], source: str) -> str:
    if not limits:
        return NOT_JUDGED
    head = (
        f"acceptance: when all stages are done, the run is judged by its completeness and "
        f"{len(limits)} {'limit' if len(limits) == 1 else 'limits'} of {source}"
    )
    rows = [list(row) for row in _acceptance_rows(limits)]
    return f"{head}\n{table(['acceptance limit', 'permitted', 'unit'], rows)}"


def acceptance_record(limits: Sequence[Limit]) -> list[dict[str, Any]]:
    """Return the acceptance limits as JSON values."""
    return [
        {"limit": limit.text, "quantity": name, "permitted": permitted, "unit": unit}
        for limit, (name, permitted, unit) in zip(limits, _acceptance_rows(limits), strict=True)
    ]


SCHEMA = "loadrig.dry_run/1"
PROMPT_S = 60.0  # assumed time for hanging a weight and answering the prompt, s
NOT_PREDICTED = (
    "The peaks do not contain the torque that the drive's loops add when the joint breaks "
    "away, or sticks and slips; on the simulated benches this is up to a fifth."
)


@dataclass(frozen=True)
class Duration:
    """Expected duration of a run."""

    under_power_s: float  # time under power, in motion and at rest, s
    # Time of the moves to the starts of the excitations, s; the first move is from 0 deg.
    moves_s: float
    prompts: int  # number of prompts that an operator must answer

    @property
    def total_s(self) -> float:
        """Total duration, with the assumed time for prompts, s."""
        return self.under_power_s + self.moves_s + self.prompts * PROMPT_S

    @property
    def words(self) -> str:
        """Description for the operator."""
        asked = (
            f"{self.prompts} prompts, {PROMPT_S:g} s assumed for each"
            if self.prompts
            else "no prompt"
        )
        parts = (
            f"{self.under_power_s:.1f} s in motion and at rest, {self.moves_s:.1f} s of moves "
            f"to the start, {asked}"
        )
        minutes, seconds = divmod(round(self.total_s), 60)
        return f"about {minutes} min {seconds} s: {parts}"


@dataclass(frozen=True)
class DryRun:
    """Result of a dry run."""

    bench: Document[Bench]
    load: PredictedLoad
    watcher: Watcher
    duration: Duration
    acceptance: tuple[Limit, ...] = ()
    acceptance_source: str = ""


def dry_run(
    bench: Document[Bench],
    load: PredictedLoad,
    asks: bool,
    acceptance: tuple[Limit, ...] = (),
    acceptance_source: str = "",
) -> DryRun:
    """Compute motion, peaks and duration of a run.

    ``asks``: whether an operator must answer the prompts.
    """
    plan = load.plan
    prompts = len(plan.stages) if asks else 0
    cycles = sum(len(move) for stage in plan.stages for move in moves_to_start(stage, plan))
    duration = Duration(plan.duration_s, cycles * plan.cycle_s, prompts)
    watcher = watcher_of(bench.value)
    return DryRun(bench, load, watcher, duration, acceptance, acceptance_source)


def describe_dry_run(run: DryRun) -> str:
    """Return the dry run as text for the terminal."""
    head = ["stage", "part", "peak N m", "limit N m", "share", "peak A", "limit A", "share"]
    rows = [
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
    lines = [
        describe(run.load.plan),
        "",
        _describe_acceptance(run.acceptance, run.acceptance_source),
        "",
        f"Predicted from {run.load.model.source}. {NOT_PREDICTED}",
        table(head, rows, right=range(2, 8)),
        "",
        f"watched by: {run.watcher.words}",
        f"duration: {run.duration.words}",
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
        "under_power_s": run.duration.under_power_s,
        "moves_s": run.duration.moves_s,
        "prompts": run.duration.prompts,
        "acceptance": acceptance_record(run.acceptance),
        "duration_s": run.duration.total_s,
        "warnings": load.warnings,
        "problems": load.problems,
        "good": not load.problems,
    }
