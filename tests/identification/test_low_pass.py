"""The low-pass filter without phase against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from identification.signals import forwards_and_backwards, sections


@pytest.mark.parametrize("share", [0.01, 0.08, 0.4, 0.85])
def test_it_is_scipys(share: float) -> None:
    values = 3.0 + np.cumsum(np.random.default_rng(0).normal(size=1500))
    expected = signal.sosfiltfilt(
        signal.butter(4, share, output="sos"), values, padlen=min(1499, int(6 / share))
    )
    found = forwards_and_backwards(sections(share), values, min(1499, int(6 / share)))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_a_constant_stays_one() -> None:
    found = forwards_and_backwards(sections(0.05), np.full(50, -7.3), 49)
    assert found == pytest.approx(np.full(50, -7.3), rel=1e-12)


def test_without_padding_the_ends_start_in_their_steady_state() -> None:
    values = np.linspace(0.0, 1.0, 40)
    expected = signal.sosfiltfilt(signal.butter(4, 0.2, output="sos"), values, padlen=0)
    assert forwards_and_backwards(sections(0.2), values, 0) == pytest.approx(expected)
