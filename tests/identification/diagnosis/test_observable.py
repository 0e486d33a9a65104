"""What recordings can show, what the true effects gain, and what is wrong in one recording."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose, observable_effects
from identification.diagnosis.held_out import (
    oracle,
)
from identification.diagnosis.joint import Joint
from identification.diagnosis.observable import Observable
from identification.diagnosis.result import Verdict
from identification.diagnosis.significance import rests_under_torque, trusted
from identification.recording import Dataset, Model, Recording
from identification.views.view import View, views

from .benches import FEW, campaign, nominal_fit

TEETH = 18
RATE_HZ = 500.0


@lru_cache
def nothing_hidden() -> dict[str, Observable]:
    found = observable_effects(Dataset(campaign({}, 3, 6.0, FEW), Model()))
    return {o.name: o for o in found}


def one_way(role: str, seed: int, amplitude_A: float) -> Recording:
    """A motor that turns one way, at a speed that hardly varies, with cogging; in amperes."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(12.0 * RATE_HZ)) / RATE_HZ
    speed = 6.0 + 0.5 * np.sin(0.7 * time)
    angle = np.cumsum(speed) / RATE_HZ
    current = 0.05 + 2e-3 * speed + amplitude_A * np.sin(TEETH * angle + 0.4)
    channels = {
        "time": time,
        "angle": np.round(angle / 1e-4) * 1e-4,
        "current": current + 0.004 * rng.standard_normal(len(time)),
    }
    return Recording(name=f"turn {seed}", channels=channels, role=role)  # type: ignore[arg-type]


def test_effects_of_one_regressor_are_alike_and_others_are_not() -> None:
    found = nothing_hidden()
    assert "cogging" not in found["torque_ripple"].alike
    assert found["gravity_imbalance"].alike.keys() >= {"return_spring"}
    assert found["brush_drop"].alike.keys() >= {"inverter_dead_time"}


def test_an_effect_is_found_above_its_least_size_and_not_below() -> None:
    least = nothing_hidden()["gravity_imbalance"].sizes["torque_Nm"]
    for times, missing in ((0.1, False), (8.0, True)):
        hidden = {"gravity_imbalance": {"torque_Nm": times * least, "zero_rad": 0.0}}
        found = diagnose(Dataset(campaign(hidden, 3, 6.0, FEW), Model()))
        assert (found.verdict is not Verdict.NOTHING_MISSING) == missing


def test_a_turn_one_way_does_not_distinguish_cogging_from_ripple() -> None:
    dataset = Dataset(
        (one_way("fit", 1, 0.03), one_way("fit", 2, 0.03), one_way("validate", 3, 0.03)),
        Model(terms=("offset",)),
    )
    seen = {o.name: o for o in observable_effects(dataset)}
    assert seen["cogging"].alike["torque_ripple"] == pytest.approx(1.0, abs=0.01)
    found = diagnose(dataset)
    assert found.verdict is Verdict.AMBIGUOUS
    assert {"cogging", "torque_ripple"} <= set(found.effects[0].alias_group)
    assert found.effects[0].confidence <= 0.5
    assert seen["backlash"].sizes == {}


VISCOUS = {"coefficient_Nms_rad": 0.4}


@pytest.fixture(scope="module")
def lopsided() -> tuple[Recording, ...]:
    return campaign({"asymmetric_viscous": VISCOUS}, 2, 6.0)


@pytest.fixture(scope="module")
def first(lopsided: tuple[Recording, ...]) -> Joint:
    return nominal_fit(lopsided)


def test_the_oracle_gains_what_is_there(lopsided: tuple[Recording, ...], first: Joint) -> None:
    found = oracle(Dataset(lopsided), first, ["asymmetric_viscous"], 25.0)
    assert found.equation == "torque"
    assert found.oracle_rms < 1.3 * found.noise_rms < 0.3 * found.baseline_rms
    both = oracle(Dataset(lopsided), first, ["asymmetric_viscous", "torque_ripple"], 25.0)
    assert both.oracle_rms == pytest.approx(found.oracle_rms, rel=0.05)
    wrong = oracle(Dataset(lopsided), first, ["cogging"], 25.0)
    assert wrong is None or wrong.baseline_rms - wrong.oracle_rms < 0.1 * (
        found.baseline_rms - found.oracle_rms
    )


def test_without_recordings_set_aside_there_is_no_oracle(lopsided, first):
    fitted = tuple(r for r in lopsided if r.role == "fit")
    assert oracle(Dataset(fitted), first, ["asymmetric_viscous"], 25.0) is None


FROM_S, TO_S = 7.0, 9.0


@pytest.fixture(scope="module")
def recordings() -> tuple[Recording, ...]:
    return campaign({"dwell_static_friction": {"growth_Nm": 3.0, "time_s": 1.0}}, 4)


def held(recording: Recording, torque_Nm: float) -> Recording:
    """Return a recording that stands for a while where it is, whatever the drive is asked for."""
    time, channels = recording.time, dict(recording.channels)
    where = (time >= FROM_S) & (time < TO_S)
    first = int(np.argmax(where))
    for name in ("angle", "motor_angle"):
        channels[name] = np.where(where, channels[name][first], channels[name])
    channels["current"] = np.where(where, torque_Nm / 3.0, channels["current"])
    return replace(recording, channels=channels)


def seen(recordings: tuple[Recording, ...]) -> tuple[View, ...]:
    return views(recordings, 25.0)


def test_a_joint_that_stands_under_a_torque_that_never_reached_it_is_told(recordings):
    assert rests_under_torque(seen(recordings), "N m") == ()
    every = seen((held(recordings[0], 150.0), *recordings[1:]))
    (line,) = rests_under_torque(every, "N m")
    assert trusted(every[:3], every) == every[1:3]
    assert trusted(every[:1], every) == every[:1]
    assert line.startswith(f"{recordings[0].name}: from 7.0")
    assert "to 9.0" in line
    assert "under a logged torque of 1.5e+02 N m" in line


def test_what_friction_holds_is_not_told(recordings: tuple[Recording, ...]) -> None:
    """Nor what the heaviest weight may hold, for which no other recording is a measure."""
    assert rests_under_torque(seen((held(recordings[0], 8.0), *recordings[1:])), "N m") == ()
    heaviest = max(range(len(recordings)), key=lambda k: recordings[k].contact_force)
    changed = tuple(held(r, 150.0) if k == heaviest else r for k, r in enumerate(recordings))
    assert rests_under_torque(seen(changed), "N m") == ()


def test_a_view_knows_the_recording_before_it_on_its_clock(recordings) -> None:
    late = [replace(r, session="second") for r in recordings[2:4]]
    linked = seen((recordings[1], recordings[0], *late))
    assert [None if v.before is None else v.before.recording.name for v in linked] == [
        recordings[0].name, None, None, late[0].name,
    ]  # fmt: skip
    every_at_zero = tuple(
        replace(r, channels={**r.channels, "time": r.time - r.time[0]}) for r in recordings
    )
    assert all(v.before is None for v in seen(every_at_zero))
