"""Areas of the swinging gate, and what presses on it."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.filter.segments import motion
from identification.model.gas_generator import (
    PAPER,
    GasGenerator,
    ValveGeometry,
    impacted_area,
    throat_area,
)
from identification.prepare import contact_force, contact_moment, prepare
from identification.recording import Array, Bench, Recording, RecordingError

NODES, WEIGHTS = np.polynomial.legendre.leggauss(400)


def integrated(angle: float, g: ValveGeometry) -> float:
    """A_s as the length of the covered pieces of vertical lines, summed by Gauss's rule between all
    corners.
    """
    centre = np.array([g.L1 * math.sin(angle), g.L1 * math.cos(angle)])
    apart = math.hypot(centre[0], centre[1] - g.L1)
    edges = {
        max(-g.b / 2, centre[0] - g.D / 2),
        min(g.b / 2, centre[0] + g.D / 2),
        -g.d / 2,
        g.d / 2,
    }
    if abs(g.D / 2 - g.d / 2) < apart < g.D / 2 + g.d / 2:
        along = (apart**2 + (g.d / 2) ** 2 - (g.D / 2) ** 2) / (2 * apart)
        across = math.sqrt((g.d / 2) ** 2 - along**2)
        unit = (centre - [0.0, g.L1]) / apart
        edges |= {along * unit[0] + side * across * unit[1] for side in (1.0, -1.0)}
    low, high = max(-g.b / 2, centre[0] - g.D / 2), min(g.b / 2, centre[0] + g.D / 2)
    if high <= low:
        return 0.0
    grid = sorted(x for x in edges if low <= x <= high)
    total = 0.0
    for left, right in pairwise(grid):
        # x = mean - half cos(u) takes the square roots off both ends.
        u = 0.5 * math.pi * (NODES + 1.0)
        x = 0.5 * (left + right) - 0.5 * (right - left) * np.cos(u)
        dx = 0.25 * math.pi * (right - left) * np.sin(u) * WEIGHTS
        reach = np.sqrt(np.maximum((g.D / 2) ** 2 - (x - centre[0]) ** 2, 0.0))
        hole = np.sqrt(np.maximum((g.d / 2) ** 2 - x**2, 0.0))
        shared = np.minimum(centre[1] + reach, g.L1 + hole) - np.maximum(
            centre[1] - reach, g.L1 - hole
        )
        total += float(
            np.sum(dx * (2.0 * reach - np.where(hole > 0.0, np.maximum(shared, 0.0), 0.0)))
        )
    return total


def test_the_papers_figures() -> None:
    assert impacted_area(np.array(0.0)) == pytest.approx(7.66e-4, abs=5e-7)
    assert throat_area(np.array(0.0)) == pytest.approx(math.pi * 0.025**2 / 4, rel=1e-12)
    assert math.degrees(PAPER.clearing_angle) == pytest.approx(29.65, abs=0.005)
    assert impacted_area(np.array(PAPER.clearing_angle)) == pytest.approx(0.0, abs=1e-15)
    assert impacted_area(np.array(PAPER.clearing_angle - 0.01)) > 1e-6


@given(
    d=st.floats(0.005, 0.05),
    D=st.floats(0.005, 0.05),
    slack=st.floats(0.0, 0.02),
    angle=st.floats(-0.6, 0.6),
)
def test_any_valve(d: float, D: float, slack: float, angle: float) -> None:
    g = ValveGeometry(d, D, d + slack, 0.095)
    both = np.array([angle, -angle])
    area = throat_area(both, g)
    assert area[0] == area[1]
    assert -1e-15 < area[0] < g.opening_area + 1e-15
    assert throat_area(both, g) + impacted_area(both, g) == pytest.approx(g.opening_area, rel=1e-12)
    assert float(impacted_area(both, g)[0]) == pytest.approx(integrated(abs(angle), g), abs=2e-9)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"D": 0.0}, "D = 0 m"),
        ({"L1": math.nan}, "L1 = nan"),
        ({"d": 0.06}, "wider than its plate"),
    ],
)
def test_a_valve_that_cannot_be_built(wrong: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ValveGeometry(**wrong)


BENCH = Bench(
    torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095, gas_generator=GasGenerator()
)
TIME = np.arange(2000) * 1e-3
ANGLE = np.deg2rad(10.0 * np.sin(np.pi * TIME))


def recording(weight: float = 0.0, bench: Bench = BENCH, **channels: Array) -> Recording:
    given = {"time": TIME, "angle": ANGLE, "current": np.zeros(len(TIME)), **channels}
    return Recording(name="one", channels=given, bench=bench, stage="loaded", weight_mass=weight)


def test_a_hot_firing_presses_with_its_pressure_on_the_impacted_area() -> None:
    pressure = np.linspace(4e6, 5e6, len(TIME))
    hot = recording(pressure=pressure)
    assert hot.hot_fire
    force = contact_force(hot, TIME, np.zeros(len(TIME)))
    np.testing.assert_allclose(force, (pressure - 0.5e6) * 7.657632e-4, rtol=1e-6)
    np.testing.assert_allclose(contact_moment(hot, TIME, np.zeros(len(TIME))), 0.095 * force)
    covered = contact_force(hot, TIME, np.full(len(TIME), np.deg2rad(29.7)))
    np.testing.assert_allclose(covered, 0.0, atol=1e-8)
    assert np.all(prepare(hot).moment > 0.0)


def test_a_weight_or_a_measured_force_goes_before_the_pressure() -> None:
    pressure = np.full(len(TIME), 4e6)
    weighed = recording(weight=30.0, pressure=pressure)
    assert not weighed.hot_fire
    np.testing.assert_allclose(contact_force(weighed, TIME, ANGLE), 30.0 * 98.0665)
    measured = recording(pressure=pressure, load_force=np.full(len(TIME), 123.0))
    np.testing.assert_allclose(contact_force(measured, TIME, ANGLE), 123.0)


def test_a_hot_firing_needs_the_valve() -> None:
    hot = recording(bench=replace(BENCH, gas_generator=None), pressure=np.full(len(TIME), 4e6))
    with pytest.raises(RecordingError, match=r"valve and p_c0 of bench\.gas_generator"):
        contact_force(hot, TIME, ANGLE)


def test_a_load_needs_its_arm() -> None:
    with pytest.raises(RecordingError, match="moment_arm"):
        contact_moment(recording(weight=30.0, bench=replace(BENCH, moment_arm=None)), TIME, ANGLE)


def test_the_filter_takes_the_mean_load_of_each_period() -> None:
    """The torque of a sample is the mean over the period that ends there."""
    up = np.deg2rad(8.0 * (1.0 - np.cos(2.0 * np.pi * np.arange(500) * 1e-3)))
    angle = np.concatenate(
        (np.full(300, up[0]), up, np.full(300, up[-1]), up[::-1], np.full(300, up[0]))
    )
    angle = np.round(angle / 1e-5) * 1e-5
    time = np.arange(len(angle)) * 1e-3
    pressure = 4e6 - 1e6 * time
    channels = {"time": time, "angle": angle, "current": np.sin(time), "pressure": pressure}
    found = motion(
        Recording(
            name="hot",
            channels=channels,
            bench=BENCH,
            stage="loaded",
            averaged=frozenset({"current"}),
        )
    )
    at_samples = contact_moment(found.recording, time, angle)
    np.testing.assert_allclose(found.moment[1:], 0.5 * (at_samples[1:] + at_samples[:-1]))
    np.testing.assert_allclose(found.breakaway_moment, found.moment[found.seen.astype(int)])
