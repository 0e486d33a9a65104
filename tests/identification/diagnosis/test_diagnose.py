"""Hidden physics is found, named and sized; where there is none, none is found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from identification.diagnosis.comparison import Contender, Round
from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.judgement import confidence_of
from identification.diagnosis.result import Diagnosis, Verdict
from identification.recording import Dataset, Model, Recording, RecordingError

from .benches import campaign, honest, nominal_fit


def of(recordings: tuple[Recording, ...], seed: int = 1) -> Diagnosis:
    return diagnose(Dataset(recordings), rng=np.random.default_rng(seed))


@cache
def of_honest() -> Diagnosis:
    return of(honest())


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


def test_nothing_is_found_where_nothing_is_hidden() -> None:
    found = of_honest()
    assert found.verdict is Verdict.NOTHING_MISSING
    assert found.effects == ()
    assert found.p_value > 0.01
    assert found.fit.final_rms < 1.2 * found.fit.noise_floor_rms
    assert "nothing is missing" in found.statement


@pytest.mark.parametrize("share", [1.0, 1.3])
def test_where_nothing_is_missing_the_values_and_errors_are_those_of_the_estimate(
    share: float,
) -> None:
    """A wrong estimate is not hidden: the printed error is the one that its values leave."""
    plain = of_honest()
    given = {**plain.parameters, "J": share * plain.parameters["J"]}
    found = diagnose(Dataset(honest()), estimate=lambda _dataset: ({**given, "Ms": None}, ("hm",)))
    assert found.parameters["J"] == given["J"]
    assert found.parameter_shift["J"].before == found.parameter_shift["J"].after == given["J"]
    assert found.parameter_shift["Ms"].after is None
    assert "hm" in found.warnings
    ratio = found.fit.final_rms / plain.fit.final_rms
    assert (0.99 < ratio < 1.05) if share == 1.0 else ratio > 1.2


@pytest.mark.parametrize(
    ("name", "parameters", "equation"),
    [
        ("backlash", {"gap_rad": 0.004}, "transmission"),
        pytest.param(
            "asymmetric_viscous",
            {"coefficient_Nms_rad": 0.4},
            "torque",
            marks=pytest.mark.proof,
        ),
        ("inverter_dead_time", {"voltage_V": 0.5}, "voltage"),
    ],
)
def test_what_is_hidden_is_named_and_sized(
    name: str, parameters: dict[str, float], equation: str
) -> None:
    found = of(campaign({name: parameters}, 2, 6.0))
    assert name in found.effects[0].alias_group
    assert found.fit.equation == equation
    for key, true in parameters.items():
        assert found.effects[0].parameters[key].value == pytest.approx(true, rel=0.15)
    assert found.fit.final_rms < 0.2 * found.fit.baseline_rms
    assert found.fit.validate_baseline_rms is not None
    assert found.fit.validate_final_rms is not None
    assert found.fit.validate_final_rms < 0.5 * found.fit.validate_baseline_rms


def test_what_is_declared_is_not_found() -> None:
    recordings = campaign({"backlash": {"gap_rad": 0.004}}, 2, 6.0)[:3]
    found = diagnose(Dataset(recordings, Model(terms=("backlash",))), rng=np.random.default_rng(1))
    assert "backlash" not in {e.name for e in found.effects}


@pytest.mark.parametrize("which", [(0, 5), pytest.param(range(6), marks=pytest.mark.proof)])
def test_what_is_in_no_catalogue_gets_no_name(which: Sequence[int]) -> None:
    hidden = {"torque_Nm": 1.0, "frequency_Hz": 3.7, "phase_rad": 0.0}
    every = campaign({"x_timed_torque": hidden}, 3, 8.0)
    found = of(tuple(every[k] for k in which))
    assert found.verdict is Verdict.OUTSIDE_CATALOGUE
    assert found.effects == ()
    assert found.curve is not None
    assert found.location is not None


def test_the_same_seed_gives_the_same_verdict() -> None:
    short = honest()[:2]
    first, again = of(short), of(short)
    assert first.p_value == again.p_value
    assert first.statement == again.statement


def test_without_a_recording_to_fit_it_says_so() -> None:
    aside = tuple(replace(r, role="validate") for r in honest())
    with pytest.raises(RecordingError, match="role fit"):
        of(aside)
