"""What the noise of torque and encoder is taken to be."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from identification.numerics.arrays import Array


@dataclass(frozen=True)
class Noise:
    """Noise of the measured torque, in a white and a correlated part, and of the angle.

    Attributes:
        torque: White part of the torque's, N m rms over a period.
        angle: Of the angle beyond the encoder's quantisation, rad rms.
        correlated: Correlated part of the torque's, a first-order process, N m rms; zero where there is none.
        correlation_s: Time over which its autocorrelation falls to 1/e, s.
    """

    torque: float
    angle: float = 0.0
    correlated: float = 0.0
    correlation_s: float = 0.0

    @property
    def whole_torque(self) -> float:
        """Both parts of the torque's noise, N m rms."""
        return math.hypot(self.torque, self.correlated)

    def louder(self, factor: float) -> Noise:
        """Return the same with the white part of the torque's noise raised by a factor."""
        return replace(self, torque=factor * self.torque)

    def drawn(self, rng: np.random.Generator, shape: tuple[int, int], period: float, share: float) -> Array:
        """Return independent rows of a share of the torque's noise, N m, a sample every ``period`` s."""
        white = np.asarray(share * self.torque * rng.standard_normal(shape), dtype=np.float64)
        if self.correlated == 0.0:
            return white
        pole = math.exp(-period / self.correlation_s)
        shocks = share * self.correlated * rng.standard_normal(shape)
        shocks[:, 1:] *= math.sqrt(1.0 - pole * pole)
        return np.asarray(white + signal.lfilter([1.0], [1.0, -pole], shocks, axis=1), dtype=np.float64)
