"""Hidden physics is found, named and sized; where there is none, none is found."""

import gc
import weakref
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.comparison import Contender, Round
from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.judgement import confidence_of
from identification.diagnosis.result import Diagnosis, Verdict
from identification.diagnosis.rules import RULES
from identification.diagnosis.within_limits import choose
from identification.effects import MOTION
from identification.recording import Dataset, Model, Recording, RecordingError
from identification.views.view import views

from .benches import FEW, campaign, honest, nominal_fit


def of(recordings: tuple[Recording, ...], seed: int = 1) -> Diagnosis:
    return diagnose(Dataset(recordings), rng=np.random.default_rng(seed))


def test_confidence_falls_with_close_rivals_with_what_is_left_and_where_more_is_missing() -> None:
    joint = nominal_fit(honest())
    alone, rivalled = (
        Round("a", ()),
        Round("a", (Contender("b", joint, 0.0, ""), Contender("c", joint, 9.0, ""))),
    )
    assert confidence_of(alone, 1.0, False, 100.0) == 0.99
    assert confidence_of(rivalled, 1.0, False, 100.0) == pytest.approx(0.5)
    assert confidence_of(alone, 0.0, False, 100.0) == pytest.approx(0.495)
    assert confidence_of(alone, 1.0, True, 100.0) == 0.7
    assert confidence_of(rivalled, 1.0, True, 100.0) == pytest.approx(0.5)
    assert confidence_of(alone, 1.0, False, 2.0) == 0.9
    assert confidence_of(alone, 1.0, False, 2.0, alone=False) == 0.7
    assert confidence_of(alone, 1.0, False, 100.0, alone=False) == 0.99
    assert confidence_of(alone, 1.0, False, 5.9) == 0.9, (
        "a tenth of it may be something else and pass for noise"
    )
    assert confidence_of(alone, 1.0, False, 6.1) == 0.99


@pytest.mark.parametrize(
    ("name", "parameters", "equation"),
    [
        ("backlash", {"gap_rad": 0.004}, "transmission"),
        pytest.param(
            "asymmetric_viscous", {"coefficient_Nms_rad": 0.4}, "torque", marks=pytest.mark.proof
        ),
        pytest.param("inverter_dead_time", {"voltage_V": 0.5}, "voltage", marks=pytest.mark.proof),
    ],
)
def test_what_is_hidden_is_named_and_sized(name, parameters, equation):
    found = of(campaign({name: parameters}, 2, 6.0, FEW))
    assert name in found.effects[0].alias_group
    assert found.fit.equation == equation
    for key, true in parameters.items():
        assert found.effects[0].parameters[key].value == pytest.approx(true, rel=0.15)
    assert found.fit.final_rms < 0.2 * found.fit.baseline_rms
    assert found.fit.validate_baseline_rms is not None
    assert found.fit.validate_final_rms < 0.5 * found.fit.validate_baseline_rms


@pytest.mark.parametrize("hidden", [False, True])
def test_recordings_set_aside_that_show_a_mismatch_are_fitted_too(hidden: bool) -> None:
    """With one weight alone a wrong exponent of the load is another friction."""
    effects = {"load_exponent": {"exponent": 0.8}} if hidden else {}
    tones = [motion for _, motion, _ in FEW]
    masses = ((0.0, "fit"), (20.0, "fit"), (30.6, "validate"), (8.0, "validate"))
    plan = [(m, tone, role) for (m, role), tone in zip(masses, tones, strict=True)]
    found = of(campaign(effects, 2, 6.0, plan))
    assert (found.verdict is Verdict.NOTHING_MISSING) is not hidden
    if hidden:
        assert "load_exponent" in found.effects[0].alias_group
        assert all(e.confidence <= RULES.undecided_confidence for e in found.effects)
        assert found.fit.validate_final_rms is None


def test_what_is_declared_is_not_found() -> None:
    recordings = campaign({"backlash": {"gap_rad": 0.004}}, 2, 6.0, FEW)[:2]
    found = diagnose(Dataset(recordings, Model(terms=("backlash",))), rng=np.random.default_rng(1))
    assert "backlash" not in {e.name for e in found.effects}


@pytest.mark.proof
@pytest.mark.parametrize("which", [(0, 5), range(6)])
def test_what_is_in_no_catalogue_gets_no_name(which: Sequence[int]) -> None:
    hidden = {"torque_Nm": 1.0, "frequency_Hz": 3.7, "phase_rad": 0.0}
    every = campaign({"x_timed_torque": hidden}, 3, 8.0)
    found = of(tuple(every[k] for k in which))
    assert found.verdict is Verdict.OUTSIDE_CATALOGUE
    assert found.effects == ()
    assert found.location is not None
    # A torque of the clock has no curve that a simulation could use.
    assert found.curve is None or found.curve.coordinate != "time"


def test_without_a_recording_to_fit_it_says_so() -> None:
    aside = tuple(replace(r, role="validate") for r in honest())
    with pytest.raises(RecordingError, match="role fit"):
        of(aside)


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


@pytest.mark.proof
@pytest.mark.parametrize("rational", [0.0, 1.0])
def test_torque_that_saturates_by_either_law(rational: float) -> None:
    hidden = {"torque_saturation": {"knee_A": KNEE_A, "rational": rational}}
    found = diagnose(Dataset(campaign(hidden, 6, 8.0), Model()))
    assert [e.name for e in found.effects] == ["torque_saturation"]
    parameters = found.effects[0].parameters
    assert parameters["knee_A"].value == pytest.approx(KNEE_A, rel=0.05)
    assert parameters["rational"].value == rational


@pytest.mark.proof
@pytest.mark.parametrize("with_torque", [0.0, 1.0])
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


HIDDEN = {"asymmetric_coulomb": {"torque_Nm": 0.4}}


def at_rest(recording: Recording, seed: int = 3) -> Recording:
    """Return a recording whose joint keeps its first angle under the torque of its first sample."""
    noise = np.random.default_rng(seed)
    still = {k: np.full_like(v, v[0]) for k, v in recording.channels.items() if k != "time"}
    for name in ("current", "voltage"):
        still[name] = still[name] + 1e-3 * noise.standard_normal(len(still[name]))
    return replace(recording, channels={**recording.channels, **still})


def resting(stage: str, seconds: float = 6.0) -> Dataset:
    """Return a campaign with a hidden effect whose recordings of one stage rest."""
    made = campaign(HIDDEN, 5, seconds)
    return Dataset(tuple(at_rest(r) if r.stage == stage else r for r in made), Model())


def test_a_loaded_stage_at_rest_is_left_out_and_the_rest_is_diagnosed() -> None:
    dataset = resting("loaded")
    chosen = choose(dataset, 25.0)
    assert [r.role for r in chosen.dataset.recordings] == ["fit", "fit", *["unused"] * 4]
    (warning,) = chosen.warnings
    assert warning.startswith(
        "r3, r4, r5, r6: at a bandwidth of 25 Hz these loaded recordings have 0 "
    )
    result = diagnose(dataset, bandwidth_Hz=25.0)
    assert warning in result.warnings
    assert result.verdict in (Verdict.NAMED, Verdict.AMBIGUOUS)
    assert result.effects[0].name == "asymmetric_coulomb"
    assert result.effects[0].parameters["torque_Nm"].value == pytest.approx(0.4, abs=0.02)


def test_a_campaign_that_moves_is_used_as_it_is() -> None:
    dataset = Dataset(campaign(HIDDEN, 5, 6.0), Model())
    assert choose(dataset, 25.0) == (dataset, 25.0, ())


def test_an_unloaded_stage_at_rest_is_refused() -> None:
    """Without its friction, that of the load is not known either."""
    with pytest.raises(RecordingError, match="samples are in motion"):
        diagnose(resting("unloaded"), bandwidth_Hz=25.0)


def test_the_next_diagnosis_releases_the_recordings_of_the_one_before() -> None:
    joint = nominal_fit(honest()[:1])
    (view,) = views(honest()[:1], 25.0)
    term = next(t for t in MOTION if t.name == "presliding")
    term.columns["torque"](view, joint.nominal, (1e4,))
    kept = weakref.ref(view)
    del view
    gc.collect()
    assert kept() is not None
    with pytest.raises(RecordingError):
        diagnose(Dataset((), Model()))
    gc.collect()
    assert kept() is None
