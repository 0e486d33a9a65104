"""Drift, gaps and late answers, found where they were put and nowhere else."""

import numpy as np
import pytest

from rig.runs.run import describe, drift_ppm

TIME = 1e-3 * np.arange(20_000)


def test_clocks_that_agree_say_nothing() -> None:
    assert describe(TIME, TIME + 4e-4, TIME + 1e-4, TIME + 2e-4) == []


@pytest.mark.parametrize("ppm", [-80.0, -3.0, 5.0, 60.0])
def test_drift_is_measured_through_jitter_and_late_stamps(ppm: float) -> None:
    rng = np.random.default_rng(0)
    other = 7.0 + TIME * (1.0 + 1e-6 * ppm) + 2e-5 * rng.uniform(size=len(TIME))
    other[::1000] += 5e-4
    assert drift_ppm(TIME, other) == pytest.approx(ppm, abs=0.2)


def test_a_clock_that_stands_or_jumps_back_has_no_drift() -> None:
    assert drift_ppm(TIME, np.zeros_like(TIME)) is None
    assert drift_ppm(TIME, np.where(TIME > 10.0, TIME - 5.0, TIME)) is None
    assert drift_ppm(TIME[:3], TIME[:3]) is None


def test_what_is_found_is_told() -> None:
    kept = np.ones(len(TIME), dtype=bool)
    kept[500:503] = kept[9000] = False
    time = TIME[kept]
    host = time + np.where(np.arange(len(time)) % 100 == 0, 3e-3, 3e-4)
    notes = describe(time, host, time * (1.0 + 40e-6), time * (1.0 - 10e-6))
    assert notes == [
        "2 gaps, 4 samples lost, the longest gap 4 ms",
        "1 % of the answers came more than one period late",
        "the drive's clock runs +40.0 ppm against the host's",
        "the encoder's clock runs -50.0 ppm against the drive's",
    ]
