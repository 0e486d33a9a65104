"""Fits the ladder of friction models to the simulated angle of recordings (M48-M51)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from identification.estimate.bandwidth import choose_bandwidth
from identification.estimate.default import by_load, solve_stages
from identification.model.parameters import (
    DIRECTIONAL,
    DRIVE_SHARE,
    SIMULATED,
    bears_load,
    drive_share,
)
from identification.numerics.arrays import Array, Progress, silent
from identification.numerics.compiled import each
from identification.numerics.least_squares import Box, huber_weight, minimise
from identification.numerics.spread import Spread, correlation_samples
from identification.prepare import Prepared, joint_angle, prepare, uniform_grid
from identification.recording import Bench, Controller, Dataset, Model, Recording
from identification.simulation.closed_loop import (
    Inputs,
    body_of,
    inputs_of,
    loop_of,
    moment_of,
    simulate,
)

STEP_S = 2e-3  # greatest integration step in a search, s; at most the sample period
LEAST_SAMPLES = 20  # least number of samples in a piece


@dataclass(frozen=True)
class Motor:
    """Ratios of motor constants to the declared constants."""

    torque_constant: float = 1.0  # ratio of Km and of Ke; both are the same constant in SI units
    resistance: float = 1.0  # ratio of R

    def bench(self, declared: Bench) -> Bench:
        """Return the constants of a bench with these motor constants."""
        km, ke, r = declared.torque_constant, declared.back_emf_constant, declared.resistance
        return replace(
            declared,
            torque_constant=None if km is None else km * self.torque_constant,
            back_emf_constant=None if ke is None else ke * self.torque_constant,
            resistance=None if r is None else r * self.resistance,
        )


@dataclass(frozen=True)
class Piece:
    """One prediction of the angle, from a measured initial state."""

    recording: Recording
    inputs: Inputs  # inputs of the simulation, shape (n,)
    angle: Array  # measured angle, rad, shape (n,); the first value is the initial state
    velocity: float  # initial velocity, rad/s

    @property
    def controller(self) -> Controller | None:
        """Position loop of the recording; None if the motor's voltage is the only input."""
        return _controller(self.recording)

    def predict(
        self, values: Mapping[str, float], motor: Motor, lateness: float, alpha: float
    ) -> Array:
        """Return the simulated angle, rad, shape (n,).

        ``lateness``: delay with which a logged command acts, s.
        """
        bench = motor.bench(self.recording.bench)
        inputs = self.inputs
        if lateness:
            command = np.interp(inputs.time - lateness, inputs.time, inputs.command)
            inputs = replace(inputs, command=command)
        loop = loop_of(self.controller or Controller("voltage", 0.0), bench, self.recording.name)
        body = body_of(values, self.recording, alpha)
        return simulate(body, loop, inputs, float(self.angle[0]), self.velocity, STEP_S).angle


def _controller(recording: Recording) -> Controller | None:
    """Return the position loop of a recording, or None if it or its command is not known."""
    return recording.controller if "command" in recording.channels else None


def pieces_of(prepared: Prepared) -> list[Piece]:
    """Return the pieces of a :func:`predictable` recording: the whole recording if the controller
    is known, else pieces of :func:`open_horizon`, whose initial states are those of the prepared
    velocity.
    """
    recording = prepared.recording
    angle = joint_angle(recording)
    assert angle is not None
    looped = _controller(recording) is not None
    inputs = inputs_of(recording) if looped else _voltage_inputs(recording)
    speed = np.interp(recording.time, uniform_grid(recording), prepared.raw_velocity)
    ends = _ends(recording.time, math.inf if looped else open_horizon(prepared))
    pieces = []
    for first, last in pairwise(ends):
        span = slice(first, last)
        part = Inputs(**{name: series[span] for name, series in vars(inputs).items()})
        if not np.all(np.isfinite(part.added)):
            continue
        start = 0.0 if looped and first == 0 else float(speed[first])
        pieces.append(Piece(recording, part, angle[span], start))
    return pieces


def open_horizon(prepared: Prepared) -> float:
    """Return the mean time between reversals of the velocity, s. With pieces of this length,
    friction changes its sign about once in a piece.
    """
    moving = prepared.velocity[prepared.used]
    turns = int(np.sum(np.sign(moving[1:]) * np.sign(moving[:-1]) < 0.0))
    time = prepared.recording.time
    return float(time[-1] - time[0]) / (turns + 1)


def _ends(time: Array, horizon: float) -> Sequence[int]:
    """Return the first sample of each piece, and the number of samples."""
    whole = float(time[-1] - time[0])
    count = 1 if not math.isfinite(horizon) else max(round(whole / horizon), 1)
    count = max(min(count, len(time) // LEAST_SAMPLES), 1)
    edges = time[0] + whole * np.arange(1, count) / count
    return [0, *(int(k) for k in np.searchsorted(time, edges)), len(time)]


def _voltage_inputs(recording: Recording) -> Inputs:
    """Return the voltage of the motor, NaN while it is off, as the only input."""
    channels, count = recording.channels, len(recording.time)
    volts = channels["voltage"]
    if "enabled" in channels:
        volts = np.where(channels["enabled"] < 0.5, np.nan, volts)
    return Inputs(recording.time, np.zeros(count), np.ones(count), volts, moment_of(recording))


CONSTANTS = ("torque_constant", "resistance")
LATENESS = "lateness"
RELATIVE_STD = 0.3
"""Relative standard deviation of a motor constant, unless the campaign states one. Motor constants
deviate because of warm windings, tolerances of magnets, and torque losses in gears.
"""
_FASTEST_SHARE, _SLOWEST_SHARE = 1.0 / 3.0, 1e-3
_LATEST = 5.0  # greatest lateness, in sample periods
_MOST_MU, _MOST_SHARE = 0.9, 5.0


@dataclass(frozen=True)
class Scales:
    """Sizes of the signals, SI, from which bounds and steps of finite differences follow."""

    torque: float  # greatest drive torque
    speed: float  # greatest speed
    inertia: float  # inertia at the start of the search
    period: float  # sample period


@dataclass(frozen=True)
class Axis:
    """Bounds of one coordinate, and its step for finite differences."""

    low: float
    high: float
    step: float


@dataclass(frozen=True)
class Point:
    """The parameters of one simulation."""

    values: Mapping[str, float]  # friction and inertia by name, SI
    motor: Motor  # ratios of the motor constants to the declared motor constants
    lateness: float  # delay with which a logged command acts, s


@dataclass(frozen=True)
class Coordinates:
    """The free coordinates of one friction model (rung) of the ladder."""

    rung: str
    names: tuple[str, ...]  # free coordinates, in the order of x
    axes: Mapping[str, Axis]  # bounds and step of each coordinate, by name
    model: Model  # declared model; its fixed parameters do not change
    # Standard deviation of the prior of a coordinate, by name; a prior is centred at 0.
    prior: Mapping[str, float]

    @property
    def box(self) -> Box:
        """Bounds of x."""
        axes = [self.axes[n] for n in self.names]
        return Box(np.array([a.low for a in axes]), np.array([a.high for a in axes]))

    def steps(self) -> Array:
        """Return the steps of finite differences, shape (p,)."""
        return np.array([self.axes[n].step for n in self.names])

    def start(self, values: Mapping[str, float]) -> Array:
        """Return the coordinates of parameters, with declared motor constants, (p,)."""
        share = drive_share(self.rung)
        # At rest the motor torque balances the external torque, so that the transmitted load
        # |external torque - motor torque| is twice the external torque.
        carried = 1.0 + share
        coulomb, gear = values.get("Mc", 0.0), values.get("mu_gc", 0.0)
        x = {
            "Mc": coulomb,
            "rise": max(values.get("Ms", 0.0) - coulomb, 0.0),
            "omega_sf": math.log(max(values.get("omega_sf", 1.0), 1e-12)),
            "sigma_2": values.get("sigma_2", 0.0),
            "J": values.get("J", 0.0),
            "mu_gc": gear / carried,
            "gear_rise": max(values.get("mu_gs", 0.0) - gear, 0.0) / carried,
            DRIVE_SHARE: share,
            "offset": values.get("offset", 0.0),
        }
        return self.box.clip(np.array([x.get(n, 0.0) for n in self.names]))

    def point(self, x: Array) -> Point:
        """Return the parameters at x."""
        found = dict(zip(self.names, (float(v) for v in x), strict=True))
        fixed = self.model.fixed
        values = {n: float(v) for n, v in fixed.items()}
        values |= {n: found[n] for n in ("Mc", "sigma_2", "J", "mu_gc", "offset") if n in found}
        if "rise" in found:
            values["Ms"] = values["Mc"] + found["rise"]
        if "omega_sf" in found:
            values["omega_sf"] = math.exp(found["omega_sf"])
        if "gear_rise" in found:
            values["mu_gs"] = values["mu_gc"] + found["gear_rise"]
        share = found.get(DRIVE_SHARE, drive_share(self.rung))
        if share:
            values[DRIVE_SHARE] = share
        motor = Motor(**{n: math.exp(found.get(n, 0.0)) for n in CONSTANTS})
        return Point(values, motor, found.get(LATENESS, 0.0))


def priors(recording: Recording) -> dict[str, float]:
    """Return the standard deviation of the logarithm of each motor constant."""
    bench, stated = recording.bench, recording.uncertainties
    declared = {"torque_constant": bench.torque_constant, "resistance": bench.resistance}
    return {
        name: stated.get(f"bench.{name}", RELATIVE_STD * value) / value
        for name, value in declared.items()
        if value is not None
    }


def coordinates(
    rung: str, model: Model, pieces: Sequence[Piece], scales: Scales, *, free: bool
) -> Coordinates:
    """Return the coordinates of one friction model (rung).

    ``free``: whether the motor constants are free, within their priors.
    """
    t, w = scales.torque, scales.speed
    small = 5e-4 * t
    axes = {
        "Mc": Axis(0.0, t, small),
        "rise": Axis(0.0, t, small),
        "omega_sf": Axis(math.log(_SLOWEST_SHARE * w), math.log(_FASTEST_SHARE * w), 1e-2),
        "sigma_2": Axis(0.0, t / w, 2e-3 * t / w),
        "J": Axis(1e-3 * scales.inertia, 1e2 * scales.inertia, 1e-2 * scales.inertia),
        "mu_gc": Axis(0.0, _MOST_MU, 1e-3),
        "gear_rise": Axis(0.0, _MOST_MU, 1e-3),
        DRIVE_SHARE: Axis(0.0, _MOST_SHARE, 5e-3),
        "offset": Axis(-t, t, small),
        "torque_constant": Axis(-1.5, 1.5, 3e-3),
        "resistance": Axis(-1.5, 1.5, 3e-3),
        LATENESS: Axis(0.0, _LATEST * scales.period, 0.03 * scales.period),
    }
    controllers = [p.controller for p in pieces]
    driven = any(c is None or c.output != "torque" for c in controllers)
    names = ["Mc", "rise", "omega_sf", "sigma_2", "J"]
    names += ["mu_gc", "gear_rise"] if bears_load(rung) else []
    names += [DRIVE_SHARE] if DRIVE_SHARE in SIMULATED[rung] else []
    names += ["offset"] if "offset" in model.terms else []
    held = set(model.fixed) | ({"rise"} if "Ms" in model.fixed else set())
    prior = {}
    if free and driven:
        prior = priors(pieces[0].recording)
    names = [n for n in names if n not in held] + list(prior)
    names += [LATENESS] if any(controllers) else []
    return Coordinates(rung, tuple(names), axes, model, prior)


QUADRATIC = 0.2
"""Angle error up to which the cost is quadratic, relative to the median absolute error at the start
of the search. Beyond it the cost is linear, so that a recording that no friction model explains has
a limited influence.
"""
TOLERANCE, MOST_STEPS = 1e-3, 40
"""Decrease of the cost over the cost at which a search ends; greatest number of steps."""
COARSE_TOLERANCE, COARSE_STEPS = 0.02, 12
"""Tolerance and steps of the first search from each start; only the best is continued."""
FOLDS = 3


@dataclass(frozen=True)
class LoopFit:
    """End of a search."""

    coordinates: Coordinates
    x: Array
    cost: float  # sum of the costs of data and priors
    ends: tuple[float, ...]  # cost at the end of the search from each start point
    threshold: float  # angle error up to which the cost is quadratic, rad
    # Angle error that counts as one standard deviation of an independent observation, rad.
    unit: float

    @property
    def point(self) -> Point:
        """The parameters at the end of the search."""
        return self.coordinates.point(self.x)


def errors(pieces: Sequence[Piece], point: Point, alpha: float) -> list[Array]:
    """Return the predicted angle less the measured angle of each piece, rad."""
    return each(
        lambda p: p.predict(point.values, point.motor, point.lateness, alpha) - p.angle, pieces
    )


def absolute_error(found: Sequence[Array]) -> float:
    """Return the mean absolute error over all samples, rad."""
    return math.fsum(float(np.sum(np.abs(e))) for e in found) / sum(map(len, found))


def fit_loop(pieces: Sequence[Piece], coordinates: Coordinates, starts: Sequence[Array]) -> LoopFit:
    """Search from several start points, and continue the search from the best end.

    ``starts``: start points, each of shape (p,); the errors of the first start determine the first
    threshold.
    """

    def begun(x: Array) -> LoopFit:
        left = errors(pieces, coordinates.point(x), coordinates.model.alpha)
        threshold = QUADRATIC * float(np.median(np.abs(np.concatenate(left))))
        return LoopFit(coordinates, x, math.inf, (), threshold, unit_of(left, threshold))

    first = begun(starts[0])
    ends = [refit(pieces, replace(first, x=x), COARSE_TOLERANCE, COARSE_STEPS) for x in starts]
    best = ends[int(np.argmin([e.cost for e in ends]))]
    # The threshold and the weight of the priors are computed from the errors at the end of a
    # search, not at its start.
    return replace(refit(pieces, begun(best.x)), ends=tuple(e.cost for e in ends))


def unit_of(found: Sequence[Array], threshold: float) -> float:
    """Return the angle error that counts as one standard deviation of an independent observation,
    rad (M51).

    The Huber cost, divided by threshold times mean absolute error, is the negative log likelihood
    of errors with a Laplace distribution. The errors of one simulation are correlated in time;
    therefore the cost is also divided by the correlation time in samples.
    """
    lengths = [correlation_samples(error) for error in found]
    persistence = float(np.average(lengths, weights=[len(error) for error in found]))
    return math.sqrt(max(threshold * absolute_error(found) * persistence, 1e-300))


def pulls(pieces: Sequence[Piece], found: LoopFit) -> tuple[Array, Array]:
    """Return each recording's normal matrix (m, p, p) and gradient (m, p), without priors."""
    c = found.coordinates
    normals: dict[str, Array] = {}
    gradients: dict[str, Array] = {}
    for piece in pieces:
        error = _errors([piece], c, found.x)
        slope = _slope([piece], c, found.x, error)
        weight = huber_weight(error, found.threshold)
        name = piece.recording.name
        normal, gradient = slope.T @ (slope * weight[:, None]), slope.T @ (weight * error)
        normals[name] = normals.get(name, 0.0) + normal / found.unit**2
        gradients[name] = gradients.get(name, 0.0) + gradient / found.unit**2
    return np.array(list(normals.values())), np.array(list(gradients.values()))


def refit(
    pieces: Sequence[Piece],
    found: LoopFit,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
) -> LoopFit:
    """Fit pieces from the end of an earlier fit, with its threshold and unit."""
    c = found.coordinates
    samples = sum(len(p.angle) for p in pieces)
    threshold = np.concatenate(
        [np.full(samples, found.threshold / found.unit), np.full(len(c.prior), math.inf)]
    )

    def residuals(x: Array) -> Array:
        at = dict(zip(c.names, x, strict=True))
        priors = [at[n] / s for n, s in c.prior.items()]
        return np.concatenate([_errors(pieces, c, x) / found.unit, priors])

    def jacobian(x: Array, here: Array) -> Array:
        data = _slope(pieces, c, x, here[:samples] * found.unit) / found.unit
        prior = [[(n == m) / s for m in c.names] for n, s in c.prior.items()]
        return np.concatenate([data, np.reshape(prior, (len(c.prior), len(x)))])

    end = minimise(
        residuals,
        jacobian,
        found.x,
        threshold=threshold,
        tolerance=tolerance,
        most_steps=most_steps,
        box=c.box,
    )
    return replace(found, x=end.x, cost=end.cost)


def _errors(pieces: Sequence[Piece], c: Coordinates, x: Array) -> Array:
    return np.concatenate(errors(pieces, c.point(x), c.model.alpha))


def _slope(pieces: Sequence[Piece], c: Coordinates, x: Array, here: Array) -> Array:
    """Return d errors by finite differences, negative at an upper bound, (n, p)."""
    slope = np.empty((len(here), len(x)))
    for k, (step, high) in enumerate(zip(c.steps(), c.box.high, strict=True)):
        other = x.copy()
        other[k] += step if x[k] + step <= high else -step
        slope[:, k] = (_errors(pieces, c, other) - here) / (other[k] - x[k])
    return slope


KM, RESISTANCE = CONSTANTS
PER_VOLT = "torque_per_volt"  # Km i / R, N m/V: what a voltage and an angle determine well


@dataclass(frozen=True)
class Constant:
    """A motor constant: its declared and its fitted value.

    Attributes:
        name: ``torque_constant``, ``resistance`` or ``torque_per_volt``.
        unit: SI.
        prior: Relative standard deviation of the declared value, or None for a derived constant.
        low: Lower end of the 90 % interval of the fitted value.
        high: Upper end of the 90 % interval of the fitted value.
        moved: Whether the interval excludes the declared value.
    """

    name: str
    unit: str
    declared: float
    prior: float | None
    value: float
    low: float
    high: float

    @property
    def change(self) -> float:
        """Relative change from the declared value."""
        return self.value / self.declared - 1.0

    @property
    def moved(self) -> bool:
        """Whether the interval excludes the declared value."""
        return not self.low <= self.declared <= self.high


def constants(pieces: Sequence[Piece], found: LoopFit) -> tuple[Constant, ...]:
    """Return the motor constants of a fit in which they were free.

    The interval is the wider of two intervals: from the curvature of cost and priors at the
    minimum, and from the scatter of the recordings' gradients there (sandwich).
    """
    c = found.coordinates
    if not c.prior:
        return ()
    normals, gradients = pulls(pieces, found)
    prior = np.array([1.0 / c.prior[n] ** 2 if n in c.prior else 0.0 for n in c.names])
    inner = (found.x > c.box.low) & (found.x < c.box.high)
    curvature = (np.sum(normals, axis=0) + np.diag(prior))[np.ix_(inner, inner)]
    covariance = np.zeros((len(c.names), len(c.names)))
    covariance[np.ix_(inner, inner)] = np.linalg.pinv(curvature, hermitian=True)
    bench = pieces[0].recording.bench
    km, r = bench.torque_constant, bench.resistance
    assert km is not None
    assert r is not None
    count = len(gradients)
    scatter = np.zeros_like(covariance)
    if count > 1:
        scatter = covariance @ (count * np.cov(gradients, rowvar=False)) @ covariance
    both = [Spread(c.names, each, max(count - 1.0, 1.0)) for each in (covariance, scatter)]
    at = dict(zip(c.names, found.x, strict=True))
    rows: tuple[tuple[str, str, float, float | None, dict[str, float]], ...] = (
        (KM, "N m/A", km, c.prior[KM], {KM: 1.0}),
        (RESISTANCE, "ohm", r, c.prior[RESISTANCE], {RESISTANCE: 1.0}),
        (PER_VOLT, "N m/V", km * bench.gear_ratio / r, None, {KM: 1.0, RESISTANCE: -1.0}),
    )
    made = []
    for name, unit, declared, std, weights in rows:
        ratio = sum(weight * at[n] for n, weight in weights.items())
        half = max(spread.half_width_along(weights) for spread in both)
        value, low, high = (declared * math.exp(ratio + side * half) for side in (0.0, -1.0, 1.0))
        made.append(Constant(name, unit, declared, std, value, low, high))
    return tuple(made)


ONE_SIDED = 1.645
"""Standard errors by which a cross-validated error must exceed the least, to be greater."""
STARTS = (0.08, 0.2)
"""Further start values of the Stribeck speed, relative to the greatest speed. Several start values
are needed, because stick-slip makes the cost irregular, with local minima at low Stribeck speeds.
"""


@dataclass(frozen=True)
class SimulatedRung:
    """One friction model, fitted to the simulated angle."""

    friction: str  # name of the rung, of `SIMULATED`
    free: bool  # whether the motor constants were free within their priors
    alpha: float  # Stribeck exponent
    fitted: Mapping[str, float]  # parameters by name, SI; `lateness` of the command, s
    train: float  # mean absolute angle error on the fitted recordings, rad (m)
    # Cross-validated error: mean absolute angle error on each third of the fitted recordings,
    # predicted with a fit to the other two thirds, rad (m). NaN for a single recording; then no
    # rung is chosen.
    crossed: float
    # Mean absolute angle error on the recordings with role `validate`, rad (m), or None without
    # such recordings.
    scored: float | None
    constants: tuple[Constant, ...]  # motor constants and their changes; empty if they were fixed
    horizon_s: float  # longest prediction, s
    chosen: bool  # whether the fit has the least cross-validated error of all fits of equal `free`
    # Whether the cross-validated error exceeds the least cross-validated error by no more than the
    # uncertainty of the difference.
    tied: bool
    ends: tuple[float, ...]  # cost at the end of the search from each start point


@dataclass(frozen=True)
class _Problem:
    """Data of all rungs: pieces to fit and to score."""

    dataset: Dataset
    fitted: Sequence[Piece]
    scored: Sequence[Piece]
    scales: Scales
    values: Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class _Case:
    """One fit with its errors; ``crossed`` has errors and samples, (m, 2)."""

    found: LoopFit
    crossed: Array
    train: float
    scored: float


def climb_simulated(
    dataset: Dataset, *, bandwidth_Hz: float | None, progress: Progress | None = None
) -> tuple[SimulatedRung, ...]:
    """Fit every rung to the simulated angle, with fixed and with free motor constants, and score
    the fits.

    ``dataset``: unloaded recordings with an angle, and a controller or a measured drive.
    ``bandwidth_Hz``: bandwidth of the equation error, which gives the start values of the searches.

    Returns:
        One record for each fit. The list is empty unless each recording is unloaded and has an
        angle and, in addition, either a declared controller and a ``command`` channel, or a motor
        voltage without torque and current. For recordings with torque or current the equation error
        is sufficient.
    """
    tell = progress or silent
    if not all(map(predictable, dataset.recordings)):
        return ()
    problem = _problem(dataset, bandwidth_Hz)
    hanging = any(p.recording.pendulum is not None for p in problem.fitted)
    rungs = [r for r in SIMULATED if hanging or not bears_load(r)]
    plan = [(rung, free) for rung in rungs for free in (False, True)]
    cases: dict[tuple[str, bool], _Case] = {}
    for k, (rung, free) in enumerate(plan):
        which = "free" if free else "declared"
        tell(f"{rung}, {which} constants", k / len(plan))
        axes = coordinates(rung, dataset.model, problem.fitted, problem.scales, free=free)
        if free and not axes.prior:
            continue
        ends = {key: case.found for key, case in cases.items()}
        cases[rung, free] = _case(problem, axes, _starts(problem, axes, free, ends))
    tell("simulated ladder", 1.0)
    return tuple(_rungs(problem, cases))


def predictable(recording: Recording) -> bool:
    """Return whether a fit of the angle is useful: loop known, or a voltage the only input."""
    channels, bench = recording.channels, recording.bench
    if joint_angle(recording) is None or recording.stage == "loaded":
        return False
    if _controller(recording) is not None:
        return True
    constants = (bench.torque_constant, bench.back_emf_constant, bench.resistance)
    return (
        "voltage" in channels
        and not {"torque", "current"} & channels.keys()
        and None not in constants
    )


def _problem(dataset: Dataset, bandwidth_Hz: float | None) -> _Problem:
    dataset, bandwidth_Hz, _ = choose_bandwidth(dataset, bandwidth_Hz)
    to_fit = dataset.part("fit")
    to_score = dataset.part("validate") or to_fit
    active = [prepare(r, bandwidth_Hz) for r in to_fit]
    aside = [prepare(r, bandwidth_Hz) for r in to_score]
    values = {
        rung: solve_stages(
            *by_load(active), replace(dataset.model, friction=rung), lambda *_: None
        )[0]
        for rung in ("stribeck", "stribeck_load_dependent")
        if not bears_load(rung) or any(r.pendulum is not None for r in to_fit)
    }
    return _Problem(
        dataset=dataset,
        fitted=[piece for p in active for piece in pieces_of(p)],
        scored=[piece for p in aside for piece in pieces_of(p)],
        scales=_scales(active, values["stribeck"]["J"]),
        values=values,
    )


def _scales(prepared: Sequence[Prepared], inertia: float) -> Scales:
    recordings = [p.recording for p in prepared]
    hung = [r.known_inertia for r in recordings if r.known_inertia]
    return Scales(
        torque=max(float(np.max(np.abs(p.drive_torque))) for p in prepared),
        speed=max(float(np.max(np.abs(p.velocity))) for p in prepared),
        inertia=max(inertia, 0.1 * min(hung, default=0.0), 1e-12),
        period=float(np.median([r.period for r in recordings])),
    )


def _starts(
    problem: _Problem, axes: Coordinates, free: bool, ends: Mapping[tuple[str, bool], LoopFit]
) -> list[Array]:
    """Return start points: of the equation error, and ends of contained models."""
    values = problem.values["stribeck_load_dependent" if bears_load(axes.rung) else "stribeck"]
    starts = [axes.start(values)]
    contained = [axes.rung] if free else []
    if axes.rung == DIRECTIONAL:
        contained = [r for r in SIMULATED if bears_load(r) and r != DIRECTIONAL] + contained
    starts += [
        _carried(end, axes)
        for (rung, moved), end in ends.items()
        if rung in contained and (moved == free or rung == axes.rung)
    ]
    if axes.rung != DIRECTIONAL:
        for share in STARTS:
            speed = {"omega_sf": share * problem.scales.speed}
            starts.append(axes.start({**values, **speed}))
    return starts


def _carried(end: LoopFit, axes: Coordinates) -> Array:
    """Return the end of another fit in the coordinates of this model, shape (p,)."""
    found = dict(zip(end.coordinates.names, end.x, strict=True))
    share = end.point.values.get(DRIVE_SHARE, 0.0)
    found.setdefault(DRIVE_SHARE, share)
    return axes.box.clip(np.array([found.get(n, 0.0) for n in axes.names]))


def _case(problem: _Problem, axes: Coordinates, starts: Sequence[Array]) -> _Case:
    found = fit_loop(problem.fitted, axes, starts)
    return _Case(
        found,
        _crossed(problem, found),
        _mean(_by_recording(problem.fitted, found, found.x)),
        _mean(_by_recording(problem.scored, found, found.x)),
    )


def _crossed(problem: _Problem, found: LoopFit) -> Array:
    """Return absolute errors and samples, each fold by a fit to the others, (m, 2)."""
    sums: list[Array] = []
    for names in _folds([p.recording for p in problem.fitted]):
        own = [p for p in problem.fitted if p.recording.name in names]
        others = [p for p in problem.fitted if p.recording.name not in names]
        if others:
            part = refit(others, found)
            sums.append(_by_recording(own, part, part.x))
    return np.concatenate(sums) if sums else np.full((1, 2), math.nan)


def _folds(recordings: Sequence[Recording]) -> Iterator[set[str]]:
    """Yield the recordings of each fold; with enough loads, one load is in one fold."""
    loads = {
        r.name: (
            0.0 if r.pendulum is None else r.pendulum.mass * r.pendulum.length,
            r.steady_torque,
        )
        for r in recordings
    }
    levels = sorted(set(loads.values()))
    if len(levels) >= FOLDS:
        group = {name: levels.index(load) for name, load in loads.items()}
    else:
        group = {name: k for k, name in enumerate(loads)}
    for k in range(FOLDS):
        if names := {name for name, index in group.items() if index % FOLDS == k}:
            yield names


def _by_recording(pieces: Sequence[Piece], found: LoopFit, x: Array) -> Array:
    """Return sum of absolute errors and number of samples of each recording, shape (m, 2)."""
    c = found.coordinates
    sums: dict[str, Array] = {}
    for piece, error in zip(pieces, errors(pieces, c.point(x), c.model.alpha), strict=True):
        own = np.array([float(np.sum(np.abs(error))), float(len(error))])
        sums[piece.recording.name] = sums.get(piece.recording.name, 0.0) + own
    return np.array(list(sums.values()))


def _mean(sums: Array) -> float:
    return float(np.sum(sums[:, 0]) / np.sum(sums[:, 1]))


def _rungs(problem: _Problem, cases: Mapping[tuple[str, bool], _Case]) -> Iterator[SimulatedRung]:
    aside = bool(problem.dataset.part("validate"))
    for (rung, free), case in cases.items():
        rivals = [c for (_, other), c in cases.items() if other == free]
        least = min(rivals, key=lambda c: _mean(c.crossed))
        point = case.found.point
        yield SimulatedRung(
            friction=rung,
            free=free,
            alpha=problem.dataset.model.alpha,
            fitted={**point.values, LATENESS: point.lateness},
            train=case.train,
            crossed=_mean(case.crossed),
            scored=case.scored if aside else None,
            constants=constants(problem.fitted, case.found),
            horizon_s=max(float(p.inputs.time[-1] - p.inputs.time[0]) for p in problem.fitted),
            chosen=case is least and math.isfinite(_mean(case.crossed)),
            tied=_tied(case.crossed, least.crossed),
            ends=case.found.ends,
        )


def _tied(sums: Array, least: Array) -> bool:
    """Return whether a model's errors exceed the best by 1.645 standard errors or less."""
    apart = sums[:, 0] / sums[:, 1] - least[:, 0] / least[:, 1]
    if not np.all(np.isfinite(apart)):
        return False
    if len(apart) < 2:
        return not np.any(apart > 0.0)
    deviation = float(np.std(apart, ddof=1)) / math.sqrt(len(apart))
    return bool(np.mean(apart) <= ONE_SIDED * deviation)
