"""Selects effects by tests, compares each with its rivals, and removes those not needed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

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
from identification.diagnosis.within_limits import feasible_or_first, infeasible, with_assumed_fall
from identification.effects.effect import Context, Effect, Shape

TRIALS = 3
"""Number of trial parameters without a score; a fit searches within a factor of 4 of each."""


def best_of_each(candidates: Sequence[Candidate], terms: Mapping[str, Effect]) -> list[Candidate]:
    """Return the best candidate of each effect that is not negligible, best first."""
    each: dict[str, list[Candidate]] = {}
    for candidate in candidates:
        each.setdefault(candidate.name, []).append(candidate)
    best = [max(c, key=lambda c: _rank(c, terms[c.name])) for c in each.values()]
    return sorted((c for c in best if c.score > 0.0 and c.relevant), key=lambda c: -c.score)


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
    """Return the candidates of greatest score; those with one regressor score equal, as one."""
    near = [c for c in ranked if c.score > RULES.rival_share * ranked[0].score]
    scores = sorted({float(f"{c.score:.9g}") for c in near}, reverse=True)[: RULES.finalists]
    return [c for c in near if float(f"{c.score:.9g}") in scores]


def unscored(
    joint: Joint, terms: Mapping[str, Effect], scored: Collection[Candidate]
) -> list[Candidate]:
    """Return candidates of the effects without a score that are nonlinear in their size, in the
    equations whose mismatch is beyond the noise.

    The regressors of these effects depend on the nominal values. If the nominal values are far from
    the true values, for example without a fall of friction with speed, the score of the right
    effect may be negative.
    """
    names = {c.name for c in scored}
    context = Context(joint.views, joint.nominal)
    beyond = beyond_noise(joint)
    out = []
    for name, term in terms.items():
        nonlinear = term.size is not None or term.simulated
        if name in names or not nonlinear or not beyond & {*judging_equations(joint, term)}:
            continue
        shapes = list(term.shapes(context))
        places = {(2 * k + 1) * len(shapes) // (2 * TRIALS) for k in range(TRIALS)}
        blocks, weights = np.zeros((0, 1)), np.zeros((0, 1, 1))
        out += [
            Candidate(name, shapes[k], np.full(1, term.scale), 0.0, 0.0, 0.0, blocks, weights, 0.0)
            for k in sorted(places)
            if k < len(shapes)
        ]
    return out


Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Search:
    """Result of the search."""

    baseline: Joint
    final: Joint
    rounds: tuple[Round, ...]  # selection step of each kept effect
    p_value: float  # p-value of the test whether physics is missing
    p_after: float  # p-value of the test whether further physics is missing
    loudest: str  # generic family or effect with the least p-value at the end of the search
    steps: tuple[Step, ...]
    # Share of the mismatch beyond the noise on recordings set aside that the effects explain, or
    # None without such recordings or without such a mismatch.
    unseen_share: float | None = None


@dataclass(frozen=True)
class Options:
    """Options of a search."""

    # Whether the search ends when an effect is selected with which the transmission is flexible.
    until_flexible: bool = False
    fixed: Collection[str] = ()  # nominal parameters that are not estimated
    # Whether effects without a score are fitted too before the first effect is selected. A score is
    # a linearisation about the nominal fit, which may be far from the right parameters.
    thorough: bool = False


class _Test(NamedTuple):
    """Test whether physics is missing: scores of effects and of generic families, p-value."""

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
    """
    named = {t.name: t for t in terms}
    return _Selection(baseline, baseline, named, rng, progress, options).run()


def missing_test(joint: Joint, left: Sequence[Effect], rng: np.random.Generator) -> _Test:
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


@dataclass
class _Selection:
    """One search: the effects to choose from, and those selected so far."""

    baseline: Joint
    joint: Joint
    terms: Mapping[str, Effect]
    rng: np.random.Generator
    progress: Progress
    options: Options
    rounds: list[Round] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)

    def run(self) -> Search:
        """Carry out the search."""
        p_values = []
        ended = False
        while True:
            named = {e.term.name for e in self.joint.effects}
            left = [t for t in self.terms.values() if t.name not in named]
            share = len(self.rounds) / (RULES.most_effects + 1)
            self.progress(f"screening {len(left)} effects", share)
            test = missing_test(self.joint, left, self.rng)
            p_values.append(test.p_value)
            self._note("test", test.loudest, test, 0.0, "this is the most significant candidate")
            if test.p_value > RULES.level or len(self.rounds) == RULES.most_effects:
                break
            if not self._take_next(test):
                break
            self.baseline, self.joint = with_lower_noise(self.baseline, self.joint)
            ended = self.options.until_flexible and self.joint.effects[-1].term.flexible
            if ended:
                break
        if not ended:
            self._settle()
        return Search(
            self.baseline,
            self.joint,
            tuple(self.rounds),
            p_values[0],
            p_values[-1],
            test.loudest,
            tuple(self.steps),
        )

    def _note(self, action: str, name: str, test: _Test, gain: float, note: str) -> None:
        self.steps.append(Step(action, name, test.p_value, gain, note))

    def _settle(self) -> None:
        """Try to remove each effect, then to replace each by its rivals."""
        base, before, steps = self.baseline, self.joint, self.steps
        joint, rounds = with_needed_effects(base, before, self.rounds, steps)
        dropped = [e for e in before.effects if all(e.term.name != r.name for r in rounds)]
        if len(before.effects) > 1:
            self.progress("comparison with rivals", 0.9)
            joint, rounds = with_best_rivals(base, joint, rounds, dropped, steps)
        terms = list(self.terms.values())
        self.joint, self.rounds = gap_or_loop(base, joint, rounds, terms, steps)

    def _take_next(self, test: _Test) -> bool:
        """Select the best further effect; return whether an effect is acceptable."""
        best = best_of_each(test.trials, self.terms)
        if self.options.thorough and not self.joint.effects:
            tried = [*best[: RULES.finalists], *unscored(self.joint, self.terms, best)]
            return self._take_best(tried, test)
        if not best:
            return False
        missing = partial(self._missing, (*test.trials, *test.unnamed))
        groups = finalist_groups(self.baseline, self.joint, self.terms, best, missing)
        return any(self._take_best(finalists, test) for finalists in groups)

    def _take_best(self, finalists: Sequence[Candidate], test: _Test) -> bool:
        """Select the best plausible finalist that explains more than chance, if there is one."""
        share = (len(self.rounds) + 0.5) / (RULES.most_effects + 1)
        self.progress("fitting " + ", ".join(c.name for c in finalists), share)
        if not finalists:
            return False
        finalists, fitted = one_of_each([(c, self._fit_with(c)) for c in finalists])
        beyond = [implausible(f) for f in fitted]
        own = [f.effects[-1] for f in fitted]
        ranked = sorted(
            range(len(fitted)), key=lambda k: fitted[k].cost + 2.0 * finalists[k].penalty
        )
        order = [k for k in ranked if not beyond[k]]
        if not order:
            first, why = finalists[0], f"fits only with {beyond[ranked[0]]}"
            self._note("stop", first.name, test, first.gain, why)
            return False
        sizes = [parameter_count(own[k]) for k in order]
        winner = order[simplest([fitted[k] for k in order], sizes)]
        ranked.remove(winner)
        best, name = fitted[winner], finalists[winner].name
        for k in ranked:
            turned = own[k].term.one_sided and own[k].coefficients[0] < 0.0
            if turned and preference(fitted[k], best) >= RULES.rejected:
                why = "fits best, but only with a negative size, which this effect cannot have"
                gain = self.joint.cost - fitted[k].cost
                self._note("stop", finalists[k].name, test, gain, why)
                return False
        rivals = tuple(
            Contender(finalists[k].name, fitted[k], preference(best, fitted[k]), beyond[k])
            for k in ranked
            if share_equation(own[k].term, own[winner].term)
            and not infeasible(fitted[k])
            and not contains(own[k], fitted[k], own[winner], best)
        )
        gain = self.joint.cost - best.cost
        if gain <= 2.0 * finalists[winner].penalty:
            self._note("stop", name, test, gain, "explains no more than expected by chance")
            return False
        told = "; ".join(preferred(r.name, r.preference, r.beyond) for r in rivals)
        none = "no other effect fits nearly as well as this effect"
        self._note("add", name, test, gain, told or none)
        self.joint = best
        self.rounds.append(Round(name, rivals))
        return True

    def _fit_with(self, candidate: Candidate) -> Joint:
        """Fit a candidate in its first form, or in a significantly better later form."""
        taken, *others = (self._fit_from(candidate, shape) for shape in self._forms(candidate))
        for other in others:
            if preference(other, taken) >= RULES.rejected:
                taken = other
        return taken

    def _forms(self, candidate: Candidate) -> list[Shape]:
        """Return the trial parameters in each form of the effect; the candidate's comes first."""
        shapes = [candidate.shape]
        for index, values in self.terms[candidate.name].forms.items():
            own = candidate.shape[index]
            if own != values[-1]:
                values = (own, *(v for v in values if v != own))
            shapes = [(*s[:index], value, *s[index + 1 :]) for value in values for s in shapes]
        return shapes

    def _fit_from(self, candidate: Candidate, shape: Shape) -> Joint:
        """Fit the selected effects and a candidate, which starts from ``shape``."""
        term, coefficients = self.terms[candidate.name], candidate.coefficients.tolist()
        added = Added(term, shape, tuple(coefficients))
        joint = self.joint
        tried = self.baseline.again(joint.nominal, (*joint.effects, added))
        if term.follows and tried.nominal.flat:
            # An effect that depends on the fall of friction with speed may have masked this fall in
            # the nominal fit.
            tried = with_assumed_fall(tried, joint.nominal, self.options.fixed)
        return feasible_or_first(tried)

    def _missing(self, candidates: Sequence[Candidate], name: str) -> bool:
        """Whether the mismatch of one equation is significant, by tests with its rows only."""
        joint, judged = self.joint, len(self.joint.equations)
        if 2.0 * judged * size_p_value(joint, name) <= RULES.level:
            return True
        # The name of a generic family starts with the name of its equation.
        own = [
            c
            for c in candidates
            if (
                name in judging_equations(joint, self.terms[c.name])
                if c.name in self.terms
                else c.name.startswith(name)
            )
        ]
        return 2.0 * judged * sign_flip_p_value(own, joint.stack.blocks, self.rng) <= RULES.level
