"""The Cramer-Rao bound of a measurement as it is.

The current is a noisy mean over each period, the drive's loop is unknown, so the current is a given input and not
foretold; the encoder is quantised; and when each stretch breaks away is unknown. Then the Fisher information is that of
the prediction errors' mean: sensitivities over standard deviations, products summed over all samples (Ljung, System
Identification, 2nd ed., 7.4), with the breakaway times eliminated.

A stretch's own sensitivities hold the current's noise, whose square would pass for excitation. They are replaced by the
mean over the stretches of the recording that make the same motion, as long after their breakaway, in which its share
falls with their number.
"""

from __future__ import annotations

import numpy as np

from identification.estimate.arrow import Arrow, equilibrated
from identification.recording import Array

_SILENT = 1e-12
"""Information on an unknown that touches no residual."""


def bound(jacobian: Arrow, others: Arrow, stretches: Array) -> Array:
    """Return the smallest covariance that an unbiased estimate can have.

    Args:
        jacobian: d residuals / d unknowns, residuals over their standard deviations, of r rows and p columns.
        others: The mean of the same over the other stretches.
        stretches: How many stretches each residual's mean is over, its own among them, shape (r,).

    Returns:
        Shape (p, p).

    Raises:
        numpy.linalg.LinAlgError: The unknowns are not all excited.
    """
    normal, scale = equilibrated(jacobian.mixed(1.0 / stretches, others).product())
    silent = np.flatnonzero(np.diag(normal) == 0.0)
    normal[silent, silent] = _SILENT
    return np.asarray(np.linalg.inv(normal) / np.outer(scale, scale))
