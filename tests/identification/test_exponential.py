"""The exponential of the compiled loops against the library's."""

from __future__ import annotations

import numpy as np
import pytest

from identification.numerics.compiled import LEAST, compiled, exponential


@compiled
def of_all(x: np.ndarray) -> np.ndarray:
    out = np.empty_like(x)
    for k in range(len(x)):
        out[k] = exponential(x[k])
    return out


def test_it_is_the_librarys_to_a_unit_in_the_last_place() -> None:
    x = np.concatenate([np.linspace(LEAST, 0.0, 100_001), -np.geomspace(1e-300, 1.0, 10_001)])
    assert np.max(np.abs(of_all(x) / np.exp(x) - 1.0)) < 1.1 * np.finfo(float).eps


def test_the_ends_of_its_range() -> None:
    assert of_all(np.array([0.0, -0.0])).tolist() == [1.0, 1.0]
    assert of_all(np.array([LEAST]))[0] == pytest.approx(np.exp(LEAST), rel=1e-15)
    assert np.isnan(of_all(np.array([np.nan]))[0])
