"""Computes the limits over time from the files attached to a recording."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.yaml_tree import DocumentError, parse
from rig.config.bench import Bench, in_force, without_watch
from rig.config.configuration import Document, Schema, validated
from rig.config.sequence import Sequence as StageSequence
from rig.config.sequence import approach
from rig.config.serial_bus import NO_WATCHDOG_AT_ALL
from rig.planning.first_pass import PlannedPass
from rig.planning.limits import Limits
from rig.planning.plan import APPROACH_SPEED_SHARE, Plan, make_plan
from rig.runs.run_record import BENCH_ATTACHMENT, SEQUENCE_ATTACHMENT

_ENDS_PASS = frozenset({"weight check", "stage start"})
"""Events that end a first pass; if a run ends during a first pass, the limits of the first pass
hold to the end.
"""
RUN_ATTACHMENT = "run.json"
"""Name of the attached record of a run, as the record was at the start."""
_SAME = 1e-9
"""Relative difference up to which two amplitudes count as equal."""


@dataclass(frozen=True)
class Attachments:
    """Content of the files attached to a recording.

    Attributes:
        bench: The bench, with the limits in force, or None if its file is missing or cannot be
            read.
        plan: The plan, with the first passes of each stage, or None if a file is missing or cannot
            be read.
        problem: The reason why ``bench`` or ``plan`` is None.
    """

    bench: Bench | None
    plan: Plan | None
    problem: str = ""


def read_attachments(attachments: Mapping[str, bytes]) -> Attachments:
    """Read the attached bench and sequence files."""
    try:
        bench = _document(attachments, BENCH_ATTACHMENT, Bench)
        if _unwatched(attachments):
            bench = without_watch(bench)
        bench = in_force(bench)
    except InputError as error:
        return Attachments(None, None, error.problems[0])
    try:
        sequence = _document(attachments, SEQUENCE_ATTACHMENT, StageSequence)
        return Attachments(bench.value, make_plan(sequence, bench, first_pass=True))
    except InputError as error:
        return Attachments(bench.value, None, error.problems[0])


def _unwatched(attachments: Mapping[str, bytes]) -> bool:
    """Return whether the record of the run has the warning of a drive without watchdog, which may
    follow from the EDS file, which is not attached to the recording.
    """
    try:
        warned = json.loads(attachments.get(RUN_ATTACHMENT, b"{}")).get("warnings", [])
    except (ValueError, AttributeError):
        return False
    return any(str(words).startswith(NO_WATCHDOG_AT_ALL) for words in warned)


def _document(attachments: Mapping[str, bytes], name: str, schema: type[Schema]) -> Document[Any]:
    """Validate one attachment.

    Raises:
        InputError: The attachment is missing, or not valid.
    """
    if name not in attachments:
        raise InputError(f"{name} is not attached to the recording")
    try:
        root, _ = parse(attachments[name].decode("utf-8"))
    except (DocumentError, UnicodeDecodeError) as error:
        raise InputError(
            f"{name}, as attached to the recording, cannot be read: {error}"
        ) from error
    return validated(Path(name), root, schema)


Step = tuple[float, Limits]
"""Start time, s, and the limits from this time on."""


def limit_steps(
    plan: Plan, events: Iterable[Mapping[str, Any]], starts: Sequence[tuple[float, float]]
) -> list[Step]:
    """Return the limits of a run over the time of one recording, including first passes.

    Args:
        plan: The plan.
        events: Events of the recording.
        starts: Time, s, and command, rad, of the first sample of each stage under power.
    """
    steps: list[Step] = [(-math.inf, plan.limits)]
    inside = False
    before: PlannedPass | None = None
    for event in events:
        if event["event"] == "first pass":
            planned = _pass_of(plan, event)
            if planned is None:
                continue
            steps += _pass_steps(planned, before, plan, event, starts)
            before, inside = planned, True
        elif inside and event["event"] in _ENDS_PASS:
            steps.append((event["time"], plan.limits))
            inside = False
        if event["event"] == "stage start":
            before = None
    return steps


def _pass_of(plan: Plan, event: Mapping[str, Any]) -> PlannedPass | None:
    passes = next((stage.first_passes for stage in plan.stages if stage.name == event["stage"]), ())
    return next(
        (p for p in passes if math.isclose(p.amplitude, event["amplitude"], rel_tol=_SAME)), None
    )


def _pass_steps(
    planned: PlannedPass,
    before: PlannedPass | None,
    plan: Plan,
    event: Mapping[str, Any],
    starts: Sequence[tuple[float, float]],
) -> Iterator[Step]:
    """Yield the limits of the move to a first pass, and the tighter angle limits of the first
    pass.
    """
    yield event["time"], planned.move_limits
    begun = [command for time, command in starts if time <= event["time"]]
    if before is None and not begun:
        return
    # As in the sequencer: from the present angle of the joint, or from the end of the previous
    # pass.
    at = float(before.targets[-1]) if before is not None else begun[-1]
    speed = min(plan.approach_speed, APPROACH_SPEED_SHARE * planned.move_limits.speed)
    cycles = len(approach(at, float(planned.targets[0]), speed, plan.cycle_s))
    settle_s = next(stage.settle_s for stage in plan.stages if stage.name == event["stage"])
    yield event["time"] + cycles * plan.cycle_s + settle_s, planned.limits
