"""The search: is anything missing, which effect explains it best, what else, and is each still needed at the end."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from identification.diagnosis.entries import ENTRIES
from identification.diagnosis.generic import families
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.result import Step
from identification.diagnosis.stack import Candidate, Stack, surprise
from identification.diagnosis.terms.term import Context, Term
from identification.diagnosis.view import View
from identification.recording import Array

LEVEL = 0.01
"""Of the test that anything is missing, and that anything more is."""
LEAST_SHARE = 0.01
"""Power of a contribution over that of the noise, in the equations where it shows, below which it does not matter."""
EXCESS = 1.5
"""Mean square of the mismatch over that of the noise, up to which the noise may have been taken too small."""
RARE = 6.0
DRAWS = 999
MOST_EFFECTS = 3
FINALISTS = 4
"""Effects that are fitted jointly before one of them is taken."""
FURTHER_SHARE = 0.4
"""Share of what is left beyond the noise that one more effect must explain; less is the first one's own shape."""
SIMPLER_IF = 1.0
"""Standard errors of preference below which the effect with fewer parameters is taken."""
LEAST_FURTHER = 0.01
"""Gain of one more effect over what is explained already where it shows; less is the shape of what came before..."""
NEARLY_ALL = 0.8
"""... unless it explains this share of what is left beyond the noise."""
SAME = 0.01
"""Square of the difference of two fits over the square of their mismatch, below which they are the same."""
USUAL_TORQUE_N_M, USUAL_SPEED_RAD_S, USUAL_TRAVEL_RAD = 40.0, 0.5, 0.8
"""Greatest torque and speed, and the travel, on the practical bench, which the catalogue's ranges suit."""
RIVAL_SHARE = 0.3
"""Score over the best one's, below which an effect is no finalist."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Contender:
    """An effect fitted jointly, and how far the data prefer the chosen one to it.

    ``preference`` is the studentised difference of squared residuals by blocks (Vuong, Econometrica 57 (1989) 307).
    ``beyond`` says which parameter would have to be beyond its plausible range; empty where none.
    """

    name: str
    joint: Joint
    preference: float
    beyond: str


@dataclass(frozen=True)
class Round:
    """One effect taken: the contenders it won against, best first, itself not among them."""

    name: str
    rivals: tuple[Contender, ...]


@dataclass(frozen=True)
class Search:
    """How the search ended.

    Attributes:
        baseline: The nominal model alone.
        final: With every effect kept.
        rounds: One for each effect kept.
        p_value: Of the test that anything is missing.
        p_after: Of the test that anything more is missing.
        loudest: Generic family, or effect, with the least chance after all (name, gain).
        steps: As it went.
    """

    baseline: Joint
    final: Joint
    rounds: tuple[Round, ...]
    p_value: float
    p_after: float
    loudest: str
    steps: tuple[Step, ...]


def search(
    views: Sequence[View],
    unit: str,
    baseline: Joint,
    terms: Sequence[Term],
    rng: np.random.Generator,
    progress: Progress,
) -> Search:
    """Add effects one at a time while the test allows, then try to remove each."""
    by_name = {t.name: t for t in terms}
    joint, rounds, steps = baseline, [], []
    p_value = p_after = 1.0
    loudest = ""
    for turn in range(MOST_EFFECTS + 1):
        left = [t for t in terms if t.name not in {e.term.name for e in joint.effects}]
        progress(f"screening {len(left)} effects", turn / (MOST_EFFECTS + 1))
        trials = list(screened(joint.stack, Context(tuple(views), joint.nominal), left))
        unnamed = list(generic(joint.stack))
        by_size = excess(joint)
        p_after = min(1.0, 2.0 * min(chance([*trials, *unnamed], joint.stack.blocks, rng), max(by_size, 1e-12)))
        loudest = max((*trials, *unnamed), key=lambda c: c.surprise).name if trials or unnamed else ""
        if turn == 0:
            p_value = p_after
        steps.append(Step("test", loudest, p_after, 0.0, "the most surprising candidate"))
        best = _best_of_each(trials)
        if p_after > LEVEL or turn == MOST_EFFECTS or not best:
            break
        finalists = [c for c in best if c.score > RIVAL_SHARE * best[0].score][:FINALISTS]
        fitted = []
        for candidate in finalists:
            progress(f"fitting {candidate.name}", (turn + 0.5) / (MOST_EFFECTS + 1))
            added = Added(by_name[candidate.name], candidate.shape, tuple(float(c) for c in candidate.coefficients))
            fitted.append(fit(views, unit, joint.nominal, (*joint.effects, added), baseline))
        beyond = [implausible(f) for f in fitted]
        ranked = sorted(range(len(fitted)), key=lambda k: fitted[k].cost + 2.0 * finalists[k].penalty)
        order = [k for k in ranked if not beyond[k]]
        if not order:
            steps.append(Step("stop", best[0].name, p_after, best[0].gain, f"fits only with {beyond[ranked[0]]}"))
            break
        winner = order[_simplest([fitted[k] for k in order], [_numbers(fitted[k].effects[-1]) for k in order])]
        ranked.remove(winner)
        rivals = tuple(
            Contender(finalists[k].name, fitted[k], preference(fitted[winner], fitted[k]), beyond[k])
            for k in ranked
            if not _again(fitted[k].effects[-1], fitted[k], fitted[winner].effects[-1], fitted[winner])
        )
        gain = joint.cost - fitted[winner].cost
        if gain <= 2.0 * finalists[winner].penalty:
            steps.append(Step("stop", finalists[winner].name, p_after, gain, "explains no more than chance would"))
            break
        term = by_name[finalists[winner].name]
        share = gain / _beyond_noise(joint, term)
        before = _explained(baseline, joint, term)
        needed = FURTHER_SHARE if gain >= LEAST_FURTHER * before else NEARLY_ALL
        if turn > 0 and share < needed:
            beside = 100.0 * gain / max(before, gain)
            note = (
                f"explains {100.0 * share:.0f} % of what is left beyond the noise, and {beside:.2g} % of what is "
                "explained already: too little for one more name"
            )
            steps.append(Step("stop", finalists[winner].name, p_after, gain, note))
            break
        steps.append(Step("add", finalists[winner].name, p_after, gain, _why(rivals)))
        joint = fitted[winner]
        rounds.append(Round(finalists[winner].name, rivals))
    joint, rounds = _pruned(views, unit, baseline, joint, rounds, steps)
    if len(rounds) > 1:
        progress("rivals, beside the other effects", 0.9)
        joint, rounds = _revisited(views, unit, baseline, joint, rounds, steps)
    return Search(baseline, joint, tuple(rounds), p_value, p_after, loudest, tuple(steps))


def screened(stack: Stack, context: Context, terms: Sequence[Term]) -> Iterator[Candidate]:
    """Yield every effect at every trial shape that these recordings can show."""
    for term in terms:
        for shape in term.shapes(context):
            candidate = stack.term(term, shape)
            if candidate is not None:
                yield candidate


def generic(stack: Stack) -> Iterator[Candidate]:
    """Yield the families without a name, in every equation."""
    for equation in stack.equations:
        for name, columns in families(equation):
            candidate = stack.independent(f"{equation.name} over {name}", equation.name, columns)
            if candidate is not None:
                yield candidate


def chance(candidates: Sequence[Candidate], blocks: int, rng: np.random.Generator, least: float = LEAST_SHARE) -> float:
    """Return the p-value of the most surprising of all candidates that matter, by flipping signs of whole blocks.

    The same flips serve all candidates, so that what they share counts once and how many there are is allowed for.
    One that explains less than ``least`` of the noise is no finding however sure: it is left out of what is seen, and
    stays among what might have been.
    """
    if not candidates:
        return 1.0
    flips = rng.choice((-1.0, 1.0), size=(DRAWS, blocks))
    seen = -np.inf
    drawn = np.full(DRAWS, -np.inf)
    for candidate in candidates:
        if candidate.share > least:
            seen = max(seen, candidate.surprise)
        drawn = np.maximum(drawn, surprise(flipped(candidate, flips), candidate.blocks.shape[1]))
    return float((1 + np.sum(drawn >= seen)) / (1 + DRAWS))


def flipped(candidate: Candidate, flips: Array) -> Array:
    """Return the statistic under flips of sign, shape (draws, b), computed as the one that was seen, shape (draws,)."""
    sums, weights = candidate.blocks, candidate.weights
    if not len(weights):
        values, vectors = np.linalg.eigh(sums.T @ sums)
        keep = values > 1e-10 * max(float(values[-1]), 1e-300)
        return np.asarray(np.sum((flips @ sums @ (vectors[:, keep] / np.sqrt(values[keep]))) ** 2, axis=1))
    score = flips @ sums
    # V = sum over blocks of (w a - G s)(w a - G s)', multiplied out so that flips meet blocks in one product.
    blocks, degrees = sums.shape
    crossed = np.einsum("bj,bkl->bjkl", sums, weights).reshape(blocks, -1)
    mixed = np.einsum("djkl,dl->djk", (flips @ crossed).reshape(-1, degrees, degrees, degrees), score)
    square = np.einsum("bjk,blm->jklm", weights, weights)
    squared = np.einsum("jklm,dk,dm->djl", square, score, score)
    variance = sums.T @ sums - mixed - np.swapaxes(mixed, 1, 2) + squared
    if degrees == 1:
        return np.asarray(score[:, 0] ** 2 / np.maximum(variance[:, 0, 0], 1e-300))
    return np.asarray(np.einsum("dj,djk,dk->d", score, np.linalg.pinv(variance, hermitian=True), score))


def excess(joint: Joint) -> float:
    """Return the p-value of the mean square of the mismatch being no more than :data:`EXCESS` times the noise's.

    It needs no candidate: what looks like nothing in the catalogue, nor like anything smooth, is noticed by its size.
    Rows beyond :data:`RARE` times the noise count as that, so that a few of them are not taken for physics; and a row
    counts as half an observation, as neighbours share the filter.
    """
    chances = []
    for equation in joint.equations:
        if equation.name == "breakaway":
            continue
        rows = joint.residual[joint.stack.part(equation.name)]
        power = float(np.mean(np.minimum(np.abs(rows), RARE) ** 2))
        chances.append(float(stats.chi2.sf(0.5 * len(rows) * power / EXCESS, 0.5 * len(rows))))
    return min(1.0, len(chances) * min(chances, default=1.0))


def preference(chosen: Joint, rival: Joint) -> float:
    """Return how far the data prefer ``chosen``, in standard errors of the difference by blocks."""
    stack = chosen.stack
    loss = stack.sums((rival.residual**2 - chosen.residual**2)[:, None])[:, 0]
    spread = float(np.std(loss, ddof=1)) * math.sqrt(len(loss))
    return float(np.sum(loss)) / spread if spread > 0.0 else 0.0


def probability(preferred: float) -> float:
    """Return the probability that goes with a preference."""
    return float(stats.norm.cdf(preferred))


def _best_of_each(candidates: Sequence[Candidate]) -> list[Candidate]:
    best: dict[str, Candidate] = {}
    for candidate in candidates:
        if candidate.name not in best or candidate.score > best[candidate.name].score:
            best[candidate.name] = candidate
    return sorted((c for c in best.values() if c.score > 0.0 and c.share > LEAST_SHARE), key=lambda c: -c.score)


def implausible(joint: Joint) -> str:
    """Say which parameter of the last effect is beyond its range in the catalogue, at the scale of this bench."""
    last = joint.effects[-1]
    views = joint.equations[0].views
    found = last.parameters(Context(views, joint.nominal))
    scales = _scales(views)
    for q in ENTRIES[last.term.name].parameters:
        scale = scales.get(q.unit, 1.0)
        low = q.low * (max(1.0, scale) if q.low < 0.0 else min(1.0, scale))
        high = q.high * max(1.0, scale)
        if not low <= found[q.name] <= high:
            return f"{q.name} {found[q.name]:.3g}, beyond what is plausible ({low:.3g} to {high:.3g})"
    return ""


def _scales(views: Sequence[View]) -> dict[str, float]:
    """Return by unit how much larger this bench is than the one that the catalogue's ranges were written for."""
    torque = max(float(np.max(np.abs(v.torque))) for v in views) / USUAL_TORQUE_N_M
    speed = max(float(np.max(np.abs(v.velocity))) for v in views) / USUAL_SPEED_RAD_S
    angle = max(float(np.ptp(v.angle)) for v in views) / USUAL_TRAVEL_RAD
    return {
        "N m": torque,
        "N m/s": torque,
        "N m/rad": torque / angle,
        "N m s/rad": torque / speed,
        "N m s^2/rad^2": torque / speed**2,
        "kg m^2": torque * angle / speed**2,
    }


def _simplest(joints: Sequence[Joint], numbers: Sequence[int]) -> int:
    """Return which of these fits, best first, has the fewest numbers among those hardly worse than the best."""
    near = [k for k in range(len(joints)) if k == 0 or preference(joints[0], joints[k]) < SIMPLER_IF]
    return min(near, key=lambda k: (numbers[k], k))


def _numbers(effect: Added) -> int:
    """Return how many numbers of an effect the data choose."""
    return effect.term.freedom + len(effect.coefficients)


def _beyond_noise(joint: Joint, term: Term) -> float:
    """Return the sum of whitened squares beyond the noise in the equations that an effect touches."""
    total = 1.0
    for equation in joint.equations:
        if equation.name in term.columns:
            rest = joint.residual[joint.stack.part(equation.name)]
            total += max(float(rest @ rest) - EXCESS * len(rest), 0.0)
    return total


def _explained(baseline: Joint, joint: Joint, term: Term) -> float:
    """Return the sum of whitened squares that has been explained in the equations that an effect touches."""
    total = 0.0
    for equation in joint.equations:
        if equation.name in term.columns:
            rows = joint.stack.part(equation.name)
            total += float(np.sum(baseline.residual[rows] ** 2) - np.sum(joint.residual[rows] ** 2))
    return total


def _why(rivals: Sequence[Contender]) -> str:
    if not rivals:
        return "nothing else comes near"
    return "; ".join(f"preferred to {r.name} by {r.preference:.1f} standard errors" for r in rivals)


def _pruned(
    views: Sequence[View],
    unit: str,
    baseline: Joint,
    joint: Joint,
    rounds: list[Round],
    steps: list[Step],
) -> tuple[Joint, list[Round]]:
    """Take out every effect that the others have made needless."""
    if len(joint.effects) < 2:
        return joint, rounds
    for name in [e.term.name for e in joint.effects]:
        rest = tuple(e for e in joint.effects if e.term.name != name)
        without = fit(views, unit, joint.nominal, rest, baseline)
        worth = preference(joint, without)
        if worth < stats.norm.isf(LEVEL):
            steps.append(Step("remove", name, None, joint.cost - without.cost, f"worth {worth:.1f} standard errors"))
            joint = without
            rounds = [r for r in rounds if r.name != name]
    return joint, rounds


def _revisited(
    views: Sequence[View],
    unit: str,
    baseline: Joint,
    joint: Joint,
    rounds: list[Round],
    steps: list[Step],
) -> tuple[Joint, list[Round]]:
    """Hold every effect against its rivals again, now that the others are in the model: what was missing misled."""
    for place, taken in enumerate(rounds):
        others = tuple(e for e in joint.effects if e.term.name != taken.name)
        own = next(e for e in joint.effects if e.term.name == taken.name)
        trials = [(own, joint)]
        for rival in taken.rivals:
            if all(e.term.name != rival.name for e in others):
                added = rival.joint.effects[-1]
                trials.append((added, fit(views, unit, joint.nominal, (*others, added), baseline)))
        ranked = sorted(trials, key=lambda trial: trial[1].cost)
        sound = [trial for trial in ranked if trial[0] is own or not implausible(trial[1])]
        chosen, best = sound[_simplest([j for _, j in sound], [_numbers(e) for e, _ in sound])]
        if chosen is not own:
            note = f"beside the others, preferred to {taken.name} by {preference(best, joint):.1f} standard errors"
            steps.append(Step("swap", chosen.term.name, None, joint.cost - best.cost, note))
        rivals = tuple(
            Contender(e.term.name, j, preference(best, j), "" if e is own else implausible(j))
            for e, j in ranked
            if e is not chosen and not _again(e, j, chosen, best)
        )
        joint = best
        rounds = [*rounds[:place], Round(chosen.term.name, rivals), *rounds[place + 1 :]]
    return joint, rounds


def _again(rival: Added, its: Joint, chosen: Added, best: Joint) -> bool:
    """Whether a rival is the chosen effect over again, with more numbers: a special case is no alias."""
    difference = its.residual - best.residual
    return _numbers(rival) > _numbers(chosen) and float(difference @ difference) < SAME * best.cost
