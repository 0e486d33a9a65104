"""Friction that follows a late speed, or whose level is late: one effect in two forms."""

from __future__ import annotations

import pytest

from identification.diagnosis.diagnose import diagnose
from identification.recording import Dataset, Model

from .benches import campaign

TIME_S = 0.04


@pytest.mark.parametrize("of_speed", [0.0, 1.0])
def test_each_form_is_identified_with_its_time(of_speed: float) -> None:
    hidden = {"friction_memory": {"time_s": TIME_S, "of_speed": of_speed}}
    found = diagnose(Dataset(campaign(hidden, 5, 8.0), Model()))
    assert [e.name for e in found.effects] == ["friction_memory"]
    parameters = found.effects[0].parameters
    assert parameters["time_s"].value == pytest.approx(TIME_S, rel=0.15)
    assert parameters["of_speed"].value == of_speed
    assert parameters["of_speed"].low == parameters["of_speed"].high == of_speed
