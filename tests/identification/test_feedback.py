"""Stiffness and damping over a bus: the margin on paper, and a sampled joint that settles."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from scipy.optimize import brentq

from identification.model.feedforward import DELAY_CYCLES, Gains, gains


def loop(found: Gains, inertia: float, period: float, omega: float) -> complex:
    """L(j omega) of the module's docstring."""
    s = 1j * omega
    return (
        (found.stiffness + found.damping * s)
        * cmath.exp(-DELAY_CYCLES * period * s)
        / (inertia * s * s)
    )


@pytest.mark.parametrize(
    ("inertia", "period"), [(0.204, 1e-3), (0.03, 1e-3), (2.0, 5e-4), (0.204, 4e-3)]
)
def test_thirty_five_degrees_and_five_decibels_are_left(inertia: float, period: float) -> None:
    found = gains(inertia, period)
    crossover = brentq(
        lambda w: abs(loop(found, inertia, period, w)) - 1.0,
        1e-2 / period,
        2.0 / period,
        xtol=1e-12,
    )
    margin = math.pi + cmath.phase(loop(found, inertia, period, crossover))
    assert math.degrees(margin) == pytest.approx(35.0, abs=1e-6)
    assert crossover * period == pytest.approx(math.pi / 8.0)
    turned = brentq(lambda w: loop(found, inertia, period, w).imag, crossover, 3.0 * crossover)
    assert -20.0 * math.log10(abs(loop(found, inertia, period, turned))) == pytest.approx(
        5.58, abs=0.01
    )


@pytest.mark.parametrize(("share", "settles"), [(0.1, True), (1.0, True), (2.2, False)])
def test_an_inertia_over_a_bus_settles(share: float, settles: bool) -> None:
    """Angle sampled at a SYNC, torque sent with the next, held for a cycle: more than twice the
    gains oscillate.
    """
    inertia, period = 0.204, 1e-3
    found = gains(inertia, period)
    fine, cycles = 20, 1000
    theta = np.zeros(cycles * fine + 1)
    omega, staged = 0.01, 0.0
    torque = 0.0
    for k in range(cycles * fine):
        if k % fine == 0:
            torque = staged
            speed = (theta[k] - theta[max(k - fine, 0)]) / period
            staged = -share * (found.stiffness * theta[k] + found.damping * speed)
        omega += torque / inertia * period / fine
        theta[k + 1] = theta[k] + omega * period / fine
    assert bool(abs(omega) < 1e-6 and abs(theta[-1]) < 1e-6) is settles
