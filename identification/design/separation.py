"""Weighs hypotheses, fits of different effects to the recordings so far, and computes how far a
further experiment separates them.

An experiment is simulated under one hypothesis, the truth, and explained by another, the model:
the model is fitted again to the recordings so far and the simulated ones, with the rows, the noise
and the derivatives of the diagnosis. The sum of its squares exceeds that of the truth by d^2, where
d is the distance of the two predictions in standard deviations of the noise. The comparison of the
two fits in the next diagnosis then prefers the truth by about d/2 standard errors, and the error
probability of the better of two equally likely normal hypotheses is at most exp(-d^2/8) / 2
(Bhattacharyya; Kailath, IEEE Transactions on Communication Technology 15 (1967) 52).

Information is additive, so that an experiment is the sum of parts, each of which is simulated once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from identification.diagnosis.comparison import implausible, preference, probability
from identification.diagnosis.crossing import distinguished_by_crossings
from identification.diagnosis.joint import Added, Joint, with_noise
from identification.diagnosis.judgement import little_unseen
from identification.diagnosis.linear import contribution, effect_derivatives
from identification.diagnosis.result import Verdict
from identification.diagnosis.rows import Equation, equations
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import Search
from identification.diagnosis.significance import trial_candidates
from identification.diagnosis.stack import Stack, stack_of
from identification.diagnosis.within_limits import without_nuisances
from identification.effects.effect import Context, Effect
from identification.effects.model import CorrectedModel
from identification.numerics.arrays import Array
from identification.recording import Recording, RecordingError
from identification.views.nominal import SPEEDS
from identification.views.view import View, views

NOTHING, OUTSIDE, UNSEEN = "nothing", "outside", "unseen"
"""Names of the hypotheses that nothing is missing, that an effect outside the catalogue is missing,
and that one is missing which the recordings so far cannot show.
"""
JOINED = " + "
BREAKAWAY_NOISE = 3.0
"""Noise of a row of the breakaway equation, over that of the torque equation, where the recordings
so far have too few breakaways for an estimate: one sample is not filtered.
"""
OUTSIDE_SHARE = 0.02
"""Probability, before any test, that the missing physics is outside the catalogue."""
REJECTED = 2.33
"""Likelihood gap to the best hypothesis, in standard errors, from which a hypothesis is rejected:
chance alone makes such a gap in 1 % of comparisons of two equally good ones.
"""
WIDE = 1.0
"""Standard deviation of a nominal constant before any recording, over its value: linear steps far
beyond it would have no physical meaning.
"""


@dataclass(frozen=True)
class Hypothesis:
    """A set of effects, fitted jointly with the nominal constants to the recordings so far.

    Attributes:
        names: Names of the effects; empty if nothing is missing.
        joint: The fit.
        preference: Preference of the data for the best hypothesis over this one, by :func:`level`.
        weight: Relative weight of the hypothesis; the odds are weights over their sum.
        beyond: Parameter outside its plausible range, as words; empty if all are plausible.
    """

    names: tuple[str, ...]
    joint: Joint
    preference: float
    weight: float
    beyond: str = ""

    @property
    def name(self) -> str:
        """Names of the effects as one name."""
        return JOINED.join(self.names) or NOTHING

    @property
    def model(self) -> CorrectedModel:
        """The hypothesis as a model for a simulation.

        Effects of one recording alone are left out, because they do not occur in the next one.
        """
        joint = self.joint
        context = Context(joint.views, joint.nominal)
        lasting = [e for e in joint.effects if e.term.place is None]
        effects = {e.term.name: e.parameters(context) for e in lasting}
        return CorrectedModel(joint.nominal.values, joint.nominal.alpha, effects)


class Weighed(NamedTuple):
    """Hypotheses, the most likely one first, and the weights of what has no model: an effect
    outside the catalogue, and one that the recordings cannot show.
    """

    hypotheses: tuple[Hypothesis, ...]
    outside: float
    unseen: float = 0.0

    @property
    def odds(self) -> dict[str, float]:
        """Probability of each hypothesis, by name, greatest first; the sum is 1."""
        found = {h.name: h.weight for h in self.hypotheses}
        found |= {OUTSIDE: self.outside, UNSEEN: self.unseen}
        total = sum(found.values())
        return {n: w / total for n, w in sorted(found.items(), key=lambda item: -item[1])}

    @property
    def rivals(self) -> list[Hypothesis]:
        """The hypotheses that the recordings have not rejected, without the first."""
        return [h for h in self.hypotheses[1:] if h.preference < REJECTED]

    @property
    def left(self) -> float:
        """Mean square of what the best hypothesis leaves, over that of the noise."""
        return float(np.mean(self.hypotheses[0].joint.residual ** 2))


def weigh(
    found: Search, verdict: Verdict, terms: Sequence[Effect], wanted: Sequence[str] = ()
) -> Weighed:
    """Return the hypotheses that a diagnosis leaves, with their weights.

    The hypotheses are the identified effects, each of them replaced by each of its rivals and by
    the catalogue's look-alikes, and nothing. All are fitted again to the same rows with the noise
    of the diagnosis' last step, and compared by :func:`level`; the best one may be a rival.

    Args:
        found: Search of the diagnosis.
        verdict: Verdict of the diagnosis.
        terms: Effects that were searched for.
        wanted: Names of the only hypotheses, or empty for all of them; a wanted effect that the
            diagnosis did not try is fitted.
    """
    base, known = found.baseline, {t.name: t for t in terms}
    named = verdict in (Verdict.NAMED, Verdict.AMBIGUOUS) and bool(found.final.effects)
    outside = OUTSIDE_SHARE
    if verdict is Verdict.OUTSIDE_CATALOGUE:
        outside = 1.0
    elif named and (found.p_after <= RULES.level or little_unseen(found)):
        outside = 1.0 - RULES.incomplete_confidence
    identified = found.final if named else base
    fitted = [_Fitted(identified)]
    if named:
        fitted += _in_place_of(found, known, wanted)
    if wanted:
        tried = (fitted_with(base, base, known[n]) for n in wanted if n in known)
        fitted += [_Fitted(joint) for joint in tried if joint is not None]
        once: dict[frozenset[str], _Fitted] = {}
        for f in fitted:
            if {*f.names} <= {*wanted}:
                once.setdefault(frozenset(f.names), f)
        fitted = [*once.values()] or [_Fitted(base)]
    best = fitted[0].joint
    for one in fitted:
        judged = one.known is None and not one.beyond
        better = judged and level(best, one.joint) < -RULES.simpler
        best = one.joint if better else best
    hypotheses = []
    for one in fitted:
        # What no row decides is known relative to the identified effects.
        behind = (
            level(best, one.joint) if one.known is None else one.known + level(best, identified)
        )
        weight = 1.0 if one.joint is best else _weight(behind, one.beyond)
        hypotheses.append(Hypothesis(one.names, one.joint, behind, weight, one.beyond))
    if named and best is not base:
        hypotheses.append(Hypothesis((), base, math.inf, max(found.p_value, 1e-6)))
    if verdict is Verdict.OUTSIDE_CATALOGUE:
        hypotheses = [replace(h, weight=h.weight * OUTSIDE_SHARE) for h in hypotheses]
    unseen = 0.0
    if verdict is Verdict.NOTHING_MISSING:
        # Before any recording, one effect of the catalogue is as likely as nothing.
        so_far = present(base, terms)
        hidden = visibility(so_far) <= RULES.collinear_below**2 * so_far.shown[:, 0]
        unseen = float(np.mean(hidden))
    order = sorted(hypotheses, key=lambda h: (h.joint is not best, -h.weight))
    return Weighed(tuple(order), outside, unseen)


def level(best: Joint, joint: Joint) -> float:
    """Return how far the likelihood of a fit is below that of another fit to the same rows with
    the same noise, in standard errors of the difference; negative if it is above.

    The standard error of the difference of two nearly equal fits is nearly zero. Therefore the gap
    is at most what :func:`separations` expects of fits whose squares differ by as much.
    """
    most = 0.5 * math.sqrt(abs(joint.cost - best.cost))
    better, worse = (best, joint) if best.cost <= joint.cost else (joint, best)
    gap = preference(better, worse)
    if gap > 0.0 and float(np.mean(better.residual**2)) <= RULES.tested_from:
        gap = preference(better, worse, _noise_of_difference(better, worse))
    return max(-most, min(gap if better is best else -gap, most)) + 0.0


def _noise_of_difference(better: Joint, worse: Joint) -> float:
    """Return the standard error of the difference of squares of two fits, the better of which
    leaves noise alone.

    What is random is the noise, not where an experiment shows the difference of the predictions:
    the scatter of the difference over blocks would be large where few blocks show all of it. The
    correlation of the noise within a block is that of what the better fit leaves.
    """
    apart = worse.residual - better.residual
    within = 2.0 * better.stack.sums((apart * better.residual)[:, None])[:, 0]
    rms = max(1.0, math.sqrt(float(np.mean(better.residual**2))))
    return max(float(np.linalg.norm(within)), 2.0 * rms * float(np.linalg.norm(apart)))


class _Fitted(NamedTuple):
    """A fit, and its gap to the identified effects where the rows do not decide: zero if the
    recordings cannot distinguish effects although their regressors differ, and for a gap or a
    hysteresis loop that of the torque during crossings, which no row contains.
    """

    joint: Joint
    known: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(e.term.name for e in self.joint.effects)

    @property
    def beyond(self) -> str:
        return implausible(self.joint)


def _in_place_of(
    found: Search, known: Mapping[str, Effect], wanted: Sequence[str]
) -> list[_Fitted]:
    """Return the fits in which another effect is in the place of one identified effect."""
    final, out = found.final, list[_Fitted]()
    here = {e.term.name for e in final.effects}
    context = Context(final.views, final.nominal)
    for own in final.effects:
        kept = tuple(e for e in final.effects if e is not own)
        without = found.baseline.again(final.nominal, kept) if kept else found.baseline
        rivals = {c.name: c for r in found.rounds if r.name == own.term.name for c in r.rivals}
        alike = own.term.indistinct(own.parameters(context), final.views)
        for other in dict.fromkeys((*rivals, *own.term.look_alikes, *wanted)):
            if other not in known or other in here:
                continue
            fits = [fitted_with(found.baseline, without, known[other])]
            tried = rivals[other].joint if other in rivals else final
            if added := [e for e in tried.effects if e.term.name == other]:
                fits.append(found.baseline.again(tried.nominal, (*kept, *added)))
            if possible := [j for j in fits if j is not None]:
                gap = 0.0 if other in alike else None
                if other in rivals and distinguished_by_crossings(own.term, known[other]):
                    gap = rivals[other].preference
                out.append(_Fitted(min(possible, key=lambda j: j.cost), gap))
    return out


def _weight(behind: float, beyond: str) -> float:
    """Return the weight of a rival over that of the best hypothesis."""
    share = min(1.0, probability(-behind) / probability(behind))
    return min(share, RULES.implausible_confidence) if beyond else share


def fitted_with(baseline: Joint, joint: Joint, term: Effect) -> Joint | None:
    """Return a fit with one more effect, or None if the recordings cannot show the effect."""
    context = Context(joint.views, joint.nominal)
    trials = list(trial_candidates(joint.stack, context, [term]))
    if not trials:
        return None
    best = max(trials, key=lambda c: c.score)
    added = Added(term, best.shape, tuple(best.coefficients.tolist()))
    return baseline.again(joint.nominal, (*joint.effects, added))


# What a further experiment would add.


@dataclass(frozen=True)
class Evidence:
    """What simulated recordings say about one model.

    Attributes:
        square: Sum of whitened squares at the present values of the model.
        score: Derivatives' product with the residual, shape (p,).
        normal: Derivatives' product with themselves, shape (p, p).
        shown: For each effect of the catalogue, products of its regressor: with itself, and with
            the derivatives, shape (e, 1 + p); empty if not asked for.
    """

    square: float
    score: Array
    normal: Array
    shown: Array

    def __add__(self, other: Evidence) -> Evidence:
        return Evidence(
            self.square + other.square,
            self.score + other.score,
            self.normal + other.normal,
            self.shown + other.shown,
        )


def experiment_views(
    recordings: Sequence[Recording], like: Joint, bandwidth_Hz: float
) -> tuple[View, ...]:
    """Return simulated recordings as further recordings of a fit."""
    valve_side = any(np.any(v.twist) for v in like.views)
    found = views(recordings, bandwidth_Hz, valve_side)
    return tuple(replace(v, index=len(like.views) + k) for k, v in enumerate(found))


def evidence(joint: Joint, here: Sequence[View], terms: Sequence[Effect] = ()) -> Evidence:
    """Return the evidence of recordings, simulated or fitted, on a model, for least squares.

    Args:
        joint: Fit of the model.
        here: Views of the recordings.
        terms: Effects whose visibility is asked for.

    Raises:
        RecordingError: The recordings have no row.
    """
    return _evidence(stack_of(_rows(joint, here), joint.nominal), joint, terms)


def _rows(joint: Joint, here: Sequence[View]) -> list[Equation]:
    """Return the equations of further recordings at the values and with the noise of a fit."""
    sigma = {e.name: e.sigma for e in joint.equations}
    sigma.setdefault("breakaway", BREAKAWAY_NOISE * sigma["torque"])
    rows = equations(here, joint.nominal, joint.unit)
    known = [with_noise(e, sigma[e.name]) for e in rows if e.name in sigma]
    if not known:
        raise RecordingError("no sample is in steady motion")
    return known


def present(joint: Joint, terms: Sequence[Effect] = ()) -> Evidence:
    """Return what the recordings so far say, and what is assumed before any recording."""
    found = _evidence(joint.stack, joint, terms)
    nominal = joint.nominal
    values = np.array([1.0 if n in SPEEDS else abs(nominal.get(n)) for n in nominal.free])
    prior = np.zeros(len(found.score))
    prior[: len(values)] = 1.0 / (WIDE * np.maximum(values, 1e-9)) ** 2
    # At its minimum a fit has no gradient; what is left of it is an error of the linearisation.
    return replace(
        found, square=0.0, score=np.zeros_like(prior), normal=found.normal + np.diag(prior)
    )


def _evidence(stack: Stack, joint: Joint, terms: Sequence[Effect]) -> Evidence:
    context = Context(joint.views, joint.nominal)
    columns = [_first_column(stack, term, context) for term in terms]
    shown = np.stack(columns, axis=1) if columns else np.zeros((len(stack.residual), 0))
    left, slopes = _linearised(stack, joint)
    shown = without_nuisances(stack, shown)
    products = np.concatenate([np.sum(shown**2, axis=0)[:, None], shown.T @ slopes], axis=1)
    return Evidence(float(left @ left), slopes.T @ left, slopes.T @ slopes, products)


def _linearised(stack: Stack, joint: Joint) -> tuple[Array, Array]:
    """Return the whitened residual of a model at its values, shape (n,), and the derivatives with
    respect to nominal constants, coefficients and nonlinear parameters, shape (n, p).
    """
    left = stack.measured
    count = len(joint.nominal.free)
    slopes = np.zeros((len(left), count))
    for equation in stack.equations:
        if equation.name == "torque":
            slopes[stack.part("torque")] = equation.tangent[:, :count] / equation.sigma
    here = {e.name for e in stack.equations}
    columns = [slopes]
    for effect in joint.effects:
        if here & effect.term.columns.keys():
            left = left - contribution(stack, effect)
            columns.append(effect_derivatives(stack, [effect]))
        else:
            fitted = len(effect.coefficients) if effect.term.size is None else 0
            columns.append(np.zeros((len(left), fitted + len(effect.term.refine))))
    slopes = np.concatenate(columns, axis=1)
    return without_nuisances(stack, left[:, None])[:, 0], without_nuisances(stack, slopes)


class Band(NamedTuple):
    """Torque of simulated recordings in steady motion, N m, and its standard error as a prediction
    of a measurement: of the noise, and of the parameters. One entry for each recording.
    """

    time: tuple[Array, ...]
    torque: tuple[Array, ...]
    error: tuple[Array, ...]


def predicted_band(joint: Joint, here: Sequence[View]) -> Band:
    """Return the band around a simulated torque.

    What the model leaves of the recordings beyond their noise is counted as noise.
    """
    stack = stack_of(_rows(joint, here), joint.nominal)
    equation = next(e for e in stack.equations if e.name == "torque")
    rows = stack.part("torque")
    _, slopes = _linearised(stack, joint)
    left = joint.residual[joint.stack.part("torque")]
    more = max(1.0, float(np.mean(left**2)))
    normal = present(joint).normal
    spread = np.sum(slopes[rows] * _solved(normal, slopes[rows].T).T, axis=1)
    error = equation.sigma * np.sqrt(more * (1.0 + np.maximum(spread, 0.0)))
    time, torque, errors = [], [], []
    for view, kept in zip(equation.views, equation.kept, strict=True):
        mine = equation.owner == view.index
        time.append(view.kept_times[kept] - view.time[0])
        torque.append(view.low_pass(view.torque)[kept])
        errors.append(error[mine])
    return Band(tuple(time), tuple(torque), tuple(errors))


def _first_column(stack: Stack, term: Effect, context: Context) -> Array:
    """Return the regressor of an effect at the middle one of its trial parameters."""
    shapes = list(term.shapes(context))
    columns = stack.columns(term, shapes[len(shapes) // 2]) if shapes else {}
    return stack.whitened(columns)[:, 0] if columns else np.zeros(len(stack.residual))


def least_squares_left(before: Evidence, added: Evidence) -> float:
    """Return the increase of a model's sum of squares by further recordings, after a new fit."""
    step = _solved(before.normal + added.normal, added.score)
    return added.square - float(added.score @ step)


def visibility(before: Evidence) -> Array:
    """Return the squares of each effect that the nominal constants cannot explain, shape (e,)."""
    own, along = before.shown[:, 0], before.shown[:, 1:]
    return np.asarray(
        np.maximum(own - np.sum(along.T * _solved(before.normal, along.T), axis=0), 0.0)
    )


def information(before: Evidence, added: Evidence) -> float:
    """Return the gain of information on the constants of a model, in nats (D-optimality)."""
    scale = np.sqrt(np.diag(before.normal))
    scale = np.where(scale > 0.0, scale, 1.0)
    logs = [
        np.linalg.slogdet(m / np.outer(scale, scale) + 1e-9 * np.eye(len(scale)))[1]
        for m in (before.normal, before.normal + added.normal)
    ]
    return 0.5 * float(logs[1] - logs[0])


def _solved(normal: Array, right: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = normal / np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
    turned = right / (scale if right.ndim == 1 else scale[:, None])
    found = np.linalg.solve(scaled, turned)
    return np.asarray(found / (scale if right.ndim == 1 else scale[:, None]))


Pair = tuple[int, int]
"""Truth and model, by their places among the hypotheses."""


def separations(before: Sequence[Evidence], added: Mapping[Pair, Evidence]) -> dict[Pair, float]:
    """Return the expected preference of each pair of hypotheses, standard errors, whichever of the
    two is true.

    Args:
        before: What the recordings so far say about each hypothesis.
        added: What the experiment, simulated under the truth, says about the model.
    """
    left = {pair: least_squares_left(before[pair[1]], e) for pair, e in added.items()}
    truths = sorted({truth for truth, _ in added})
    return {
        (a, b): 0.5 * math.sqrt(max(0.0, min(left[a, b] - left[a, a], left[b, a] - left[b, b])))
        for a, b in combinations(truths, 2)
    }


def error_bound(odds: Sequence[float], apart: Mapping[Pair, float]) -> float:
    """Return a bound of the probability that the most likely hypothesis is wrong after an
    experiment that separates each pair by so many standard errors.
    """
    return sum(math.sqrt(odds[a] * odds[b]) * math.exp(-0.5 * z**2) for (a, b), z in apart.items())
