"""What the page of a run is put together from: channels, phases, limits, and charts that lose no
extreme.
"""

from __future__ import annotations

import dataclasses
import json
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.recording import Array, Bench
from rig.common.sample import Sample
from rig.control.safety import Check
from rig.results.run.charts import PANELS, Frame, Panel, Plots, Shade, TimeAxis, chart
from rig.results.run.recorded import (
    BRAKING,
    COLUMNS,
    ENABLED,
    MOVING,
    NAMES,
    STATES,
    Derived,
    Deriver,
    Moment,
    Series,
    Span,
    Traces,
    Tripped,
    _gathered,
    spans,
    with_braking,
)
from rig.runs.mcap.reader import Block, Happening
from rig.runs.run_record import SegmentRecord


def taken(count: int, **fields: Any) -> dict[str, Array]:
    time = np.arange(count) * 1e-3
    found = {name: np.zeros(count) for name in Sample._fields}
    found |= {
        "time": time,
        "host_time": time + 4e-4,
        "device_time": time + 5.0,
        "encoder_time": 1.001 * time,
    }
    found |= {
        "fresh": np.ones(count),
        "statusword": np.full(count, 0x237),
        "pressure": np.full(count, math.nan),
    }
    return found | fields


BENCH = Bench(torque_constant=0.03, gear_ratio=100.0)


def column(values: Array, name: str) -> Array:
    return values[:, NAMES.index(name)]


def test_derived_channels_are_those_of_the_safety_check() -> None:
    derive = Deriver(BENCH, 1e-3)
    values = derive(
        taken(3, motor_angle=np.full(3, 10.0), angle=np.full(3, 0.09), current=np.full(3, -2.0)), []
    ).values
    np.testing.assert_allclose(column(values, "disagreement"), 0.01)
    np.testing.assert_allclose(column(values, "torque"), -6.0)
    np.testing.assert_allclose(column(values, "error"), -0.09)
    np.testing.assert_allclose(column(values, "answer"), 4e-4)
    np.testing.assert_allclose(column(values, "drive_clock"), 0.0, atol=1e-12)
    np.testing.assert_allclose(column(values, "encoder_clock"), [0.0, 1e-6, 2e-6], atol=1e-12)
    assert np.isnan(column(values, "pressure")).all()
    assert np.isnan(column(values, "force")).all()


@pytest.mark.parametrize("split", range(1, 9))
def test_ages_go_on_from_block_to_block(split: int) -> None:
    fresh = np.array([1, 1, 0, 0, 1, 0, 0, 0, 1, 1.0])
    whole, derive = taken(10, fresh=fresh), Deriver(BENCH, 1e-3)
    parts = [{k: v[:split] for k, v in whole.items()}, {k: v[split:] for k, v in whole.items()}]
    ages = np.concatenate([column(derive(part, []).values, "age") for part in parts])
    np.testing.assert_allclose(1e3 * ages, [0, 0, 1, 2, 0, 1, 2, 3, 0, 0], atol=1e-9)


def test_a_step_of_time_is_lateness_but_for_a_pause() -> None:
    time = np.array([0.0, 1.0, 31.0, 32.0, 60.0, 61.0]) * 1e-3
    derived = Deriver(BENCH, 1e-3)(taken(6, time=time), [{"event": "stage start", "time": 0.050}])
    np.testing.assert_allclose(1e3 * column(derived.values, "late"), [0, 0, 29, 0, 0, 0], atol=1e-9)
    assert derived.broken.tolist() == [True, False, True, False, True, False]


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x237, "enabled"),
        (0x217, "quick stop"),
        (0x218, "fault"),
        (0x21F, "fault"),
        (0x250, "off"),
        (0x231, "off"),
    ],
)
def test_the_state_of_the_drive(statusword: int, state: str) -> None:
    values = Deriver(BENCH, 1e-3)(taken(1, statusword=np.full(1, statusword)), []).values
    assert STATES[int(column(values, "state")[0])] == state
    assert (column(values, "state")[0] == ENABLED) is np.bool_(state == "enabled")


EVENTS: list[dict[str, Any]] = [
    {"event": "prompt", "time": 0.0, "stage": "a"},
    {"event": "stage start", "time": 1.0, "stage": "a"},
    {"event": "segment", "time": 2.0, "stage": "a", "number": 1},
    {"event": "segment", "time": 5.0, "stage": "a", "number": 2},
    {"event": "stage end", "time": 7.0, "stage": "a"},
    {"event": "prompt", "time": 7.0, "stage": "b"},
    {"event": "stage start", "time": 20.0, "stage": "b"},
    {"event": "first pass", "time": 20.5, "stage": "b"},
    {"event": "weight check", "time": 21.0, "stage": "b"},
    {"event": "segment", "time": 22.0, "stage": "b", "number": 3},
    {"event": "tripped", "time": 24.0, "phase": "excite"},
]
SEGMENTS = [
    SegmentRecord(1, "a[1]", "unloaded", 0.0, 2.0, 2000, 4.0),
    SegmentRecord(2, "a[2]", "unloaded", 0.0, 5.0, 1900, 6.9),
    SegmentRecord(3, "b", "loaded", 10.0, 22.0, 9000),
]


def test_phases_follow_from_events_and_excitations() -> None:
    found = spans(EVENTS, SEGMENTS, 23.9)
    assert [(s.stage, s.phase, round(s.start, 6), round(s.stop, 6)) for s in found] == [
        ("a", MOVING, 1.0, 2.0),
        ("a[1]", "excite", 2.0, 4.0),
        ("a[1]", "hold", 4.0, 4.1),
        ("a[1]", MOVING, 4.1, 5.0),
        ("a[2]", "excite", 5.0, 6.9),
        ("a[2]", "hold", 6.9, 7.0),
        ("b", MOVING, 20.0, 20.5),
        ("b", "first pass", 20.5, 21.0),
        ("b", MOVING, 21.0, 22.0),
        ("b", "excite", 22.0, 23.9),
    ]


def test_what_comes_after_the_end_is_braking() -> None:
    cut = with_braking(
        [Span(0.0, 1.0, "a", "excite"), Span(1.0, 2.0, "a", "hold")], Moment(1.5, "tripped")
    )
    assert [(s.start, s.stop, s.phase) for s in cut] == [
        (0.0, 1.0, "excite"),
        (1.0, 1.5, "hold"),
        (1.5, 2.0, BRAKING),
    ]


@given(
    count=st.integers(2, 9000),
    pause=st.sampled_from([0, 100_000]),
    seed=st.integers(0, 9),
)
def test_a_recording_is_reduced_without_the_loss_of_an_extreme(
    count: int, pause: int, seed: int
) -> None:
    cycles, half = np.arange(count), count // 2
    cycles[half:] += pause
    current = np.random.default_rng(seed).normal(size=count)
    whole = taken(count, time=cycles * 1e-3, current=current)
    first, second = (
        Block({name: values[part] for name, values in whole.items()})
        for part in (slice(half), slice(half, None))
    )
    start = Happening({"event": "stage start", "time": float(whole["time"][half])})
    traces = _gathered([first, start, second], BENCH, 1e-3)
    assert traces.reduced is not None
    assert traces.reduced.extremes("current") == (current.min(), current.max())
    assert len(traces.reduced.time) <= 2 * COLUMNS + 3
    assert (np.diff(traces.reduced.time) >= 0.0).all()
    ends = whole["time"][[0, half - 1, half, -1]].tolist()
    assert traces.powered == [tuple(ends[:2]), tuple(ends[2:])]
    # No line is drawn across a pause.
    row = traces.reduced.low[NAMES.index("current")]
    assert np.isnan(row).sum() == (1 if pause else 0)


def test_the_last_samples_have_gaps_and_keep_every_extreme() -> None:
    values = np.zeros((6000, len(NAMES)))
    values[1234, 0], values[4321, 0] = 7.0, -7.0
    broken = np.arange(6000) == 3000
    tail = Derived(np.arange(6000) * 1e-3, values, broken, np.zeros(6000))
    few, many = (Traces(tail=tail).samples(first, 6.0) for first in (4.3, 0.0))
    assert few.extremes(NAMES[0]) == (-7.0, 0.0)
    assert len(few.time) == 1700
    assert many.extremes(NAMES[0]) == (-7.0, 7.0)
    assert len(many.time) <= 2 * 2000
    assert np.isnan(many.low).any(axis=0).sum() == 1
    assert not np.isnan(few.low).any()


def current(*values: float) -> Series:
    matrix = np.full((len(NAMES), len(values)), math.nan)
    matrix[NAMES.index("current")] = values
    return Series(np.arange(len(values)) * 1e-3, matrix, matrix)


def panel_of(check: Check) -> Panel:
    return next(panel for panel in PANELS if check in panel.checks)


def with_limit(limit: float) -> Panel:
    return dataclasses.replace(panel_of(Check.CURRENT), upper=lambda limits: limit)


@pytest.mark.parametrize(("limit", "shown"), [(9.9, True), (10.0, True), (10.1, False)])
def test_a_limit_far_away_is_written_and_not_drawn(limit: float, shown: bool) -> None:
    made = chart(with_limit(limit), current(0.0, 1.0), [(-math.inf, None)], None, tall=False)  # type: ignore[list-item]
    assert made is not None
    assert bool(made.limits) is shown
    assert f"limit -{limit:g} and {limit:g} A" in made.reading
    assert ("outside this chart" in made.reading) is not shown


@pytest.mark.parametrize(
    ("value", "beyond"), [(5.0, False), (5.001, True), (-5.0, False), (-5.001, True)]
)
def test_what_is_beyond_a_limit_is_said(value: float, beyond: bool) -> None:
    made = chart(with_limit(5.0), current(0.0, value), [(-math.inf, None)], None, tall=False)  # type: ignore[list-item]
    assert made is not None
    assert made.beyond is beyond
    html = Plots().figure(made, Frame(TimeAxis([(0.0, 1e-3)]), ""))
    assert ("BEYOND THE LIMIT" in html) is beyond


def test_the_limit_of_a_trip_is_drawn_where_no_other_is_known() -> None:
    tripped = Tripped(Check.CURRENT, 12.0, 11.0)
    made = chart(panel_of(Check.CURRENT), current(0.0, -12.0), [], tripped, tall=True)
    assert made is not None
    assert sorted(limit[0][1] for limit in made.limits) == [-11.0, 11.0]
    assert made.beyond


def test_a_channel_that_was_not_recorded_has_no_chart() -> None:
    assert chart(panel_of(Check.PRESSURE), current(1.0), [], None, tall=False) is None


def test_long_pauses_are_drawn_short_and_short_ones_to_scale() -> None:
    axis = TimeAxis([(0.0, 10.0), (300.0, 310.0), (310.1, 320.0)])
    assert axis.pauses == [(10.0, 300.0)]
    assert axis.at(0.0) == 0.0
    assert axis.at(320.0) == pytest.approx(1.0)
    assert axis.at(300.0) - axis.at(10.0) == pytest.approx(0.02)
    assert axis.at(310.0) - axis.at(300.0) == pytest.approx(axis.at(10.0) - axis.at(0.0))


@given(
    first=st.floats(0.0, 1e5),
    lengths=st.lists(st.floats(1e-3, 1e4), min_size=1, max_size=6),
    pause=st.floats(0.0, 1e4),
)
def test_labels_of_the_time_axis_leave_room_for_one_another(
    first: float, lengths: list[float], pause: float
) -> None:
    powered, at = [], first
    for length in lengths:
        powered.append((at, at + length))
        at += length + pause
    ticks = list(TimeAxis(powered).ticks())
    assert len(ticks) <= 9
    places = [place for place, _ in ticks]
    assert all(0.0 <= place <= 1.0 + 1e-9 for place in places)
    assert all(after - before >= 0.12 for before, after in pairwise(places))


def data_of(plots: Plots) -> Any:
    """Return the data of the charts as a browser reads them."""
    return json.loads(plots.script().partition(">")[2].removesuffix("</script>"))


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), min_size=1, max_size=50))
def test_any_values_can_be_drawn(values: list[float]) -> None:
    plots = Plots()
    made = chart(panel_of(Check.CURRENT), current(*values), [], None, tall=False)
    if made is not None:
        plots.figure(made, Frame(TimeAxis([(0.0, 1.0)]), ""))
    assert "NaN" not in plots.script()
    assert "Infinity" not in plots.script()
    for each in data_of(plots)["charts"]:
        assert each["range"][0] < each["range"][1]


def test_text_from_files_is_escaped() -> None:
    plots = Plots()
    panel = Panel("<t>", "<u>", 1.0, {"current": "<c>"})
    made = chart(panel, current(0.0, 1.0), [], None, tall=False)
    assert made is not None
    made = dataclasses.replace(made, reading="<r>")
    shades = [Shade(0.0, 1.0, "</script><s>", 0)]
    html = plots.figure(made, Frame(TimeAxis([(0.0, 1.0)]), "<k>", shades, (0.5, "<m>")))
    for name in "tucr":
        assert f"<{name}>" not in html
        assert f"&lt;{name}&gt;" in html
    assert "<" not in plots.script().removesuffix("</script>").partition(">")[2]
    assert data_of(plots)["charts"][0]["frame"]["shades"][0][2] == "</script><s>"


def test_a_limit_that_changes_is_drawn_in_steps_and_judged_by_the_wider() -> None:
    plots = Plots()
    steps: Any = [(-math.inf, 5.0), (0.5e-3, 3.0)]
    panel = dataclasses.replace(panel_of(Check.CURRENT), upper=lambda value: value)
    series = current(4.0, 2.0)
    made = chart(panel, series, steps, None, tall=False)
    assert made is not None
    assert not made.beyond
    plots.figure(made, Frame(TimeAxis([(0.0, 1e-3)]), ""))
    upper, lower = data_of(plots)["charts"][0]["limits"]
    assert upper == [[0.0, 0.5, 5.0], [0.5, 1.0, 3.0]]
    assert lower == [[0.0, 0.5, -5.0], [0.5, 1.0, -3.0]]
    late = current(4.0, 4.0)
    assert chart(panel, late, steps, None, tall=False).beyond  # type: ignore[union-attr]
    wide = late._replace(width_s=1.5e-3)
    assert not chart(panel, wide, steps, None, tall=False).beyond  # type: ignore[union-attr]


def test_a_series_is_stored_once_with_the_channels_that_are_drawn() -> None:
    plots, series = Plots(), current(0.0, 123456.789)
    for _ in range(2):
        made = chart(panel_of(Check.CURRENT), series, [], None, tall=False)
        assert made is not None
        plots.figure(made, Frame(TimeAxis([(0.0, 1e-3)]), ""))
    data = data_of(plots)
    assert [each["series"] for each in data["charts"]] == [0, 0]
    assert data["series"] == [
        {"time": [0.0, 1.0], "low": {"current": [0.0, 123460.0]}, "high": None}
    ]
