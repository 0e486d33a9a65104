"""The test by sign flips holds its level on noise that is correlated within blocks; how effects are
added and kept.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.removal import needed_share
from identification.diagnosis.result import Verdict
from identification.diagnosis.significance import flipped_statistics, sign_flip_p_value
from identification.diagnosis.stack import Candidate, wald_statistic
from identification.recording import Dataset, Model, Recording
from identification.views.view import one_clock

from .benches import campaign

BLOCKS, ROWS, CANDIDATES, STUDIES = 40, 25, 20, 100


def scored(regressor: np.ndarray, residual: np.ndarray) -> Candidate:
    unit = regressor / np.linalg.norm(regressor)
    sums = (unit * residual).reshape(BLOCKS, ROWS).sum(axis=1)[:, None]
    score = sums.sum(axis=0)
    weights = (unit**2).reshape(BLOCKS, ROWS).sum(axis=1)[:, None, None]
    gain = float(score @ score)
    return Candidate(
        "any",
        (),
        score,
        gain,
        1.0,
        wald_statistic(score, sums - weights @ score),
        sums,
        weights,
        gain,
    )


def study(rng: np.random.Generator, hidden: float) -> float:
    level = np.repeat(rng.standard_normal(BLOCKS), ROWS)
    residual = rng.standard_normal(BLOCKS * ROWS) + 0.7 * level
    regressors = np.repeat(rng.standard_normal((CANDIDATES, BLOCKS)), ROWS, axis=1)
    residual = residual + hidden * regressors[0]
    return sign_flip_p_value([scored(r, residual) for r in regressors], BLOCKS, rng)


@pytest.mark.parametrize("degrees", [1, 2, 3])
@pytest.mark.parametrize("alike", [1.0, 3e-4])
def test_flips_give_what_flipped_blocks_would(degrees: int, alike: float) -> None:
    rng = np.random.default_rng(degrees)
    columns = rng.standard_normal((BLOCKS, ROWS, degrees))
    columns[:, :, 1:] = columns[:, :, :1] + alike * columns[:, :, 1:]
    residual = rng.standard_normal((BLOCKS, ROWS))
    sums = np.einsum("bij,bi->bj", columns, residual)
    weights = np.einsum("bij,bik->bjk", columns, columns) / (BLOCKS * ROWS)
    flips = rng.choice((-1.0, 1.0), size=(20, BLOCKS))
    expected = [wald_statistic(f @ sums, f[:, None] * sums - weights @ (f @ sums)) for f in flips]
    candidate = Candidate("any", (), np.zeros(degrees), 1.0, 1.0, 1.0, sums, weights, 1.0)
    assert flipped_statistics(candidate, flips) == pytest.approx(expected, rel=1e-6)


def test_false_alarms_come_as_often_as_said() -> None:
    rng = np.random.default_rng(5)
    alarms = sum(study(rng, 0.0) <= 0.05 for _ in range(STUDIES))
    assert alarms <= 10, "more than 10 % at a level of 5 %"


def test_an_effect_is_seen() -> None:
    rng = np.random.default_rng(6)
    assert sum(study(rng, 0.8) <= 0.01 for _ in range(20)) >= 18


def test_two_effects_are_named_and_a_look_alike_of_the_first_is_taken_out_again() -> None:
    """The gap is worth a thousand times the drag, and is seen by other encoders."""
    both = {"backlash": {"gap_rad": 0.002}, "asymmetric_coulomb": {"torque_Nm": 0.6}}
    found = diagnose(Dataset(campaign(both, 10), Model()))
    assert found.verdict is Verdict.NAMED
    assert {e.name for e in found.effects} == set(both)


@pytest.mark.parametrize(("others", "needed"), [(0.1, 0.4), (0.005, 0.8), (0.0005, math.inf)])
def test_what_one_more_name_must_explain(others: float, needed: float) -> None:
    assert needed_share(others) == needed


@pytest.mark.proof
def test_recordings_of_speed_alone_share_no_origin_of_their_angles() -> None:
    """Each has a phase of its own, and a place says nothing."""
    shared = campaign({"cogging": {"torque_Nm": 1.5, "per_motor_turn": 7.0, "phase_rad": 0.3}}, 3)
    turned = tuple(only_speed(r) for r in shared if r.role == "fit")
    found = diagnose(Dataset(turned, Model()), rng=np.random.default_rng(0))
    assert [e.name for e in found.effects] == ["cogging"]
    assert found.effects[0].parameters["per_motor_turn"].value == 7.0
    assert found.effects[0].parameters["torque_Nm"].value == pytest.approx(1.5, rel=0.1)
    assert any("is counted from its first sample" in w for w in found.warnings)


def only_speed(recording: Recording) -> Recording:
    channels = dict(recording.channels)
    angle = channels.pop("motor_angle") / recording.bench.gear_ratio
    channels.pop("angle")
    channels["velocity"] = np.gradient(angle, channels["time"])
    return replace(recording, channels=channels)


def begun_late(recording: Recording, late_s: float) -> Recording:
    """Return a recording without its first seconds, of which nothing is known."""
    time = recording.channels["time"]
    kept = time - time[0] >= late_s
    channels = {n: c[kept] for n, c in recording.channels.items()}
    channels["time"] = channels["time"] - channels["time"][0]
    return replace(recording, channels=channels)


@pytest.mark.proof
def test_recordings_that_have_no_clock_in_common_each_began_cold() -> None:
    """One that is set aside may have begun warm."""
    hidden = campaign({"coulomb_drift": {"rate_Nm_s": 0.03}}, 3, 6.0)
    assert one_clock(hidden)
    found = diagnose(Dataset(hidden, Model()), rng=np.random.default_rng(0))
    assert [e.name for e in found.effects] == ["coulomb_drift"]
    drift = {"coulomb_drift": {"rate_Nm_s": 0.12, "time_s": 5.0}}
    apart = tuple(
        replace(
            campaign(drift, 3 + k, 6.0)[0],
            name=f"r{k}",
            role="validate" if k == 3 else "fit",
        )
        for k in range(4)
    )
    apart = (*apart[:-1], begun_late(apart[-1], 2.0))
    assert not one_clock(apart)
    found = diagnose(Dataset(apart, Model()), rng=np.random.default_rng(0))
    assert [e.name for e in found.effects] == ["coulomb_drift"]
    assert found.effects[0].parameters["rate_Nm_s"].value == pytest.approx(0.12, rel=0.15)
    assert found.effects[0].parameters["time_s"].value == pytest.approx(5.0, rel=0.3)
    assert any("no common clock" in w for w in found.warnings)


@pytest.mark.parametrize("other", [pytest.param(0.0, marks=pytest.mark.proof), -0.3])
def test_end_stops_are_found_at_one_end_of_the_travel_or_at_both(other: float) -> None:
    stop = {"angle_rad": 0.28, "stiffness_Nm_rad": 60.0, "other_rad": other}
    found = diagnose(
        Dataset(campaign({"end_stop": stop}, 8, 8.0), Model()), rng=np.random.default_rng(0)
    )
    assert [e.name for e in found.effects] == ["end_stop"]
    sizes = found.effects[0].parameters
    assert sizes["angle_rad"].value == pytest.approx(0.28, abs=0.01)
    assert sizes["other_rad"].value == pytest.approx(other, abs=0.01)
    assert sizes["stiffness_Nm_rad"].value == pytest.approx(60.0, rel=0.1)
    assert ("at the other end" in found.statement) == (other < 0.0)
