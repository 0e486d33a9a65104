"""The diagnosis on recordings of real machines: what their owners know and the tool was not told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose
from identification.recording import Dataset, Recording
from rig.diagnose import as_json, diagnose_source
from rig.sources import load_source

CAMPAIGNS = Path(__file__).parents[1] / "campaigns"
pytestmark = pytest.mark.usefixtures("recordings")


def diagnosed(name: str) -> dict[str, Any]:
    return as_json(diagnose_source(CAMPAIGNS / f"{name}.yaml", 0))


def test_asymmetric_viscous_friction_of_emps() -> None:
    """The authors of the data say so; the record with pulses takes no part and is predicted better."""
    found = diagnosed("emps")
    first = found["effects"][0]
    assert first["name"] == "asymmetric_viscous"
    assert first["parameters"]["coefficient_Nms_rad"]["unit"] == "N s/m"
    assert -45.0 < first["parameters"]["coefficient_Nms_rad"]["value"] < -30.0
    assert found["fit"]["validate_final_rms"] < 0.7 * found["fit"]["validate_baseline_rms"]


def test_seven_periods_a_turn_of_a_motor_turned_slowly_once() -> None:
    """0.79 A by the notes beside the data; one turn at one speed cannot tell cogging from a ripple of the constant."""
    found = diagnosed("odrive_cogging")
    assert found["verdict"] == "ambiguous"
    first = found["effects"][0]
    assert set(first["alias_group"]) == {"cogging", "torque_ripple"}
    assert first["parameters"]["per_motor_turn"]["value"] == 7.0
    assert first["parameters"]["torque_Nm"]["unit"] == "A"
    assert first["parameters"]["torque_Nm"]["value"] == pytest.approx(0.79, rel=0.15)
    assert found["fit"]["validate_final_rms"] < 0.5 * found["fit"]["validate_baseline_rms"]


def test_the_weight_of_one_recording_is_not_what_its_label_says() -> None:
    """0.259 kg labelled 0.457 kg."""
    found = diagnosed("sts3032_wrong_label")
    assert [e["name"] for e in found["effects"]] == ["wrong_weight"]
    mass = found["effects"][0]["parameters"]["mass_kg"]
    assert mass["low"] < 0.259 < mass["high"]
    assert mass["high"] < 0.3
    assert found["effects"][0]["where"]["recordings"] == ["m259g_l100mm_kp16_up_and_down"]


def test_a_delay_laid_into_real_channels_comes_back() -> None:
    """Four milliseconds, beside the 0.76 ms that the machine has by itself."""
    dataset = load_source(CAMPAIGNS / "emps.yaml")
    own = skew(dataset)
    late = skew(Dataset(tuple(delayed(r, 0.004) for r in dataset.recordings), dataset.model))
    assert late - own == pytest.approx(-0.004, rel=0.05)


def skew(dataset: Dataset) -> float:
    found = diagnose(dataset, rng=np.random.default_rng(0))
    return next(e.parameters["time_s"].value for e in found.effects if e.name == "time_skew")


def delayed(recording: Recording, seconds: float) -> Recording:
    time = recording.time
    late = np.interp(time - seconds, time, recording.channels["angle"])
    return replace(recording, channels={**recording.channels, "angle": late})
