"""Tests whether physics is missing from a fit: by its mismatch's size and by sign flips."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy import stats

from identification.diagnosis.joint import Joint
from identification.diagnosis.result import ResidualTrace
from identification.diagnosis.rows import Equation, families
from identification.diagnosis.rules import RULES
from identification.diagnosis.stack import Candidate, Stack, log_surprise
from identification.effects.effect import Context, Effect
from identification.recording import Array
from identification.views.view import View

DRAWS = 999
BY_RECORDING = ("torque", "transmission")
"""Equations tested in each recording too: a slip or a wrong label is in one recording only."""
SINGULAR = 1e-6
"""Determinant of a 2 x 2 covariance over its squared trace, below which it is pseudo-inverted."""


def trial_candidates(
    stack: Stack, context: Context, terms: Sequence[Effect]
) -> Iterator[Candidate]:
    """Yield every effect at all trial parameters for which these recordings give a candidate."""
    for term in terms:
        for shape in term.shapes(context):
            candidate = stack.term(term, shape)
            if candidate is not None:
                yield candidate


def generic_candidates(stack: Stack) -> Iterator[Candidate]:
    """Yield the scores of the generic families in every equation."""
    for equation in stack.equations:
        for name, columns in families(equation):
            candidate = stack.independent(f"{equation.name} over {name}", equation.name, columns)
            if candidate is not None:
                yield candidate


def sign_flip_p_value(
    candidates: Sequence[Candidate], blocks: int, rng: np.random.Generator
) -> float:
    """Return the p-value of the most significant of all relevant candidates, by sign flips of whole
    blocks.

    One set of flips is applied to all candidates, which accounts for the number and the correlation
    of the candidates. A negligible candidate is irrelevant even if it is significant: it is omitted
    from the observed statistics, but not from the statistics under flips.
    """
    if not candidates:
        return 1.0
    flips = rng.choice((-1.0, 1.0), size=(DRAWS, blocks))
    seen = max((c.surprise for c in candidates if c.relevant), default=-np.inf)
    if seen == -np.inf:
        return 1.0
    # Significance grows with the statistic; of candidates with equally many coefficients only the
    # one with the greatest statistic is needed.
    greatest: dict[int, Array] = {}
    for candidate in candidates:
        degrees, drawn = candidate.blocks.shape[1], flipped_statistics(candidate, flips)
        greatest[degrees] = np.maximum(greatest.get(degrees, drawn), drawn)
    beyond = np.any(
        [log_surprise(drawn, degrees) >= seen for degrees, drawn in greatest.items()], axis=0
    )
    return float((1 + np.sum(beyond)) / (1 + DRAWS))


def flipped_statistics(candidate: Candidate, flips: Array) -> Array:
    """Return the statistic under sign flips of shape (draws, b), shape (draws,)."""
    sums, weights = candidate.blocks, candidate.weights
    if not len(weights):
        values, vectors = np.linalg.eigh(sums.T @ sums)
        keep = values > 1e-10 * max(float(values[-1]), 1e-300)
        return np.asarray(
            np.sum((flips @ sums @ (vectors[:, keep] / np.sqrt(values[keep]))) ** 2, axis=1)
        )
    score = flips @ sums
    # V = sum over blocks of (w a - G s)(w a - G s)', expanded so that the sum over blocks is one
    # matrix product with the flips w.
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
    """Return the statistic of two coefficients, (d, 2): most candidates are waves."""
    a, b, c = variance[:, 0, 0], variance[:, 0, 1], variance[:, 1, 1]
    x, y = score.T
    left = a * c - b * b
    flat = left <= SINGULAR * (a + c) ** 2
    out = (c * x * x - 2.0 * b * x * y + a * y * y) / np.where(flat, 1.0, left)
    for k in np.flatnonzero(flat):
        out[k] = score[k] @ np.linalg.pinv(variance[k], hermitian=True) @ score[k]
    return np.asarray(out)


def beyond_noise(joint: Joint) -> set[str]:
    """Return the names of the equations whose mismatch is beyond the noise, over all recordings or,
    by more than `excess_of_one`, in one recording; with white noise, even a mismatch within the
    noise shows.
    """
    return {
        e.name
        for e in joint.equations
        if e.white
        or float(np.mean(over_own_noise(joint, e) ** 2)) > RULES.tested_from
        or greatest_mean_square(joint, e) > RULES.excess_of_one
    }


def over_own_noise(joint: Joint, equation: Equation) -> Array:
    """Return a fit's residual in an equation over the noise of each row's recording, shape (n,)."""
    rows = joint.residual[joint.stack.part(equation.name)]
    return np.asarray(rows / np.sqrt(equation.allowed()))


def greatest_mean_square(joint: Joint, equation: Equation) -> float:
    """Return the ratio of the mean-square mismatch of an equation to that of the recording's own
    noise, in the recording in which this ratio is greatest.
    """
    return greatest(over_own_noise(joint, equation), equation)


def greatest(rows: Array, equation: Equation) -> float:
    """Return the mean square of an equation's rows in the recording where it is greatest."""
    return max(
        float(np.mean(rows[equation.owner == index] ** 2)) for index in np.unique(equation.owner)
    )


def level(equation: Equation) -> float:
    """Return the mean square of the own noise of each row's recording over the equation's."""
    return float(np.mean(equation.allowed()))


def size_p_value(joint: Joint, only: str = "") -> float:
    """Return the p-value of the hypothesis that the mean-square mismatch is at most `excess`
    times that of the noise, in all equations or only in the equation named ``only``.

    The test needs no candidate: a mismatch that resembles neither an effect nor a smooth function
    is detected by its size. Rows are clipped at `outlier` times the noise, so that a few outliers
    do not count as a mismatch; a row counts as half an observation, because the filter correlates
    neighbouring rows. If outliers recur in many blocks, such as after every reversal with
    presliding, the number of blocks with an outlier is tested. Deviations of constants are tested
    by themselves: a large one is no outlier.
    """
    chances = []
    for equation in joint.equations:
        if not equation.judges or (only and equation.name != only):
            continue
        rows = over_own_noise(joint, equation)
        powers = np.minimum(np.abs(rows), RULES.outlier) ** 2
        chances.append(_beyond(powers, RULES.excess))
        if equation.firm:
            off = rows[list(equation.firm)]
            chances.append(float(stats.chi2.sf(off @ off, len(off))))
        chances.append(_recurring(rows, joint.stack.block[joint.stack.part(equation.name)]))
        if equation.name in BY_RECORDING:
            chances += [
                _beyond(powers[equation.owner == v.index], RULES.excess_of_one)
                for v in equation.views
            ]
    return min([1.0, *(len(chances) * chance for chance in chances)])


def _beyond(powers: Array, limit: float) -> float:
    """Return the probability that noise of mean square ``limit`` reaches that of ``powers``."""
    half = 0.5 * len(powers)
    return float(stats.chi2.sf(half * float(np.mean(powers)) / limit, half)) if len(powers) else 1.0


def _recurring(residual: Array, block: np.ndarray) -> float:
    """Return the probability of at least as many blocks with an outlier as observed, if a share of
    `outlier_blocks` of the blocks has an outlier by chance.

    The result is 1 if the power of the mismatch is at most `excess` times the power of the noise.
    """
    if not len(residual) or float(np.mean(residual**2)) <= RULES.excess:
        return 1.0
    found = len(np.unique(block[np.abs(residual) > RULES.outlier]))
    return float(stats.binom.sf(found - 1, len(np.unique(block)), RULES.outlier_blocks))


LONG_S = 0.3
"""Least duration of a rest, s. At the end of a shorter rest, under a torque that rises fast, the
torque exceeds the static limit before motion is visible.
"""
TORQUE_RATIO = 1.5
"""Ratio of the torque during a rest to the greatest torque at the end of a rest in any other
recording, from which the rest is reported.
"""
LEAST_BREAKAWAYS = 12
LEAST_SHARE, CROWDED = 0.25, 3.0
"""Least remaining share of a reported recording, and least ratio of it to the share of rows."""
MOST_OF_IT = 0.8  # share of the mismatch of a recording that the reported interval of time contains


def rests_under_torque(views: Sequence[View], unit: str) -> tuple[str, ...]:
    """Return a text for each rest under a torque greater than the torque at the end of any rest in
    other recordings.

    At rest friction is known only to be within its static limit, so that a torque beyond the limit
    does not appear in the mismatch. A possible cause is a drive that has switched its torque off
    but still logs the requested torque.
    """
    return tuple(line for view in views for line in _rests_of(view, views, unit))


def trusted(aside: Sequence[View], every: Sequence[View]) -> tuple[View, ...]:
    """Return the recordings set aside that can judge effects: those without a rest as in
    :func:`rests_under_torque`, because their logged torque may not have reached the motor; all of
    them if no other is left.
    """
    found = tuple(v for v in aside if not any(_rests_of(v, every, "")))
    return found or tuple(aside)


def _rests_of(view: View, views: Sequence[View], unit: str) -> Iterator[str]:
    # Friction at rest grows with the load; recordings with less load therefore give no limit.
    others = [
        v
        for v in views
        if v is not view and v.recording.contact_force >= view.recording.contact_force
    ]
    ended = [np.abs(v.raw_torque[v.breakaways - 1]) for v in others if len(v.breakaways)]
    torques = np.concatenate(ended) if ended else np.zeros(0)
    if len(torques) < LEAST_BREAKAWAYS:
        return
    limit = float(np.max(torques))
    linear = view.recording.bench.motion == "linear"
    for first, last in runs(view.still):
        torque = float(np.median(np.abs(view.raw_torque[first:last])))
        if view.time[last - 1] - view.time[first] < LONG_S or torque < TORQUE_RATIO * limit:
            continue
        place = float(np.median(view.angle[first:last]))
        where = f"{place:.4g} m" if linear else f"{np.rad2deg(place):.1f} deg"
        yield (
            f"{view.recording.name}: from {view.time[first]:.2f} to {view.time[last - 1]:.2f} s "
            f"the joint rests at {where} under a logged torque of {torque:.2g} {unit}, but all "
            f"rests in other recordings end at a torque of at most {limit:.2g} {unit}: check "
            "whether the drive had switched its torque off, or whether the joint was blocked (a "
            "recording set aside of this kind judges no effect unless there is no other)"
        )


def crowded_recordings(traces: Sequence[ResidualTrace]) -> tuple[str, ...]:
    """Return a text on each recording that holds much of the corrected model's mismatch."""
    lines = []
    for equation in dict.fromkeys(t.equation for t in traces):
        mine = [t for t in traces if t.equation == equation]
        powers = [float(t.after @ t.after) for t in mine]
        total, rows = max(sum(powers), 1e-300), sum(len(t.time) for t in mine)
        for trace, power in zip(mine, powers, strict=True):
            share, usual = power / total, len(trace.time) / rows
            if share >= LEAST_SHARE and share >= CROWDED * usual:
                first, last = shortest(trace.time, trace.after**2)
                lines.append(
                    f"{trace.recording}: contains {100.0 * share:.0f} % of the remaining "
                    f"{equation} mismatch, but only {100.0 * usual:.0f} % of the samples; most of "
                    f"this mismatch is between {first:.2f} and {last:.2f} s"
                )
    return tuple(lines)


def shortest(time: Array, power: Array) -> tuple[float, float]:
    """Return start and end, s, of the shortest interval with :data:`MOST_OF_IT` of the power."""
    total = np.concatenate(([0.0], np.cumsum(power)))
    ends = np.searchsorted(total, total[:-1] + MOST_OF_IT * total[-1])
    starts = np.flatnonzero(ends < len(total))
    spans = time[ends[starts] - 1] - time[starts]
    best = int(starts[np.argmin(spans)])
    return float(time[best]), float(time[ends[best] - 1])


def runs(marks: np.ndarray) -> list[tuple[int, int]]:
    """Return the first sample and the sample after the last of each run of marked samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], marks, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
