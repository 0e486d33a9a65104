"""Checks that the current loop of a simulated drive is stable with its motor.

An unstable current loop looks like a jammed joint: the current oscillates at its limit, and the run
stops with a violated limit of torque or current.
"""

from __future__ import annotations

import math

import numpy as np

from drivers.mock.plant.parts import constants

_BISECTIONS = 60
_ADVISED_SHARE = 0.5
"""Recommended gain as a share of the gain at the stability limit: a gain margin of 6 dB."""


def unstable_current_loop(machine: constants.Machine) -> str | None:
    """Return a message with a stable gain if the current loop of a simulated drive is unstable.

    The loop is a PI controller with a zero-order hold on resistance and inductance of the motor
    (eq. 1). The loop is linear, so that its eigenvalues determine its stability; the supply voltage
    only limits the oscillation.

    Args:
        machine: The simulated machine.

    Returns:
        The message on the key ``current_gain_V_A``, or None if the loop is stable.
    """
    gain = machine.loops.current_gain_V_A
    radius = _radius(machine, gain)
    if radius < 1.0:
        return None
    motor, loops = machine.motor, machine.loops
    advised = _ADVISED_SHARE * _greatest_stable_gain(machine)
    return (
        f"with {motor.inductance_H:g} H and {motor.resistance_ohm:g} ohm at {loops.rate_Hz:g} Hz "
        f"the current loop of "
        f"the simulated drive is unstable (its error grows by a factor of {radius:.3g} each "
        f"period), and may stop a run by its limits of current or torque; lower the gain to "
        f"{advised:.2g} or less, or raise rate_Hz"
    )


def _radius(machine: constants.Machine, gain: float) -> float:
    """Return the growth factor of the loop's error per period, which is the greatest magnitude of
    the eigenvalues.
    """
    motor, loops = machine.motor, machine.loops
    period = 1.0 / loops.rate_Hz
    integral = gain * loops.current_integral_1_s * period
    constant_s = motor.inductance_H / motor.resistance_ohm
    kept = math.exp(-period / constant_s) if constant_s > 0.0 else 0.0
    rise = (1.0 - kept) / motor.resistance_ohm
    # State: current, and voltage of the integrator including the error of the present period.
    loop = np.array([[kept - rise * (gain + integral), rise], [-integral, 1.0]])
    return float(np.max(np.abs(np.linalg.eigvals(loop))))


def _greatest_stable_gain(machine: constants.Machine) -> float:
    """Return the gain at the stability limit, V/A; all lower gains are stable."""
    low, high = 0.0, machine.loops.current_gain_V_A
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _radius(machine, middle) < 1.0 else (low, middle)
    return low
