"""Names whose fit is no model, or that do not pay on recordings set aside, are no diagnosis."""

import math
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identification.diagnosis import diagnose as diagnosing
from identification.diagnosis import held_out, judgement, reasons
from identification.diagnosis import unexplained as unexplained_module
from identification.diagnosis.comparison import Contender, Round
from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.held_out import (
    DROPPED,
    _Case,
    _with_rivals_judged,
    dropped_effects,
    validated_effects,
    validation_rms,
)
from identification.diagnosis.joint import (
    Added,
    Joint,
    _form_error,
    estimates,
    fit,
    undetermined_size,
)
from identification.diagnosis.judgement import Judged, effects_of, verdict_of
from identification.diagnosis.result import Fit, Step, Verdict
from identification.diagnosis.rules import RULES
from identification.diagnosis.scored import Scores
from identification.diagnosis.search import Search
from identification.diagnosis.statement import statement
from identification.diagnosis.unexplained import unexplained, unexplained_equations
from identification.effects import MOTION
from identification.recording import Array, Dataset, Recording
from identification.views.predicted import Predicted
from identification.views.view import View, views

from .benches import FEW, PLAN, campaign, honest, ladder, nominal_fit, with_torque

NAME = "asymmetric_coulomb"
FAINT_N_M, UNSEEN = 0.002, 1.4
"""Size of an effect that explains hardly anything, and mean square in all that may still be
noise.
"""


DRAWN: dict[object, Any] = {}


@pytest.fixture(autouse=True)
def _drawn_once(monkeypatch):
    """Draw the maps of the same mismatch once: they decide no verdict."""
    maps = judgement.maps

    def known(stack: Any, main: Any, before: Array, after: Array, *rest: Any) -> Any:
        key = (main.name, len(rest), before.tobytes(), after.tobytes())
        if len(rest) > 1 or key not in DRAWN:
            DRAWN[key] = maps(stack, main, before, after, *rest)
        return DRAWN[key]

    monkeypatch.setattr(judgement, "maps", known)


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
def test_a_fit_that_needs_impossible_constants_names_nothing(monkeypatch, beyond, expected):
    monkeypatch.setattr(reasons, "infeasible", lambda _joint: beyond)
    judged = verdict_of(found(1.0), np.random.default_rng(0))
    assert judged.verdict is expected
    assert any("outside their physical limits" in t for t in texts_of(judged)) is beyond


@pytest.mark.parametrize(
    ("one", "expected"), [(False, Verdict.NAMED), (True, Verdict.OUTSIDE_CATALOGUE)]
)
def test_a_name_that_explains_little_may_not_leave_much_of_one_recording(one, expected):
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
    ("power", "expected"), [(0.3, Verdict.NOTHING_MISSING), (0.9, Verdict.OUTSIDE_CATALOGUE)]
)
def test_a_pattern_within_the_noise_without_a_name_is_nothing_missing(power, expected):
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
def test_what_explains_little_of_recordings_set_aside_is_not_sure(share, confidence):
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


TERM = {t.name: t for t in MOTION}
SIDE = {"asymmetric_coulomb": {"torque_Nm": 0.5}}


@lru_cache
def hidden() -> tuple[Recording, ...]:
    return campaign(SIDE, 5, 6.0)


@lru_cache
def nominal() -> Joint:
    return nominal_fit(hidden())


def here() -> tuple[View, ...]:
    return nominal().equations[0].views


def aside() -> tuple[View, ...]:
    fitted = [r for r in hidden() if r.role == "fit"]
    held = [r for r in hidden() if r.role == "validate"]
    return views((*fitted, *held), 25.0, False, hidden())[len(fitted) :]


def search(*effects: Added) -> Search:
    final = fit(here(), "N m", nominal().nominal, effects, nominal())
    rounds = tuple(Round(e.term.name, ()) for e in effects)
    return Search(nominal(), final, rounds, 1e-3, 1.0, "", ())


RIGHT = Added(TERM["asymmetric_coulomb"], (), (0.0,))
WRONG = Added(TERM["position_dependent_friction"], (0.2, 0.02), (0.0,))


def test_an_effect_beside_another_is_dropped_if_its_interval_contains_zero(monkeypatch):
    # Any effect passes the test on unused recordings.
    monkeypatch.setattr(held_out, "_error_reduction", lambda *_: 9.0)
    absent = Added(TERM["asymmetric_viscous"], (), (0.0,))
    found = validated_effects(search(RIGHT, absent), ())
    assert [e.term.name for e in found.final.effects] == ["asymmetric_coulomb"]
    (step,) = (s for s in found.steps if s.action == DROPPED)
    assert step.name == "asymmetric_viscous"
    (warning,) = dropped_effects(found)
    assert "contains zero" in warning
    plain = nominal_fit(honest())
    final = fit(plain.views, "N m", plain.nominal, (absent,), plain)
    alone = Search(plain, final, (Round(absent.term.name, ()),), 1e-3, 1.0, "", ())
    assert validated_effects(alone, ()).final.effects == (), "nor if it is the only one"


def test_a_weight_that_was_not_hung_is_no_size_of_zero() -> None:
    """Its true mass is zero, and its interval holds zero, however surely the label is wrong."""
    missing = replace(hidden()[0], name="missing", weight_mass=10.0, stage="loaded", role="fit")
    joint = nominal_fit((*hidden()[:2], missing, *hidden()[3:5]))
    weight = Added(TERM["wrong_weight"], (2.0,), (0.0,))
    found = fit(joint.equations[0].views, "N m", joint.nominal, (RIGHT, weight), joint)
    mass = estimates(found)[1]["mass_kg"]
    assert mass.low < 0.0 < mass.high < 0.1
    assert undetermined_size(found, 1) is None


def test_a_rival_that_recordings_cannot_distinguish_was_not_fitted_and_is_open() -> None:
    found = search(RIGHT)
    alike = Contender("constant_torque", found.final, 0.0, "")
    (effect,) = effects_of(
        replace(found, rounds=(Round("asymmetric_coulomb", (alike,)),)), np.random.default_rng(0)
    )
    assert effect.alias_group == ("asymmetric_coulomb", "constant_torque")


def test_the_error_of_a_form_is_a_share_of_what_the_effect_changes() -> None:
    """An efficiency of 1 is no effect: what is left widens 1 - efficiency, not the efficiency."""
    found = search(Added(TERM["transmission_efficiency"], (), (0.05,))).final
    with_form, without = (
        next(iter(estimates(found, form=form)[0].values())) for form in (True, False)
    )
    share = _form_error(found, found.stack, found.effects[0])
    half = [0.5 * (e.high - e.low) for e in (with_form, without)]
    assert share > 0.0
    assert math.sqrt(half[0] ** 2 - half[1] ** 2) == pytest.approx(
        share * abs(1.0 - with_form.value), rel=1e-3
    )


@pytest.mark.parametrize("set_aside", [True, False])
def test_what_is_there_pays_and_what_is_not_does_not(set_aside: bool) -> None:
    unseen = aside() if set_aside else ()
    found = validated_effects(search(RIGHT, WRONG), unseen)
    assert [e.term.name for e in found.final.effects] == ["asymmetric_coulomb"]
    assert [r.name for r in found.rounds] == ["asymmetric_coulomb"]
    if set_aside:
        assert found.unseen_share > 0.95
    else:
        assert found.unseen_share is None
    assert [s.name for s in found.steps if s.action == DROPPED] == ["position_dependent_friction"]
    assert found.final.effects[0].coefficients[0] == pytest.approx(0.5, rel=0.1)
    (words,) = dropped_effects(found)
    assert "standard errors" in words
    assert ("set aside" if set_aside else "predicted from the other parts") in words


def test_what_is_held_out_is_scored_by_the_reported_constants() -> None:
    found = validated_effects(search(RIGHT), aside())
    before, after = (validation_rms(j, aside())["torque"] for j in (found.baseline, found.final))
    assert after < 0.5 * before
    sigma = next(e.sigma for e in found.final.equations if e.name == "torque")
    assert after == pytest.approx(sigma, rel=0.25)


@pytest.mark.parametrize("label_kg", [16.0, 20.0])
def test_what_one_recording_alone_shows_need_not_pay_on_another(label_kg: float) -> None:
    """The mass is 20 kg; with this label there is no effect."""
    labelled = [replace(r, weight_mass=label_kg) if r.name == "r4" else r for r in hidden()]
    joint = nominal_fit(labelled)
    weight = Added(TERM["wrong_weight"], (3.0,), (0.0,))
    assert weight.term.place is not None
    final = fit(joint.views, "N m", joint.nominal, (RIGHT, weight), joint)
    rounds = tuple(Round(e.term.name, ()) for e in (RIGHT, weight))
    found = validated_effects(Search(joint, final, rounds, 1e-3, 1.0, "", ()), aside())
    wrong = {"wrong_weight"} if label_kg != 20.0 else set()
    assert {e.term.name for e in found.final.effects} == {"asymmetric_coulomb"} | wrong


def test_recordings_set_aside_reject_a_rival_that_fits_as_well() -> None:
    rival = Contender(WRONG.term.name, search(WRONG).final, 0.0, "")
    found = search(RIGHT)
    found = replace(found, rounds=(Round(RIGHT.term.name, (rival,)),))
    (judged,) = validated_effects(found, aside()).rounds
    assert judged.rivals[0].preference >= RULES.rejected


@pytest.mark.parametrize("preference", [0.0, 5.0])
def test_recordings_set_aside_choose_between_effects_that_fit_alike(preference: float) -> None:
    """A rival that the fit rejected does not take the place; the effect is then ambiguous."""
    rival = Contender(RIGHT.term.name, search(RIGHT).final, preference, "")
    steps: list[Step] = []
    joint, taken = _with_rivals_judged(
        _Case(aside(), nominal(), (), set()),
        search(WRONG).final,
        Round(WRONG.term.name, (rival,)),
        steps,
    )
    swapped = preference < RULES.rejected
    assert taken.name == joint.effects[-1].term.name == (RIGHT if swapped else WRONG).term.name
    assert [s.action for s in steps] == ["swap"] * swapped
    assert taken.unconfirmed is swapped
    if swapped:
        assert taken.rivals[0].preference >= RULES.rejected
    else:
        assert taken.rivals[0].preference <= 0.0


def test_friction_of_one_recording_is_no_drift() -> None:
    """An unknown start is a free constant there, which the fit without the drift has as well."""
    recordings = [
        r
        if r.role == "fit"
        else replace(
            r,
            channels={
                **r.channels,
                "current": r.channels["current"]
                + 0.3 * np.sign(np.gradient(r.channels["command"])) / r.bench.ampere_torque,
            },
        )
        for r in honest()
    ]
    fitted = [r for r in recordings if r.role == "fit"]
    joint = nominal_fit(honest())
    unseen = views(recordings, 25.0, False, recordings)[len(fitted) :]
    drift = fit(
        joint.equations[0].views,
        "N m",
        joint.nominal,
        (Added(TERM["coulomb_drift"], (1e6,), (0.0,)),),
        joint,
    )
    found = Search(joint, drift, (Round("coulomb_drift", ()),), 1e-3, 1.0, "", ())
    kept = validated_effects(found, unseen).final.effects
    assert not kept


def test_after_a_drop_all_names_compete_again_and_the_winner_is_no_sure_name() -> None:
    """The recordings set aside dropped the one and chose the other."""
    terms = [TERM[n] for n in ("asymmetric_coulomb", "quadratic_drag", WRONG.term.name)]
    found = validated_effects(search(WRONG), aside(), terms)
    assert [s.name for s in found.steps] == [WRONG.term.name, RIGHT.term.name]
    (taken,) = found.rounds
    assert (taken.name, taken.unconfirmed) == (RIGHT.term.name, True)
    assert found.final.effects[0].coefficients[0] == pytest.approx(0.5, rel=0.1)
    dropped = next(r for r in taken.rivals if r.name == WRONG.term.name)
    assert dropped.preference >= RULES.rejected
    (effect,) = effects_of(found, np.random.default_rng(0))
    assert effect.confidence == RULES.undecided_confidence
    (sure,) = effects_of(validated_effects(search(RIGHT), aside(), terms), np.random.default_rng(0))
    assert sure.confidence > 0.9


def test_what_does_not_explain_unused_recordings_takes_no_empty_place() -> None:
    terms = [TERM[n] for n in ("quadratic_drag", "cogging", WRONG.term.name)]
    found = validated_effects(search(WRONG), aside(), terms)
    assert found.rounds == ()
    assert found.final.effects == ()


RESTS = (PLAN[1], *((mass, ladder, "fit") for mass in (0.0, 10.0)), (0.0, ladder, "validate"))


@pytest.mark.parametrize("growth_N_m", [6.0, pytest.param(0.0, marks=pytest.mark.proof)])
def test_static_friction_that_grows_at_rest_is_named_by_its_breakaways(growth_N_m: float) -> None:
    """The other equations have no mismatch."""
    dwell = {"growth_Nm": growth_N_m, "time_s": 0.25}
    hidden = {"dwell_static_friction": dwell} if growth_N_m else {}
    found = diagnose(Dataset(campaign(hidden, 3, 16.0, RESTS)), rng=np.random.default_rng(0))
    assert {e.name for e in found.effects} == set(hidden)
    for effect in found.effects:
        assert found.verdict is Verdict.NAMED
        for name, value in dwell.items():
            assert effect.parameters[name].value == pytest.approx(value, rel=0.3)
    assert found.effects or found.verdict is Verdict.NOTHING_MISSING


PATCH = {"torque_Nm": 1.5, "center_rad": 0.0, "width_rad": 0.08}
ONE_SINE = tuple((0.0, ((22.0, 0.35),), role) for *_, role in PLAN)


@pytest.mark.parametrize(
    ("hidden", "plan", "bent", "sure"),
    [({}, ONE_SINE, 1.5, False), ({"position_dependent_friction": PATCH}, PLAN, 0.0, True)],
)
def test_friction_that_a_speed_explains_as_well_is_no_sure_patch(hidden, plan, bent, sure):
    """Of one sine the middle of the travel is the highest speed."""
    bends = with_torque(campaign(hidden, 5, 6.0, plan), lambda _a, w, _t: -bent * w * np.abs(w))
    joint = nominal_fit(bends)
    added = Added(TERM["position_dependent_friction"], (0.0, 0.1), (1.0,))
    final = fit(joint.views, "N m", joint.nominal, (added,), joint)
    alone = Search(joint, final, (Round(added.term.name, ()),), 1e-3, 1.0, "", ())
    (effect,) = effects_of(alone, np.random.default_rng(0))
    assert (effect.confidence > RULES.undecided_confidence) is sure


@pytest.mark.parametrize(
    ("before", "after", "unseen", "left"),
    [
        (1.0, 0.35, (1.0, 0.35), 35.0),
        (1.0, 0.1, (1.0, 0.02), 0.0),
        (0.1, 0.012, (0.26, 0.07), 7.0),
        (0.1, 0.012, (None, None), 0.0),
    ],
)
def test_many_noise_floors_left_are_a_part_unless_nearly_all_is_explained(
    before: float, after: float, unseen: tuple[float | None, float | None], left: float
) -> None:
    errors = Fit("torque", "N m", 25.0, before, after, 0.01, *unseen)
    assert reasons.floors_left(errors) == pytest.approx(left)


@pytest.mark.parametrize(("after", "kind"), [(0.35, reasons.Kind.MUCH_LEFT), (0.012, None)])
def test_a_part_is_told_as_a_part_and_the_verdict_is_outside(monkeypatch, after, kind):
    monkeypatch.setattr(diagnosing, "grown", lambda *_: False)
    errors = Fit("torque", "N m", 25.0, 1.0, after, 0.01, 1.0, after)
    shown: Any = SimpleNamespace(effects=(NAME,), main=errors, before=None, after=None)
    left = reasons.floors_left(errors)
    assert diagnosing._doubt(shown, Judged(Verdict.NAMED, None, ()), left) is kind
    if kind is not None:
        reason = reasons.Reason(kind, found(1.0), (NAME,), left=left)
        (text,) = texts_of(Judged(Verdict.OUTSIDE_CATALOGUE, None, (), reason))
        assert "asymmetric Coulomb" in text
        assert "35.0 times the noise floor" in text


def test_a_part_keeps_its_name_with_a_low_confidence() -> None:
    (effect,) = effects_of(found(1.0), np.random.default_rng(0))
    (part,) = diagnosing._part_of((effect,))
    assert (part.name, part.confidence) == (NAME, RULES.part_confidence)
    errors = Fit("torque", "N m", 25.0, 1.0, 0.35, 0.01, 1.0, 0.35)
    said = statement(Verdict.OUTSIDE_CATALOGUE, (part,), errors, None, 0.0, ())
    assert effect.statement in said
    assert "1 -> 0.35 N m" in said


def test_a_recording_that_judges_nothing_does_not_judge_the_reported_model() -> None:
    def parts(size: float) -> tuple[Predicted, ...]:
        errors = {"a": ("fit", 1.0), "torque lost": ("validate", 9.0), "b": ("validate", 2.0)}
        time = np.arange(4.0)
        return tuple(
            Predicted("torque", name, role, time, np.full(4, size * error), np.zeros(4))
            for name, (role, error) in errors.items()
        )

    errors = Fit("torque", "N m", 25.0, 1.0, 0.1, 0.01, 7.0, 0.7)
    model: Any = None
    before, after = (Scores(model, parts(size)) for size in (1.0, 0.1))
    shown = diagnosing._Shown((), before, after, model, (), errors, ())
    main = diagnosing._judging(shown, {"b"}).main
    assert main.validate_baseline_rms == pytest.approx(2.0)
    assert main.validate_final_rms == pytest.approx(0.2)
    assert (main.baseline_rms, main.final_rms) == (1.0, 0.1)


def test_an_effect_without_a_state_at_the_start_is_judged_by_the_printed_error() -> None:
    """Whatever the clocks are: the errors are those of the exported model."""
    effect = SimpleNamespace(term=TERM["cogging"])
    search: Any = SimpleNamespace(
        baseline=SimpleNamespace(views=()), final=SimpleNamespace(effects=(effect,))
    )
    views: Any = [SimpleNamespace(recording=SimpleNamespace(session="", span=(0.0, 1.0)))] * 2
    errors = Fit("torque", "N m", 25.0, 1.0, 0.1, 0.01, 1.0, 0.1)
    assert diagnosing._with_own_starts(errors, search, views) is errors


@pytest.mark.parametrize("hidden", [False, True])
def test_what_other_constants_explain_in_recordings_set_aside_is_no_further_physics(hidden) -> None:
    every = campaign({"asymmetric_coulomb": {"torque_Nm": 0.6}}, 2, 6.0, FEW)
    if hidden:
        every = (*every[:-1], *with_torque(every[-1:], lambda q, w, t: 0.8 * np.sin(20.0 * t)))
    joint = nominal_fit(every)
    added = Added(TERM["asymmetric_coulomb"], (), (0.6,))
    final = fit(joint.views, "N m", joint.nominal, (added,), joint)
    aside = views(every[-1:], 25.0, campaign=every)
    search: Any = SimpleNamespace(final=final)
    errors = Fit("torque", "N m", 25.0, 0.4, 0.02, 0.02, 0.5, 0.5)
    assert reasons.floors_left(errors) == pytest.approx(25.0)
    left = diagnosing._left(errors, search, aside)
    assert (left > RULES.floors_left) is hidden
