"""Two clocks on one time base."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.mock.plant.machine import simulate
from drivers.mock.plant.parts.constants import Machine
from identification.estimate.default import identify, solve_stages
from identification.prepare import prepare
from identification.recording import Array, Bench, Dataset, Model, Recording
from rig.common.errors import InputError
from rig.runs.alignment import aligned, taken_at
from rig.sources import load_source

from ..identification.practical import CURRENT_QUANTUM_A, DURATION_S, command
from ..identification.synthetic import TRUTH

FINE = 20
COUNT_RAD = 2.0 * np.pi / (1 << 18)
MEANS = frozenset({"current"})


def free_running(samples: int, ppm: float, start: float = 0.3) -> tuple[Array, Array, Array]:
    """Row times, the stamps of an encoder with its own clock, and when they were taken."""
    rows = 1e-3 * np.arange(1, samples + 1)
    period = 1e-3 / (1.0 + 1e-6 * ppm)
    ticks = np.floor((rows - start * 1e-3) / period)
    return rows, 65.0 + 1e-3 * ticks, start * 1e-3 + period * ticks


@pytest.mark.parametrize("ppm", [-400.0, 250.0, 1000.0])
def test_the_instants_are_recovered(ppm: float) -> None:
    rows, stamps, true = free_running(20_000, ppm)
    assert np.max(np.abs(taken_at(rows, stamps) - true)) < 4e-5
    assert np.max(rows - true) > 9e-4


@pytest.mark.parametrize("ppm", [0.0, 60.0])
def test_latched_together_nothing_is_moved(ppm: float) -> None:
    """As on one SYNC: the clocks drift, the samples do not."""
    time = 1e-3 * np.arange(5000)
    channels = {"time": time, "angle": np.sin(time)}
    found, words = aligned(channels, 12.0 + time * (1.0 + 1e-6 * ppm), MEANS, 100.0)
    assert words == ""
    assert all(found[name] is values for name, values in channels.items())


def test_stamps_that_jump_back_are_not_believed() -> None:
    time = 1e-3 * np.arange(5000)
    assert aligned({"time": time, "angle": time}, time[::-1].copy(), MEANS, 1.0)[1] == ""


def test_the_finer_motor_encoder_keeps_the_drives_time() -> None:
    rows, stamps, true = free_running(5000, 300.0)
    channels = {
        "time": rows,
        "angle": np.sin(true),
        "motor_angle": np.floor(1e5 * np.sin(rows)) * 1e-3,
    }
    found, words = aligned(channels, stamps, MEANS, 100.0)
    assert "interpolated at the drive's time stamps" in words
    assert found["motor_angle"] is channels["motor_angle"]
    assert np.max(np.abs(found["angle"] - np.sin(rows))[1:-1]) < 5e-5
    assert np.max(np.abs(channels["angle"] - np.sin(rows))) > 7e-4


def test_means_stay_means_and_overwritten_samples_are_filled() -> None:
    rows, stamps, true = free_running(5000, 1000.0)
    integral = -np.cos(rows)
    current = np.diff(np.concatenate(([-np.cos(0.0)], integral))) / 1e-3
    channels = {"time": rows, "angle": np.round(true / 1e-5) * 1e-5, "current": current}
    found, words = aligned(channels, stamps, MEANS, 1.0)
    assert "angles interpolated that were overwritten" in words
    assert np.ptp(np.diff(found["time"])) < 1e-6
    assert np.max(np.abs(found["angle"] - found["time"])) < 6e-5
    middle = found["time"] - 0.5e-3
    assert np.max(np.abs(found["current"] - np.sin(middle))[2:]) < 5e-4


def logged(weight: float, seed: int) -> tuple[dict[str, Array], Array]:
    """Rows of the practical bench with a joint encoder on its own clock, +300 ppm."""
    rng = np.random.default_rng(seed)
    fine = simulate(Machine(), command, DURATION_S, 1000.0 * FINE, weight, rng=rng)
    rows, stamps, true = free_running(round(1000.0 * DURATION_S) - 1, 300.0)
    current = np.convolve(fine["mean_current"], np.ones(FINE) / FINE, mode="full")[
        FINE * np.arange(1, len(rows) + 1)
    ]
    angle = np.interp(true, fine["time"], fine["angle"])
    return {
        "time": rows,
        "angle": np.floor(angle / COUNT_RAD) * COUNT_RAD,
        "current": np.round(current / CURRENT_QUANTUM_A) * CURRENT_QUANTUM_A,
    }, stamps


@pytest.mark.proof
def test_the_inertia_is_biased_before_and_not_after() -> None:
    channels, stamps = logged(0.0, 1)
    bench = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095)
    before = prepare(Recording("before", channels, bench, averaged=MEANS), 40.0)
    biased, _ = solve_stages([before], [], Model(), lambda _stage, _share: None)
    assert biased["J"] < 0.9 * TRUTH["J"]
    on_one_clock = Recording(
        "after", aligned(channels, stamps, MEANS, 100.0)[0], bench, averaged=MEANS
    )
    result = identify(Dataset((on_one_clock,)))
    assert result.warnings == ()
    for name, value in result.values().items():
        assert value == pytest.approx(TRUTH[name], rel=0.02 if name == "J" else 0.006), name


CAMPAIGN = """\
campaign: 1
bench: {torque_constant: 0.03, gear_ratio: 100, moment_arm: 0.095}
recordings:
  - file: log.npz
    channels: {time: t, angle: q, angle_time: stamp, current: {column: i, average: true}}
"""


def test_a_campaign_may_have_the_encoders_stamps(tmp_path: Path) -> None:
    rows, stamps, true = free_running(5000, 300.0)
    np.savez(
        tmp_path / "log.npz",
        t=rows,
        q=np.round(np.sin(true) / 1e-5) * 1e-5,
        stamp=stamps,
        i=np.cos(rows),
    )
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN)
    (found,) = load_source(tmp_path / "campaign.yaml").recordings
    assert "angle_time" not in found.channels
    assert any("samples by its own clock" in note for note in found.notes)
    assert np.max(np.abs(found.channels["angle"] - np.sin(found.time))) < 6e-5


def test_stamps_without_an_angle_are_refused(tmp_path: Path) -> None:
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN.replace("angle: q", "motor_angle: q"))
    with pytest.raises(InputError, match="time stamps of an encoder without its `angle`"):
        load_source(tmp_path / "campaign.yaml")
