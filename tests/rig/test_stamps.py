"""Stamps that jitter around evenly taken samples give way to even times; uneven samples do not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.recording import Array
from rig.sources import load_source
from rig.sources.build import even_stamps

PERIOD, COUNT = 0.005, 4000
CAMPAIGN = """\
campaign: 1
bench: {torque_constant: 0.03, gear_ratio: 100}
defaults: {channels: {time: t, motor_angle: q, current: i}}
recordings:
  - {file: a.csv, stage: unloaded}
"""


def angle_at(time: Array) -> Array:
    return np.asarray(
        30.0 * np.sin(2.0 * np.pi * 0.7 * time) + 3.0 * np.sin(2.0 * np.pi * 3 * time)
    )


def grid() -> Array:
    return 12.5 + PERIOD * np.arange(COUNT)


def jittering(share: float, seed: int = 3) -> Array:
    rng = np.random.default_rng(seed)
    late = np.clip(share * rng.standard_normal(COUNT), -0.45, 0.45)
    return np.asarray(grid() + PERIOD * late)


@pytest.mark.parametrize("kind", ["normal", "late", "late at times"])
def test_jitter_of_any_distribution_gives_even_times(kind: str) -> None:
    """Stamps of a host are late, never early, and now and then by several periods."""
    rng, count = np.random.default_rng(0), 20_000
    true = PERIOD * np.arange(count)
    late = {
        "normal": 0.13 * rng.standard_normal(count),
        "late": rng.exponential(0.13, count),
        "late at times": rng.exponential(0.05, count) + 2.0 * (rng.uniform(size=count) < 1e-3),
    }[kind]
    stamps = np.maximum.accumulate(true + PERIOD * late)
    found = even_stamps(stamps, angle_at(true))
    assert found is not None
    offset = found[0] - true
    assert np.ptp(offset) < 0.03 * PERIOD
    assert np.mean(offset) == pytest.approx(PERIOD * np.mean(late), abs=0.02 * PERIOD)


@pytest.mark.parametrize("share", [0.01, 0.1, 0.25])
def test_uneven_samples_keep_their_stamps(share: float) -> None:
    assert even_stamps(jittering(share), angle_at(jittering(share))) is None


def test_even_stamps_stay() -> None:
    assert even_stamps(grid(), angle_at(grid())) is None


def test_noise_that_hides_the_jitter_keeps_the_stamps() -> None:
    noise = 5.0 * np.random.default_rng(1).standard_normal(COUNT)
    assert even_stamps(jittering(0.05), angle_at(grid()) + noise) is None


def test_lost_samples_are_allowed_for() -> None:
    kept = np.random.default_rng(5).uniform(size=COUNT) > 0.02
    found = even_stamps(jittering(0.05)[kept], angle_at(grid())[kept])
    assert found is not None
    assert np.max(np.abs(found[0] - grid()[kept])) < 0.03 * PERIOD


@pytest.mark.parametrize("drift", [0.3, 3.0])
def test_a_rate_that_changes_is_no_grid(drift: float) -> None:
    time = grid() + drift * PERIOD * np.sin(np.linspace(0.0, 6.0, COUNT))
    assert even_stamps(time, angle_at(time)) is None


def test_a_campaign_says_that_it_did_so(tmp_path: Path) -> None:
    rows = np.column_stack([jittering(0.1), angle_at(grid()), np.cos(grid())])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="t,q,i", comments="", fmt="%.9g")
    (tmp_path / "c.yaml").write_text(CAMPAIGN)
    (recording,) = load_source(tmp_path / "c.yaml").recordings
    assert np.ptp(np.diff(recording.time)) < 1e-9
    notes = [n for n in recording.notes if "jitter" in n or "uneven" in n]
    assert len(notes) == 1
    assert notes[0].startswith("time stamps jitter by 0.0005 s rms (10 % of the period)")
