"""Selects effects of the gas generator one by one by tests, compares each with its rivals, and
removes effects that are no longer needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from identification.diagnosis.gas.burns import Burn
from identification.diagnosis.gas.fit import Fitted, Model, fit, nominal_model
from identification.diagnosis.gas.rows import candidates, families, padded_rows, stack_of, starts
from identification.diagnosis.removal import LEAST_FURTHER
from identification.diagnosis.result import Step
from identification.diagnosis.rules import RULES
from identification.diagnosis.significance import sign_flip_p_value
from identification.diagnosis.stack import Stack
from identification.effects import GAS
from identification.effects.gas_generator import GasEffect, GasGeneratorEffect
from identification.recording import Array

MOST_EFFECTS = 2
LEAST_SHARE = 5e-4
"""Power of an effect's contribution, relative to the noise power, below which it is negligible.

The limit is low because a leak or erosion is nearly collinear with the nominal constants, and a
small remainder is significant in white transducer noise.
"""
REJECTED = 1.645
"""Number of standard errors by which a rival must be worse to be rejected (one-sided level of 5
%).
"""
TRIALS_FITTED = 2
"""Number of sets of trial parameters, the best by the linear score, from which an effect is
fitted.
"""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Rivalry:
    """A rival, fitted in place of the selected effect.

    Attributes:
        name: Stable name.
        fitted: Fit with the rival.
        preference: Preference of the data for the selected effect, in standard errors of the
            difference: by blocks (Vuong, Econometrica 57 (1989) 307), or from the likelihood ratio
            if only noise is left.
        apart: Expected preference in white noise, from the distance of the two simulated pressures:
            the greatest preference that this excitation allows.
    """

    name: str
    fitted: Fitted
    preference: float
    apart: float

    @property
    def open(self) -> bool:
        """Whether the recordings do not reject the rival."""
        return self.preference < REJECTED or self.apart < REJECTED


@dataclass(frozen=True)
class Selected:
    """A selected effect and its rivals, best first."""

    name: str
    rivals: tuple[Rivalry, ...]


@dataclass(frozen=True)
class GasSearch:
    """Result of the search.

    Attributes:
        burns: Recordings.
        sigma: Noise of a row, Pa.
        baseline: Fit of the nominal model alone.
        final: Fit with every kept effect.
        stack: Stack of the baseline.
        taken: One entry for each kept effect.
        p_value: p-value of the test whether physics is missing.
        p_after: p-value of the test whether further physics is missing.
        steps: Steps of the search.
    """

    burns: tuple[Burn, ...]
    sigma: float
    baseline: Fitted
    final: Fitted
    stack: Stack
    taken: tuple[Selected, ...]
    p_value: float
    p_after: float
    steps: tuple[Step, ...]


def search(
    burns: tuple[Burn, ...], sigma: float, rng: np.random.Generator, progress: Progress
) -> GasSearch:
    """Add effects one at a time while the test allows, then try to remove each effect."""
    progress("nominal gas generator", 0.0)
    baseline = here = fit(burns, sigma, nominal_model(burns))
    first = stack_of(burns, baseline, sigma)
    seen = _test(burns, first, here, rng)
    p_value = seen.p_value
    taken: list[Selected] = []
    steps = [seen.step]
    while seen.p_value <= RULES.level and len(taken) < MOST_EFFECTS:
        progress("fitting effects", (len(taken) + 0.5) / (MOST_EFFECTS + 1))
        tried = _fits_with_one_more(burns, sigma, here, seen.stack)
        fitted = [f for f in tried if plausible(f.model.effects[-1])]
        winner = _simplest_fit(fitted, first) if fitted else None
        stop = _stop(baseline, here, tried, winner, first, seen.p_value)
        if stop is not None:
            steps.append(stop)
        if stop is not None or winner is None:
            break
        after = _test(burns, stack_of(burns, winner, sigma, first), winner, rng)
        prefer = preference if after.p_value <= RULES.level else _likelihood_preference
        rivals = tuple(
            Rivalry(
                f.model.effects[-1].term.name,
                f,
                prefer(winner, f, first),
                expected_preference(winner, f),
            )
            for f in sorted(fitted, key=lambda f: f.cost)
            if f is not winner
        )
        name, gain = winner.model.effects[-1].term.name, here.cost - winner.cost
        steps += [Step("add", name, seen.p_value, gain, _why(rivals)), after.step]
        taken.append(Selected(name, rivals))
        here, seen = winner, after
    final, taken = _with_needed_effects(burns, sigma, here, taken, first, steps)
    return GasSearch(
        burns, sigma, baseline, final, first, tuple(taken), p_value, seen.p_value, tuple(steps)
    )


def _stop(
    baseline: Fitted,
    here: Fitted,
    tried: Sequence[Fitted],
    winner: Fitted | None,
    stack: Stack,
    p_value: float,
) -> Step | None:
    """Return the step that ends the search without a further effect, or None if the best further
    effect is selected.

    Args:
        baseline: Fit of the nominal model alone.
        here: Fit with the effects selected so far.
        tried: Fits with each of the other effects in addition.
        winner: Best of these fits with a plausible size.
        stack: Stack of the baseline.
        p_value: p-value of the test whether further physics is missing.
    """
    if winner is None:
        words = "no effect of the catalogue fits with parameters in their plausible ranges"
        return Step("stop", "", p_value, 0.0, words)
    turned = [
        f
        for f in tried
        if reversed_sign(f.model.effects[-1])
        and _likelihood_preference(f, winner, stack) > REJECTED
    ]
    if turned:
        best = min(turned, key=lambda f: f.cost)
        words = "fits better than any other effect, but with a size of the opposite sign"
        name = best.model.effects[-1].term.name
        return Step("stop", name, p_value, here.cost - best.cost, words)
    gain = here.cost - winner.cost
    share = gain / max(here.cost - RULES.excess * len(here.residual), gain)
    beside = gain / max(baseline.cost - here.cost, gain)
    needed = RULES.further_share if beside >= LEAST_FURTHER else RULES.nearly_all
    if here.model.effects and share < needed:
        words = (
            f"explains {100.0 * share:.0f} % of the remaining mismatch, and only "
            f"{100.0 * beside:.2g} % of the squares that the selected effects explain: too little "
            "for one more effect"
        )
        return Step("stop", winner.model.effects[-1].term.name, p_value, gain, words)
    return None


@dataclass(frozen=True)
class _Test:
    """Result of a test whether physics is missing: p-value, step, and rows with all fitted
    parameters projected out.
    """

    p_value: float
    step: Step
    stack: Stack


def _test(burns: Sequence[Burn], stack: Stack, here: Fitted, rng: np.random.Generator) -> _Test:
    """Test whether physics is missing by three p-values: of the pattern of the mismatch (sign flips
    of blocks), of its size, and of the deviations of valve and sensors; the result is the least of
    them.
    """
    named = {e.term.name for e in here.model.effects}
    left = [t for t in GAS if t.name not in named]
    tried = [*candidates(burns, stack, here, left), *families(burns, stack, here)]
    by_shape, by_size, by_belief = (
        sign_flip_p_value(tried, stack.blocks, rng, LEAST_SHARE),
        _excess(here),
        _deviation_p_value(here),
    )
    p_value = min(1.0, 3.0 * max(min(by_shape, by_size, by_belief), 1e-12))
    loudest = max(tried, key=lambda c: c.surprise).name if tried else ""
    words = "the most significant candidate"
    if by_belief < min(by_shape, by_size):
        loudest, words = (
            "beliefs",
            "constants of valve or sensors would have to deviate by more than their tolerances",
        )
    return _Test(p_value, Step("test", loudest, p_value, 0.0, words), stack)


def _simplest_fit(fitted: Sequence[Fitted], stack: Stack) -> Fitted:
    """Return the fit of least cost, or a fit with fewer parameters that is not significantly
    worse.
    """
    best = min(fitted, key=lambda f: f.cost)
    same = [
        f
        for f in fitted
        if preference(best, f, stack) < RULES.simpler
        and _likelihood_preference(best, f, stack) < REJECTED
    ]
    return min((best, *same), key=lambda f: (len(f.model.effects[-1].parameters), f.cost))


def preference(chosen: Fitted, rival: Fitted, stack: Stack) -> float:
    """Return the preference of the data for ``chosen``, in standard errors of the difference by
    blocks.
    """
    loss = stack.sums(padded_rows(stack, (rival.residual**2 - chosen.residual**2)[:, None]))[:, 0]
    loss[-1] = rival.pull @ rival.pull - chosen.pull @ chosen.pull
    spread = float(np.std(loss, ddof=1)) * math.sqrt(len(loss))
    return float(np.sum(loss)) / spread if spread > 0.0 else 0.0


def _likelihood_preference(chosen: Fitted, rival: Fitted, _stack: Stack) -> float:
    """Return the preference if the residual of ``chosen`` is white noise: from the square root of
    the likelihood ratio, as in :func:`expected_preference`.
    """
    return 0.5 * math.sqrt(max(rival.cost - chosen.cost, 0.0))


def expected_preference(one: Fitted, other: Fitted) -> float:
    """Return the expected preference between two models in white noise, from the difference of
    their pressures.
    """
    return 0.5 * float(np.linalg.norm(one.residual - other.residual))


def _fits_with_one_more(
    burns: Sequence[Burn], sigma: float, here: Fitted, stack: Stack
) -> list[Fitted]:
    """Return for every effect that lowers the cost its best fit, jointly with all selected effects
    and constants.
    """
    named = {e.term.name for e in here.model.effects}
    fresh, found = nominal_model(burns), []
    for term in GAS:
        if term.name in named:
            continue
        trials = starts(burns, stack, here, term)[:TRIALS_FITTED]
        started = [_with(here.model, fresh, term, size, shape) for _, size, shape in trials]
        started += [
            _with(here.model, here.model, term, size, shape) for _, size, shape in trials[:1]
        ]
        tried = [fit(burns, sigma, model) for model in started]
        if tried:
            found.append(min(tried, key=lambda f: (not plausible(f.model.effects[-1]), f.cost)))
    return [f for f in found if f.cost < here.cost]


def _with(
    model: Model, start: Model, term: GasGeneratorEffect, size: float, shape: tuple[float, ...]
) -> Model:
    """Return the start of a fit with the effects of a model and one further effect. The constants
    are those of ``start``, because nominal constants are better start values than constants of a
    fit without the further effect.
    """
    sizes = dict(zip(term.sizes, (size, *shape), strict=True))
    return replace(start, effects=(*model.effects, GasEffect(term, sizes)))


def plausible(effect: GasEffect) -> bool:
    """Whether an effect's parameters are within the ranges of the catalogue."""
    ranges = {q.name: (q.low, q.high) for q in effect.term.parameters}
    return all(
        ranges[name][0] <= value <= ranges[name][1] for name, value in effect.parameters.items()
    )


def reversed_sign(effect: GasEffect) -> bool:
    """Whether the size of an effect has a sign that the catalogue excludes; for example, a throat
    that becomes wider is not a negative deposit.
    """
    name = next(iter(effect.term.sizes))
    low = next(q.low for q in effect.term.parameters if q.name == name)
    return effect.parameters[name] < low


def _excess(fitted: Fitted) -> float:
    """Return the p-value of the hypothesis that the power of the mismatch is at most `excess` times
    the power of the noise.
    """
    rows: Array = np.minimum(np.abs(fitted.residual), RULES.outlier)
    return float(stats.chi2.sf(float(rows @ rows) / RULES.excess, len(rows)))


def _deviation_p_value(fitted: Fitted) -> float:
    """Return the p-value of the fitted deviations of valve and sensors, for normally distributed
    tolerances.
    """
    pull = fitted.pull[fitted.firm]
    return float(stats.chi2.sf(float(pull @ pull), len(pull)))


def _why(rivals: Sequence[Rivalry]) -> str:
    if not rivals:
        return "no other effect fits with parameters in their plausible ranges"
    return "; ".join(f"preferred to {r.name} by {r.preference:.1f} standard errors" for r in rivals)


def _with_needed_effects(
    burns: Sequence[Burn],
    sigma: float,
    final: Fitted,
    taken: list[Selected],
    stack: Stack,
    steps: list[Step],
) -> tuple[Fitted, list[Selected]]:
    """Remove every effect that is no longer needed beside effects that were selected later; return
    fit and effects.
    """
    for name in [t.name for t in taken] if len(taken) > 1 else []:
        rest = tuple(e for e in final.model.effects if e.term.name != name)
        without = fit(burns, sigma, replace(final.model, effects=rest))
        worth = preference(final, without, stack)
        if worth < stats.norm.isf(RULES.level):
            steps.append(
                Step(
                    "remove",
                    name,
                    None,
                    final.cost - without.cost,
                    f"worth {worth:.1f} standard errors",
                )
            )
            final, taken = without, [t for t in taken if t.name != name]
    return final, taken
