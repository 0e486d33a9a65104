"""Loads and losses that a machine may have without an effect of friction: each is identified with
its size where it is hidden, and shares a group with what these recordings cannot distinguish.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.result import Diagnosis, Verdict
from identification.recording import Dataset, Recording

from .benches import campaign


def without(recording: Recording, *names: str) -> Recording:
    channels = {n: c for n, c in recording.channels.items() if n not in names}
    return replace(recording, channels=channels, averaged=recording.averaged - {*names})


def found(
    effects: Mapping[str, Mapping[str, float]], seed: int, *dropped: str, supply_V: float = 0.0
) -> Diagnosis:
    recordings = tuple(without(r, *dropped) for r in campaign(effects, seed, 8.0))
    if supply_V:
        recordings = tuple(
            replace(r, bench=replace(r.bench, supply_voltage=supply_V)) for r in recordings
        )
    return diagnose(Dataset(recordings), rng=np.random.default_rng(0))


def test_a_load_above_coulomb_friction_is_no_asymmetry_of_friction() -> None:
    (effect,) = found({"constant_torque": {"torque_Nm": 12.0}}, 3).effects
    assert effect.alias_group == ("constant_torque",)
    assert effect.parameters["torque_Nm"].value == pytest.approx(12.0, rel=0.01)


def test_without_voltage_a_load_may_be_an_offset_of_the_current() -> None:
    (effect,) = found({"constant_torque": {"torque_Nm": -12.0}}, 5, "voltage").effects
    assert {"constant_torque", "current_offset"} == {*effect.alias_group}


def test_a_load_below_coulomb_friction_may_be_an_asymmetry_of_friction() -> None:
    diagnosis = found({"constant_torque": {"torque_Nm": 1.0}}, 4)
    (effect,) = diagnosis.effects
    assert diagnosis.verdict is Verdict.AMBIGUOUS
    assert {"constant_torque", "asymmetric_coulomb"} == {*effect.alias_group}
    assert abs(effect.parameters["torque_Nm"].value) == pytest.approx(1.0, rel=0.03)


@pytest.mark.parametrize(("seed", "loss"), [(3, 0.03), (7, 0.01)])
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


def test_a_declared_supply_gives_the_resistance() -> None:
    (effect,) = found(SAG, 4, "supply_voltage", supply_V=60.0).effects
    assert effect.name == "supply_sag"
    assert effect.parameters["supply_V"].value == 60.0
    assert effect.parameters["resistance_ohm"].value == pytest.approx(0.5, rel=0.1)


def test_with_one_encoder_a_gap_is_a_travel_without_friction() -> None:
    (effect,) = found({"backlash": {"gap_rad": 0.02}}, 3, "angle").effects
    assert effect.alias_group == ("friction_play", "backlash")
    assert effect.parameters["friction_share"].value == pytest.approx(1.0, abs=0.05)
