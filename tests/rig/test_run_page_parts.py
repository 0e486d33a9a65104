"""What the page of a run is put together from: bins that lose no extreme, phases, and charts that
can be read.
"""

from __future__ import annotations

import dataclasses
import math
import re
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.recording import Array, Bench
from rig.common.sample import Sample
from rig.control.safety import Check
from rig.results.run.page.channels import ENABLED, NAMES, STATES, Deriver
from rig.results.run.page.chart import (
    Bins,
    Bound,
    Chart,
    Curve,
    Envelope,
    Flags,
    Mark,
    Shade,
    TimeAxis,
    draw,
    in_columns,
    of_samples,
)
from rig.results.run.page.panels import PANELS, Panel, Tripped, chart
from rig.results.run.page.phases import BRAKING, MOVING, Moment, Span, spans, with_braking
from rig.runs.run_record import SegmentRecord


def samples(values: Array, broken: Flags | None = None) -> Bins:
    time = np.arange(len(values)) * 1e-3
    return of_samples(
        time, values[:, None], np.zeros(len(values), dtype=bool) if broken is None else broken
    )


@given(
    values=st.lists(st.floats(-1e6, 1e6) | st.just(math.nan), min_size=1, max_size=300),
    sizes=st.lists(st.integers(1, 40), min_size=1, max_size=40),
    gaps=st.sets(st.integers(0, 299), max_size=12),
    most=st.integers(4, 32),
)
def test_no_extreme_is_lost_and_no_bin_lies_across_a_gap(
    values: list[float], sizes: list[int], gaps: set[int], most: int
) -> None:
    given_values = np.array(values)
    broken = np.isin(np.arange(len(values)), list(gaps)) | (np.arange(len(values)) == 0)
    whole, envelope, at = samples(given_values, broken), Envelope(most), 0
    for size in sizes * (1 + len(values) // sum(sizes)):
        if at < len(values):
            envelope.add(Bins(*(field[at : at + size] for field in whole)))
            at += size
    bins = envelope.bins()
    assert bins is not None
    assert len(bins.start) <= max(2 * most, 4 * int(broken.sum()) + 2)
    edges = [round(1e3 * t) for t in bins.start], [round(1e3 * t) + 1 for t in bins.stop]
    assert edges[0] == [0, *edges[1][:-1]]
    assert edges[1][-1] == len(values)
    for k, (first, stop) in enumerate(zip(*edges, strict=True)):
        inside = given_values[first:stop]
        finite = inside[np.isfinite(inside)]
        expected = (finite.min(), finite.max()) if len(finite) else (math.nan, math.nan)
        np.testing.assert_equal((bins.low[k, 0], bins.high[k, 0]), expected)
        assert bool(bins.broken[k]) is bool(broken[first])
        assert not broken[first + 1 : stop].any()


def test_bins_of_a_long_recording_are_about_equally_wide() -> None:
    envelope, blocks = Envelope(64), 400
    for k in range(blocks):
        block = samples(np.zeros(100))
        envelope.add(block._replace(start=block.start + 0.1 * k, stop=block.stop + 0.1 * k))
    bins = envelope.bins()
    assert bins is not None
    widths = bins.stop - bins.start
    assert 16 <= len(widths) <= 128
    assert widths.max() <= 1.1 * np.median(widths)


def test_columns_hold_the_least_and_the_greatest() -> None:
    bins = in_columns(samples(np.array([1.0, 5.0, -2.0, 4.0])), np.array([0.0, 0.2, 0.5, 0.9]), 2)
    assert bins.low[:, 0].tolist() == [1.0, -2.0]
    assert bins.high[:, 0].tolist() == [5.0, 4.0]


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


def current(*values: float) -> Bins:
    matrix = np.full((len(values), len(NAMES)), math.nan)
    matrix[:, NAMES.index("current")] = values
    return of_samples(np.arange(len(values)) * 1e-3, matrix, np.zeros(len(values), dtype=bool))


def panel_of(check: Check) -> Panel:
    return next(panel for panel in PANELS if check in panel.checks)


def with_limit(limit: float) -> Panel:
    return dataclasses.replace(panel_of(Check.CURRENT), upper=lambda limits: limit)


@pytest.mark.parametrize(("limit", "shown"), [(9.9, True), (10.0, True), (10.1, False)])
def test_a_limit_far_away_is_written_and_not_drawn(limit: float, shown: bool) -> None:
    made = chart(with_limit(limit), current(0.0, 1.0), [(-math.inf, None)], None, tall=False)  # type: ignore[list-item]
    assert made is not None
    assert bool(made.bounds) is shown
    assert f"limit -{limit:g} and {limit:g} A" in made.reading
    assert ("outside this chart" in made.reading) is not shown


@pytest.mark.parametrize(
    ("value", "beyond"), [(5.0, False), (5.001, True), (-5.0, False), (-5.001, True)]
)
def test_what_is_beyond_a_limit_is_said(value: float, beyond: bool) -> None:
    made = chart(with_limit(5.0), current(0.0, value), [(-math.inf, None)], None, tall=False)  # type: ignore[list-item]
    assert made is not None
    assert made.beyond is beyond
    assert ("BEYOND THE LIMIT" in draw(made, TimeAxis([(0.0, 1e-3)]))) is beyond


def test_the_limit_of_a_trip_is_drawn_where_no_other_is_known() -> None:
    tripped = Tripped(Check.CURRENT, 12.0, 11.0)
    made = chart(panel_of(Check.CURRENT), current(0.0, -12.0), [], tripped, tall=True)
    assert made is not None
    assert sorted(bound.steps[0][1] for bound in made.bounds) == [-11.0, 11.0]
    assert made.beyond


def test_a_channel_that_was_not_recorded_has_no_chart() -> None:
    assert chart(panel_of(Check.PRESSURE), current(1.0), [], None, tall=False) is None


def drawn(values: Array, **more: Any) -> str:
    curve = Curve("x", samples(values))
    return draw(
        Chart("title", "A", [curve], **more), TimeAxis([(0.0, 1e-3 * max(len(values) - 1, 1))])
    )


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True, width=32), min_size=1, max_size=50))
def test_any_values_can_be_drawn(values: list[float]) -> None:
    html = drawn(np.array(values))
    assert html.count("<figure") == html.count("</figure>") == 1
    assert "nan" not in html
    assert "inf" not in html


def test_text_from_files_is_escaped() -> None:
    html = draw(
        Chart("<t>", "<u>", [Curve("<c>", samples(np.array([0.0, 1.0])))], reading="<r>"),
        TimeAxis([(0.0, 1.0)]),
        [Shade(0.0, 1.0, "<s>", 0)],
        Mark(0.5, "<m>"),
    )
    for name in "tucrsm":
        assert f"<{name}>" not in html.replace("<svg", "")
        assert f"&lt;{name}&gt;" in html


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


def test_a_limit_that_changes_is_drawn_in_steps() -> None:
    bound = Bound([(-math.inf, 5.0), (0.5, 3.0)])
    html = draw(
        Chart("t", "A", [Curve("x", samples(np.array([0.0, 1.0])))], [bound]),
        TimeAxis([(0.0, 1.0)]),
    )
    paths = re.findall(r'<path d="(M[^"]*)" stroke="#a30000"', html)
    assert len(re.findall(r"M[\d.]+ [\d.]+H[\d.]+", paths[0])) == 2
    assert "limit 5 A" in html
    assert "limit 3 A" in html
