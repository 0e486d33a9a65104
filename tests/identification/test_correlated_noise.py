"""Correlated noise of the current sensor is told from physics that is missing, and the refinement
stays.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.default import identify
from identification.estimate.refinement import refine_recordings, refusal
from identification.filter.segments import Noise
from identification.model.parameters import NOMINAL, SYSTEM_PARAMETERS
from identification.recording import Bench, Dataset, Model, Recording
from identification.simulation.drive_loop import respond, usual_loop

PERIOD_S, STAGE_S = 1e-3, 8.0
COUNT_RAD = 2.0 * np.pi / 409600.0
NOISE = Noise(torque=0.07, correlated=0.07, correlation_s=0.01)


@pytest.fixture(scope="module")
def clean() -> Recording:
    """Return an unloaded stage of the model itself, without noise of the torque."""
    time = PERIOD_S * np.arange(round(STAGE_S / PERIOD_S))
    command = np.deg2rad(20.0) * np.sin(0.8 * np.pi * time) * np.clip(time, 0.0, 1.0)
    out = respond(
        command, PERIOD_S, NOMINAL, 0.0, 2.0, usual_loop(NOMINAL["J"], 75.0), np.zeros(len(time))
    )
    angle = np.floor(out.angle / COUNT_RAD) * COUNT_RAD
    channels = {"time": time, "angle": angle, "torque": out.torque}
    return Recording(
        name="run", channels=channels, bench=Bench(moment_arm=0.095), averaged={"torque"}
    )


def with_torque(recording: Recording, more: np.ndarray) -> Recording:
    return replace(
        recording, channels={**recording.channels, "torque": recording.channels["torque"] + more}
    )


def test_drawn_noise_has_both_parts() -> None:
    rows = NOISE.drawn(np.random.default_rng(0), (2, 200_000), PERIOD_S, 0.5)
    later = [float(np.mean(rows[:, lag:] * rows[:, : rows.shape[1] - lag])) for lag in (0, 1, 10)]
    correlated = (
        0.25
        * NOISE.correlated**2
        * np.exp(-np.array([0.0, 1.0, 10.0]) * PERIOD_S / NOISE.correlation_s)
    )
    assert later == pytest.approx(
        correlated + np.array([0.25 * NOISE.torque**2, 0.0, 0.0]), rel=0.05
    )


@pytest.mark.proof
def test_correlated_noise_is_measured_and_the_refinement_stays(clean: Recording) -> None:
    noise = NOISE.drawn(np.random.default_rng(1), (1, len(clean.time)), PERIOD_S, 1.0)[0]
    found = identify(Dataset((with_torque(clean, noise),)), bandwidth_Hz=40.0)
    assert found.warnings == ()
    assert found.noise.torque == pytest.approx(NOISE.torque, rel=0.2)
    assert found.noise.correlated == pytest.approx(NOISE.correlated, rel=0.3)
    assert math.log(found.noise.correlation_s / NOISE.correlation_s) == pytest.approx(0.0, abs=0.6)
    for name, p in found.parameters.items():
        assert abs(p.value - NOMINAL[name]) < p.high - p.low, name


def test_physics_that_is_missing_is_not_taken_for_noise(clean: Recording) -> None:
    white = 0.07 * np.random.default_rng(2).standard_normal(len(clean.time))
    cogging = 0.4 * np.sin(60.0 * clean.channels["angle"])
    recording = with_torque(clean, white + cogging)
    refined = refine_recordings([recording], NOMINAL, SYSTEM_PARAMETERS, Model(), correlated=True)
    assert not isinstance(refined, str)
    assert refined.noise.correlated > 0.05
    assert refined.repeating_share > 0.6
    assert "repeats in matching half cycles" in refusal(refined, 1.0, 1.0)
