"""Effects in two forms: the form is identified together with the size."""

from __future__ import annotations

import pytest

from identification.diagnosis.diagnose import diagnose
from identification.recording import Dataset, Model

from .benches import campaign

TIME_S = 0.04
KNEE_A = 30.0


@pytest.mark.proof
@pytest.mark.parametrize("of_speed", [0.0, 1.0])
def test_friction_that_lags_by_its_level_or_by_its_speed(of_speed: float) -> None:
    hidden = {"friction_memory": {"time_s": TIME_S, "of_speed": of_speed}}
    found = diagnose(Dataset(campaign(hidden, 5, 12.0), Model()))
    assert [e.name for e in found.effects] == ["friction_memory"]
    parameters = found.effects[0].parameters
    assert parameters["time_s"].value == pytest.approx(TIME_S, rel=0.05)
    assert parameters["of_speed"].value == of_speed
    assert parameters["of_speed"].low == parameters["of_speed"].high == of_speed


@pytest.mark.parametrize("rational", [0.0, pytest.param(1.0, marks=pytest.mark.proof)])
def test_torque_that_saturates_by_either_law(rational: float) -> None:
    hidden = {"torque_saturation": {"knee_A": KNEE_A, "rational": rational}}
    found = diagnose(Dataset(campaign(hidden, 6, 8.0), Model()))
    assert [e.name for e in found.effects] == ["torque_saturation"]
    parameters = found.effects[0].parameters
    assert parameters["knee_A"].value == pytest.approx(KNEE_A, rel=0.05)
    assert parameters["rational"].value == rational


@pytest.mark.parametrize("with_torque", [0.0, pytest.param(1.0, marks=pytest.mark.proof)])
def test_an_error_of_the_teeth_is_told_from_one_of_the_angle_alone(with_torque: float) -> None:
    wave = {"amplitude_rad": 1e-3, "per_turn": 33.0, "phase_rad": 0.4, "with_torque": with_torque}
    found = diagnose(Dataset(campaign({"gear_mesh_ripple": wave}, 8, 8.0), Model()))
    assert [e.name for e in found.effects] == ["gear_mesh_ripple"]
    parameters = found.effects[0].parameters
    assert parameters["amplitude_rad"].value == pytest.approx(1e-3, rel=0.05)
    assert parameters["with_torque"].value == with_torque


@pytest.mark.proof
@pytest.mark.parametrize("magnet", [0.0, 1.0])
def test_a_winding_that_heats_alone_is_told_from_one_with_its_magnets(magnet: float) -> None:
    """And neither is dropped as the winding of an unseen recording began warm."""
    hidden = {"winding_heating": {"rise_K_per_W": 0.4, "time_s": 60.0, "magnet": magnet}}
    found = diagnose(Dataset(campaign(hidden, 7, 20.0), Model()))
    (effect,) = found.effects
    assert effect.name == "winding_heating"
    assert effect.parameters["magnet"].value == magnet
    assert effect.parameters["rise_K_per_W"].value == pytest.approx(0.4, rel=0.15)
