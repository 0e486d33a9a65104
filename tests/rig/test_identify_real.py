"""Real recordings through the whole of identification, against published values where there are any."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from identification.estimate.default import identify
from identification.estimate.result import Identification
from rig.sources import load_source

CAMPAIGNS = Path(__file__).parents[1] / "campaigns"


def result_of(name: str) -> Identification:
    return identify(load_source(CAMPAIGNS / name), rng=np.random.default_rng(0))


@pytest.mark.recordings
def test_emps_against_the_published_least_squares(recordings: Path) -> None:
    found = result_of("emps.yaml")
    values = found.values()
    assert values["J"] == pytest.approx(95.1089, rel=0.01)
    assert values["sigma_2"] == pytest.approx(203.5034, rel=0.01)
    assert values["Mc"] == pytest.approx(20.3935, rel=0.01)
    assert values["offset"] == pytest.approx(-3.1648, rel=0.02)
    assert found.fit.unit == "N"
    assert found.fit.bandwidth_Hz == pytest.approx(40.0, rel=1e-3)
    assert found.fit.train_relative <= 0.0415
    assert found.fit.validate_relative is not None
    assert found.fit.validate_relative <= 0.0602


@pytest.mark.recordings
def test_emps_shows_no_rise_toward_rest_and_says_so(recordings: Path) -> None:
    found = result_of("emps.yaml")
    for name in ("Ms", "omega_sf"):
        assert not found.parameters[name].identifiable
        assert found.parameters[name].value is None
        assert found.parameters[name].reason


@pytest.mark.recordings
def test_sts3032_predicts_the_other_mass_in_volts(recordings: Path) -> None:
    """Each mass predicted from the other costs at most 5 % more volts than fitting it."""
    to_heavy, to_light = result_of("sts3032_to_heavy.yaml"), result_of("sts3032_to_light.yaml")
    for found, own in ((to_heavy, to_light), (to_light, to_heavy)):
        assert found.fit.unit == "V"
        assert found.fit.validate_rms is not None
        assert found.fit.validate_rms < 1.05 * own.fit.train_rms
        assert found.fit.train_relative < 0.35
        assert len(found.fits_by_recording) == len(found.traces) == 54


@pytest.mark.recordings
def test_a_wrong_sign_of_the_zero_is_worse_on_both_masses(recordings: Path, tmp_path: Path) -> None:
    """The evidence behind docs/decisions/0005."""
    text = (CAMPAIGNS / "sts3032_to_heavy.yaml").read_text()
    text = text.replace("../../../shared", str(CAMPAIGNS.parents[2] / "shared"))
    assert "zero: 0.1258" in text
    flipped = tmp_path / "flipped.yaml"
    flipped.write_text(text.replace("zero: 0.1258", "zero: -0.1258"))
    right = result_of("sts3032_to_heavy.yaml").fit
    wrong = identify(load_source(flipped), rng=np.random.default_rng(0)).fit
    assert right.validate_rms is not None
    assert wrong.validate_rms is not None
    assert wrong.train_rms > 1.2 * right.train_rms
    assert wrong.validate_rms > 1.2 * right.validate_rms


@pytest.mark.recordings
def test_the_lead_screw_has_a_stribeck_speed_and_the_anti_backlash_screw_none(recordings: Path) -> None:
    first, second = result_of("screw_drive_1.yaml"), result_of("screw_drive_2.yaml")
    speed = first.parameters["omega_sf"]
    assert speed.value is not None
    assert speed.low is not None
    assert 2.5 < speed.value < 6.0
    assert speed.low > 1.0
    assert not second.parameters["omega_sf"].identifiable
    assert not second.parameters["Ms"].identifiable
