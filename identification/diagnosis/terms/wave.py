"""Compiled sine and cosine of large phases; most regressors of the catalogue are sines of an angle
or of time.
"""

from __future__ import annotations

import math

import numpy as np

from identification.numerics.compiled import compiled
from identification.recording import Array

_PER_HALF_TURN = 1.0 / math.pi
_HALF_TURN, _REST = 3.1415926534682512, 1.2154201013012384e-10
"""pi to 33 bits, whose small multiples are exact, and the remainder of pi."""
_SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(11))
_COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(12))
_S1, _S2, _S3, _S4, _S5, _S6, _S7, _S8, _S9, _S10 = _SINE[1:]
_C1, _C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10, _C11 = _COSINE[1:]


def sine_cosine(frequency: float, angle: Array) -> Array:
    """Return sin and cos of ``frequency * angle``, shape (2, m), with an error of a few units of
    1e-16 for phases below a million half turns.

    This function has no branches, so that the processor computes several samples at a time; numpy
    computes one sample at a time and takes ten times as long.
    """
    out = np.empty((2, len(angle)))
    _fill(frequency, angle, out[0], out[1])
    return out


@compiled
def _fill(frequency: float, angle: Array, sine: Array, cosine: Array) -> None:
    # The compiler must not change the order of these sums, because it would add the two parts of
    # pi.
    for k in range(len(angle)):
        phase = frequency * angle[k]
        turns = np.floor(phase * _PER_HALF_TURN + 0.5)
        rest = (phase - turns * _HALF_TURN) - turns * _REST
        z = rest * rest
        sign = 1.0 - 2.0 * (turns - 2.0 * np.floor(0.5 * turns))
        # Power series for phases within a quarter turn on either side; the first omitted terms are
        # below 1e-18.
        odd = _S5 + z * (_S6 + z * (_S7 + z * (_S8 + z * (_S9 + z * _S10))))
        odd = 1.0 + z * (_S1 + z * (_S2 + z * (_S3 + z * (_S4 + z * odd))))
        even = _C5 + z * (_C6 + z * (_C7 + z * (_C8 + z * (_C9 + z * (_C10 + z * _C11)))))
        even = 1.0 + z * (_C1 + z * (_C2 + z * (_C3 + z * (_C4 + z * even))))
        sine[k] = sign * rest * odd
        cosine[k] = sign * even
