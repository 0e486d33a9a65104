"""The search: is anything missing, which effect explains it best, what else, and is each still
needed at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import stats

from identification.diagnosis.begin import or_kept, or_raised
from identification.diagnosis.contest import (
    Contender,
    Round,
    again,
    broken,
    implausible,
    numbers,
    preference,
    simplest,
)
from identification.diagnosis.crossing import told_apart
from identification.diagnosis.further import groups
from identification.diagnosis.generic import families
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.kept import EXCESS, alike, judging, pruned, revisited
from identification.diagnosis.quiet import quieter
from identification.diagnosis.result import Step
from identification.diagnosis.rows.view import View
from identification.diagnosis.stack import Candidate, Stack, surprise
from identification.diagnosis.terms.term import Context, Term
from identification.recording import Array

LEVEL = 0.01
"""Of the test that anything is missing, and that anything more is."""
LEAST_SHARE = 0.01
"""Power of a contribution over that of the noise, in the equations where it shows, below which it
does not matter.
"""
RARE = 6.0
RARE_BLOCKS = 0.01
"""Share of blocks in which a row beyond that may be chance: on simulated benches that hide nothing
there is none.
"""
EXCESS_OF_ONE = 2.0
"""Mean square of the torque's mismatch in one recording over the noise's, up to which nothing is
said of it. What is met in a few strokes of one recording has too few blocks for flips of their
signs.
"""
DRAWS = 999
MOST_EFFECTS = 3
FLAT = 1e-6
"""Determinant of a variance over its trace's square, below which its inverse is taken with care."""

Progress = Callable[[str, float], None]


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
    until: Collection[str] = (),
    fixed: Collection[str] = (),
) -> Search:
    """Add effects one at a time while the test allows, then try to remove each.

    One more effect is judged at the end, beside the others: what seems to explain little of the
    rest may leave nothing of it together with the next one.

    Args:
        views: Recordings.
        unit: Of the torque.
        baseline: The nominal model's fit of them.
        terms: Effects to choose from.
        rng: Of the tests by sign flips.
        progress: Told what is being done.
        until: Names, the first of which to be added ends the search.
        fixed: Nominal parameters that are not asked for.
    """
    by_name = {t.name: t for t in terms}
    joint, rounds, steps = baseline, [], []
    p_value = p_after = 1.0
    loudest = ""
    for turn in range(MOST_EFFECTS + 1):
        left = [t for t in terms if t.name not in {e.term.name for e in joint.effects}]
        progress(f"screening {len(left)} effects", turn / (MOST_EFFECTS + 1))
        trials = list(screened(joint.stack, Context(tuple(views), joint.nominal), left))
        unnamed = list(generic(joint.stack))
        by_size = max(excess(joint), 1e-12)
        # No draw of the flips could be rarer than this.
        by_flips = (
            1.0
            if by_size < 1.0 / (1 + DRAWS)
            else chance([*trials, *unnamed], joint.stack.blocks, rng)
        )
        p_after = min(1.0, 2.0 * min(by_flips, by_size))
        loudest = (
            max((*trials, *unnamed), key=lambda c: c.surprise).name if trials or unnamed else ""
        )
        if turn == 0:
            p_value = p_after
        steps.append(Step("test", loudest, p_after, 0.0, "the most surprising candidate"))
        best = _best_of_each(trials)
        if p_after > LEVEL or turn == MOST_EFFECTS or not best:
            break
        missing = partial(_missing, joint, by_name, (*trials, *unnamed), rng)
        taken = None
        for finalists in groups(baseline, joint, by_name, best, missing):
            progress(
                "fitting " + ", ".join(c.name for c in finalists), (turn + 0.5) / (MOST_EFFECTS + 1)
            )
            taken = _contest(
                views, unit, baseline, joint, finalists, by_name, p_after, steps, fixed
            )
            if taken is not None:
                break
        if taken is None:
            break
        joint, added = taken
        rounds.append(added)
        baseline, joint = quieter(views, unit, baseline, joint)
        if added.name in until:
            return Search(baseline, joint, tuple(rounds), p_value, p_after, loudest, tuple(steps))
    before = joint
    joint, rounds = pruned(views, unit, baseline, joint, rounds, steps)
    dropped = [e for e in before.effects if all(e.term.name != r.name for r in rounds)]
    if len(before.effects) > 1:
        progress("rivals, beside the other effects", 0.9)
        joint, rounds = revisited(views, unit, baseline, joint, rounds, dropped, steps)
    joint, rounds = told_apart(views, unit, baseline, joint, rounds, terms, steps)
    return Search(baseline, joint, tuple(rounds), p_value, p_after, loudest, tuple(steps))


def _contest(
    views: Sequence[View],
    unit: str,
    baseline: Joint,
    joint: Joint,
    finalists: Sequence[Candidate],
    terms: Mapping[str, Term],
    p_value: float,
    steps: list[Step],
    fixed: Collection[str],
) -> tuple[Joint, Round] | None:
    """Fit finalists jointly with what is named already; return the model with the best, or None
    where none will do.
    """
    if not finalists:
        return None
    fitted = []
    for candidate in finalists:
        added = Added(
            terms[candidate.name], candidate.shape, tuple(float(c) for c in candidate.coefficients)
        )
        tried = fit(views, unit, joint.nominal, (*joint.effects, added), baseline)
        # What is built from the fall of friction may have hidden it from the nominal fit.
        lost = added.term.follows and tried.nominal.flat
        tried = or_raised(views, unit, tried, joint.nominal, fixed) if lost else tried
        fitted.append(or_kept(views, unit, tried))
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
        simplest([fitted[k] for k in order], [numbers(fitted[k].effects[-1]) for k in order])
    ]
    ranked.remove(winner)
    rivals = tuple(
        Contender(finalists[k].name, fitted[k], preference(fitted[winner], fitted[k]), beyond[k])
        for k in ranked
        if alike(terms[finalists[k].name], terms[finalists[winner].name])
        and not broken(fitted[k])
        and not again(fitted[k].effects[-1], fitted[k], fitted[winner].effects[-1], fitted[winner])
    )
    gain = joint.cost - fitted[winner].cost
    if gain <= 2.0 * finalists[winner].penalty:
        steps.append(
            Step(
                "stop", finalists[winner].name, p_value, gain, "explains no more than chance would"
            )
        )
        return None
    steps.append(Step("add", finalists[winner].name, p_value, gain, _why(rivals)))
    return fitted[winner], Round(finalists[winner].name, rivals)


def _missing(
    joint: Joint,
    terms: Mapping[str, Term],
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    name: str,
) -> bool:
    """Whether anything is missing in one equation, by the test that the whole model is put to."""
    judged = len(joint.equations)
    if 2.0 * judged * excess(joint, name) <= LEVEL:
        return True
    # A family without a name carries its equation's in front.
    own = [
        c
        for c in candidates
        if (name in judging(joint, terms[c.name]) if c.name in terms else c.name.startswith(name))
    ]
    return 2.0 * judged * chance(own, joint.stack.blocks, rng) <= LEVEL


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


def chance(
    candidates: Sequence[Candidate],
    blocks: int,
    rng: np.random.Generator,
    least: float = LEAST_SHARE,
) -> float:
    """Return the p-value of the most surprising of all candidates that matter, by flipping signs of
    whole blocks.

    The same flips serve all candidates, so that what they share counts once and how many there are
    is allowed for. One that explains less than ``least`` of the noise is no finding however sure:
    it is left out of what is seen, and stays among what might have been.
    """
    if not candidates:
        return 1.0
    flips = rng.choice((-1.0, 1.0), size=(DRAWS, blocks))
    seen = max((c.surprise for c in candidates if c.share > least), default=-np.inf)
    if seen == -np.inf:
        return 1.0
    # A surprise grows with the statistic: of candidates with as many numbers that of the greatest
    # will do.
    greatest: dict[int, Array] = {}
    for candidate in candidates:
        degrees, drawn = candidate.blocks.shape[1], flipped(candidate, flips)
        greatest[degrees] = np.maximum(greatest.get(degrees, drawn), drawn)
    beyond = np.any(
        [surprise(drawn, degrees) >= seen for degrees, drawn in greatest.items()], axis=0
    )
    return float((1 + np.sum(beyond)) / (1 + DRAWS))


def flipped(candidate: Candidate, flips: Array) -> Array:
    """Return the statistic under flips of sign, shape (draws, b), computed as the one that was
    seen, shape (draws,).
    """
    sums, weights = candidate.blocks, candidate.weights
    if not len(weights):
        values, vectors = np.linalg.eigh(sums.T @ sums)
        keep = values > 1e-10 * max(float(values[-1]), 1e-300)
        return np.asarray(
            np.sum((flips @ sums @ (vectors[:, keep] / np.sqrt(values[keep]))) ** 2, axis=1)
        )
    score = flips @ sums
    # V = sum over blocks of (w a - G s)(w a - G s)', multiplied out so that flips meet blocks in
    # one product.
    blocks, degrees = sums.shape
    crossed = np.einsum("bj,bkl->bjkl", sums, weights).reshape(blocks, -1)
    mixed = ((flips @ crossed).reshape(-1, degrees**2, degrees) @ score[:, :, None]).reshape(
        -1, degrees, degrees
    )
    flat = weights.reshape(blocks, -1)
    square = (
        (flat.T @ flat)
        .reshape(degrees, degrees, degrees, degrees)
        .transpose(1, 3, 0, 2)
        .reshape(degrees**2, -1)
    )
    pairs = (score[:, :, None] * score[:, None, :]).reshape(-1, degrees**2)
    variance = (
        sums.T @ sums
        - mixed
        - np.swapaxes(mixed, 1, 2)
        + (pairs @ square).reshape(-1, degrees, degrees)
    )
    if degrees == 1:
        return np.asarray(score[:, 0] ** 2 / np.maximum(variance[:, 0, 0], 1e-300))
    if degrees == 2:
        return _over_two(score, variance)
    return np.asarray(
        np.einsum("dj,djk,dk->d", score, np.linalg.pinv(variance, hermitian=True), score)
    )


def _over_two(score: Array, variance: Array) -> Array:
    """Return scores of two numbers, shape (d, 2), over their variance, (d, 2, 2): most trial shapes
    are waves.
    """
    a, b, c = variance[:, 0, 0], variance[:, 0, 1], variance[:, 1, 1]
    x, y = score.T
    left = a * c - b * b
    flat = left <= FLAT * (a + c) ** 2
    out = (c * x * x - 2.0 * b * x * y + a * y * y) / np.where(flat, 1.0, left)
    for k in np.flatnonzero(flat):
        out[k] = score[k] @ np.linalg.pinv(variance[k], hermitian=True) @ score[k]
    return np.asarray(out)


def excess(joint: Joint, only: str = "") -> float:
    """Return the p-value of the mean square of the mismatch being no more than :data:`EXCESS` times
    the noise's.

    Over all equations, or in the one of the name ``only``.

    It needs no candidate: what looks like nothing in the catalogue, nor like anything smooth, is
    noticed by its size. Rows beyond :data:`RARE` times the noise count as that, so that a few of
    them are not taken for physics; and a row counts as half an observation, as neighbours share the
    filter. Where such rows come in block after block, as they do after every reversal on a joint
    that springs before it slips, it is how many blocks that counts.
    """
    chances = []
    for equation in joint.equations:
        if equation.name == "breakaway" or (only and equation.name != only):
            continue
        rows = joint.stack.part(equation.name)
        powers = np.minimum(np.abs(joint.residual[rows]), RARE) ** 2
        chances.append(_beyond(powers, EXCESS))
        chances.append(_recurring(joint.residual[rows], joint.stack.block[rows]))
        if equation.name == "torque":
            chances += [
                _beyond(powers[equation.owner == v.index], EXCESS_OF_ONE) for v in equation.views
            ]
    return min([1.0, *(len(chances) * chance for chance in chances)])


def _beyond(powers: Array, limit: float) -> float:
    """Return the chance of such a mean square, were the noise's ``limit``; 1 without rows."""
    half = 0.5 * len(powers)
    return float(stats.chi2.sf(half * float(np.mean(powers)) / limit, half)) if len(powers) else 1.0


def _recurring(residual: Array, block: np.ndarray) -> float:
    """Return the chance of so many blocks with a row beyond :data:`RARE`, were one in a hundred to
    have any.

    1 where all of it is no more than :data:`EXCESS` times the noise's power.
    """
    if not len(residual) or float(np.mean(residual**2)) <= EXCESS:
        return 1.0
    found = len(np.unique(block[np.abs(residual) > RARE]))
    return float(stats.binom.sf(found - 1, len(np.unique(block)), RARE_BLOCKS))


def _best_of_each(candidates: Sequence[Candidate]) -> list[Candidate]:
    best: dict[str, Candidate] = {}
    for candidate in candidates:
        if candidate.name not in best or candidate.score > best[candidate.name].score:
            best[candidate.name] = candidate
    return sorted(
        (c for c in best.values() if c.score > 0.0 and c.share > LEAST_SHARE),
        key=lambda c: -c.score,
    )


def _why(rivals: Sequence[Contender]) -> str:
    if not rivals:
        return "nothing else comes near"
    return "; ".join(f"preferred to {r.name} by {r.preference:.1f} standard errors" for r in rivals)
