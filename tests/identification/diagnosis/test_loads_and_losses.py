"""Loads and losses that a machine may have without an effect of friction: each is identified with
its size where it is hidden, and shares a group with what these recordings cannot distinguish.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.result import Diagnosis, Verdict
from identification.recording import Dataset, Pendulum, Recording

from .benches import FEW, PLAN, campaign

PROOF = pytest.mark.proof


def without(recording: Recording, *names: str) -> Recording:
    channels = {n: c for n, c in recording.channels.items() if n not in names}
    return replace(recording, channels=channels, averaged=recording.averaged - {*names})


def found(
    effects: Mapping[str, Mapping[str, float]],
    seed: int,
    *dropped: str,
    supply_V: float = 0.0,
    plan: Any = FEW,
) -> Diagnosis:
    recordings = tuple(without(r, *dropped) for r in campaign(effects, seed, 8.0, plan))
    if supply_V:
        recordings = tuple(
            replace(r, bench=replace(r.bench, supply_voltage=supply_V)) for r in recordings
        )
    return diagnose(Dataset(recordings), rng=np.random.default_rng(0))


def test_a_load_above_coulomb_friction_is_no_asymmetry_of_friction() -> None:
    (effect,) = found({"constant_torque": {"torque_Nm": 12.0}}, 3).effects
    assert effect.alias_group == ("constant_torque",)
    assert effect.parameters["torque_Nm"].value == pytest.approx(12.0, rel=0.01)


@PROOF
def test_without_voltage_a_load_may_be_an_offset_of_the_current() -> None:
    (effect,) = found({"constant_torque": {"torque_Nm": -12.0}}, 5, "voltage").effects
    assert {"constant_torque", "current_offset"} == {*effect.alias_group}


@PROOF
def test_a_load_below_coulomb_friction_may_be_an_asymmetry_of_friction() -> None:
    diagnosis = found({"constant_torque": {"torque_Nm": 1.0}}, 4)
    (effect,) = diagnosis.effects
    assert diagnosis.verdict is Verdict.AMBIGUOUS
    assert {"constant_torque", "asymmetric_coulomb"} == {*effect.alias_group}
    assert abs(effect.parameters["torque_Nm"].value) == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize(("seed", "loss"), [(3, 0.03), pytest.param(7, 0.01, marks=PROOF)])
def test_a_loss_of_the_motor_grows_with_its_current_and_speed(seed: int, loss: float) -> None:
    (effect,) = found({"stray_loss": {"coefficient_Nms_A2rad": loss}}, seed).effects
    assert effect.alias_group == ("stray_loss",)
    assert effect.parameters["coefficient_Nms_A2rad"].value == pytest.approx(loss, rel=0.1)


SAG = {"supply_sag": {"resistance_ohm": 0.5}}


def test_a_supply_without_a_log_has_one_voltage_in_all_recordings() -> None:
    diagnosis = found(SAG, 3, "supply_voltage")
    (effect,) = diagnosis.effects
    assert effect.name == "supply_sag"
    share = effect.parameters["resistance_ohm"].value / effect.parameters["supply_V"].value ** 2
    assert share == pytest.approx(0.5 / 60.0**2, rel=0.1)


@PROOF
def test_a_declared_supply_gives_the_resistance() -> None:
    (effect,) = found(SAG, 4, "supply_voltage", supply_V=60.0).effects
    assert effect.name == "supply_sag"
    assert effect.parameters["supply_V"].value == 60.0
    assert effect.parameters["resistance_ohm"].value == pytest.approx(0.5, rel=0.1)


@PROOF
def test_with_one_encoder_a_gap_is_a_travel_without_friction() -> None:
    (effect,) = found({"backlash": {"gap_rad": 0.02}}, 3, "angle", plan=PLAN).effects
    assert effect.alias_group == ("friction_play", "backlash")
    assert effect.parameters["friction_share"].value == pytest.approx(1.0, abs=0.05)


@PROOF
def test_friction_of_a_gear_grows_with_its_torque_and_builds_up_over_a_travel() -> None:
    hidden = {
        "gear_friction": {"travel_rad": 0.01, "against_motion": 0.15, "against_torque": 0.05},
        "gravity_imbalance": {"torque_Nm": 20.0, "zero_rad": 0.3},
    }
    weight = Pendulum(mass=20.0 / 9.80665 / 0.02, length=0.02, zero=0.3)
    recordings = tuple(replace(r, pendulum=weight) for r in campaign(hidden, 3, 8.0))
    (effect,) = diagnose(Dataset(recordings), rng=np.random.default_rng(0)).effects
    assert effect.alias_group == ("gear_friction",)
    found = {n: p.value for n, p in effect.parameters.items()}
    assert found["travel_rad"] == pytest.approx(0.01, rel=0.15)
    assert found["against_motion"] + found["against_torque"] == pytest.approx(0.2, rel=0.1)


@pytest.mark.parametrize(("seed", "cycles"), [(3, 1.0), pytest.param(4, 2.0, marks=PROOF)])
def test_an_encoder_that_swings_is_no_cogging(seed: int, cycles: float) -> None:
    hidden = {"amplitude_rad": 0.02, "per_turn": cycles, "phase_rad": 0.5}
    (effect,) = found({"encoder_ripple": hidden}, seed, "angle").effects
    assert effect.alias_group == ("encoder_ripple",)
    assert effect.parameters["per_turn"].value == cycles
    assert effect.parameters["amplitude_rad"].value == pytest.approx(0.02, rel=0.1)
    assert effect.parameters["phase_rad"].value == pytest.approx(0.5, abs=0.1)


@PROOF
def test_with_one_encoder_a_machine_that_hides_nothing_raises_no_alarm() -> None:
    assert found({}, 5, "angle").verdict is Verdict.NOTHING_MISSING
