"""The noise model of measured torque and angle: white and correlated parts (M25)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy

from identification.numerics.arrays import Array


@dataclass(frozen=True)
class Noise:
    """Levels of the white and correlated noise of the measured torque, and of the noise of the
    angle.

    Attributes:
        torque: White part of the torque noise, N m rms over a period.
        angle: Noise of the angle in addition to the quantisation error of the encoder, rad rms.
        correlated: Correlated part of the torque noise, a first-order process, N m rms; zero for
            white noise.
        correlation_s: Time over which the autocorrelation of the correlated part falls to 1/e, s.
    """

    torque: float
    angle: float = 0.0
    correlated: float = 0.0
    correlation_s: float = 0.0

    @property
    def whole_torque(self) -> float:
        """Standard deviation of the torque noise, white and correlated part together, N m."""
        return math.hypot(self.torque, self.correlated)

    def louder(self, factor: float) -> Noise:
        """Return a copy with the white part of the torque noise multiplied by a factor."""
        return replace(self, torque=factor * self.torque)

    def drawn(
        self, rng: np.random.Generator, shape: tuple[int, int], period: float, share: float
    ) -> Array:
        """Return independent simulated series of torque noise, multiplied by ``share``, N m, one
        per row, with one sample every ``period`` s.
        """
        white = np.asarray(share * self.torque * rng.standard_normal(shape), dtype=np.float64)
        if self.correlated == 0.0:
            return white
        pole = math.exp(-period / self.correlation_s)
        shocks = share * self.correlated * rng.standard_normal(shape)
        shocks[:, 1:] *= math.sqrt(1.0 - pole * pole)
        return np.asarray(
            white + scipy.signal.lfilter([1.0], [1.0, -pole], shocks, axis=1), dtype=np.float64
        )
