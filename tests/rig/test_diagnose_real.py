"""The diagnosis on recordings of real machines, held against what their owners know."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.result import Diagnosis, Verdict
from identification.diagnosis.search import Search
from identification.numerics.series import play
from identification.recording import Dataset, Recording
from rig.results.diagnose.diagnose import diagnose_source
from rig.sources import load_source

PERIOD_SAMPLES = 6240
"""Of the motion of emps, which repeats to within a micrometre: what one period reads later than
another is noise.
"""
NEWTONS_PER_UNIT = 35.15065188248547
CAMPAIGNS = Path(__file__).parents[1] / "campaigns"
pytestmark = pytest.mark.usefixtures("recordings")


def diagnosed(name: str) -> dict[str, Any]:
    return diagnose_source(CAMPAIGNS / f"{name}.yaml", 0).record()


@pytest.mark.proof
def test_asymmetric_viscous_friction_of_emps() -> None:
    """The authors of the data say so; beside it a flexibility that they suspect is missing."""
    found = diagnose_source(CAMPAIGNS / "emps.yaml", 0).diagnosis
    assert found.verdict is Verdict.OUTSIDE_CATALOGUE
    added = [step.name for step in found.steps if step.action == "add"]
    assert added[:2] == ["asymmetric_viscous", "time_skew"]
    with_pulses = diagnosed("emps_pulses")
    coefficient = with_pulses["effects"][0]["parameters"]["coefficient_Nms_rad"]
    assert with_pulses["effects"][0]["name"] == "asymmetric_viscous"
    assert coefficient["unit"] == "N s/m"
    assert -45.0 < coefficient["value"] < -30.0
    assert with_pulses["fit"]["final_rms"] < 0.5 * with_pulses["fit"]["baseline_rms"]


@pytest.mark.proof
def test_the_play_of_a_band_that_one_sensor_sees(recordings: Path) -> None:
    """Least squares over all samples: 7.6 mm; 67 noise floors are left, so that it is a part."""
    searches: list[Search] = []
    dataset = load_source(recordings / "campaigns" / "friction_damper.yaml")
    found = diagnose(dataset, rng=np.random.default_rng(0), searched=searches.append)
    assert found.verdict is Verdict.OUTSIDE_CATALOGUE
    (play_of_the_band,) = searches[-1].final.effects
    assert play_of_the_band.term.name == "friction_play"
    assert play_of_the_band.shape[0] == pytest.approx(7.6e-3, rel=0.1)


def test_seven_periods_a_turn_of_a_motor_turned_slowly_once() -> None:
    """0.79 A by the notes beside the data."""
    found = diagnosed("odrive_cogging")
    assert found["verdict"] == "named"
    first = found["effects"][0]
    assert first["alias_group"] == ["cogging"]
    assert first["parameters"]["per_motor_turn"]["value"] == 7.0
    assert first["parameters"]["torque_Nm"]["unit"] == "A"
    assert first["parameters"]["torque_Nm"]["value"] == pytest.approx(0.79, rel=0.15)
    assert found["fit"]["validate_final_rms"] < 0.5 * found["fit"]["validate_baseline_rms"]


@pytest.mark.proof
def test_the_weight_of_one_recording_is_not_what_its_label_says() -> None:
    """0.259 kg labelled 0.457 kg."""
    found = diagnosed("sts3032_wrong_label")
    assert [e["name"] for e in found["effects"]] == ["wrong_weight"]
    mass = found["effects"][0]["parameters"]["mass_kg"]
    assert mass["low"] < 0.259 < mass["high"]
    assert mass["high"] < 0.35
    assert found["effects"][0]["where"]["recordings"] == ["m259g_l100mm_kp16_up_and_down"]


@pytest.mark.proof
def test_a_delay_laid_into_real_channels_comes_back() -> None:
    """Four milliseconds, beside the 0.76 ms that the machine has by itself."""
    dataset = load_source(CAMPAIGNS / "emps.yaml")
    own = skew(dataset)
    late = skew(Dataset(tuple(delayed(r, 0.004) for r in dataset.recordings), dataset.model))
    assert late - own == pytest.approx(-0.004, rel=0.05)


@pytest.mark.proof
def test_a_constant_load_on_a_screw() -> None:
    """Half the sum of the mean torques both ways is -0.26 to -0.40 mN m."""
    found = diagnosed("screw_drive_1_untold")
    assert found["verdict"] == "ambiguous"
    effect = found["effects"][0]
    assert {*effect["alias_group"]} == {"asymmetric_coulomb", "constant_torque"}
    # A torque that helps the positive direction is friction that is lower there.
    sign = {"constant_torque": 1.0, "asymmetric_coulomb": -1.0}[effect["name"]]
    assert 0.25e-3 < sign * effect["parameters"]["torque_Nm"]["value"] < 0.40e-3
    assert found["fit"]["validate_final_rms"] < 0.5 * found["fit"]["validate_baseline_rms"]


@pytest.mark.proof
def test_a_swing_that_makes_unseen_recordings_worse_is_not_named() -> None:
    """Only speeds were recorded: no two recordings share an angle."""
    found = diagnosed("screw_drive_2_untold")
    assert found["verdict"] == "outside_catalogue"
    assert found["fit"]["validate_final_rms"] == found["fit"]["validate_baseline_rms"]


@pytest.mark.proof
def test_two_recordings_of_the_heavy_mass_stand_under_a_torque_that_did_not_reach_the_motor():
    """They fall at 4.6 s and stay, while the firmware asks for 5.4 V up."""
    said = [w for w in diagnosed("sts3032_to_light")["warnings"] if "the joint rests" in w]
    assert [w.split(":")[0] for w in said] == [
        f"m457g_l100mm_kp{gain}_up_and_down" for gain in (16, 32)
    ]
    assert all("to 6.00 s the joint rests at 4" in w for w in said)


@pytest.mark.proof
def test_how_late_the_servos_samples_are_is_what_the_notes_beside_them_say(tmp_path: Path) -> None:
    """5 to 10 ms by the notes."""
    text = (
        (CAMPAIGNS / "sts3032_to_heavy.yaml")
        .read_text()
        .replace("terms: []", "terms: [load_dependent_friction]")
    )
    path = tmp_path / "campaign.yaml"
    path.write_text(text.replace("../../../shared", str(CAMPAIGNS.parents[2] / "shared")))
    found = diagnose_source(path, 0, bandwidth_Hz=25.0).record()
    first = found["effects"][0]
    assert first["alias_group"] == ["time_skew"]
    assert "after the angles" in first["statement"]
    late = first["parameters"]["time_s"]
    assert 0.005 < -late["value"] < 0.010
    assert late["high"] - late["low"] < 0.002
    assert found["fit"]["final_rms"] < 0.8 * found["fit"]["baseline_rms"]
    assert found["fit"]["validate_final_rms"] < 0.95 * found["fit"]["validate_baseline_rms"]


@pytest.mark.proof
def test_what_makes_unseen_recordings_worse_is_no_name_and_said_so(tmp_path: Path) -> None:
    """Without the controller's law nobody knows that the voltage was computed."""
    text = (
        (CAMPAIGNS / "sts3032_to_heavy.yaml")
        .read_text()
        .replace("terms: []", "terms: [load_dependent_friction]")
    )
    text = re.sub(r"^ +controller:.*\n", "", text, flags=re.MULTILINE)
    path = tmp_path / "campaign.yaml"
    path.write_text(text.replace("../../../shared", str(CAMPAIGNS.parents[2] / "shared")))
    found = diagnose_source(path, 0, bandwidth_Hz=25.0).record()
    assert found["verdict"] == "outside_catalogue"
    assert found["effects"] == []
    (line,) = [w for w in found["warnings"] if "is not identified" in w]
    assert re.match(
        r"time skew explains part .* set aside the effect makes the error larger by \d", line
    )
    assert found["fit"]["equation"] == "torque"


@pytest.mark.parametrize(
    ("mass", "length"),
    [
        pytest.param(259, 50, marks=pytest.mark.proof),
        (259, 70),
        (259, 100),
        pytest.param(457, 50, marks=pytest.mark.proof),
    ],
)
def test_a_weight_that_was_not_declared_is_found(mass: int, length: int, tmp_path: Path) -> None:
    """The drive is stronger than declared, so that all values are low (docs/measurements.md)."""
    text = (CAMPAIGNS / "sts3032_no_weight.yaml").read_text()
    path = tmp_path / "campaign.yaml"
    text = text.replace("../../../shared", str(CAMPAIGNS.parents[2] / "shared"))
    path.write_text(text.replace("m259g_l100mm", f"m{mass}g_l{length:03d}mm"))
    found = diagnose_source(path, 0).record()
    first = found["effects"][0]
    assert first["name"] == "gravity_imbalance"
    assert set(first["alias_group"]) <= {"gravity_imbalance", "return_spring"}
    weight = 9.80665e-6 * mass * length
    assert 0.8 * weight < first["parameters"]["torque_Nm"]["value"] < weight
    assert found["fit"]["validate_final_rms"] < min(
        0.2 * weight, 0.5 * found["fit"]["validate_baseline_rms"]
    )


@pytest.mark.proof
@pytest.mark.parametrize("amperes", [0.3, -0.3])
def test_a_constant_current_added_to_real_channels_comes_back(amperes: float) -> None:
    """No motion at one load tells it from asymmetric friction."""
    own = diagnosed_in_amperes(0.0, declared=True).parameter_shift["offset"]
    found = diagnosed_in_amperes(amperes, declared=False)
    effect = next(e for e in found.effects if "current_offset" in e.alias_group)
    assert {"current_offset", "asymmetric_coulomb"} <= set(effect.alias_group)
    if effect.name == "current_offset":
        size = effect.parameters["current_A"].value * NEWTONS_PER_UNIT
    else:
        # A constant torque has the sign of a load that is supplied.
        size = effect.parameters["torque_Nm"].value
        size *= -1.0 if effect.name == "constant_torque" else 1.0
    added = NEWTONS_PER_UNIT * amperes
    # Asymmetric viscous friction takes the machine's own constant up, where it is named.
    asymmetric = any(e.name == "asymmetric_viscous" for e in found.effects)
    assert own.before is not None
    beside = [own.before, 0.0] if asymmetric else [own.before]
    assert min(abs(size - own_part - added) for own_part in beside) < 0.15 * abs(added)
    assert found.fit.validate_final_rms is not None
    assert found.fit.validate_baseline_rms is not None
    assert found.fit.validate_final_rms < 0.3 * found.fit.validate_baseline_rms


@cache
def diagnosed_in_amperes(added: float, declared: bool) -> Diagnosis:
    dataset = load_source(CAMPAIGNS / "emps.yaml")
    model = replace(dataset.model, terms=dataset.model.terms if declared else ())
    recordings = tuple(with_current(r, added) for r in dataset.recordings)
    return diagnose(Dataset(recordings, model), rng=np.random.default_rng(0))


def with_current(recording: Recording, added: float) -> Recording:
    channels = dict(recording.channels)
    channels["current"] = channels.pop("torque") / NEWTONS_PER_UNIT + added
    return replace(
        recording,
        channels=channels,
        bench=replace(recording.bench, torque_constant=NEWTONS_PER_UNIT),
    )


@pytest.mark.proof
@pytest.mark.parametrize("gap_m", [2e-5, 1e-4])
def test_a_dead_zone_laid_between_real_channels_comes_back(gap_m: float) -> None:
    """The second encoder is the first one a period later, behind a gap."""
    record = load_source(CAMPAIGNS / "emps.yaml").recordings[0]
    twice = behind_a_gap(record, gap_m)
    half = len(twice.time) - PERIOD_SAMPLES
    parts = (portion(twice, slice(0, half), "fit"), portion(twice, slice(half, None), "validate"))
    found = diagnose(
        Dataset(parts, load_source(CAMPAIGNS / "emps.yaml").model), rng=np.random.default_rng(0)
    )
    effect = next(e for e in found.effects if e.name == "backlash")
    assert set(effect.alias_group) <= {"backlash", "coupling_hysteresis"}
    assert effect.parameters["gap_rad"].unit == "m"
    assert effect.parameters["gap_rad"].low < gap_m < effect.parameters["gap_rad"].high
    fit = next(f for f in found.fits if f.equation == "transmission")
    assert fit.validate_baseline_rms == pytest.approx(0.5 * gap_m, rel=0.05)
    assert fit.validate_final_rms is not None
    assert fit.validate_final_rms < 1e-6


def behind_a_gap(record: Recording, gap_m: float) -> Recording:
    position = record.channels["angle"]
    later = position[PERIOD_SAMPLES:]
    assert np.max(np.abs(later - position[:-PERIOD_SAMPLES])) < 2e-6
    channels = {name: values[:-PERIOD_SAMPLES] for name, values in record.channels.items()}
    channels["motor_angle"] = channels["angle"]
    channels["angle"] = later - play(later, gap_m)
    return replace(record, channels=channels)


def portion(record: Recording, where: slice, role: str) -> Recording:
    channels = {name: values[where] for name, values in record.channels.items()}
    return replace(record, name=f"{record.name} {role}", role=role, channels=channels)


def skew(dataset: Dataset) -> float:
    found = diagnose(dataset, rng=np.random.default_rng(0))
    return next(e.parameters["time_s"].value for e in found.effects if e.name == "time_skew")


def delayed(recording: Recording, seconds: float) -> Recording:
    time = recording.time
    late = np.interp(time - seconds, time, recording.channels["angle"])
    return replace(recording, channels={**recording.channels, "angle": late})
