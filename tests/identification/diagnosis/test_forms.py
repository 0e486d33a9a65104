"""Effects in two forms: the form is identified together with the size."""

from __future__ import annotations

import pytest

from identification.diagnosis.diagnose import diagnose
from identification.recording import Dataset, Model

from .benches import campaign

TIME_S = 0.04
KNEE_A = 30.0


@pytest.mark.parametrize("of_speed", [0.0, 1.0])
def test_friction_that_lags_by_its_level_or_by_its_speed(of_speed: float) -> None:
    hidden = {"friction_memory": {"time_s": TIME_S, "of_speed": of_speed}}
    found = diagnose(Dataset(campaign(hidden, 5, 12.0), Model()))
    assert [e.name for e in found.effects] == ["friction_memory"]
    parameters = found.effects[0].parameters
    assert parameters["time_s"].value == pytest.approx(TIME_S, rel=0.05)
    assert parameters["of_speed"].value == of_speed
    assert parameters["of_speed"].low == parameters["of_speed"].high == of_speed


@pytest.mark.parametrize("rational", [0.0, 1.0])
def test_torque_that_saturates_by_either_law(rational: float) -> None:
    hidden = {"torque_saturation": {"knee_A": KNEE_A, "rational": rational}}
    found = diagnose(Dataset(campaign(hidden, 6, 8.0), Model()))
    assert [e.name for e in found.effects] == ["torque_saturation"]
    parameters = found.effects[0].parameters
    assert parameters["knee_A"].value == pytest.approx(KNEE_A, rel=0.05)
    assert parameters["rational"].value == rational
