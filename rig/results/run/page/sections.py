"""Makes the chart sections of a run's page: the last seconds of an unfinished run, and every whole
recording.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from rig.control.safety import Check
from rig.results.run.page import panels
from rig.results.run.page.channels import NAMES, Traces, read_traces
from rig.results.run.page.chart import Bins, Chart, Mark, Shade, TimeAxis, draw, of_samples
from rig.results.run.page.clock_words import SIMULATED, axis_words, clock_of, not_late_words
from rig.results.run.page.limits import Attachments, Step, limit_steps, read_attachments
from rig.results.run.page.phases import BRAKING, Moment, Span, moment_of, spans, with_braking
from rig.runs.run_file import recorded_bench
from rig.runs.run_record import PartRecord, RunRecord, SegmentRecord

BEFORE_S = 2.0
"""Time shown before the end of an unfinished run, s."""
_AFTER_SHARE = 0.12
"""Shortest time that is shown after the end, as a share of the time before the end."""
_CLOSE_S = (0.08, 0.04)
"""Time shown before and after the end in the close-up with single samples, s."""
NEVER_MOVED = "No control cycle was recorded: the drive was never under power, and nothing moved."


class Recorded:
    """One recording of a run, read in order to draw it.

    Args:
        folder: The run folder.
        record: ``run.json``.
        number: Number of the recording, from 1.

    Raises:
        InputError: The file cannot be opened, or is not a recording.
    """

    def __init__(self, folder: Path, record: RunRecord, number: int) -> None:
        self.record = record
        self.part: PartRecord = record.parts[number - 1]
        self.traces: Traces = read_traces(
            folder / self.part.file, recorded_bench(record), record.cycle_s
        )
        self.attached: Attachments = read_attachments(self.traces.attachments)
        self.segments: list[SegmentRecord] = [s for s in record.segments if s.part == number]
        plan = self.attached.plan
        self.steps: list[Step] = (
            [] if plan is None else limit_steps(plan, self.traces.events, self.traces.starts)
        )
        self.is_last = number == len(record.parts)

    @property
    def spans(self) -> list[Span]:
        """Phases of the recording; requires samples."""
        return spans(self.traces.events, self.segments, self.traces.ends[1])

    @property
    def moment(self) -> Moment | None:
        """Time of the end of the run, if the run stopped in this recording after a first sample;
        else None.
        """
        tail = self.traces.tail
        if not self.is_last or self.record.state == "done" or tail is None:
            return None
        return moment_of(self.record, tail, self.segments, self.traces.events)

    @property
    def tripped(self) -> panels.Tripped | None:
        """The trip of the run, if the run tripped in this recording; else None."""
        trip = self.record.trip
        check = next((check for check in Check if trip and check.value == trip.get("check")), None)
        if trip is None or check is None or not self.is_last:
            return None
        return panels.Tripped(check, _number(trip.get("value")), _number(trip.get("limit")))


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def last_seconds(recorded: Recorded) -> Iterator[str]:
    """Yield the section of the last seconds before a run ended, the tripped channel first."""
    moment, tail = recorded.moment, recorded.traces.tail
    if moment is None or tail is None:
        yield f'<p class="note">{NEVER_MOVED}</p>'
        return
    first = max(moment.time - BEFORE_S, float(tail.time[0]))
    last = float(tail.time[-1])
    until = max(
        last,
        moment.time + _AFTER_SHARE * (moment.time - first),
        first + 10.0 * recorded.record.cycle_s,
    )
    bins = of_samples(tail.time, tail.values, tail.broken).part(first, last)
    shades = _shades(with_braking(recorded.spans, moment), numbered=False)
    shades.append(
        Shade(last, math.inf, "drive off" if recorded.record.de_energised else "not recorded", 3)
    )
    mark = Mark(moment.time, f"{moment.words} {moment.time:.3f} s")
    axis = TimeAxis([(first, until)], clock_of(recorded.record))
    charts = _charts(recorded, bins)
    yield f'<p class="note">{escape(_about(recorded, moment))}</p>'
    for each in charts[:1]:
        yield draw(dataclasses.replace(each, tall=True), axis, _inside(shades, first, until), mark)
        if each.tall:
            yield from _closer(recorded, bins, moment, shades)
    yield '<div class="pair">'
    yield from (draw(each, axis, _inside(shades, first, until), mark) for each in charts[1:])
    yield "</div>"


def _about(recorded: Recorded, moment: Moment) -> str:
    words = f"Black line: {moment.words} at {moment.time:.3f} s since the start of this recording."
    return f"{words} {axis_words(recorded.record)} {_limits_words(recorded)}"


def _limits_words(recorded: Recorded) -> str:
    if recorded.steps:
        return "Dashed red: the limit in force, tighter in a first pass."
    return (
        f"The limits are not known ({recorded.attached.problem}); only the limit of a trip is "
        "drawn."
    )


def _closer(
    recorded: Recorded, bins: Bins, moment: Moment, shades: Sequence[Shade]
) -> Iterator[str]:
    """Yield a close-up of the tripped channel in which single samples are visible."""
    before, after = _CLOSE_S
    first, until = moment.time - before, moment.time + after
    near = bins.part(first, until)
    charts = _charts(recorded, near)
    if charts:
        axis = TimeAxis([(first, until)], clock_of(recorded.record))
        close = dataclasses.replace(charts[0], title=f"{charts[0].title}, sample by sample")
        yield draw(close, axis, _inside(shades, first, until), Mark(moment.time, moment.words))


def whole(recorded: Recorded) -> Iterator[str]:
    """Yield the page section that shows one whole recording."""
    traces = recorded.traces
    if traces.damage is not None:
        yield f'<p class="warning">The recording is damaged: {escape(traces.damage)}</p>'
    if traces.bins is None:
        yield f'<p class="note">{NEVER_MOVED}</p>'
        return
    moment = recorded.moment
    found = recorded.spans if moment is None else with_braking(recorded.spans, moment)
    axis = TimeAxis(_powered(traces), clock_of(recorded.record))
    shades = _shades(found, numbered=True)
    words = (
        f"{traces.count} samples. Each column of a chart shows the least and the greatest "
        f"value of the samples in its time interval. "
    )
    words += f"Grey: the drive was off{', which is not drawn to scale' if axis.pauses else ''}. "
    words += f"{axis_words(recorded.record)} "
    yield f'<p class="note">{escape(words + _limits_words(recorded))}</p><div class="pair">'
    mark = None if moment is None else Mark(moment.time, f"{moment.words} {moment.time:.3f} s")
    yield from (
        draw(each, axis, shades, mark) for each in _charts(recorded, traces.bins, tall=False)
    )
    yield "</div>"
    if _never_late(recorded, traces.bins):
        yield f'<p class="note">{escape(not_late_words(recorded.record))}</p>'


def result(recorded: Recorded) -> Iterator[str]:
    """Yield the figure at the top of a page: the tripped channel, tracking error, current and
    temperature over the whole last recording.
    """
    traces = recorded.traces
    if traces.bins is None:
        yield f'<p class="note">{NEVER_MOVED}</p>'
        return
    moment = recorded.moment
    found = recorded.spans if moment is None else with_braking(recorded.spans, moment)
    axis = TimeAxis(_powered(traces), clock_of(recorded.record))
    shades = _shades(found, numbered=True)
    mark = None if moment is None else Mark(moment.time, f"{moment.words} {moment.time:.3f} s")
    tripped = recorded.tripped
    for panel in panels.result_panels(None if tripped is None else tripped.check):
        mine = tripped if tripped is not None and tripped.check in panel.checks else None
        chart = panels.chart(panel, traces.bins, recorded.steps, mine, False)
        if chart is not None:
            yield draw(chart, axis, shades, mark)


def _charts(recorded: Recorded, bins: Bins, tall: bool = True) -> list[Chart]:
    """Return the charts of an interval, the tripped channel first."""
    tripped = recorded.tripped
    check = None if tripped is None else tripped.check
    made = []
    for panel in panels.tripped_first(check):
        if panel is panels.LATENESS and recorded.record.simulated:
            if _never_late(recorded, bins):
                continue
            panel = dataclasses.replace(panel, channels={"late": f"lateness, {SIMULATED}"})
        mine = tripped if check in panel.checks else None
        each = panels.chart(panel, bins, recorded.steps, mine, tall and mine is not None)
        if each is not None:
            made.append(each)
    return made


def _never_late(recorded: Recorded, bins: Bins) -> bool:
    """Return whether a chart of lateness would only show that simulated time is never late."""
    tripped = recorded.tripped
    if not recorded.record.simulated or (tripped and tripped.check is Check.LATENESS):
        return False
    return not np.any(bins.high[:, NAMES.index("late")] > 0.0)


def _powered(traces: Traces) -> list[tuple[float, float]]:
    """Return start and end of the time under power for each stage."""
    assert traces.bins is not None
    begins = [time for time, _ in traces.starts]
    first, last = traces.ends
    edges = sorted({first, *begins})
    ends = []
    for k, _ in enumerate(edges):
        inside = (
            traces.bins.stop[traces.bins.stop < edges[k + 1]]
            if k + 1 < len(edges)
            else traces.bins.stop
        )
        ends.append(float(inside[-1]) if len(inside) else edges[k])
    return list(zip(edges, [*ends[:-1], last], strict=True))


def _shades(found: Sequence[Span], *, numbered: bool) -> list[Shade]:
    """Return the shaded phases; in the whole recording (``numbered``) the label is only the name of
    the stage.
    """
    shades = []
    for k, span in enumerate(found):
        if numbered:
            name = span.stage if span.phase == "excite" else ""
        else:
            name = f"{span.stage}: {span.phase}" if span.phase != BRAKING else BRAKING
        if k and span.start > found[k - 1].stop:
            shades.append(Shade(found[k - 1].stop, span.start, "", 3))
        shades.append(Shade(span.start, span.stop, name, 2 if span.phase == BRAKING else k % 2))
    return shades


def _inside(shades: Sequence[Shade], first: float, last: float) -> list[Shade]:
    """Return the parts of the shades between two times."""
    return [
        Shade(max(shade.start, first), min(shade.stop, last), shade.name, shade.kind)
        for shade in shades
        if shade.stop > first and shade.start < last
    ]
