"""Hidden properties of motor, power stage and sensors, each against a closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

from .track import PER_AMPERE, Effects, Track, cruise, sine, steady_torque

BACK_EMF = 2.588


def means(
    effects: Effects, speed: float = 0.2, weight_kg: float = 20.0
) -> tuple[float, float, float]:
    """Return mean voltage, current and supply at a steady speed."""
    track = Track(effects, cruise(speed), weight_kg)
    return tuple(float(np.mean(v[-200:])) for v in (track.voltage, track.current, track.supply))  # type: ignore[return-value]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_dead_time_takes_its_voltage_off(side: float) -> None:
    voltage, current, _ = means({"inverter_dead_time": {"voltage_V": 1.3}}, side * 0.2)
    assert voltage == pytest.approx(side * 1.3 + 1.56 * current + BACK_EMF * side * 0.2, rel=1e-3)


def test_brushes_drop_a_voltage_that_saturates() -> None:
    for weight in (0.0, 20.0):
        voltage, current, _ = means(
            {"brush_drop": {"voltage_V": 1.0, "current_A": 3.0}}, 0.2, weight
        )
        drop = math.tanh(current / 3.0)
        assert voltage == pytest.approx(drop + 1.56 * current + BACK_EMF * 0.2, rel=2e-3)


def test_supply_sags_and_the_log_does_not_know() -> None:
    ohm = 0.5
    voltage, current, supply = means({"supply_sag": {"resistance_ohm": ohm}})
    assert supply == pytest.approx(60.0 - ohm * voltage / 60.0 * current, abs=1e-3)
    reaching = 1.56 * current + BACK_EMF * 0.2
    assert voltage * supply / 60.0 == pytest.approx(reaching, rel=1e-3)
    assert voltage > reaching


def test_torque_per_ampere_falls() -> None:
    knee = 15.0
    needed = means({}, weight_kg=20.0)[1]
    current = means({"torque_saturation": {"knee_A": knee}}, weight_kg=20.0)[1]
    assert knee * math.tanh(current / knee) == pytest.approx(needed, rel=1e-3)
    assert current > 1.05 * needed


def test_torque_per_ampere_falls_by_a_rational_law() -> None:
    knee = 30.0
    needed = means({}, weight_kg=20.0)[1]
    current = means({"torque_saturation": {"knee_A": knee, "rational": 1.0}}, weight_kg=20.0)[1]
    assert current / (1.0 + (current / knee) ** 2) == pytest.approx(needed, rel=1e-3)
    assert current > 1.02 * needed


def test_torque_lags_the_current() -> None:
    """On a steady slope of the torque the current leads by the time constant."""
    lag = 2e-3
    steady = steady_torque({"current_loop_lag": {"time_s": lag}}, 0.4)
    assert steady == pytest.approx(steady_torque({}, 0.4), abs=0.01)
    spring = {"return_spring": {"stiffness_Nm_rad": 40.0, "rest_rad": 0.0}}
    both = {**spring, "current_loop_lag": {"time_s": lag}}
    ahead, straight = (Track(e, cruise(1.0)) for e in (both, spring))
    extra = PER_AMPERE * np.mean((ahead.current - straight.current)[-200:])
    assert extra == pytest.approx(40.0 * 1.0 * lag, rel=0.05)


def test_eccentric_encoder_reads_a_sine_more() -> None:
    track = Track({"encoder_eccentricity": {"amplitude_rad": 2e-3, "phase_rad": 0.6}}, sine())
    np.testing.assert_allclose(
        track.seen - track.angle, 2e-3 * np.sin(track.angle + 0.6), atol=2e-6
    )


def test_coupling_slips_once_and_stays() -> None:
    slip = {"encoder_slip": {"angle_rad": 3e-3, "at_s": 0.5, "recording": 2.0}}
    first, second, third = (Track(slip, sine(1.0), on=k) for k in (1, 2, 3))
    shift = second.seen - second.angle
    assert np.max(np.abs(first.seen - first.angle)) < 2e-6
    assert np.max(np.abs(shift[second.time < 0.499])) < 2e-6
    np.testing.assert_allclose(shift[second.time > 0.501], 3e-3, atol=2e-6)
    assert (
        np.max(np.abs(third.seen - third.angle)) < 2e-6
    )  # it was not running in its second recording
    second.machine.power(False)
    second.machine.power(True)
    second.machine.advance(1_000_000)
    seen, truth = second.machine.latch(), second.machine.truth()
    assert seen.joint_counts * second.machine.joint_count_rad - truth.angle_rad == pytest.approx(
        3e-3, abs=2e-6
    )
