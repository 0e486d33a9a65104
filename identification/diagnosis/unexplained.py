"""Texts on the part of the mismatch that the effects do not explain."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from identification.diagnosis.held_out import DROPPED
from identification.diagnosis.judgement import effects_of, little_unseen
from identification.diagnosis.reasons import (
    Kind,
    Reason,
    equations_of_effects,
    excess_of,
    judged_equation,
)
from identification.diagnosis.result import Verdict
from identification.diagnosis.rows import AT_INSTANTS, Equation, between_samples
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import Search
from identification.effects import MOTION
from identification.effects.effect import Needs, title
from identification.model.parameters import LINEAR
from identification.recording import Bench, Recording
from identification.views.view import View, lacks_common_origin, one_clock

# Finds effects that recordings cannot show because their angles have no common origin, because
# they have no common clock, or because the bench has no angle with which the effect is periodic.


def unrecorded_effects(
    fitted: Sequence[Recording], views: Sequence[View]
) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return effects to exclude from the search, and warnings that state the reason."""
    absent = _not_on(fitted[0].bench)
    warnings = []
    if lacks_common_origin(views):
        absent |= {Needs.COMMON_ZERO}
        local = [title(e.name) for e in MOTION if Needs.COMMON_ZERO in e.needs]
        warnings.append(
            "only speed was recorded, no angle: the angle of each recording is counted from its "
            f"first sample, so that effects at a fixed angle ({', '.join(local)}) are not "
            "searched for, and each recording has phases of its own"
        )
    if not one_clock(fitted):
        warnings.append(
            "the recordings have no common clock, so each recording is assumed to start cold, with "
            "running time counted from its first sample; if the start times are known, state "
            "`start` in the campaign file"
        )
    return frozenset(e.name for e in MOTION if e.needs & absent), tuple(warnings)


def _not_on(bench: Bench) -> frozenset[Needs]:
    """Return which angles a bench lacks: on a linear one, the motor's without a gear ratio."""
    if bench.motion != LINEAR:
        return frozenset()
    motor = {Needs.MOTOR_TURN} if bench.gear_ratio == 1.0 else set()
    return frozenset({Needs.JOINT_TURN, *motor})


_ENDS: Mapping[str, str] = {
    "stop": "the best candidate of the catalogue",
    "remove": "the last effect that was removed again",
    DROPPED: "",
}
"""Step by which a search ends without an effect, to the words for the effect of this step."""


def unexplained(
    found: Search, verdict: Verdict, reason: Reason | None, rng: np.random.Generator
) -> tuple[str, ...]:
    """Return all texts on the part of the mismatch that the effects do not explain."""
    outside = () if reason is None else _reason_texts(reason, rng)
    fitted = " and ".join(title(e.term.name) for e in found.final.effects)
    within = (
        f"{fitted} fits the recordings better but is not identified: the mismatch of the nominal "
        "model is within the noise"
    )
    if verdict is Verdict.NOTHING_MISSING and fitted:
        outside = (*outside, within)
    return (*outside, *unexplained_equations(found, verdict))


_WHY_NOT: Mapping[Kind, str] = {
    Kind.CANCELLING: (
        "{titles} would explain the mismatch only if they nearly cancel each other, each being at "
        "least about twice their sum"
    ),
    Kind.INFEASIBLE: (
        "{titles} would explain the mismatch only with nominal parameters outside their physical "
        "limits"
    ),
    Kind.NOT_BETTER: (
        "{titles} would explain the mismatch of the fitted rows, but the model with these effects "
        "does not lower the error of the recordings"
    ),
    Kind.MISFIT: (
        "the nominal model does not describe these recordings: its error is above the noise floor, "
        "although no effect of the catalogue shows in it; look at the channels, their signs and "
        "units, and for torques that are not declared (a weight, a contact, a controller's own)"
    ),
    Kind.MUCH_LEFT: (
        "{titles}: {share:.0f} % of the mismatch beyond the noise in the fitted recordings; an "
        "error of {left:.1f} times the noise floor is left, so that another effect is missing or "
        "this effect has another form"
    ),
    Kind.REVERSALS: (
        "{share:.0f} % of the mismatch beyond the noise would be explained if {words}; but the "
        "remaining mismatch depends on the travel or time since the last reversal, and these "
        "effects do not"
    ),
    Kind.TOO_LITTLE: (
        "effects of the catalogue explain only {share:.0f} % of the mismatch beyond the noise (a "
        "verdict needs at least {needed:.0f} %), if {words}"
    ),
}
"""Why effects do not explain a mismatch, with their titles or the words that state them."""
_STATED = (Kind.REVERSALS, Kind.TOO_LITTLE)


def _reason_texts(reason: Reason, rng: np.random.Generator) -> tuple[str, ...]:
    """Return texts that state why effects do not explain a mismatch outside the catalogue."""
    titles = [title(n) for n in reason.effects]
    if reason.kind is Kind.NO_EFFECT:
        return _last_candidate(reason.search)
    if reason.kind is Kind.BETWEEN_SAMPLES:
        return _between_samples(reason.search)
    if reason.kind is Kind.ONE_DIRECTION:
        return tuple(
            f"{t} would explain the mismatch only with a different size in each direction of motion"
            for t in titles
        )
    stated = effects_of(reason.search, rng) if reason.kind in _STATED else ()
    text = _WHY_NOT[reason.kind].format(
        titles=" and ".join(titles),
        words="; and ".join(e.statement for e in stated),
        share=100.0 * judged_equation(reason.search).explained,
        needed=100.0 * reason.needed,
        left=reason.left,
    )
    return (text,)


def _between_samples(found: Search) -> tuple[str, ...]:
    """Return the text on a voltage mismatch that values between the samples may cause."""
    voltage = next(e for e in found.baseline.equations if e.name == "voltage")
    rows = found.baseline.residual[found.baseline.stack.part("voltage")]
    rms = voltage.sigma * math.sqrt(float(np.mean(rows**2)))
    return (
        f"the voltage equation has a mismatch of {rms:.3g} V rms (noise floor {voltage.sigma:.3g} "
        f"V), which is not attributed to an effect: values between the samples, which are not "
        f"logged, may cause about {between_samples(voltage.views):.3g} V rms, because the logged "
        f"{_sampled(voltage)} from sample to sample; log the mean of each sample period, and "
        "declare `average: true`",
    )


def _sampled(voltage: Equation) -> str:
    """Return the channels of the voltage equation that are not averaged, with their verb."""
    averaged = frozenset.intersection(*(v.recording.averaged for v in voltage.views))
    names = [name for name in ("voltage", "current") if name not in averaged]
    return f"{names[0]} changes" if len(names) == 1 else "voltage and current change"


def _last_candidate(found: Search) -> tuple[str, ...]:
    """Return the text that states why a search ended without an effect."""
    last = next((s for s in reversed(found.steps) if s.action in _ENDS), None)
    if last is None:
        return ("no effect of the catalogue resembles the mismatch",)
    if last.action == DROPPED:  # :func:`dropped_effects` states it
        return ()
    return (f"{_ENDS[last.action]}, {title(last.name)}, {last.note}",)


def unexplained_equations(found: Search, verdict: Verdict) -> tuple[str, ...]:
    """Return texts on equations with a mismatch beyond the noise in which no identified effect
    appears, and on recordings set aside in which the effects explain too little.
    """
    if verdict not in (Verdict.NAMED, Verdict.AMBIGUOUS):
        return ()
    acting = equations_of_effects(found)
    of = {e.name: e for e in found.final.equations}
    unseen = (
        f"on recordings set aside the effects explain only "
        f"{100.0 * (found.unseen_share or 0.0):.0f} % of the mismatch beyond the noise"
    )
    return (
        *((unseen,) if little_unseen(found) else ()),
        *(
            f"the {e.equation} equation has a further mismatch that no effect explains: "
            f"{math.sqrt(e.after) * of[e.equation].sigma:.3g} {of[e.equation].unit} rms; "
            f"noise floor {of[e.equation].sigma:.3g}"
            for e in excess_of(found)
            if e.equation not in AT_INSTANTS | {*acting} and e.after > RULES.excess
        ),
    )
