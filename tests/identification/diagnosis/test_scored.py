"""The reported constants and errors are those of the exported model."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from identification.diagnosis import diagnose as diagnosing
from identification.diagnosis import scored
from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.result import Diagnosis, Map, Verdict
from identification.diagnosis.scored import curve_of, model_with, scores, worse
from identification.effects.model import CorrectedModel
from identification.estimate.default import identify
from identification.recording import Dataset, Recording, RecordingError
from identification.result import Identification, Parameter

from .benches import FEW, Same, campaign, nominal_fit

HIDDEN = {"asymmetric_coulomb": {"torque_Nm": 1.5}}


def plain_campaign() -> tuple[Recording, ...]:
    """Return a campaign that hides nothing."""
    return campaign({}, 1, 4.0, FEW)


@pytest.fixture(scope="module")
def outcomes() -> dict[object, Any]:
    return {}


@pytest.fixture(autouse=True)
def _searched_once(outcomes, monkeypatch):
    """Search the same recordings once: what is reported of a search does not change it."""
    search = diagnosing._searches

    def known(task: Any, terms: Any) -> Any:
        key = Same(task.dataset.recordings)
        if key not in outcomes:
            outcomes[key] = search(task, terms)
        return outcomes[key]

    monkeypatch.setattr(diagnosing, "_searches", known)


@cache
def of_honest() -> tuple[Diagnosis, Identification]:
    estimate = identify(Dataset(plain_campaign()), rng=np.random.default_rng(0))
    return diagnose(Dataset(plain_campaign()), estimate=lambda _: estimate), estimate


def of_honest_machine(_dataset: Dataset) -> Identification:
    """Return the constants of the machine that hides nothing: the nominal part of the others."""
    return of_honest()[1]


@cache
def of_hidden() -> tuple[Dataset, Diagnosis]:
    dataset = Dataset(campaign(HIDDEN, 3, 6.0, FEW))
    return dataset, diagnose(dataset)


def test_without_effects_constants_and_error_are_those_of_the_identification() -> None:
    found, estimate = of_honest()
    assert (found.verdict, found.effects) == (Verdict.NOTHING_MISSING, ())
    assert found.p_value > 0.01
    assert found.fit.final_rms < 1.2 * found.fit.noise_floor_rms
    assert {n: found.parameters[n] for n in estimate.fitted} == dict(estimate.fitted)
    for name, shift in found.parameter_shift.items():
        assert shift.before == shift.after == estimate.parameters[name].value
    at_that_bandwidth = scores(
        Dataset(plain_campaign()), CorrectedModel(estimate.fitted), estimate.fit.bandwidth_Hz
    )
    assert at_that_bandwidth.rms("torque", "fit") == pytest.approx(estimate.fit.train_rms, 1e-12)
    assert at_that_bandwidth.rms("torque", "validate") == pytest.approx(
        estimate.fit.validate_rms, 1e-12
    )


def test_printed_errors_are_those_of_the_exported_model() -> None:
    dataset, found = of_hidden()
    assert [e.name for e in found.effects] == ["asymmetric_coulomb"]
    exported = model_with(found.parameters, found.alpha, found.effects, dataset)
    again = scores(dataset, exported, found.fit.bandwidth_Hz)
    assert {f.equation for f in found.fits} >= {"torque", "voltage", "transmission"}
    for fit in found.fits:
        assert again.rms(fit.equation, "fit") == pytest.approx(fit.final_rms, 1e-9)
        assert again.rms(fit.equation, "validate") == pytest.approx(fit.validate_final_rms, 1e-9)
    assert found.fits[0].final_rms < 0.5 * found.fits[0].baseline_rms


def estimate_with(found: Diagnosis, **changes: float | None) -> Identification:
    """Return an identification with the constants of a diagnosis, but for some."""
    values = {n: v for n, v in found.parameters.items() if n in found.parameter_shift}
    values |= {n: v for n, v in changes.items() if v is not None}
    known = {n: changes.get(n, v) for n, v in values.items()}
    plain = of_honest()[1]
    return replace(
        plain,
        fitted=values,
        parameters={n: Parameter(n, "", v, identifiable=v is not None) for n, v in known.items()},
        warnings=("hm",),
    )


@pytest.mark.parametrize("share", [1.0, 1.5])
def test_refined_constants_are_reported_unless_their_error_is_larger(monkeypatch, share):
    dataset, plain = of_hidden()
    refined = estimate_with(plain, J=share * 1.0001 * plain.parameters["J"])
    monkeypatch.setattr(scored, "refit", lambda *_: refined)
    found = diagnose(dataset, estimate=of_honest_machine)
    given = of_honest()[1]
    assert found.parameter_shift["J"].before == given.parameters["J"].value
    nominal = scores(dataset, CorrectedModel(given.fitted), found.fit.bandwidth_Hz)
    assert nominal.rms("torque", "fit") == pytest.approx(found.fits[0].baseline_rms, 1e-9)
    taken = found.parameters["J"] == refined.fitted["J"]
    assert taken == (share == 1.0)
    assert any("hm" in w for w in found.warnings if "again" in w) == taken


def test_a_rise_that_is_not_determined_is_left_out_and_said(monkeypatch):
    dataset, plain = of_hidden()
    refined = replace(
        estimate_with(plain, mu_s=None),
        fitted={**estimate_with(plain).fitted, "mu_s": 1.0005 * plain.parameters["mu_c"]},
    )
    monkeypatch.setattr(scored, "refit", lambda *_: refined)
    found = diagnose(dataset, estimate=of_honest_machine)
    assert found.parameter_shift["mu_s"].after is None
    assert found.parameters["mu_s"] == found.parameters["mu_c"]
    assert any(w.startswith("mu_s is not determined") for w in found.warnings)


@pytest.mark.parametrize("fails", [False, True])
def test_constants_that_are_not_refined_are_said(monkeypatch, fails):
    dataset, plain = of_hidden()

    def refit(*_arguments: object) -> Identification:
        raise RecordingError("no motion")

    monkeypatch.setattr(scored, "refit", refit)
    if not fails:
        monkeypatch.setattr(scored, "REFINED_SAMPLES", 10)
    found = diagnose(dataset, estimate=of_honest_machine)
    assert any("less precise than those of rig identify" in w for w in found.warnings) != fails
    assert any(w.endswith("not fitted again: no motion") for w in found.warnings) == fails
    assert found.parameters["J"] == plain.parameters["J"]


def test_an_estimate_that_fails_is_said_and_the_constants_are_those_of_the_rows() -> None:
    def fails(_dataset: Dataset) -> Identification:
        raise RecordingError("no motion")

    found = diagnose(Dataset(plain_campaign()), estimate=fails)
    assert found.verdict is Verdict.NOTHING_MISSING
    assert any("no motion" in w for w in found.warnings)
    assert found.fit.final_rms < 1.2 * found.fit.noise_floor_rms


def contact(recordings: tuple[Recording, ...]) -> tuple[Recording, ...]:
    """Return recordings whose torque is mostly that of a controller that fights a contact."""
    rng = np.random.default_rng(0)
    out = []
    for r in recordings:
        time = r.channels["time"]
        slow = np.interp(time, time[::400], np.cumsum(rng.normal(0.0, 15.0, len(time[::400]))))
        out.append(
            replace(
                r,
                channels={**r.channels, "current": r.channels["current"] + slow / 3.0},
                stage="unloaded",
                weight_mass=0.0,
            )
        )
    return tuple(out)


@pytest.mark.proof
def test_nothing_is_missing_only_where_the_model_describes_the_machine() -> None:
    found = diagnose(Dataset(contact(plain_campaign())))
    torque = next(f for f in found.fits if f.equation == "torque")
    assert (torque.relative or 0.0) ** 2 > 0.5
    assert found.verdict is not Verdict.NOTHING_MISSING


def map_over(coordinate: str) -> Map:
    none = np.zeros(2)
    return Map("torque", coordinate, "rad", "N m", none, none, none, none, none, 0.5)


def test_a_curve_is_over_angle_or_speed_where_it_lowers_the_error_of_other_blocks() -> None:
    wavy = {"position_dependent_friction": {"torque_Nm": 2.0, "center_rad": 0.1, "width_rad": 0.1}}
    dataset, plain = Dataset(campaign(wavy, 12, 8.0)), Dataset(plain_campaign())
    before, none = (
        scores(d, CorrectedModel(nominal_fit(d.recordings).nominal.values), 25.0)
        for d in (dataset, plain)
    )
    over_angle = replace(map_over("angle"), against_motion=True)
    drawn = curve_of(dataset, before, [over_angle], 25.0)
    assert drawn.value[np.argmin(np.abs(drawn.grid - 0.1))] > 0.5
    carried = scores(dataset, replace(before.model, curve=drawn), 25.0)
    assert (carried.rms("torque", "fit") or 9.0) < 0.9 * (before.rms("torque", "fit") or 0.0)
    assert worse(before, carried, "torque", "fit")
    assert not worse(carried, before, "torque", "fit")
    assert curve_of(dataset, before, [map_over("time")], 25.0) is None
    assert curve_of(plain, none, [map_over("angle")], 25.0) is None
    assert curve_of(dataset, before, [], 25.0) is None
