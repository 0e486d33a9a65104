"""The exponential function for compiled loops that run over several lanes at a time.

The compiler cannot vectorise calls of the C library's exponential function; the function of this
module consists of additions and multiplications alone.
"""

from __future__ import annotations

import math

import numpy as np

from identification.numerics.compiled import inlined

LEAST = -700.0
"""Least exponent; for a smaller exponent the result would not be a normal floating-point number."""
_LOG2_E = 1.0 / math.log(2.0)
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""Natural logarithm of 2 as a sum of two numbers; the first number has 32 bits, so that its small
multiples are exact (fdlibm, e_exp.c).
"""
_ROUNDING = 1.5 * 2.0**52
"""Number that is added to a value so that the last bits of the sum hold the nearest integer."""
_BIAS, _FRACTION = 1023, 52
_2, _3, _4, _5, _6, _7, _8, _9, _10, _11, _12, _13 = (1.0 / math.factorial(k) for k in range(2, 14))


@inlined
def exponential(x: float) -> float:
    """Return exp(x) for ``LEAST`` <= x <= 0, to 1.1 units in the last place.

    exp(x) = 2^n exp(r) with |r| <= ln(2) / 2, where 14 terms of the series suffice.
    """
    shifted = x * _LOG2_E + _ROUNDING
    n = shifted - _ROUNDING
    r = (x - n * _LN2_HIGH) - n * _LN2_LOW
    square = r * r
    fourth = square * square
    low = (_2 + r * _3) + square * (_4 + r * _5)
    middle = (_6 + r * _7) + square * (_8 + r * _9)
    high = (_10 + r * _11) + square * (_12 + r * _13)
    series = 1.0 + (r + square * (low + fourth * (middle + fourth * high)))
    power = (np.float64(shifted).view(np.int64) + _BIAS) << _FRACTION
    return float(series * np.int64(power).view(np.float64))
