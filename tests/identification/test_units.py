"""Units of rotary and linear benches, and the names that text shows."""

import numpy as np
import pytest

from identification.diagnosis.result import Estimate
from identification.diagnosis.statement import sentence
from identification.effects import EFFECTS
from identification.model.parameters import parameter_title, parameter_unit, torque_word, unit_on
from identification.prepare import drive_channel, torque_unit
from identification.recording import Bench, Recording


@pytest.mark.parametrize(
    ("unit", "linear", "amperes"),
    [
        ("N m", "N", "A"),
        ("rad/s", "m/s", "m/s"),
        ("N m s/rad", "N s/m", "A s/m"),
        ("kg m^2", "kg", "A s^2/m"),
        ("s/rad", "s/m", "s/m"),
        ("deg C", "deg C", "deg C"),
    ],
)
def test_a_unit_on_a_linear_bench(unit: str, linear: str, amperes: str) -> None:
    assert unit_on("rotary", unit) == unit
    assert unit_on("linear", unit) == linear
    assert unit_on("linear", unit, amperes=True) == amperes


@pytest.mark.parametrize(
    ("channels", "motion", "word", "unit"),
    [
        (("torque",), "linear", "force", "N"),
        (("torque", "current"), "rotary", "torque", "N m"),
        (("current",), "rotary", "current", "A"),
        (("voltage",), "linear", "voltage", "A"),
    ],
)
def test_the_logged_quantity_is_named(channels, motion, word, unit):
    time = np.arange(4) * 1e-3
    recording = Recording(
        time, time, channels=dict.fromkeys(channels, time), bench=Bench(motion=motion)
    )
    assert drive_channel(recording) == word
    assert torque_unit(recording) == unit
    late = {"time_s": Estimate(0.00078, 0.0007, 0.0009, "s")}
    assert sentence(EFFECTS["time_skew"], late, (), word).startswith(f"the {word} is sampled 0.78")
    assert torque_word("rotary") == "torque"


@pytest.mark.parametrize("entry", EFFECTS.values(), ids=lambda e: e.name)
def test_parameters_of_effects_have_no_rotary_unit_on_a_linear_bench(entry: object) -> None:
    for q in entry.parameters:  # type: ignore[attr-defined]
        unit, title = parameter_unit("linear", q.name, q.unit), parameter_title("linear", q.name)
        assert parameter_title("rotary", q.name) == q.name
        if not q.name.startswith(("phase", "zero")):
            assert "rad" not in unit
            assert "N m" not in unit
            assert "rad" not in title.replace("per_rad", "")
            assert "Nm" not in title
    assert parameter_title("linear", "torque_Nm") == "torque_N"
    assert parameter_title("linear", "phase_rad") == "phase_rad"
