"""Computes the regressors of voltage drops with the sign of the current: dead time of the inverter,
drop of the brushes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from identification.diagnosis.rows.nominal import Nominal
from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.term import Context, Shape, everywhere, rows
from identification.recording import Array
from identification.signals import resample, values_at_ends

STEP_SHARES = (0.001, 0.03)
"""Limits of the range of current over which a dead-time step is smeared, relative to the greatest
current.

Near zero a noisy sample does not determine the sign of the current, and during the step the winding
has no current.
"""
ROUNDED_SHARES = (0.03, 1.0)
"""Limits of the range of current over which a brush drop is reached, relative to the greatest
current; over a smaller range a brush drop resembles a dead time.
"""
DEAD_SHARES, BRUSH_SHARES = (0.005, 0.02), (0.05, 0.1, 0.2)
LEAST_CROSSINGS = 12
"""Least number of passages of the current through zero from which the change of the current in a
passage is computed.
"""
GREATEST_QUANTILE = 0.99
"""Quantile of the magnitude of the current that counts as the greatest current, so that spikes are
ignored.
"""


def has_current(view: View) -> bool:
    """Whether a recording has a current channel, and its bench a torque constant."""
    return view.current is not None and view.recording.bench.torque_constant is not None


def about_zero(shares: Sequence[float]) -> Callable[[Context], Sequence[Shape]]:
    """Return trial parameters: the range of current over which a drop is reached, relative to the
    greatest current; the reading of the current at zero current, A; the greatest current, A.
    """

    def trials(context: Context) -> Sequence[Shape]:
        currents = [np.abs(v.current) for v in context.views if v.current is not None]
        if not currents:
            return ()
        greatest_A = float(np.nanquantile(np.concatenate(currents), GREATEST_QUANTILE))
        shapes = [(share, context.nominal.zero_A, greatest_A) for share in shares]
        return everywhere(context, lambda v: has_current(v) and v.voltage is not None, shapes)

    return trials


def at_zero(nominal: Nominal, shape: Shape) -> tuple[Nominal, Shape]:
    """Return nominal values and nonlinear parameters with which the drop depends on the sign of the
    true current, because the offset of the current sensor may exceed the range of the step.
    """
    return nominal, (shape[0], nominal.zero_A, *shape[2:])


def _mean_over_sample(
    view: View,
    zero_A: float,
    antiderivative: Callable[[Array], Array],
    function: Callable[[Array], Array],
) -> Array:
    """Return the mean of a function of the current over each sample's period, for a current that is
    linear in time.

    The mean is needed because the current may change by more than I_b within one period when it
    reverses. ``zero_A`` is the reading at zero current. The function is applied to the logged
    samples, and its result is resampled like the voltage, because interpolation of the current
    would widen the step.
    """
    recording = view.recording
    current = recording.channels["current"] - zero_A
    ends = 0.5 * (current[1:] + current[:-1])
    before, after = np.concatenate((current[:1], ends)), np.concatenate((ends, current[-1:]))
    change = after - before
    small = np.abs(change) < 1e-9
    mean = (antiderivative(after) - antiderivative(before)) / np.where(small, 1.0, change)
    values = np.where(small, function(current), mean)
    if "current" in recording.averaged:
        values = values_at_ends(recording.time, values, recording.period)
    return resample(recording.time, values, view.time)


def drop(view: View, _nominal: Nominal, shape: Shape) -> Array:
    """Return the regressor of a drop with the sign of the current: tanh(I / I_b), dimensionless,
    shape (1, n).

    Args:
        view: The recording.
        shape: I_b relative to the greatest current; the reading at zero current, A; the greatest
            current, A.
    """
    share, zero_A, greatest_A = shape
    knee = share * greatest_A

    def log_cosh(current: Array) -> Array:
        size = np.abs(current) / knee
        return np.asarray(knee * (size + np.log1p(np.exp(-2.0 * size)) - np.log(2.0)))

    return rows(
        _mean_over_sample(
            view, zero_A, log_cosh, lambda current: np.asarray(np.tanh(current / knee))
        )
    )


def change_at_zero(views: Sequence[View]) -> float:
    """Return the change of the current from one sample to the next during a passage through zero,
    A: the greatest change in each passage, and of these the median over the passages of all
    recordings; 0 with fewer than :data:`LEAST_CROSSINGS` passages.

    A step of the voltage over a smaller range of current is smeared over a sample period. In a
    passage the current changes its sign, from a magnitude beyond the current of a dead-time step to
    a magnitude beyond it, so that noise around zero at rest is no passage.
    """
    currents = [v.current for v in views if v.current is not None]
    if not currents:
        return 0.0
    greatest_A = float(np.nanquantile(np.abs(np.concatenate(currents)), GREATEST_QUANTILE))
    changes: list[float] = []
    for current in currents:
        places = np.flatnonzero(np.abs(current) > STEP_SHARES[1] * greatest_A)
        beyond = current[places]
        passed = beyond[1:] * beyond[:-1] < 0.0
        steps = np.abs(np.diff(current))
        changes += [float(np.max(steps[places[k] : places[k + 1]])) for k in np.flatnonzero(passed)]
    return float(np.median(changes)) if len(changes) >= LEAST_CROSSINGS else 0.0
