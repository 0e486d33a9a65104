"""What samples at instants leave unknown is a parameter of the voltage equation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.rows import Equation
from identification.recording import Recording
from identification.signals import central_difference, values_at_ends
from identification.views.nominal import command_ripple

from .benches import honest, nominal_fit

BOTH = frozenset({"voltage", "current"})
RIPPLE = 0.02
"""Voltage in proportion to the command's acceleration, V s^2/rad."""


def rippled(
    recordings: Sequence[Recording], averaged: frozenset[str], size: float = RIPPLE
) -> list[Recording]:
    out = []
    for r in recordings:
        speed = central_difference(r.channels["command"], r.period)
        current = r.channels["current"]
        if "current" not in averaged:
            current = values_at_ends(r.time, current, r.period)
        voltage = r.channels["voltage"] + size * central_difference(speed, r.period)
        out.append(
            replace(
                r,
                channels={**r.channels, "voltage": voltage, "current": current},
                averaged=averaged,
            )
        )
    return out


def voltage_equation(recordings: Sequence[Recording]) -> Equation:
    return next(e for e in nominal_fit(recordings).equations if e.name == "voltage")


def left(equation: Equation) -> float:
    """Return the mean square of the whitened rows after the fit of the equation's parameters."""
    found, *_ = np.linalg.lstsq(equation.tangent, equation.residual, rcond=None)
    rest = equation.residual - equation.tangent @ found
    return float(np.mean((rest / equation.sigma) ** 2))


def test_a_ripple_of_the_command_is_a_parameter_where_values_are_samples_at_instants() -> None:
    found = []
    for size in (0.0, RIPPLE):
        equation = voltage_equation(rippled(honest(), frozenset({"voltage"}), size))
        assert equation.names == ("R", "Ke", "ripple")
        fitted, *_ = np.linalg.lstsq(equation.tangent, equation.residual, rcond=None)
        found.append(fitted[2])
        assert left(equation) < 1.2
    assert found[1] - found[0] == pytest.approx(RIPPLE, rel=0.01)


def test_means_have_no_ripple_so_that_it_stays_a_mismatch() -> None:
    equation = voltage_equation(rippled(honest(), BOTH))
    assert equation.names == ("R", "Ke")
    assert left(equation) > 4.0


@pytest.mark.parametrize("channels", [BOTH, frozenset({"voltage"})])
def test_without_a_command_there_is_no_ripple(channels: frozenset[str]) -> None:
    bare = [
        replace(
            r,
            channels={k: v for k, v in r.channels.items() if k != "command"},
            averaged=channels,
        )
        for r in honest()
    ]
    equation = voltage_equation(bare)
    assert "ripple" not in equation.names
    assert not np.any(command_ripple(equation.views[0]))
