"""Defines the charts of a run's page: channels, units and limits of each."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rig.control.safety import Check
from rig.planning.limits import Limits
from rig.results.run.page.channels import NAMES, STATES
from rig.results.run.page.chart import Bins, Bound, Chart, Curve
from rig.results.run.page.limits import Step

DEG = math.degrees(1.0)
_SEEN = 10.0
"""Ratio of a limit to the greatest value up to which the limit is drawn; a more distant limit would
flatten the curve.
"""


@dataclass(frozen=True)
class Panel:
    """One chart of a run: its channels, and its upper and lower limit in SI units, if any.

    Attributes:
        title: Title of the chart.
        unit: Unit of the chart.
        scale: Factor from the SI unit to ``unit``.
        channels: Names of the curves by their columns; the limits are those of the first curve.
        checks: Checks whose trips the chart shows.
        upper: Upper limit.
        lower: Lower limit; with ``symmetric``, the upper limit with its sign changed.
        symmetric: Whether the limit is on the magnitude.
        categories: Names of the values if they are categories.
        least: Smallest range of the value axis, in ``unit``.
    """

    title: str
    unit: str
    scale: float
    channels: Mapping[str, str]
    checks: tuple[Check, ...] = ()
    upper: Callable[[Limits], float | None] = lambda limits: None
    lower: Callable[[Limits], float | None] = lambda limits: None
    symmetric: bool = False
    categories: tuple[str, ...] = ()
    least: float = 0.0


@dataclass(frozen=True)
class Tripped:
    """Trip of a run: value and limit in SI units; a value that is not a number is NaN."""

    check: Check
    value: float
    limit: float


LATENESS = Panel(
    "lateness of the control cycle, beyond a period",
    "ms",
    1e3,
    {"late": "lateness"},
    (Check.LATENESS,),
    lambda limits: limits.lateness,
)
PANELS: tuple[Panel, ...] = (
    Panel(
        "joint angle",
        "deg",
        DEG,
        {"angle": "joint encoder", "command": "command", "motor": "drive's encoder / gear ratio"},
        (Check.ANGLE,),
        lambda limits: limits.angle_max,
        lambda limits: limits.angle_min,
    ),
    Panel("tracking error, command less joint encoder", "deg", DEG, {"error": "error"}),
    Panel(
        "following error, as the drive computes it",
        "deg",
        DEG,
        {"following_error": "following error"},
        (Check.FOLLOWING_ERROR,),
        lambda limits: limits.following_error,
        symmetric=True,
    ),
    Panel(
        "drive's encoder less joint encoder",
        "deg",
        DEG,
        {"disagreement": "difference"},
        (Check.DISAGREEMENT,),
        lambda limits: limits.encoder_disagreement,
        symmetric=True,
    ),
    Panel(
        "joint speed",
        "deg/s",
        DEG,
        {"velocity": "speed"},
        (Check.SPEED, Check.RUNAWAY),
        lambda limits: limits.speed,
        symmetric=True,
    ),
    Panel(
        "motor current",
        "A",
        1.0,
        {"current": "current"},
        (Check.CURRENT,),
        lambda limits: limits.current,
        symmetric=True,
    ),
    Panel(
        "joint torque Km i I",
        "N m",
        1.0,
        {"torque": "torque"},
        (Check.TORQUE,),
        lambda limits: limits.torque,
        symmetric=True,
    ),
    Panel("motor voltage", "V", 1.0, {"voltage": "voltage"}),
    Panel(
        "supply voltage (DC link)",
        "V",
        1.0,
        {"supply_voltage": "supply"},
        (Check.SUPPLY,),
        lambda limits: limits.supply_max,
        lambda limits: limits.supply_min or None,
    ),
    Panel(
        "motor temperature",
        "deg C",
        1.0,
        {"temperature": "temperature"},
        (Check.TEMPERATURE,),
        lambda limits: limits.temperature,
    ),
    Panel(
        "chamber pressure",
        "MPa",
        1e-6,
        {"pressure": "pressure"},
        (Check.PRESSURE,),
        lambda limits: None if limits.gas is None else limits.gas.pressure,
    ),
    Panel(
        "contact force that follows from the pressure",
        "N",
        1.0,
        {"force": "force"},
        (Check.CONTACT_FORCE,),
        lambda limits: None if limits.gas is None else limits.gas.contact_force,
    ),
    Panel(
        "state of the drive", "", 1.0, {"state": "state"}, (Check.DRIVE_STATE,), categories=STATES
    ),
    Panel(
        "age of the last whole answer",
        "ms",
        1e3,
        {"age": "age", "answer": "answer collected after the cycle's start"},
        (Check.SAMPLE_AGE, Check.PAUSE),
        lambda limits: limits.sample_age,
    ),
    LATENESS,
    Panel(
        "clocks of the devices less the host's",
        "ms",
        1e3,
        {"drive_clock": "drive", "encoder_clock": "encoder"},
        least=1e-3,
    ),
)


RESULT = ("error", "current", "temperature")
"""First channels of the panels that show the course of a run, in order."""


def result_panels(check: Check | None) -> list[Panel]:
    """Return the panels at the top of a page: the panel of the trip, tracking error, current and
    temperature.
    """
    by_channel = {next(iter(panel.channels)): panel for panel in PANELS}
    usual = [by_channel[name] for name in RESULT]
    return [p for p in PANELS if check in p.checks] + [p for p in usual if check not in p.checks]


def tripped_first(check: Check | None) -> list[Panel]:
    """Return the panels in an order in which the panel of the trip comes first."""
    return sorted(PANELS, key=lambda panel: check not in panel.checks)


def chart(
    panel: Panel, bins: Bins, steps: Sequence[Step], tripped: Tripped | None, tall: bool
) -> Chart | None:
    """Return one chart of a time interval. The result is None if no channel of the panel was
    recorded.

    Args:
        panel: The panel.
        bins: Samples of the interval.
        steps: Limits over time; empty if unknown.
        tripped: The trip, if this panel shows it; the limit of the trip is drawn if ``steps`` is
            empty.
        tall: Whether it is the most important chart, drawn taller.
    """
    curves = [
        Curve(name, _channel(bins, column, panel.scale)) for column, name in panel.channels.items()
    ]
    curves = [curve for curve in curves if np.isfinite(curve.bins.high).any()]
    if not curves:
        return None
    first = curves[0].bins
    low, high = float(np.nanmin(first.low)), float(np.nanmax(first.high))
    bounds = _bounds(panel, steps) or _bounds_of_trip(panel, tripped)
    beyond = any(_broken(bound, first) for bound in bounds)
    size = max(float(np.nanmax(np.abs([c.bins.low, c.bins.high]))) for c in curves)
    always = beyond or tall or size == 0.0
    reading = "" if panel.categories else _reading(low, high, bounds, panel)
    if tripped is not None and not panel.categories:
        # The value is not always among the samples, e.g. lateness on a simulated bench in real
        # time.
        reading = f"tripped at {panel.scale * tripped.value:.4g} {panel.unit}; {reading}"
    shown = [b for b in bounds if always or min(abs(value) for _, value in b.steps) <= _SEEN * size]
    return Chart(
        panel.title,
        panel.unit,
        curves,
        shown,
        reading + (" (outside this chart)" if len(shown) < len(bounds) else ""),
        beyond,
        panel.categories,
        tall,
        panel.least,
    )


def _channel(bins: Bins, name: str, scale: float) -> Bins:
    column = NAMES.index(name)
    return bins._replace(
        low=scale * bins.low[:, column, None], high=scale * bins.high[:, column, None]
    )


def _bounds(panel: Panel, steps: Sequence[Step]) -> list[Bound]:
    upper = [(time, value) for time, limits in steps if (value := panel.upper(limits)) is not None]
    lower = [(time, value) for time, limits in steps if (value := panel.lower(limits)) is not None]
    if panel.symmetric:
        lower = [(time, -value) for time, value in upper]
    return [_bound(panel, found, found is upper) for found in (upper, lower) if found]


def _bounds_of_trip(panel: Panel, tripped: Tripped | None) -> list[Bound]:
    if tripped is None or panel.categories:
        return []
    above = not tripped.value < tripped.limit
    bounds = [_bound(panel, [(-math.inf, tripped.limit)], above)]
    return (
        [*bounds, _bound(panel, [(-math.inf, -tripped.limit)], False)]
        if panel.symmetric
        else bounds
    )


def _bound(panel: Panel, steps: Sequence[tuple[float, float]], upper: bool) -> Bound:
    scaled = [(time, panel.scale * value) for time, value in steps]
    changes = [step for k, step in enumerate(scaled) if k == 0 or step[1] != scaled[k - 1][1]]
    return Bound(changes, upper)


def _broken(bound: Bound, bins: Bins) -> bool:
    """Return whether a bin is beyond a limit."""
    times = np.array([time for time, _ in bound.steps])
    values = np.array([value for _, value in bound.steps])[
        np.searchsorted(times, bins.start, side="right") - 1
    ]
    return bool(
        np.any(bins.high[:, 0] > values) if bound.upper else np.any(bins.low[:, 0] < values)
    )


def _reading(low: float, high: float, bounds: Sequence[Bound], panel: Panel) -> str:
    unit, least = panel.unit, max(1e-6 * max(abs(low), abs(high)), 1e-3 * panel.least)
    words = (
        " to ".join(f"{value if abs(value) > least else 0.0:.4g}" for value in (low, high))
        + f" {unit}"
    )
    if not bounds:
        return f"{words}; {'limit not known' if panel.checks else 'no limit'}"
    limits = " and ".join(
        f"{value:.4g}" for value in sorted({bound.steps[-1][1] for bound in bounds})
    )
    return f"{words}; limit {limits} {unit}"
