"""Residuals at other breakaway times, of the samples that feel them: the same as of all samples."""

from __future__ import annotations

import numpy as np
import pytest

from identification.filter.likelihood import Point
from identification.filter.segments import Noise, motion
from identification.model.parameters import pack
from identification.recording import Model, Recording

from .synthetic import TRUTH


@pytest.mark.parametrize("shift_ms", [-3.0, 0.5, 3.5])
def test_only_the_first_samples_feel_a_breakaway_time(
    practical_pair: tuple[Recording, Recording], shift_ms: float
) -> None:
    motions = [m for m in map(motion, practical_pair) if m is not None]
    point = Point.of(motions, pack(TRUTH, 2.0), [], Model(), Noise(0.06))
    held, x = point.weighted(), point.origin()
    near = held.near_breakaways(x, held.residuals(x))
    assert len(near.heads.rows) < 0.5 * len(point.experiment.samples)
    there = x + shift_ms
    whole = held.residuals(x)
    whole[near.rows] = near.residuals(there)
    np.testing.assert_allclose(whole, held.residuals(there), atol=1e-4)
    assert np.max(np.abs(near.residuals(there) - near.here)) > 0.1
