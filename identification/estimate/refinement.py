"""Computes the final estimate: by prediction errors if accepted, else by equation error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.estimate.covariance import (
    covariances,
    named_covariances,
    not_below,
    rise_to_static,
)
from identification.estimate.equation_error import block_sandwich
from identification.estimate.parameter_table import typical_error
from identification.estimate.replicates import Bias, likelihood_bias
from identification.estimate.searches import (
    MOST_CHI2,
    MOST_DROP,
    MOST_ERROR,
    MOST_NOISE,
    MOST_REPEATING,
    MOST_WHITENESS,
    Refined,
    refine_stages,
)
from identification.filter.likelihood import (
    ROUNDS,
    Point,
    Reduced,
    optimise_breakaway_times,
    reduce,
    search_breakaway_times,
)
from identification.filter.segments import lacking, motion
from identification.model.parameters import (
    INDEX,
    LOGARITHMIC,
    PAPER_FRICTION,
    STRIBECK_TERMS,
    pack,
    unpack,
)
from identification.numerics.arrays import Array, Progress, silent
from identification.numerics.least_squares import equilibrated
from identification.numerics.spread import Spread
from identification.prepare import Prepared, joint_angle
from identification.recording import Model, Recording
from identification.result import Convergence, MeasuredNoise, Starts
from identification.signals import quantum


def refusal(refined: Refined, before: float, after: float) -> str:
    """Return the reason why the refined values are rejected; empty if they are accepted.

    ``before``: mean equation error of the start values over the recordings. ``after``: mean
    equation error of the refined values over the recordings.
    """
    judged = (
        refined.whiteness,
        refined.equations_chi2,
        refined.likelihood_drop,
        after,
        *refined.values.values(),
    )
    if not np.all(np.isfinite(judged)):
        return "the search diverged to values that are not finite"
    # Where no search ends at a solution, its noise says nothing about the model.
    if refined.equations_chi2 > MOST_CHI2:
        return (
            "no search of the unloaded fit solves the estimating equations (least chi-square "
            f"{refined.equations_chi2:.3g}, limit {MOST_CHI2:g})"
        )
    if refined.noise.torque > MOST_NOISE * refined.torque_scatter:
        return (
            f"the torque noise by the prediction errors, {refined.noise.torque:.3g}, is greater "
            f"than {MOST_NOISE:g} times the torque scatter from sample to sample, "
            f"{refined.torque_scatter:.3g}, so the parameters would compensate physics that the "
            "model lacks"
        )
    if abs(refined.whiteness) > MOST_WHITENESS:
        return (
            f"neighbouring prediction errors have a correlation of {refined.whiteness:+.2f} "
            f"(limit {MOST_WHITENESS}), so the parameters would compensate physics that the "
            "model lacks"
        )
    if refined.repeating_share > MOST_REPEATING:
        return (
            f"{100.0 * refined.repeating_share:.0f} % of the correlated noise repeats in matching "
            f"half cycles (limit {100.0 * MOST_REPEATING:.0f} %), so the recordings show "
            "physics that the model lacks"
        )
    if refined.likelihood_drop > MOST_DROP:
        return (
            "the search of the loaded fit ends at a lower likelihood than it starts (change of "
            f"the deviance {refined.likelihood_drop:+.0f}, limit {MOST_DROP:+g})"
        )
    if after > MOST_ERROR * before:
        return (
            f"the refined values raise the equation error from {before:.3g} to {after:.3g}, that "
            f"is, by more than a factor of {MOST_ERROR:g}"
        )
    return ""


NEEDED = (
    "prediction errors need even sampling, a quantised encoder, a measured torque or current, and "
    "two breakaways from rest"
)


@dataclass(frozen=True)
class Found:
    """The final estimate, with the steps that led to it."""

    values: dict[str, float]
    spread: Spread  # covariance of the fitted parameters
    # Half width of the 90 % interval at the Cramer-Rao bound, by name; empty without an accepted
    # refinement.
    floors: Mapping[str, float] = field(default_factory=dict)
    taken: Refined | None = None  # the refinement, if it is accepted
    starts: tuple[Starts, ...] = ()  # search ends of the refinement, whether accepted or not
    stages: tuple[Convergence, ...] = ()
    warnings: tuple[str, ...] = ()  # reason why the refinement was rejected


def refine(
    attempt: Callable[[bool], Refined | str],
    active: Sequence[Prepared],
    values: dict[str, float],
    names: Sequence[str],
    alpha: float,
) -> Found:
    """Refine equation-error values by prediction errors, and apply the acceptance tests.

    The torque noise is white, or correlated if the innovations contradict white noise.

    ``attempt``: function that refines the values, with or without a correlated part of the noise;
    it returns the reason as text if prediction errors do not apply. ``active``: the recordings,
    prepared for the equation error.
    """
    before = typical_error(active, values, alpha)

    def judged(correlated: bool) -> tuple[Refined | None, str]:
        found = attempt(correlated)
        if isinstance(found, str):
            return None, found
        return found, refusal(found, before, typical_error(active, found.values, alpha))

    refined, fault = judged(False)
    if refined is not None and fault:
        if refined.stopped:
            fault += "; the search stopped at its greatest number of filter runs"
        elif (
            abs(refined.whiteness) > MOST_WHITENESS
            or refined.noise.torque > MOST_NOISE * refined.torque_scatter
        ) and refined.noise.torque < _LOUDEST_SENSOR * refined.torque_scatter:
            # The cause may be correlated noise of the current sensor, and not unmodelled physics.
            other, also = judged(True)
            if other is not None:
                refined, fault = (
                    (refined, f"{fault}; with correlated torque noise: {also}")
                    if also
                    else (other, "")
                )
    starts = () if refined is None else refined.starts
    stages: tuple[Convergence, ...] = ()
    if refined is not None:
        work = refined.evaluations, refined.iterations, refined.innovation_rms
        stages = (Convergence("joint", "prediction error", *work, "of the noise"),)
    if refined is None or fault:
        bandwidth = f"{active[0].bandwidth_Hz:.3g} Hz"
        kept = f"values are those of the equation error at {bandwidth}: {fault}"
        spread = block_sandwich(active, values, names, alpha)
        return Found(values, spread, starts=starts, stages=stages, warnings=(kept,))
    return Found(
        dict(refined.values),
        Spread(refined.names, refined.covariance, math.inf),
        floors_of(refined.names, refined.floor),
        refined,
        starts,
        stages,
        partly_used(refined.left_out),
    )


def equation_noise(
    unloaded: Sequence[Prepared], values: Mapping[str, float], alpha: float
) -> float:
    """Return the white torque noise that would explain the equation error beside the quantisation
    of the angle, N m; zero without unloaded recordings.

    The equation error has the share 2 b T of the variance of white torque noise (bandwidth b,
    sample period T), and the quantisation error of the angle enters it as J times its second
    derivative.
    """
    explained = 0.0
    if not unloaded:
        return explained
    recording, bandwidth = unloaded[0].recording, unloaded[0].bandwidth_Hz
    share = 2.0 * bandwidth * recording.period
    angle = joint_angle(recording)
    if angle is not None:
        acceleration = quantum(angle) * (2.0 * math.pi * bandwidth) ** 2 / math.sqrt(60.0)
        explained = (values["J"] * acceleration) ** 2
    left = typical_error(unloaded, values, alpha) ** 2 / share - explained
    return math.sqrt(max(left, 0.0))


def corrected(found: Found, rng: np.random.Generator, progress: Progress = silent) -> Found:
    """Correct the bias of an accepted refinement (M33 to M36, M42) and solve the equation of the
    inertia with replicates (M32).

    ``found``: the estimate; returned unchanged if its refinement was not accepted.
    """
    if found.taken is None:
        return found
    joint = found.taken.joint
    bias = likelihood_bias(joint, found.taken.names, rng, progress)
    if bias is None:
        return found
    found = _unbiased(found, bias)
    return _with_instruments(found, joint, bias) if bias.replicates else found


def _unbiased(found: Found, bias: Bias) -> Found:
    """Subtract the bias (M36) and add its variance (M42), unless a value leaves its range."""
    values = {name: value - bias.shifts.get(name, 0.0) for name, value in found.values.items()}
    rises = all(
        values[static] >= values[coulomb]
        for coulomb, static, _ in STRIBECK_TERMS
        if static in values
    )
    positive = all(values[name] > 0.0 for name in ("omega_sf", "omega_sL") if name in values)
    if not (rises and positive):
        return found
    covariance = found.spread.matrix + _left_open(bias, found.spread.names)
    return replace(found, values=values, spread=replace(found.spread, matrix=covariance))


def _left_open(bias: Bias, names: Sequence[str]) -> Array:
    return np.diag([bias.variances[name] for name in names])


def _with_instruments(found: Found, joint: Point, bias: Bias) -> Found:
    """Solve the estimating equation of the inertia with instruments from matching half cycles and
    from replicates (M32); the other parameters change with the inertia.

    Floors are computed from the replicates.

    The equation is solved at the bias-corrected values of the other parameters, because in a
    replicate the other parameters have the values with which it was simulated. Errors of the other
    parameters have an effect of second order, which is not negligible if these errors are several
    standard deviations.
    """
    names = found.spread.names
    begun = replace(joint, vector=pack(found.values, joint.alpha))
    there = search_breakaway_times(begun)
    solved = covariances(there, bias.replicates)
    x = there.origin()
    x[: len(solved.step)] += solved.step
    values = {**found.values, **unpack(there.parameters(x), names)}
    achieved, floor = named_covariances(solved, there, names)
    spread = replace(found.spread, matrix=achieved + _left_open(bias, names))
    return replace(found, values=values, spread=spread, floors=floors_of(names, floor))


def refine_recordings(
    recordings: Sequence[Recording],
    values: Mapping[str, float],
    names: Sequence[str],
    model: Model,
    correlated: bool = False,
    progress: Progress = silent,
    equation_noise: float = 0.0,
) -> Refined | str:
    """Return the refined estimate, or a text with the reason why prediction errors do not apply.

    A fit that acceptance rejects ends early. ``correlated``: whether the torque noise has a
    correlated part. ``progress``: called at the start of each fit. ``equation_noise``: white torque
    noise that would explain the unloaded equation error, N m.
    """
    if not names:
        return "every parameter is fixed"
    if model.friction != PAPER_FRICTION:
        return (
            f"prediction errors support only the friction model {PAPER_FRICTION}, but the model "
            f"{model.friction} is declared"
        )
    if not {"Ms", "omega_sf"} <= set(names) | set(model.fixed):
        return "the equation error finds no static friction above Coulomb friction"
    motions = [motion(r) for r in recordings]
    found = [m for m in motions if m is not None]
    left_out = {r.name: lacking(r) for r, m in zip(recordings, motions, strict=True) if m is None}
    unloaded = [m for m in found if m.recording.stage == "unloaded"]
    loaded = [m for m in found if m.recording.stage == "loaded"]
    if not values["J"] > 0.0:
        return "the equation error finds no inertia above 0, with which a refinement could start"
    for condition, usable in (("unloaded", unloaded), ("loaded", loaded)):
        unusable = [r.name for r in recordings if r.stage == condition]
        if unusable and not usable:
            return f"{NEEDED}; {_lacks({name: left_out[name] for name in unusable})}"
    if not unloaded:
        return "a refinement by prediction errors needs an unloaded recording"
    if loaded and not {"mu_s", "omega_sL"} <= set(names) | set(model.fixed):
        # A static friction above Coulomb friction may be visible in the breakaways even if the
        # equation error, at its bandwidth, does not show it.
        values = {**values, "omega_sL": model.fixed.get("omega_sL", values["omega_sf"])}
    try:
        refined = refine_stages(
            unloaded, loaded, values, model, correlated, progress, equation_noise
        )
    except np.linalg.LinAlgError:
        return (
            "the search by prediction errors finds no solution: the recordings do not determine "
            "the parameters, or the machine has physics that the model lacks"
        )
    return replace(refined, left_out=left_out)


def _lacks(left_out: Mapping[str, str]) -> str:
    """Return which recordings lack what, by what they lack."""
    parts = []
    for what in dict.fromkeys(left_out.values()):
        names = [name for name, lacked in left_out.items() if lacked == what]
        parts.append(f"{', '.join(names)} {'lacks' if len(names) == 1 else 'lack'} {what}")
    return "; ".join(parts)


def partly_used(left_out: Mapping[str, str]) -> tuple[str, ...]:
    """Return the warning on recordings that prediction errors do not use, if any."""
    if not left_out:
        return ()
    names = ", ".join(left_out)
    return (
        f"{names}: used by the equation error only, for the start values; {NEEDED}; "
        f"{_lacks(left_out)}",
    )


def noise_of(refined: Refined, unit: str) -> MeasuredNoise:
    """Return the measured noise of a refined estimate, with torques in ``unit``."""
    noise, steps = (
        refined.noise,
        [math.sqrt(12.0 * m.angle_variance) for m in refined.joint.motions],
    )
    return MeasuredNoise(
        noise.torque, noise.correlated, noise.correlation_s, noise.angle, max(steps), unit
    )


def floors_of(names: tuple[str, ...], floor: Array) -> dict[str, float]:
    """Return the half width of each 90 % interval at the Cramer-Rao bound ``floor``, (p, p)."""
    exact = Spread(names, floor, math.inf)
    return {name: exact.half_width(name) for name in names}


_LOUDEST_SENSOR = 10.0
"""Torque noise over torque scatter above which it is not the noise of a current sensor."""
PASSES = 3
SETTLED = 0.2
"""Size of a step below which the passes end: rms over the parameters, in standard errors."""


def refine_pieces(
    heads: Sequence[Recording],
    pieces: Sequence[Recording],
    values: Mapping[str, float],
    names: Sequence[str],
    model: Model,
    progress: Callable[[float], None],
    correlated: bool = False,
    equation_noise: float = 0.0,
) -> Refined | str:
    """Return the refined estimate over all pieces, or a text with the reason why prediction errors
    do not apply.

    ``heads``: first pieces of recordings, for the start values, one or more for each load
    condition. ``pieces``: all pieces, including the heads. ``progress``: called with the ratio of
    the passes done to the greatest number of passes.
    """
    start = refine_recordings(
        heads, values, names, model, correlated, equation_noise=equation_noise
    )
    if isinstance(start, str) or start.partial:
        return start
    # Least squares give a biased inertia, because noise in the drive's loop counts as excitation;
    # therefore the inertia is that of the heads.
    names = [n for n in start.names if n != "J"]
    free = [INDEX[n] for n in names]
    vector = pack(start.values, model.alpha)
    begins: dict[int, tuple[Array, ...]] = {}
    evaluations = start.evaluations
    left_out = {piece.name: lacking(piece) for piece in pieces}
    for number in range(PASSES):
        found: list[Reduced] = []
        for k, piece in enumerate(pieces):
            moving = motion(piece)
            if moving is None:
                continue
            point, rounds = Point.of([moving], vector, free, model, start.noise), ROUNDS
            if k in begins:
                point, rounds = replace(point, breakaway_times=begins[k]), 1
            point = optimise_breakaway_times(point, rounds)
            left_out.pop(piece.name, None)
            begins[k] = point.breakaway_times
            found.append(reduce(point))
            evaluations += point.filter.evaluations
            progress((number + (k + 1) / len(pieces)) / PASSES)
        step, length = _step(found)
        x = point.origin()
        x[: len(free)] += step
        vector = point.parameters(x)
        if length < len(free) * SETTLED**2:
            break
    evaluated = replace(
        start, evaluations=evaluations, iterations=start.iterations + number + 1, left_out=left_out
    )
    return _over_all(evaluated, found, names, vector)


def _step(found: Sequence[Reduced]) -> tuple[Array, float]:
    """Return the Gauss-Newton step of the parameters, and its squared norm in standard errors."""
    normal = np.sum([r.normal for r in found], axis=0)
    gradient = np.sum([r.scores.sum(axis=0) for r in found], axis=0)
    step = -np.linalg.pinv(normal, hermitian=True, rcond=1e-14) @ gradient
    return step, float(step @ normal @ step)


def _over_all(
    start: Refined, found: Sequence[Reduced], names: Sequence[str], vector: Array
) -> Refined:
    """Return the estimate of the heads with values and statistics of all pieces."""
    achieved, floor = start.covariance.copy(), start.floor.copy()
    order = np.ix_(*2 * [[start.names.index(n) for n in names]])
    achieved[order], floor[order] = _covariances(found, names, vector)
    squares, count = sum(r.squares for r in found), sum(r.count for r in found)
    return replace(
        start,
        values={**start.values, **unpack(vector, [n for n in INDEX if n in start.values])},
        covariance=achieved,
        floor=floor,
        innovation_rms=float(np.sqrt(squares / count)),
        whiteness=sum(r.neighbours for r in found) / squares,
        breakaways=sum(len(r.scores) for r in found),
    )


def _covariances(
    found: Sequence[Reduced], names: Sequence[str], vector: Array
) -> tuple[Array, Array]:
    """Return covariance (larger of information and sandwich) and Cramer-Rao bound."""
    normal, scale = equilibrated(np.sum([r.normal for r in found], axis=0))
    scores = np.concatenate([r.scores for r in found])
    bread = np.linalg.pinv(normal, hermitian=True)
    scaled = scores / scale
    clusters = max(len(scores), 2)
    sandwich = bread @ (scaled.T @ scaled) @ bread * clusters / max(clusters - len(names), 1)
    mean_square = sum(r.squares for r in found) / sum(r.count for r in found)
    plain = bread * max(mean_square, 1.0)
    widen = np.sqrt(np.maximum(np.diag(sandwich) / np.diag(plain), 1.0))
    units = np.array([vector[INDEX[n]] if INDEX[n] in LOGARITHMIC else 1.0 for n in names])
    turn = rise_to_static(names)
    full = plain * np.outer(widen * units / scale, widen * units / scale)
    bound = bread * np.outer(units / scale, units / scale)
    floor = np.asarray(turn @ bound @ turn.T)
    return not_below(turn @ full @ turn.T, floor), floor
