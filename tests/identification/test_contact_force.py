"""What presses on the valve: a weight, a measured force, or the gas of a hot firing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.filter.segments import motion
from identification.model.gas_generator import GasGenerator
from identification.prepare import contact_force, contact_moment, prepare
from identification.recording import Array, Bench, Recording, RecordingError

BENCH = Bench(
    torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095, gas_generator=GasGenerator()
)
TIME = np.arange(2000) * 1e-3
ANGLE = np.deg2rad(10.0 * np.sin(np.pi * TIME))


def recording(weight: float = 0.0, bench: Bench = BENCH, **channels: Array) -> Recording:
    given = {"time": TIME, "angle": ANGLE, "current": np.zeros(len(TIME)), **channels}
    return Recording("one", given, bench, stage="loaded", weight_mass=weight)


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


def test_gas_that_would_lift_the_valve_does_not_press() -> None:
    hot = recording(pressure=np.full(len(TIME), 0.4e6))
    np.testing.assert_array_equal(contact_force(hot, TIME, ANGLE), 0.0)


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
    """The torque of a sample is the mean over the period that ends there; so is the load that it
    moves against.
    """
    up = np.deg2rad(8.0 * (1.0 - np.cos(2.0 * np.pi * np.arange(500) * 1e-3)))
    angle = np.concatenate(
        (np.full(300, up[0]), up, np.full(300, up[-1]), up[::-1], np.full(300, up[0]))
    )
    angle = np.round(angle / 1e-5) * 1e-5
    time = np.arange(len(angle)) * 1e-3
    pressure = 4e6 - 1e6 * time
    channels = {"time": time, "angle": angle, "current": np.sin(time), "pressure": pressure}
    found = motion(
        Recording("hot", channels, BENCH, stage="loaded", averaged=frozenset({"current"}))
    )
    assert found is not None
    at_samples = contact_moment(found.recording, time, angle)
    np.testing.assert_allclose(found.moment[1:], 0.5 * (at_samples[1:] + at_samples[:-1]))
    np.testing.assert_allclose(found.breakaway_moment, found.moment[found.seen.astype(int)])
