"""Real recordings through the whole of identification, against published values."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from identification.estimate.default import identify
from identification.estimate.ladder import climb, transfer
from identification.estimate.parameter_table import fit_of
from identification.estimate.simulated_ladder import climb_simulated
from identification.model.parameters import DIRECTIONAL, LADDER, TRANSMITTED
from identification.prepare import prepare
from identification.result import Identification
from rig.results.identify.simulate import simulate_source
from rig.sources import load_source

CAMPAIGNS = Path(__file__).parents[1] / "campaigns"


@cache
def result_of(name: str) -> Identification:
    return identify(load_source(CAMPAIGNS / name), rng=np.random.default_rng(0))


@pytest.mark.recordings
def test_emps_against_the_published_least_squares(recordings: Path) -> None:
    found = result_of("emps.yaml")
    values = found.values
    assert values["J"] == pytest.approx(95.1089, rel=0.01)
    assert values["sigma_2"] == pytest.approx(203.5034, rel=0.01)
    assert values["Mc"] == pytest.approx(20.3935, rel=0.01)
    assert values["offset"] == pytest.approx(-3.1648, rel=0.02)
    assert found.fit.unit == "N"
    assert found.fit.bandwidth_Hz == pytest.approx(40.0, rel=1e-3)
    # The published errors are over all samples in motion, reversals included.
    every = [
        prepare(r, found.fit.bandwidth_Hz) for r in load_source(CAMPAIGNS / "emps.yaml").recordings
    ]
    fitted, aside = ([p for p in every if p.recording.role == role] for role in ("fit", "validate"))
    published = fit_of(fitted, found.fitted, found.alpha, aside)
    assert published.train_relative <= 0.0415
    assert published.validate_relative is not None
    assert published.validate_relative <= 0.0602
    assert found.fit.train_relative <= 0.0415


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
    """The evidence for the sign of the zero in the campaign file."""
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
@pytest.mark.parametrize("way", ["", "_forward", "_backward"])
def test_the_lead_screw_has_a_stribeck_speed_and_the_anti_backlash_screw_none(recordings, way):
    """At 2 rpm the lead screw sticks and slips, and nothing of that is fitted."""
    first, second = result_of(f"screw_drive_1{way}.yaml"), result_of(f"screw_drive_2{way}.yaml")
    assert first.alpha == second.alpha == 2.0
    speed = first.parameters["omega_sf"]
    assert speed.value is not None
    assert speed.low is not None
    assert 2.5 < speed.value < 6.0
    assert speed.low > 0.5  # the interval contains what the model lacks
    slow = [trace for trace in first.traces if trace.recording in ("2", "n2")]
    assert slow
    assert not any(np.any(trace.used) for trace in slow)
    assert not second.parameters["omega_sf"].identifiable
    assert not second.parameters["Ms"].identifiable


@pytest.mark.proof
@pytest.mark.recordings
def test_the_ladder_carried_over_to_the_other_mass_gets_better_with_the_load_in_friction(
    recordings: Path,
) -> None:
    """Volts and simulated angle on the mass that was not fitted."""
    for name, worst_mrad in (("sts3032_to_heavy.yaml", 70.0), ("sts3032_to_light.yaml", 30.0)):
        dataset = load_source(CAMPAIGNS / name)
        rungs = {
            r.friction: r for r in climb(dataset, bandwidth_Hz=None, rng=np.random.default_rng(1))
        }
        assert list(rungs) == list(LADDER)
        scored = {friction: rung.result.fit.validate_rms for friction, rung in rungs.items()}
        without_load = min(scored["stribeck"], scored["coulomb_viscous"])
        assert scored["load_dependent"] < 0.8 * without_load
        assert scored["stribeck_load_dependent"] < 1.01 * scored["load_dependent"]
        for rung in rungs.values():
            assert rung.result.fit.unit == "V"
            assert 5.0 < 1e3 * rung.angle.angle_rms < worst_mrad


@pytest.mark.recordings
def test_emps_in_closed_loop_errs_by_newtons_where_no_friction_errs_by_tens(recordings, tmp_path):
    fitted = fitted_file("emps.yaml", tmp_path)
    found = simulate_source(CAMPAIGNS / "emps.yaml", fitted, None, quiet)
    assert found.unit == "N"
    published = simulate_source(
        CAMPAIGNS / "emps.yaml", CAMPAIGNS / "emps_published.json", found.bandwidth_Hz, quiet
    )
    for role, limit in (("fit", 3.0), ("validate", 5.0)):
        mine, theirs = (each.pooled()[role].torque_rms for each in (found, published))
        assert mine < limit
        assert mine == pytest.approx(theirs, rel=0.02)


@pytest.mark.recordings
def test_emps_carried_over_from_the_pulses_moves_the_mass(recordings: Path) -> None:
    """Under pulses the mass comes out 1.1 kg less; the intervals contain what the model lacks."""
    pulses, steady = (load_source(CAMPAIGNS / name) for name in ("emps_pulses.yaml", "emps.yaml"))
    found = transfer(identify(pulses), pulses, steady)
    mass = next(m for m in found.parameters if m.name == "J")
    assert mass.difference == pytest.approx(1.1, abs=0.3)
    assert {m.name for m in found.parameters if m.moved} <= {"J"}
    assert found.floor.rms < 0.2 * found.own.train_rms < found.fit.train_rms


def fitted_file(name: str, folder: Path) -> Path:
    result = result_of(name)
    path = folder / "fitted.json"
    path.write_text(
        json.dumps(
            {"schema": "loadrig.identify/1", "alpha": result.alpha, "fitted": dict(result.fitted)}
        )
    )
    return path


def quiet(_what: str, _share: float) -> None:
    pass


@pytest.mark.proof
@pytest.mark.recordings
@pytest.mark.parametrize(
    ("name", "declared_mrad", "free_mrad"),
    [("sts3032_to_light.yaml", 12.0, 7.7), ("sts3032_to_heavy.yaml", 22.8, 17.5)],
)
def test_sts3032_predicts_the_angle_of_the_other_mass(recordings, name, declared_mrad, free_mrad):
    """Mean absolute errors of the loop simulated from its command, supply and first sample."""
    rungs = {
        (r.friction, r.free): r
        for r in climb_simulated(load_source(CAMPAIGNS / name), bandwidth_Hz=None)
    }
    for friction in (TRANSMITTED, DIRECTIONAL):
        declared, free = (rungs[friction, way].scored for way in (False, True))
        assert 1e3 * declared < declared_mrad
        assert 1e3 * free < free_mrad
        drive = next(c for c in rungs[friction, True].constants if c.name == "torque_per_volt")
        assert 0.15 < drive.change < 0.45
        assert drive.moved
