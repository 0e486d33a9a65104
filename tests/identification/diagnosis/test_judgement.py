"""Names whose fit is no model, or leaves too much of one recording, are no diagnosis."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from identification.diagnosis import judgement, reasons
from identification.diagnosis import unexplained as unexplained_module
from identification.diagnosis.comparison import Round
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.judgement import Judged, effects_of, verdict_of
from identification.diagnosis.result import Verdict
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import Search
from identification.diagnosis.unexplained import unexplained, unexplained_equations
from identification.effects import MOTION
from identification.recording import Array

from .benches import campaign, nominal_fit

NAME = "asymmetric_coulomb"
FAINT_N_M, UNSEEN = 0.002, 1.4
"""Size of an effect that explains hardly anything, and mean square in all that may still be
noise.
"""


@lru_cache
def found(size_N_m: float) -> Search:
    joint = nominal_fit(campaign({NAME: {"torque_Nm": size_N_m}}, 5, 6.0))
    # These tests set the mismatch in multiples of the noise alone.
    bare = tuple(replace(e, own={}, accuracy=0.0) for e in joint.equations)
    joint = replace(joint, equations=bare, stack=replace(joint.stack, equations=bare))
    term = next(t for t in MOTION if t.name == NAME)
    final = fit(joint.equations[0].views, "N m", joint.nominal, (Added(term, (), (0.0,)),), joint)
    return Search(joint, final, (Round(NAME, ()),), 1e-3, 1.0, "", ())


def verdict(search: Search) -> Verdict:
    return verdict_of(search, np.random.default_rng(0))[0]


def texts_of(judged: Judged) -> tuple[str, ...]:
    """Return the texts on why the effects do not explain the mismatch."""
    return unexplained(found(1.0), judged.verdict, judged.reason, np.random.default_rng(0))


def with_left(joint: Joint, more: Array) -> Joint:
    """Return a fit that leaves more of the torque."""
    residual = joint.residual.copy()
    residual[joint.stack.part("torque")] += more
    return replace(joint, residual=residual)


def noise(search: Search, power: float) -> Array:
    """Return white rows of the torque of this power over the noise's."""
    rows = search.final.stack.part("torque")
    return np.random.default_rng(1).normal(0.0, np.sqrt(power), rows.stop - rows.start)


@pytest.mark.parametrize(
    ("beyond", "expected"), [(False, Verdict.NAMED), (True, Verdict.OUTSIDE_CATALOGUE)]
)
def test_a_fit_that_needs_impossible_constants_names_nothing(
    monkeypatch: pytest.MonkeyPatch, beyond: bool, expected: Verdict
) -> None:
    monkeypatch.setattr(reasons, "infeasible", lambda _joint: beyond)
    judged = verdict_of(found(1.0), np.random.default_rng(0))
    assert judged.verdict is expected
    assert any("outside their physical limits" in t for t in texts_of(judged)) is beyond


@pytest.mark.parametrize(
    ("one", "expected"), [(False, Verdict.NAMED), (True, Verdict.OUTSIDE_CATALOGUE)]
)
def test_a_name_that_explains_little_may_not_leave_much_of_one_recording(
    one: bool, expected: Verdict
) -> None:
    """As much in all as may be noise, in every recording or in one."""
    search = found(FAINT_N_M)
    owner = search.final.equations[0].owner
    left = UNSEEN - float(np.mean(search.final.residual[search.final.stack.part("torque")] ** 2))
    where = owner == owner[0] if one else np.ones(len(owner), bool)
    more = noise(search, left) * where * np.sqrt(len(owner) / np.sum(where))
    both = {
        name: with_left(joint, more)
        for name, joint in (("baseline", search.baseline), ("final", search.final))
    }
    assert verdict(replace(search, **both)) is expected


@pytest.mark.parametrize(
    ("power", "expected"),
    [(0.3, Verdict.NOTHING_MISSING), (0.9, Verdict.OUTSIDE_CATALOGUE)],
)
def test_a_pattern_within_the_noise_without_a_name_is_nothing_missing(
    power: float, expected: Verdict
) -> None:
    """Beyond one and a half times the noise it is something."""
    search = found(1.0)
    left = (
        power + 1.0 - float(np.mean(search.final.residual[search.final.stack.part("torque")] ** 2))
    )
    joint = with_left(search.final, noise(search, left))
    alone = replace(joint, effects=())
    assert verdict(replace(search, baseline=alone, final=alone, rounds=())) is expected


def test_an_effect_that_took_anothers_place_must_explain_the_mismatch_too() -> None:
    search = found(1.0)
    term = next(t for t in MOTION if t.name == "cogging")
    views = search.final.equations[0].views
    little = fit(views, "N m", search.final.nominal, (Added(term, (7.0,), ()),), search.baseline)
    swapped = replace(search, final=little, rounds=(Round("cogging", ()),))
    rng = np.random.default_rng(0)
    assert verdict_of(swapped, rng, search)[0] is Verdict.OUTSIDE_CATALOGUE
    assert verdict_of(search, rng, search)[0] is Verdict.NAMED


@pytest.mark.parametrize(
    ("share", "confidence"), [(None, 0.99), (0.97, 0.99), (0.2, RULES.incomplete_confidence)]
)
def test_what_explains_little_of_recordings_set_aside_is_not_sure(
    share: float | None, confidence: float
) -> None:
    search = replace(found(1.0), unseen_share=share)
    (effect,) = effects_of(search, np.random.default_rng(0))
    assert effect.confidence == pytest.approx(confidence, abs=0.01)
    texts = unexplained_equations(search, Verdict.NAMED)
    assert any("set aside the effects explain only 20 %" in text for text in texts) is (
        share == 0.2
    )


@pytest.mark.parametrize("hysteretic", [True, False])
def test_effects_that_explain_enough_are_outside_the_catalogue_with_the_right_reason(
    monkeypatch: pytest.MonkeyPatch, hysteretic: bool
) -> None:
    monkeypatch.setattr(reasons, "hysteretic_remainder", lambda _found: hysteretic)
    judged = verdict_of(found(1.0), np.random.default_rng(0))
    assert (judged.verdict is Verdict.OUTSIDE_CATALOGUE) is hysteretic
    texts = texts_of(judged)
    assert len(texts) == hysteretic
    assert all("since the last reversal" in t and "are needed" not in t for t in texts)


@pytest.mark.parametrize(
    ("times_noise", "between", "counts"), [(2.5, 0.5, True), (2.5, 2.0, False), (3.5, 9.0, True)]
)
def test_a_voltage_mismatch_that_unlogged_voltages_may_cause_does_not_count(
    monkeypatch: pytest.MonkeyPatch, times_noise: float, between: float, counts: bool
) -> None:
    """Voltages between the samples may cause so many times the mismatch."""
    joint = replace(found(1.0).final, effects=())
    (voltage,) = (e for e in joint.equations if e.name == "voltage")
    part = joint.stack.part("voltage")
    # In the other equations no more than noise is left.
    residual = np.sign(np.sin(np.arange(len(joint.residual))))
    residual[part] *= times_noise * np.sqrt(voltage.allowed())
    alone = replace(joint, residual=residual)
    search = replace(found(1.0), baseline=alone, final=alone, rounds=())
    bound_V = between * times_noise * voltage.sigma
    for module in (judgement, unexplained_module):
        monkeypatch.setattr(module, "between_samples", lambda _views: bound_V)
    judged = verdict_of(search, np.random.default_rng(0))
    assert judged.verdict is Verdict.OUTSIDE_CATALOGUE
    settled = judgement.without_unlogged(judged, search)
    assert settled.verdict is (Verdict.OUTSIDE_CATALOGUE if counts else Verdict.NOTHING_MISSING)
    said = [t for t in texts_of(settled) if f"may cause about {bound_V:.3g} V rms" in t]
    assert bool(said) is not counts
