"""Guesses of what the columns of a recording hold."""

from __future__ import annotations

import math

import pytest

from rig.sources.columns import guess_channels, guess_mass, is_linear


@pytest.mark.parametrize(
    ("name", "channel", "scale"),
    [
        ("t_ms", "time", 1e-3),
        ("Timestamp (us)", "time", 1e-6),
        ("current [mA]", "current", 1e-3),
        ("pos/deg", "angle", math.pi / 180),
        ("speed [rpm]", "velocity", math.pi / 30),
        ("pos_ref", "command", 1.0),
        ("motor_position_deg", "motor_angle", math.pi / 180),
        ("temperature [°C]", "temperature", 1.0),
        ("current [deg]", None, 1.0),
        ("comment", None, 1.0),
    ],
)
def test_guesses(name: str, channel: str | None, scale: float) -> None:
    guesses = guess_channels([name])
    assert list(guesses) == ([channel] if channel else [])
    if channel:
        assert guesses[channel].scale == pytest.approx(scale)


def test_a_column_is_taken_once_and_the_first_that_fits() -> None:
    guesses = guess_channels(["t", "time", "angle", "", "phi"])
    assert [(name, guess.column) for name, guess in guesses.items()] == [
        ("time", "t"),
        ("angle", "angle"),
    ]


@pytest.mark.parametrize(
    ("stem", "mass"),
    [("log_5kg", 5.0), ("run-2.5 kg", 2.5), ("a0p5kg", 0.5), ("empty", 0.0), ("kg5", 0.0)],
)
def test_a_mass_in_the_name_of_a_file(stem: str, mass: float) -> None:
    assert guess_mass(stem) == mass


@pytest.mark.parametrize(
    ("name", "channel", "scale"),
    [
        ("pos [mm]", "angle", 1e-3),
        ("speed [m/s]", "velocity", 1.0),
        ("force_kN", "torque", 1e3),
        ("pos [deg]", None, 1.0),
    ],
)
def test_guesses_on_a_linear_bench(name: str, channel: str | None, scale: float) -> None:
    guesses = guess_channels([name], linear=True)
    assert list(guesses) == ([channel] if channel else [])
    if channel:
        assert guesses[channel].scale == pytest.approx(scale)
    assert is_linear([name]) is (name in ("pos [mm]", "speed [m/s]"))
