"""Makes the charts of a run's page: their channels, limits, phases and time axes.

The charts are drawn by ``static/run.js`` from the data at the end of the page, which
:class:`Plots` collects.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from operator import attrgetter
from typing import Any

import numpy as np

from identification.recording import Array
from rig.control.safety import Check
from rig.planning.limits import Limits
from rig.results.run.recorded import (
    BRAKING,
    NAMES,
    STATES,
    TAIL_S,
    Recorded,
    Series,
    Span,
    Step,
    Tripped,
    with_braking,
)
from rig.runs.run_record import RunRecord

BEFORE_S = 2.0  # time shown before the end of an unfinished run, s
_AFTER_SHARE = 0.12
"""Shortest time that is shown after the end, as a share of the time before the end."""
_CLOSE_S = (0.08, 0.04)
"""Time shown before and after the end in the close-up with single samples, s."""
NOT_LATE = (
    "Lateness of the control cycle is not drawn: the times of the samples are simulated time, in "
    "which every cycle of this recording started on time."
)
"""Message that replaces the chart of lateness on a simulated bench."""
NEVER_MOVED = "No control cycle was recorded: the drive was never under power, and nothing moved."
HOST, SIMULATED = "host time", "simulated time"
DEG = math.degrees(1.0)
_SEEN = 10.0  # ratio of a limit to the greatest value up to which the limit is drawn


@dataclass(frozen=True)
class Panel:
    """One chart of a run: its channels, and its upper and lower limit in SI units, if any."""

    title: str
    unit: str
    scale: float  # factor from the SI unit to `unit`
    # Names of the curves by their columns; the limits are those of the first curve.
    channels: Mapping[str, str]
    checks: tuple[Check, ...] = ()  # checks whose trips the chart shows
    upper: Callable[[Limits], float | None] = lambda limits: None  # upper limit
    # Lower limit; with `symmetric`, the upper limit with its sign changed.
    lower: Callable[[Limits], float | None] = lambda limits: None
    symmetric: bool = False  # whether the limit is on the magnitude
    categories: tuple[str, ...] = ()  # names of the values if they are categories
    least: float = 0.0  # smallest range of the value axis, in `unit`


# fmt: off
LATENESS = Panel(
    "lateness of the control cycle, beyond a period", "ms", 1e3, {"late": "lateness"},
    (Check.LATENESS,), attrgetter("lateness"),
)
PANELS: tuple[Panel, ...] = (
    Panel(
        "joint angle", "deg", DEG,
        {"angle": "joint encoder", "command": "command", "motor": "drive's encoder / gear ratio"},
        (Check.ANGLE,), attrgetter("angle_max"), attrgetter("angle_min"),
    ),
    Panel("tracking error, command less joint encoder", "deg", DEG, {"error": "error"}),
    Panel(
        "following error, as the drive computes it", "deg", DEG,
        {"following_error": "following error"},
        (Check.FOLLOWING_ERROR,), attrgetter("following_error"), symmetric=True,
    ),
    Panel(
        "drive's encoder less joint encoder", "deg", DEG, {"disagreement": "difference"},
        (Check.DISAGREEMENT,), attrgetter("encoder_disagreement"), symmetric=True,
    ),
    Panel(
        "joint speed", "deg/s", DEG, {"velocity": "speed"},
        (Check.SPEED, Check.RUNAWAY), attrgetter("speed"), symmetric=True,
    ),
    Panel(
        "motor current", "A", 1.0, {"current": "current"},
        (Check.CURRENT,), attrgetter("current"), symmetric=True,
    ),
    Panel(
        "joint torque Km i I", "N m", 1.0, {"torque": "torque"},
        (Check.TORQUE,), attrgetter("torque"), symmetric=True,
    ),
    Panel("motor voltage", "V", 1.0, {"voltage": "voltage"}),
    Panel(
        "supply voltage (DC link)", "V", 1.0, {"supply_voltage": "supply"},
        (Check.SUPPLY,), attrgetter("supply_max"), lambda limits: limits.supply_min or None,
    ),
    Panel(
        "motor temperature", "deg C", 1.0, {"temperature": "temperature"},
        (Check.TEMPERATURE,), attrgetter("temperature"),
    ),
    Panel(
        "chamber pressure", "MPa", 1e-6, {"pressure": "pressure"},
        (Check.PRESSURE,), lambda limits: None if limits.gas is None else limits.gas.pressure,
    ),
    Panel(
        "contact force that follows from the pressure", "N", 1.0, {"force": "force"},
        (Check.CONTACT_FORCE,),
        lambda limits: None if limits.gas is None else limits.gas.contact_force,
    ),
    Panel(
        "state of the drive", "", 1.0, {"state": "state"}, (Check.DRIVE_STATE,), categories=STATES
    ),
    Panel(
        "age of the last whole answer", "ms", 1e3,
        {"age": "age", "answer": "answer collected after the cycle's start"},
        (Check.SAMPLE_AGE, Check.PAUSE), attrgetter("sample_age"),
    ),
    LATENESS,
    Panel(
        "clocks of the devices less the host's", "ms", 1e3,
        {"drive_clock": "drive", "encoder_clock": "encoder"}, least=1e-3,
    ),
)
# fmt: on


RESULT = ("error", "current", "temperature")
"""First channels of the panels that show the course of a run, in order."""


Limit = Sequence[tuple[float, float]]
"""Pairs of time, s, and the limit from then on, in the chart's unit."""


@dataclass(frozen=True)
class Chart:
    """One chart of a time interval."""

    panel: Panel  # channels and unit; the channels without values are left out
    series: Series  # values
    limits: Sequence[Limit] = ()  # drawn limits
    reading: str = ""  # text with extremes and limits
    beyond: bool = False  # whether a limit was broken
    tall: bool = False  # whether it is the most important chart, drawn taller

    @property
    def range(self) -> tuple[float, float]:
        """Least and greatest value of the value axis, in the unit of the chart."""
        if self.panel.categories:
            return -0.3, len(self.panel.categories) - 0.7
        values = [value for limit in self.limits for _, value in limit]
        for channel in self.panel.channels:
            rows = self.series.low[NAMES.index(channel)], self.series.high[NAMES.index(channel)]
            finite = np.concatenate([row[np.isfinite(row)] for row in rows])
            values += [] if not len(finite) else [
                self.panel.scale * float(finite.min()), self.panel.scale * float(finite.max())
            ]  # fmt: skip
        low, high = (min(values), max(values)) if values else (0.0, 1.0)
        if not high - low > max(self.panel.least, 1e-9 * max(abs(low), abs(high))):
            half = max(0.05 * abs(high), 0.5 * self.panel.least, 1e-6)
            low, high = low - half, high + half
        margin = 0.06 * (high - low)
        # Room above for the name of the mark.
        return low - margin, high + (2.0 if self.tall else 3.0) * margin


def chart(
    panel: Panel, series: Series, steps: Sequence[Step], tripped: Tripped | None, tall: bool
) -> Chart | None:
    """Return one chart of a time interval. The result is None if no channel of the panel was
    recorded.

    ``steps``: limits over time; empty if unknown. ``tripped``: the trip, if this panel shows it;
    the limit of the trip is drawn if ``steps`` is empty. ``tall``: whether it is the most important
    chart, drawn taller.
    """
    extremes = {name: series.extremes(name) for name in panel.channels}
    channels = {
        name: words
        for name, words in panel.channels.items()
        if any(math.isfinite(value) for value in extremes[name])
    }
    if not channels:
        return None
    panel = dataclasses.replace(panel, channels=channels)
    first = next(iter(channels))
    low, high = (panel.scale * value for value in extremes[first])
    limits = _limits(panel, steps)
    if not limits and tripped is not None and not panel.categories:
        limits = [(_scaled(panel, [(-math.inf, tripped.limit)]), not tripped.value < tripped.limit)]
        if panel.symmetric:
            limits.append((_scaled(panel, [(-math.inf, -tripped.limit)]), False))
    beyond = any(_broken(limit, upper, panel, series) for limit, upper in limits)
    size = panel.scale * max(abs(value) for name in channels for value in extremes[name])
    always = beyond or tall or size == 0.0
    reading = "" if panel.categories else _reading(low, high, [each for each, _ in limits], panel)
    if tripped is not None and not panel.categories:
        # The value is not always among the samples, e.g. lateness on a simulated bench in real
        # time.
        reading = f"tripped at {panel.scale * tripped.value:.4g} {panel.unit}; {reading}"
    shown = [
        limit for limit, _ in limits
        if always or min(abs(value) for _, value in limit) <= _SEEN * size
    ]  # fmt: skip
    if len(shown) < len(limits):
        reading += " (outside this chart)"
    return Chart(panel, series, shown, reading, beyond, tall)


def _limits(panel: Panel, steps: Sequence[Step]) -> list[tuple[Limit, bool]]:
    """Return the upper and lower limit of a panel, and whether each is an upper limit."""
    found = []
    for upper, limit in ((True, panel.upper), (False, panel.lower)):
        sign = 1.0
        if panel.symmetric and not upper:
            limit, sign = panel.upper, -1.0
        values = [(t, sign * v) for t, limits in steps if (v := limit(limits)) is not None]
        if values:
            found.append((_scaled(panel, values), upper))
    return found


def _scaled(panel: Panel, values: Limit) -> Limit:
    scaled = [(time, panel.scale * value) for time, value in values]
    return [step for k, step in enumerate(scaled) if k == 0 or step[1] != scaled[k - 1][1]]


def _broken(limit: Limit, upper: bool, panel: Panel, series: Series) -> bool:
    """Return whether the first channel is beyond a limit; while it changes, the wider counts."""
    times, values = (np.array(each) for each in zip(*limit, strict=True))
    half = 0.5 * series.width_s
    found = [
        values[np.maximum(np.searchsorted(times, series.time + shift, side="right") - 1, 0)]
        for shift in (-half, half)
    ]
    row = NAMES.index(next(iter(panel.channels)))
    if upper:
        return bool(np.any(panel.scale * series.high[row] > np.maximum(*found)))
    return bool(np.any(panel.scale * series.low[row] < np.minimum(*found)))


def _reading(low: float, high: float, limits: Sequence[Limit], panel: Panel) -> str:
    unit, least = panel.unit, max(1e-6 * max(abs(low), abs(high)), 1e-3 * panel.least)
    low, high = (value if abs(value) > least else 0.0 for value in (low, high))
    words = f"{low:.4g} to {high:.4g} {unit}"
    if not limits:
        return f"{words}; {'limit not known' if panel.checks else 'no limit'}"
    last = " and ".join(f"{value:.4g}" for value in sorted({limit[-1][1] for limit in limits}))
    return f"{words}; limit {last} {unit}"


_NICE = (1.0, 2.0, 5.0, 10.0)


class TimeAxis:
    """Maps a time to a position on the page. Long pauses with the drive off are shortened.

    Args:
        powered: Time intervals drawn to scale, s, in order.
    """

    _PAUSE = 0.02
    """Width of a shortened pause."""

    def __init__(self, powered: Sequence[tuple[float, float]]) -> None:
        joined = [powered[0]]
        longest = 0.02 * sum(stop - start for start, stop in powered)
        for start, stop in powered[1:]:
            if start - joined[-1][1] > longest:
                joined.append((start, stop))
            else:
                joined[-1] = (joined[-1][0], stop)
        self.pauses = [(before[1], after[0]) for before, after in pairwise(joined)]
        pause = min(self._PAUSE, 0.2 / max(len(self.pauses), 1))
        total = max(sum(stop - start for start, stop in joined), 1e-9)
        scale = (1.0 - pause * len(self.pauses)) / total
        times, places, at = [], [], 0.0
        for start, stop in joined:
            times += [start, stop]
            places += [at, at + scale * (stop - start)]
            at = places[-1] + pause
        self._times, self._places, self._joined, self._total = times, places, joined, total

    @property
    def ends(self) -> tuple[float, float]:
        """First and last time, s."""
        return self._times[0], self._times[-1]

    def place(self, time: Array) -> Array:
        """Return the positions of times, 0 at the left edge and 1 at the right."""
        return np.asarray(np.interp(time, self._times, self._places))

    def at(self, time: float) -> float:
        """Return the position of one time."""
        return float(self.place(np.array([time]))[0])

    def ticks(self) -> Iterator[tuple[float, str]]:
        """Yield positions and labels of the ticks, spaced widely enough for a telephone."""
        step, last = 1.0, -1.0
        if 0.0 < (rough := self._total / 5.0) < math.inf:
            # The next number that is 1, 2 or 5 times a power of ten.
            power = 10.0 ** math.floor(math.log10(rough))
            step = next(power * k for k in _NICE if power * k >= rough * (1.0 - 1e-9))
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        for start, stop in self._joined:
            for k in range(math.ceil(start / step - 1e-9), math.floor(stop / step + 1e-9) + 1):
                value, place = k * step, self.at(k * step)
                if place - last >= 0.12:
                    plain = digits < 7 and abs(value) < 1e7
                    yield place, f"{value:z.{digits}f}" if plain else f"{value:.3g}"
                    last = place

    def stairs(self, limit: Limit) -> Iterator[tuple[float, float, float]]:
        """Yield start and end on the axis, and value, of each constant part of a limit."""
        begins, ends = self.ends
        for (start, value), (stop, _) in pairwise([*limit, (ends, math.nan)]):
            if max(start, begins) < min(stop, ends):
                yield self.at(max(start, begins)), self.at(min(stop, ends)), value


@dataclass(frozen=True)
class Shade:
    """A time interval; ``kind`` 0 and 1 are phases in turn, 2 braking, 3 no power."""

    start: float
    stop: float
    name: str
    kind: int


@dataclass(frozen=True)
class Frame:
    """What the charts of one section have in common."""

    axis: TimeAxis  # time axis
    clock: str  # name of the clock
    shades: Sequence[Shade] = ()  # shaded phases
    mark: tuple[float, str] | None = None  # time, s, and name of a marked moment, or None

    def record(self) -> dict[str, Any]:
        """Return the data of the frame for the page; times are places on the axis, 0 to 1."""
        at, mark = self.axis.at, self.mark
        placed = [(at(s.start), at(s.stop), s.name, s.kind) for s in self.shades]
        return {
            "clock": self.clock,
            "ticks": [(round(place, 5), f"{text} s") for place, text in self.axis.ticks()],
            "shades": [
                (round(start, 5), round(stop, 5), name, kind)
                for start, stop, name, kind in placed
                if stop > start
            ],
            "mark": None if mark is None else (round(at(mark[0]), 5), mark[1]),
        }


@dataclass
class Plots:
    """Data of all charts of a page; each series is stored once, with the channels drawn."""

    charts: list[dict[str, Any]] = field(default_factory=list)
    _series: list[tuple[Series, TimeAxis, dict[str, None]]] = field(default_factory=list)

    def figure(self, chart: Chart, frame: Frame) -> str:
        """Add a chart; return its place in the page with title, legend and reading."""
        panel = chart.panel
        known = (k for k, each in enumerate(self._series) if each[0] is chart.series)
        number = next(known, None)
        if number is None:
            number = len(self._series)
            self._series.append((chart.series, frame.axis, {}))
        self._series[number][2].update(dict.fromkeys(panel.channels))
        self.charts.append(
            {
                "series": number,
                "curves": list(panel.channels),
                "scale": panel.scale,
                "unit": panel.unit,
                "categories": panel.categories,
                "range": chart.range,
                "limits": [list(frame.axis.stairs(limit)) for limit in chart.limits],
                "tall": chart.tall,
                "frame": frame.record(),
            }
        )
        unit = f" <span>[{escape(panel.unit)}]</span>" if panel.unit else ""
        keys = [(f"k{k}", name) for k, name in enumerate(panel.channels.values())]
        keys += [("limit", "limit")] if chart.limits else []
        legend = "".join(
            f' <span class="name"><span class="key {kind}"></span>{escape(name)}</span>'
            for kind, name in keys
        )
        reading = chart.reading + (": BEYOND THE LIMIT" if chart.beyond else "")
        kind = ' class="beyond"' if chart.beyond else ""
        return (
            f'<figure class="chart{" tall" if chart.tall else ""}"><figcaption>'
            f"<b>{escape(panel.title)}</b>{unit}{legend}"
            + (f"<br><small{kind}>{escape(reading)}</small>" if reading else "")
            + f'</figcaption><div class="plot" data-plot="{len(self.charts) - 1}" role="img" '
            f'aria-label="{escape(panel.title)} over time"></div></figure>'
        )

    def script(self) -> str:
        """Return the data as JSON in a script element."""
        series = [
            {
                "time": _digits(axis.place(each.time)),
                "low": {name: _digits(each.low[NAMES.index(name)]) for name in names},
                "high": {name: _digits(each.high[NAMES.index(name)]) for name in names}
                if each.high is not each.low
                else None,
            }
            for each, axis, names in self._series
        ]
        data = json.dumps({"series": series, "charts": self.charts}, separators=(",", ":"))
        # A title must not end the element.
        safe = data.replace("<", "\\u003c")
        return f'<script type="application/json" id="plots">{safe}</script>'


def _digits(values: Array) -> list[float | None]:
    """Return values with five significant digits; None where there is no finite value."""
    return [float(f"{v:.5g}") if math.isfinite(v) else None for v in values.tolist()]


def last_seconds(recorded: Recorded, plots: Plots) -> Iterator[str]:
    """Yield the last seconds of a run, the tripped channel first, with a close-up."""
    moment, traces = recorded.moment, recorded.traces
    if moment is None:
        yield f'<p class="note">{NEVER_MOVED}</p>'
        return
    last = traces.end_s
    first = max(moment.time - BEFORE_S, last - TAIL_S, traces.powered[0][0])
    after = moment.time + _AFTER_SHARE * (moment.time - first)
    until = max(last, after, first + 10.0 * recorded.record.cycle_s)
    shades = _shades(with_braking(recorded.spans, moment), numbered=False)
    off = "drive off" if recorded.record.de_energised else "not recorded"
    shades.append(Shade(last, math.inf, off, 3))
    mark = (moment.time, f"{moment.words} {moment.time:.3f} s")
    clock = SIMULATED if recorded.record.simulated else HOST
    frame = Frame(TimeAxis([(first, until)]), clock, _inside(shades, first, until), mark)
    charts = _charts(recorded, traces.samples(first, last))
    about = f"Black line: {moment.words} at {moment.time:.3f} s since the start of this recording."
    about += f" {_axis_words(recorded.record)} {_limits_words(recorded)}"
    yield f'<p class="note">{escape(about)}</p>'
    if charts:
        yield plots.figure(dataclasses.replace(charts[0], tall=True), frame)
    if charts and charts[0].tall:
        first, until = moment.time - _CLOSE_S[0], moment.time + _CLOSE_S[1]
        near_mark = (moment.time, moment.words)
        near = Frame(TimeAxis([(first, until)]), clock, _inside(shades, first, until), near_mark)
        for each in _charts(recorded, traces.samples(first, until))[:1]:
            title = f"{each.panel.title}, sample by sample"
            panel = dataclasses.replace(each.panel, title=title)
            yield plots.figure(dataclasses.replace(each, panel=panel), near)
    yield '<div class="pair">'
    yield from (plots.figure(each, frame) for each in charts[1:])
    yield "</div>"


def _limits_words(recorded: Recorded) -> str:
    if recorded.steps:
        return "Dashed red: the limit in force, tighter in a first pass."
    problem = recorded.attached.problem
    return f"The limits are not known ({problem}); only the limit of a trip is drawn."


def whole(recorded: Recorded, plots: Plots) -> Iterator[str]:
    """Yield the page section that shows one whole recording."""
    traces = recorded.traces
    if traces.damage is not None:
        yield f'<p class="warning">The recording is damaged: {escape(traces.damage)}</p>'
    if traces.reduced is None:
        yield f'<p class="note">{NEVER_MOVED}</p>'
        return
    frame = _whole_frame(recorded)
    scale = ", which is not drawn to scale" if frame.axis.pauses else ""
    words = (
        f"{traces.count} samples. Each column of a chart shows the least and the greatest "
        f"value of the samples in its time interval. Grey: the drive was off{scale}. "
        f"{_axis_words(recorded.record)} {_limits_words(recorded)}"
    )
    yield f'<p class="note">{escape(words)}</p><div class="pair">'
    yield from (plots.figure(each, frame) for each in _charts(recorded, traces.reduced, tall=False))
    yield "</div>"
    if _never_late(recorded, traces.reduced):
        late = "A recording in simulated time does not show how late this computer is."
        if recorded.record.realtime:
            late = (
                "The lateness of this computer, which paces the simulation, is in the table `How "
                "late cycles started`."
            )
        yield f'<p class="note">{NOT_LATE} {late}</p>'


def result(recorded: Recorded, plots: Plots) -> Iterator[str]:
    """Yield the top of a page: trip, tracking error, current and temperature."""
    traces = recorded.traces
    if traces.reduced is None:
        yield f'<p class="note">{NEVER_MOVED}</p>'
        return
    frame = _whole_frame(recorded)
    tripped = recorded.tripped
    check = None if tripped is None else tripped.check
    by_channel = {next(iter(panel.channels)): panel for panel in PANELS}
    usual = [by_channel[name] for name in RESULT if check not in by_channel[name].checks]
    for panel in (*(p for p in PANELS if check in p.checks), *usual):
        mine = tripped if tripped is not None and tripped.check in panel.checks else None
        each = chart(panel, traces.reduced, recorded.steps, mine, False)
        if each is not None:
            yield plots.figure(each, frame)


def _whole_frame(recorded: Recorded) -> Frame:
    moment = recorded.moment
    found = recorded.spans if moment is None else with_braking(recorded.spans, moment)
    mark = None if moment is None else (moment.time, f"{moment.words} {moment.time:.3f} s")
    clock = SIMULATED if recorded.record.simulated else HOST
    axis = TimeAxis(recorded.traces.powered)
    return Frame(axis, clock, _shades(found, numbered=True), mark)


def _charts(recorded: Recorded, series: Series, tall: bool = True) -> list[Chart]:
    """Return the charts of an interval, the tripped channel first."""
    tripped = recorded.tripped
    check = None if tripped is None else tripped.check
    made = []
    for panel in sorted(PANELS, key=lambda panel: check not in panel.checks):
        if panel is LATENESS and recorded.record.simulated:
            if _never_late(recorded, series):
                continue
            panel = dataclasses.replace(panel, channels={"late": f"lateness, {SIMULATED}"})
        mine = tripped if check in panel.checks else None
        each = chart(panel, series, recorded.steps, mine, tall and mine is not None)
        if each is not None:
            made.append(each)
    return made


def _never_late(recorded: Recorded, series: Series) -> bool:
    """Return whether a chart of lateness would only show that simulated time is never late."""
    tripped = recorded.tripped
    if not recorded.record.simulated or (tripped and tripped.check is Check.LATENESS):
        return False
    return not series.extremes("late")[1] > 0.0


def _axis_words(record: RunRecord) -> str:
    if not record.simulated:
        return "Time axis: time of the host's clock since the start of this recording."
    pace = ", in step with real time" if record.realtime else ""
    return f"Time axis: simulated time since the start of this recording{pace}."


def _shades(found: Sequence[Span], *, numbered: bool) -> list[Shade]:
    """Return the shaded phases; if ``numbered``, each is named by its stage only."""
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
