"""Selects effects one by one by tests, compares each with its rivals, and removes effects that are
no longer needed.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from identification.diagnosis.comparison import (
    Contender,
    Round,
    contains,
    implausible,
    one_of_each,
    parameter_count,
    preference,
    preferred,
    simplest,
)
from identification.diagnosis.crossing import gap_or_loop
from identification.diagnosis.joint import Added, Joint, with_lower_noise
from identification.diagnosis.removal import (
    judging_equations,
    left_beyond_noise,
    share_equation,
    with_best_rivals,
    with_needed_effects,
    would_be_removed,
)
from identification.diagnosis.result import Step
from identification.diagnosis.rules import RULES
from identification.diagnosis.significance import (
    DRAWS,
    beyond_noise,
    generic_candidates,
    sign_flip_p_value,
    size_p_value,
    trial_candidates,
)
from identification.diagnosis.stack import Candidate
from identification.diagnosis.within_limits import (
    feasible_or_first,
    infeasible,
    with_assumed_fall,
)
from identification.effects.effect import Context, Effect, Shape

TRIALS = 3
"""Number of trial parameters of an effect without a score; a fit searches within a factor of 4 of
each trial parameter.
"""


def best_of_each(candidates: Sequence[Candidate], terms: Mapping[str, Effect]) -> list[Candidate]:
    """Return the best candidate of each effect that is not negligible, best first.

    Args:
        candidates: Candidates of all effects.
        terms: Terms of the candidates, by name.
    """
    each: dict[str, list[Candidate]] = {}
    for candidate in candidates:
        each.setdefault(candidate.name, []).append(candidate)
    best = [max(c, key=lambda c: _rank(c, terms[c.name])) for c in each.values()]
    return sorted(
        (c for c in best if c.score > 0.0 and c.share > RULES.least_share),
        key=lambda c: -c.score,
    )


def _rank(candidate: Candidate, term: Effect) -> float:
    """Return by what the trials of one effect are compared: the score, and for an effect whose
    nonlinear parameters determine its size, the score at this size.

    The score has a free coefficient, so that all delays far below the time of a motion score alike.
    A fit starts from the trial and searches nearby: it needs the trial of the right size.
    """
    if term.size is None or candidate.score <= 0.0:
        return candidate.score
    short = 1.0 - term.size / float(candidate.coefficients[0])
    return candidate.score - candidate.gain * short**2


def finalist_groups(
    baseline: Joint,
    joint: Joint,
    terms: Mapping[str, Effect],
    ranked: Sequence[Candidate],
    missing: Callable[[str], bool],
) -> Iterator[list[Candidate]]:
    """Yield groups of finalists, to be tried in turn until one effect is selected.

    The finalists for the first effect are selected by their scores alone. For a further effect, the
    first group has those that explain a sufficient share of the mismatch beyond the noise in their
    equations. Effects that appear only in equations without a significant mismatch, and effects
    that would be removed again, are omitted.

    Args:
        baseline: Fit of the nominal model.
        joint: Fit with the effects that were selected so far.
        terms: Terms of the candidates, by name.
        ranked: The best candidate of each effect, best first.
        missing: Function that returns whether physics is missing in the equation of a given name.
    """
    if not joint.effects:
        yield _finalists(ranked)
        return
    seen = {e.name for e in joint.equations if missing(e.name)}
    shown = [
        c
        for c in ranked
        if any(name in seen for name in judging_equations(joint, terms[c.name]))
        and not would_be_removed(baseline, joint, terms[c.name], c)
    ]
    telling = [
        c for c in shown if c.gain >= RULES.further_share * left_beyond_noise(joint, terms[c.name])
    ]
    first = _finalists(telling)
    yield first
    rest = [c for c in shown if c not in first]
    yield _finalists(rest)


def _finalists(ranked: Sequence[Candidate]) -> list[Candidate]:
    return [c for c in ranked if c.score > RULES.rival_share * ranked[0].score][: RULES.finalists]


def unscored(
    joint: Joint, terms: Mapping[str, Effect], scored: Collection[Candidate]
) -> list[Candidate]:
    """Return candidates of the effects without a score whose size is given by a nonlinear
    parameter, in the equations whose mismatch is beyond the noise.

    The regressors of these effects depend on the nominal values. If the nominal values are far from
    the true values, for example without a fall of friction with speed, the score of the right
    effect may be negative.
    """
    names = {c.name for c in scored}
    context = Context(joint.views, joint.nominal)
    beyond = beyond_noise(joint)
    out = []
    for name, term in terms.items():
        if name in names or term.size is None or not beyond & {*judging_equations(joint, term)}:
            continue
        shapes = list(term.shapes(context))
        places = {(2 * k + 1) * len(shapes) // (2 * TRIALS) for k in range(TRIALS)}
        out += [_trial(name, shapes[k]) for k in sorted(places) if k < len(shapes)]
    return out


def _trial(name: str, shape: Shape) -> Candidate:
    none = np.zeros((0, 1))
    return Candidate(name, shape, np.ones(1), 0.0, 0.0, 0.0, none, np.zeros((0, 1, 1)), 0.0)


Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Search:
    """Result of the search.

    Attributes:
        baseline: Fit of the nominal model alone.
        final: Fit with every kept effect.
        rounds: Selection step of each kept effect.
        p_value: p-value of the test whether physics is missing.
        p_after: p-value of the test whether further physics is missing.
        loudest: Generic family or effect with the least p-value at the end of the search.
        steps: Steps of the search.
        unseen_share: Share of the mismatch beyond the noise on recordings set aside that the
            effects explain, or None without such recordings or without such a mismatch.
    """

    baseline: Joint
    final: Joint
    rounds: tuple[Round, ...]
    p_value: float
    p_after: float
    loudest: str
    steps: tuple[Step, ...]
    unseen_share: float | None = None


@dataclass(frozen=True)
class Options:
    """Options of a search.

    Attributes:
        until_flexible: Whether the search ends when an effect is selected with which the
            transmission is flexible.
        fixed: Nominal parameters that are not estimated.
        thorough: Whether effects without a score are fitted too before the first effect is
            selected. A score is a linearisation about the nominal fit, which may be far from the
            right parameters.
    """

    until_flexible: bool = False
    fixed: Collection[str] = ()
    thorough: bool = False


@dataclass(frozen=True)
class _Case:
    """Effects to choose from, by name, and options of the search."""

    terms: Mapping[str, Effect]
    options: Options


@dataclass(frozen=True)
class _Test:
    """Result of a test whether physics is missing.

    Attributes:
        trials: Scores of the effects of the catalogue at trial parameters.
        unnamed: Scores of the generic families.
        p_value: p-value of the test.
        loudest: Name of the most significant candidate.
    """

    trials: tuple[Candidate, ...]
    unnamed: tuple[Candidate, ...]
    p_value: float
    loudest: str


def search(
    baseline: Joint,
    terms: Sequence[Effect],
    rng: np.random.Generator,
    progress: Progress,
    options: Options = Options(),
) -> Search:
    """Add effects one at a time while the test allows, then try to remove each effect.

    Each effect is judged at the end, with all other effects in the model: two effects may together
    explain the whole mismatch although each of them alone explains little.

    Args:
        baseline: Fit of the nominal model.
        terms: Effects to choose from.
        rng: Random generator for the sign flips.
        progress: Called with the current step.
        options: Options of the search.
    """
    case = _Case({t.name: t for t in terms}, options)
    joint = baseline
    rounds: list[Round] = []
    steps: list[Step] = []
    p_values: list[float] = []
    while True:
        named = {e.term.name for e in joint.effects}
        left = [t for t in terms if t.name not in named]
        progress(f"screening {len(left)} effects", len(rounds) / (RULES.most_effects + 1))
        test = _missing_test(joint, case, left, rng)
        p_values.append(test.p_value)
        steps.append(
            Step("test", test.loudest, test.p_value, 0.0, "this is the most significant candidate")
        )
        if test.p_value > RULES.level or len(rounds) == RULES.most_effects:
            break
        tell = partial(_tell, progress, (len(rounds) + 0.5) / (RULES.most_effects + 1))
        taken = _next_effect(case, (baseline, joint), test, rng, tell, steps)
        if taken is None:
            break
        joint, added = taken
        rounds.append(added)
        baseline, joint = with_lower_noise(baseline, joint)
        if options.until_flexible and case.terms[added.name].flexible:
            break
    ended = options.until_flexible and rounds and case.terms[rounds[-1].name].flexible
    if not ended:
        joint, rounds = _final_effects(case, (baseline, joint), rounds, progress, steps)
    p_value, p_after = p_values[0], p_values[-1]
    return Search(baseline, joint, tuple(rounds), p_value, p_after, test.loudest, tuple(steps))


def _missing_test(
    joint: Joint, case: _Case, left: Sequence[Effect], rng: np.random.Generator
) -> _Test:
    """Test whether physics is missing, by size and by sign flips.

    Only equations whose mismatch is beyond the noise are tested. Effects that may vary by their
    full amplitude from row to row are tested in any case, because the noise estimate contains them.
    """
    beyond = beyond_noise(joint)
    shown = [t for t in left if t.fast or beyond & {*judging_equations(joint, t)}]
    trials = tuple(trial_candidates(joint.stack, Context(joint.views, joint.nominal), shown))
    # The name of a generic family starts with the name of its equation.
    unnamed = tuple(c for c in generic_candidates(joint.stack) if c.name.split(" ")[0] in beyond)
    # An effect in a block or two has no statistic by blocks; the test by size shows it.
    every = (*(c for c in trials if c.tested), *unnamed)
    by_size = max(size_p_value(joint), 1e-12)
    # This is the smallest p-value that the number of sign flips can give.
    by_flips = (
        1.0 if by_size < 1.0 / (1 + DRAWS) else sign_flip_p_value(every, joint.stack.blocks, rng)
    )
    loudest = max(every, key=lambda c: c.surprise).name if every else ""
    return _Test(trials, unnamed, min(1.0, 2.0 * min(by_flips, by_size)), loudest)


def _tell(progress: Progress, share: float, finalists: Sequence[Candidate]) -> None:
    progress("fitting " + ", ".join(c.name for c in finalists), share)


def _next_effect(
    case: _Case,
    fits: tuple[Joint, Joint],
    test: _Test,
    rng: np.random.Generator,
    tell: Callable[[Sequence[Candidate]], None],
    steps: list[Step],
) -> tuple[Joint, Round] | None:
    """Return the fit with the best further effect, or None if no further effect is acceptable.

    Args:
        case: Inputs of the search.
        fits: Fits of the nominal model, and with the effects selected so far.
        test: Test by which one more effect is needed.
        rng: Random generator for the tests of single equations.
        tell: Called with the effects that are being fitted.
        steps: Steps of the search so far, to which the new step is appended.
    """
    baseline, joint = fits
    best = best_of_each(test.trials, case.terms)
    if case.options.thorough and not joint.effects:
        tried = [*best[: RULES.finalists], *unscored(joint, case.terms, best)]
        tell(tried)
        return _best_finalist(case, fits, tried, test.p_value, steps)
    if not best:
        return None
    missing = partial(_missing, joint, case.terms, (*test.trials, *test.unnamed), rng)
    for finalists in finalist_groups(baseline, joint, case.terms, best, missing):
        tell(finalists)
        taken = _best_finalist(case, fits, finalists, test.p_value, steps)
        if taken is not None:
            return taken
    return None


def _final_effects(
    case: _Case,
    fits: tuple[Joint, Joint],
    rounds: list[Round],
    progress: Progress,
    steps: list[Step],
) -> tuple[Joint, list[Round]]:
    """Try to remove each effect, then to replace each remaining effect by its rivals; return the
    final fit and the selection rounds.
    """
    baseline, before = fits
    joint, rounds = with_needed_effects(baseline, before, rounds, steps)
    dropped = [e for e in before.effects if all(e.term.name != r.name for r in rounds)]
    if len(before.effects) > 1:
        progress("comparison with rivals", 0.9)
        joint, rounds = with_best_rivals(baseline, joint, rounds, dropped, steps)
    return gap_or_loop(baseline, joint, rounds, list(case.terms.values()), steps)


def _best_finalist(
    case: _Case,
    fits: tuple[Joint, Joint],
    finalists: Sequence[Candidate],
    p_value: float,
    steps: list[Step],
) -> tuple[Joint, Round] | None:
    """Fit each finalist jointly with the selected effects; return the fit with the best finalist,
    or None if no finalist is plausible and explains more than chance.
    """
    if not finalists:
        return None
    terms, joint = case.terms, fits[1]
    finalists, fitted = one_of_each(
        [(candidate, _fit_with(case, fits, candidate)) for candidate in finalists]
    )
    beyond = [implausible(f) for f in fitted]
    ranked = sorted(range(len(fitted)), key=lambda k: fitted[k].cost + 2.0 * finalists[k].penalty)
    order = [k for k in ranked if not beyond[k]]
    if not order:
        first = finalists[0]
        steps.append(
            Step("stop", first.name, p_value, first.gain, f"fits only with {beyond[ranked[0]]}")
        )
        return None
    winner = order[
        simplest(
            [fitted[k] for k in order], [parameter_count(fitted[k].effects[-1]) for k in order]
        )
    ]
    ranked.remove(winner)
    rivals = tuple(
        Contender(finalists[k].name, fitted[k], preference(fitted[winner], fitted[k]), beyond[k])
        for k in ranked
        if share_equation(terms[finalists[k].name], terms[finalists[winner].name])
        and not infeasible(fitted[k])
        and not contains(
            fitted[k].effects[-1], fitted[k], fitted[winner].effects[-1], fitted[winner]
        )
    )
    gain = joint.cost - fitted[winner].cost
    if gain <= 2.0 * finalists[winner].penalty:
        steps.append(
            Step(
                "stop",
                finalists[winner].name,
                p_value,
                gain,
                "explains no more than expected by chance",
            )
        )
        return None
    steps.append(Step("add", finalists[winner].name, p_value, gain, _why(rivals)))
    return fitted[winner], Round(finalists[winner].name, rivals)


def _fit_with(case: _Case, fits: tuple[Joint, Joint], candidate: Candidate) -> Joint:
    """Return the fit with a candidate and the selected effects.

    An effect with several forms is fitted in each form in turn; a later form is selected only if it
    fits significantly better than the earlier forms.
    """
    taken, *others = (_fit_from(case, fits, candidate, shape) for shape in _forms(case, candidate))
    for other in others:
        if preference(other, taken) >= RULES.rejected:
            taken = other
    return taken


def _forms(case: _Case, candidate: Candidate) -> list[Shape]:
    """Return the trial parameters of a candidate in each form of the effect, in the order of the
    forms of the term; but the form of the candidate comes first, unless it is the last form of the
    term.
    """
    shapes = [candidate.shape]
    for index, values in case.terms[candidate.name].forms.items():
        own = candidate.shape[index]
        if own != values[-1]:
            values = (own, *(v for v in values if v != own))
        shapes = [(*s[:index], value, *s[index + 1 :]) for value in values for s in shapes]
    return shapes


def _fit_from(case: _Case, fits: tuple[Joint, Joint], candidate: Candidate, shape: Shape) -> Joint:
    """Return the fit with the selected effects and a candidate; the search for the nonlinear
    parameters of the candidate starts from ``shape``.
    """
    baseline, joint = fits
    added = Added(
        case.terms[candidate.name],
        shape,
        tuple(float(c) for c in candidate.coefficients),
    )
    tried = baseline.again(joint.nominal, (*joint.effects, added))
    if added.term.follows and tried.nominal.flat:
        # An effect that depends on the fall of friction with speed may have masked this fall in the
        # nominal fit.
        tried = with_assumed_fall(tried, joint.nominal, case.options.fixed)
    return feasible_or_first(tried)


def _missing(
    joint: Joint,
    terms: Mapping[str, Effect],
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    name: str,
) -> bool:
    """Whether the mismatch of one equation is significant, by the tests of :func:`_missing_test`
    with the rows of this equation only.
    """
    judged = len(joint.equations)
    if 2.0 * judged * size_p_value(joint, name) <= RULES.level:
        return True
    # The name of a generic family starts with the name of its equation.
    own = [
        c
        for c in candidates
        if (
            name in judging_equations(joint, terms[c.name])
            if c.name in terms
            else c.name.startswith(name)
        )
    ]
    return 2.0 * judged * sign_flip_p_value(own, joint.stack.blocks, rng) <= RULES.level


def _why(rivals: Sequence[Contender]) -> str:
    if not rivals:
        return "no other effect fits nearly as well as this effect"
    return "; ".join(preferred(r.name, r.preference, r.beyond) for r in rivals)
