"""Diagnosis of the gas generator from pressure and valve angle: the mass balance of the gas (eq. 4)
as one more set of equations for the search, with the constants of propellant, valve and sensors as
its nominal parameters.

All constants are fitted together with the effects, each with a prior whose standard deviation is
its tolerance; otherwise a throat that is 0.02 mm wider than in the drawing would count as missing
physics.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np

from identification.diagnosis.comparison import implausible
from identification.diagnosis.diagnose import IDENTIFIED, judge
from identification.diagnosis.held_out import dropped_effects, rms_by_equation, validation_residual
from identification.diagnosis.joint import Joint
from identification.diagnosis.judgement import effects_of
from identification.diagnosis.linear import Added, effect_derivatives
from identification.diagnosis.result import Diagnosis, Fit, Map, ResidualTrace, Shift, Verdict
from identification.diagnosis.rows import Coordinate, Equation
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import Options, Progress, search
from identification.diagnosis.stack import Stack, stack_of, with_effect_basis
from identification.diagnosis.statement import NONE_ASIDE, statement
from identification.diagnosis.unexplained import unexplained
from identification.diagnosis.within_limits import fitted_part
from identification.effects import GAS
from identification.effects.effect import Shape
from identification.effects.gas_generator import GasGeneratorEffect
from identification.effects.model import Curve
from identification.model import gas_generator as kernel
from identification.model.gas_generator import (
    GasGenerator,
    ValveGeometry,
    constants,
    throat_area,
    throat_derivatives,
)
from identification.numerics.least_squares import minimise
from identification.recording import Array, Dataset, Recording, RecordingError
from identification.signals import Decimator
from identification.views.nominal import Nominal
from identification.views.view import View, forget

PRESSURE = "pressure"  # name of the equation


@dataclass(frozen=True)
class Constant:
    """A constant that has one value in all recordings.

    Attributes:
        unit: Unit, SI.
        tolerance: Standard deviation of the prior: a share of the value if ``relative``, else in
            the unit.
        relative: Whether the logarithm of the constant is fitted.
    """

    unit: str
    tolerance: float
    relative: bool = False

    def moved(self, value: float, steps: float) -> float:
        """Return a value that is ``steps`` tolerances from the nominal value."""
        change = self.tolerance * steps
        return value * math.exp(change) if self.relative else value + change

    def steps(self, nominal: float, value: float) -> float:
        """Return the deviation from the nominal value, in tolerances; inverse of :meth:`moved`."""
        return (math.log(value / nominal) if self.relative else value - nominal) / self.tolerance


CONSTANTS: Mapping[str, Constant] = {
    "a": Constant("m/s", 0.1, relative=True),  # at 1 MPa; scatter between propellant lots
    "n": Constant("1", 0.03),  # uncertainty of a strand burner measurement
    "C_r": Constant("m/s", 0.05, relative=True),
    "d": Constant("m", 2.5e-5),
    "D": Constant("m", 2.5e-5),
    "b": Constant("m", 2.5e-5),
    "angle_zero": Constant("rad", math.radians(0.05)),  # true less measured angle
    "pressure_zero": Constant("Pa", 3e3),  # measured less true, of a transducer tared before firing
    "delay": Constant("s", 1e-3),  # delay of the pressure relative to the angle
}
"""Constants by name, in the order in which they are fitted."""
PROPELLANT = ("a", "n", "C_r")  # constants that neither a drawing nor a calibration states
VOLUME = Constant("m^3", 0.3, relative=True)
"""Free volume of the chamber at the first row of each recording, without igniter and grain."""
START_PRESSURE = Constant("Pa", 0.01, relative=True)
"""Pressure at the first row of each recording; the tolerance scales the fit and is no prior."""
ROW_S = 0.005  # averaging time of a row, s; a tenth of the time constant of the chamber's outflow
LEAST_ROWS = 50
FIRST_ROWS = 4
TURN, SIZE = math.radians(0.05), 2.5e-5
"""Steps of numerical derivatives, rad and m: about the tolerances of encoder and valve."""
PIECES = 4
"""Number of intervals of time of each recording for which a generic family has a constant each."""
STEP = 0.01  # step of numerical derivatives, in the units of the fit
STAGES = ((1e4, 1e-3, 10), (1.0, 1e-6, 25))
"""Stages of the fit: factor on the weight of the priors of valve and sensors, relative decrease of
the cost below which a stage ends, and greatest number of steps. The constants of valve and sensors
are almost fixed until all other parameters have converged; from distant start values they would
move far from their nominal values.
"""
FARTHEST, FIRM_FARTHEST = 6.0, 15.0
"""Limits of the constants of the propellant, and of valve and sensors, in tolerances. Without
limits, the filling of a chamber ten times as large would explain any slow mismatch.
"""
BEYOND = 1e6  # residual, relative to the noise, that is returned beyond the limits
VALIDATION_RATIO = 1.5
"""Ratio of the rms error on validation recordings to the noise, from which a warning is given."""
DEVIATION_LIMIT = 3.0  # deviation of a constant, in tolerances, from which it is reported


@dataclass(frozen=True, eq=False)
class Burn:
    """One recording of a burning gas generator as rows; throat and pressure are means over the same
    samples. For the search a burn is a view.
    """

    recording: Recording
    index: int
    time: Array  # time since the first sample of the recording, s, shape (n,)
    areas: Array  # A_t and its derivatives with respect to the thickness of a deposit, shape (3, n)
    shifts: Array  # derivatives of A_t by angle, d, D and b, shape (4, n)
    angle: Array  # rad, shape (n,)
    pressure: Array  # Pa, shape (n,)
    # Pressure, Pa, web burnt, m, and rate of pressure, Pa/s, by the last fit of the nominal model,
    # shape (3, n).
    simulated: Array = field(default_factory=lambda: np.zeros((3, 0)))
    low_pass: ClassVar[Decimator] = Decimator(np.ones(1), 1)  # the rows are means already

    @property
    def step(self) -> float:
        """Distance of the rows, s."""
        return float(self.time[-1] - self.time[0]) / (len(self.time) - 1)

    @property
    def sense(self) -> Array:
        """One for every row: the pressure does not depend on a direction."""
        return np.ones(len(self.time))

    @property
    def generator(self) -> GasGenerator:
        """Nominal constants of the recording's gas generator."""
        found = self.recording.bench.gas_generator
        assert found is not None
        return found


def has_gas_channels(recording: Recording) -> bool:
    """Whether a recording has what a diagnosis of the gas generator needs."""
    known = recording.bench.gas_generator is not None
    return known and {"pressure", "angle"} <= recording.channels.keys()


def burns(recordings: Sequence[Recording]) -> tuple[Burn, ...]:
    """Return recordings as rows."""
    return tuple(_burn(recording, index) for index, recording in enumerate(recordings))


def _burn(recording: Recording, index: int) -> Burn:
    missing = {"pressure", "angle"} - recording.channels.keys()
    g = recording.bench.gas_generator
    if missing or g is None:
        what = " and ".join(sorted(missing)) or "bench.gas_generator"
        raise RecordingError(
            f"{recording.name}: the recording has no {what}, but a gas generator is diagnosed from "
            "pressure and valve angle"
        )
    per_row = max(1, round(ROW_S / recording.period))
    count = len(recording.time) // per_row
    if count < LEAST_ROWS:
        raise RecordingError(
            f"{recording.name}: the {len(recording.time)} samples give {count} averages over "
            f"{ROW_S * 1e3:g} ms; at least {LEAST_ROWS} averages are needed"
        )

    def mean(values: Array) -> Array:
        parts = values[..., : count * per_row].reshape(*values.shape[:-1], count, per_row)
        return np.asarray(parts.mean(axis=-1))

    measured = recording.channels["angle"]
    time, angle, pressure = map(mean, (recording.time, measured, recording.channels["pressure"]))
    lowest = float(np.min(pressure))
    if not lowest > 0.0:
        raise RecordingError(
            f"{recording.name}: the pressure falls to {lowest:g} Pa; the channel must be the "
            "absolute pressure in Pa, only while the gas generator burns"
        )
    areas = mean(throat_derivatives(measured, g.valve))
    shifts = mean(throat_shifts(measured, g.valve))
    return Burn(recording, index, time - float(recording.time[0]), areas, shifts, angle, pressure)


def throat_shifts(angle: Array, valve: ValveGeometry) -> Array:
    """Return dA_t/d(angle) (m^2/rad), d, D and b (m), by central differences, shape (4, n)."""
    by_angle = throat_area(angle + TURN, valve) - throat_area(angle - TURN, valve)
    by_size = [
        throat_area(angle, replace(valve, **{name: value + SIZE}))
        - throat_area(angle, replace(valve, **{name: value - SIZE}))
        for name, value in (("d", valve.d), ("D", valve.D), ("b", valve.b))
    ]
    return np.stack([by_angle / (2.0 * TURN), *(change / (2.0 * SIZE) for change in by_size)])


def noise(burns: Sequence[Burn]) -> float:
    """Return the pressure's scatter from row to row, Pa; at least the quantisation error."""
    differences = np.concatenate([np.diff(b.pressure, n=3) for b in burns])
    # Third differences of white noise of unit variance have the variance 20.
    scatter = 1.4826 * float(np.median(np.abs(differences))) / math.sqrt(20.0)
    steps = np.diff(np.unique(np.concatenate([b.pressure for b in burns])))
    if not steps.size:
        raise RecordingError(
            f"{burns[0].recording.name}: the pressure channel is constant; check whether the "
            "pressure transducer was logged"
        )
    return max(scatter, float(np.min(steps)) / math.sqrt(12.0))


class Start(NamedTuple):
    """State at the first row of a recording: pressure in Pa, free volume in m^3."""

    pressure: float
    volume: float


class Acting(NamedTuple):
    """An effect with its size and its other parameters."""

    term: GasGeneratorEffect
    size: float
    shape: Shape


@dataclass(frozen=True, eq=False)
class GasNominal(Nominal):
    """Constants of propellant, valve and sensors, with the state at the start of each recording."""

    starts: tuple[Start, ...] = ()
    # Fitted effects, on which the response to a further effect depends.
    acting: tuple[Acting, ...] = ()

    @classmethod
    def believed(cls, burns: Sequence[Burn]) -> GasNominal:
        """Return the nominal constants; each recording starts at its first pressure."""
        g = burns[0].generator
        starts = tuple(Start(float(np.mean(b.pressure[:FIRST_ROWS])), g.V_0) for b in burns)
        return cls(_stated(g), tuple(CONSTANTS), 2.0, starts=starts)

    def without_effects(self) -> GasNominal:
        """Return the constants without effects."""
        return replace(self, acting=())

    def with_effect(self, term: GasGeneratorEffect, size: float, shape: Shape) -> GasNominal:
        """Return the constants with one more effect, or with other parameters of an effect."""
        others = tuple(a for a in self.acting if a.term.name != term.name)
        return replace(self, acting=(*others, Acting(term, size, shape)))

    def simulated(self, burn: Burn) -> Array:
        """Return pressure (Pa), web burnt (m) and rate of pressure (Pa/s), shape (3, n)."""
        own, start = _stated(burn.generator), self.starts[burn.index]
        off = [self.values[name] - own[name] for name in ("angle_zero", "d", "D", "b")]
        areas = burn.areas.copy()
        areas[0] += np.array(off) @ burn.shifts
        vector = np.zeros(kernel.MISSING_SIZE)
        for term, size, shape in self.acting:
            vector[list(term.slots)] = (size, *shape)
        out = np.empty((3, len(burn.time)))
        c = constants(burn.generator, self.values, start.pressure, start.volume)
        kernel.march(burn.time, areas, c, vector, out)
        return out

    def signal(self, burn: Burn) -> Array:
        """Return the signal of a transducer with zero error and delay, Pa, shape (n,)."""
        pressure, _, rise = self.simulated(burn)
        return np.asarray(pressure + self.values["pressure_zero"] - self.values["delay"] * rise)

    def response(self, burn: Burn, term: GasGeneratorEffect, shape: Shape) -> Array:
        """Return the change of the signal by an effect over the effect's size, shape (n,): at the
        fitted size, so that size times response is what the effect adds, or at a small size.
        """
        size = next((a.size for a in self.acting if a.term.name == term.name), 0.0)
        size = size or STEP * term.scale
        others = replace(self, acting=tuple(a for a in self.acting if a.term.name != term.name))
        with_it = others.with_effect(term, size, shape)
        return (with_it.signal(burn) - others.signal(burn)) / size


def _stated(g: GasGenerator) -> dict[str, float]:
    """Return the nominal constants by the names of :data:`CONSTANTS`."""
    given = {**vars(g), **vars(g.valve)}
    return {name: given.get(name, 0.0) for name in CONSTANTS}


@dataclass(frozen=True)
class PressureEquation(Equation):
    """Pressure of all recordings, followed by one row for each prior: the deviation of the constant
    from its nominal value; therefore constants can replace an effect only within their tolerances.
    """

    firm: tuple[int, ...] = ()  # rows of the constants of valve and sensors
    white: ClassVar[bool] = True

    def rows(self, per_view: Any) -> Array:
        """Return series, shape (m,) or (k, m) per burn, as rows, shape (n, k); zero for priors."""
        parts = [np.atleast_2d(per_view(view)).T for view in self.views]
        priors = int(np.sum(self.owner < 0))
        return np.concatenate([*parts, np.zeros((priors, parts[0].shape[1]))])

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Coordinates on which the mismatch may depend."""

        def place(burn: Any) -> Array:
            return np.asarray(burn.index + (1.0 - 1e-9) * burn.time / burn.time[-1])

        pieces = PIECES * len(self.views)
        each = Coordinate("time in each recording", "s", place, False, bins=pieces)
        return (*self.mapped, each)

    @property
    def mapped(self) -> tuple[Coordinate, ...]:
        """Coordinates over which the mismatch is located."""
        return COORDINATES


COORDINATES = (
    Coordinate("time", "s", lambda b: b.time, False),
    Coordinate("web burnt", "m", lambda b: cast(Any, b).simulated[1], False),
    Coordinate("pressure", "Pa", lambda b: cast(Any, b).simulated[0], False),
    Coordinate("throat area", "m^2", lambda b: cast(Any, b).areas[0], False),
    Coordinate(
        "opening rate", "m^2/s", lambda b: np.gradient(cast(Any, b).areas[0], b.time), False
    ),
)


class _Layout:
    """Fitted vector: deviations of constants and starts in tolerances, and scaled effects."""

    def __init__(
        self, burns: Sequence[Burn], start: GasNominal, effects: Sequence[Added], shared: bool
    ) -> None:
        self.given, self.effects = start, effects if shared else ()
        self.believed = GasNominal.believed(burns)
        self.constants = CONSTANTS if shared else {}
        self.shared, self.ends = len(self.constants), len(self.constants) + 2 * len(burns)
        inner = [
            c.steps(self.believed.values[k], start.values[k]) for k, c in self.constants.items()
        ]
        for mine, own in zip(start.starts, self.believed.starts, strict=True):
            inner += [
                VOLUME.steps(own.volume, mine.volume),
                START_PRESSURE.steps(own.pressure, mine.pressure),
            ]
        for effect in self.effects:
            (size,), term = effect.coefficients, _term(effect)
            inner += [size / term.scale, *np.log(effect.shape)]
        self.start, self.held = np.array(inner), np.zeros(len(inner))
        self.held[: self.ends] = [1.0] * self.shared + [1.0, 0.0] * len(burns)
        self.firm = np.zeros(len(inner), dtype=np.bool_)
        self.firm[: self.shared] = [name not in PROPELLANT for name in self.constants]

    def added(self, x: Array) -> tuple[Added, ...]:
        """Return the effects with the parameters of a vector."""
        out, at = [], self.ends
        for effect in self.effects:
            size, *rest = x[at : at + 1 + len(effect.shape)].tolist()
            shape = tuple(math.exp(min(v, 20.0)) for v in rest)
            out.append(replace(effect, coefficients=(size * _term(effect).scale,), shape=shape))
            at += 1 + len(effect.shape)
        return tuple(out)

    def model(self, x: Array) -> GasNominal:
        """Return the model with the fitted quantities of a vector."""
        own, inner = self.believed, x[: self.shared].tolist()
        moved = {
            k: c.moved(own.values[k], v)
            for (k, c), v in zip(self.constants.items(), inner, strict=True)
        }
        starts = tuple(
            Start(START_PRESSURE.moved(b.pressure, p), VOLUME.moved(b.volume, v))
            for b, (v, p) in zip(
                own.starts, x[self.shared : self.ends].reshape(-1, 2).tolist(), strict=True
            )
        )
        found = replace(self.given, values={**self.given.values, **moved}, starts=starts)
        for effect in self.added(x):
            found = found.with_effect(_term(effect), effect.coefficients[0], effect.shape)
        return found

    def tangent(self, burns: Sequence[Burn], x: Array) -> Array:
        """Return the derivative of the signal with respect to the vector, Pa, shape (n, p)."""
        here = [self.model(x).signal(b) for b in burns]
        out = [np.zeros((len(p), len(x))) for p in here]
        for k in range(len(x)):
            moved = x.copy()
            moved[k] += STEP
            model = self.model(moved)
            # The state at the start of a recording affects this recording alone.
            own = (k - self.shared) // 2 if self.shared <= k < self.ends else None
            for j, burn in enumerate(burns):
                if own is None or own == j:
                    out[j][:, k] = (model.signal(burn) - here[j]) / STEP
        return np.concatenate(out)


def _term(effect: Added) -> GasGeneratorEffect:
    assert isinstance(effect.term, GasGeneratorEffect)
    return effect.term


@dataclass(frozen=True, eq=False)
class GasFit(Joint):
    """Constants, effects and the state at the start of each recording, fitted by simulation."""

    # Whitened derivatives with respect to constants and effects, with the states at the start of
    # the recordings projected out, shape (n, k).
    derivatives: Array = field(default_factory=lambda: np.zeros((0, 0)))
    limited: ClassVar[bool] = True

    def again(self, start: Nominal, effects: Sequence[Added]) -> GasFit:
        """Return a fit of the same recordings with these effects. It starts from the nominal
        constants too, because a fit without an effect may have moved the constants far from them.
        """
        here, sigma = cast(Any, self.views), self.equations[0].sigma
        begun = (GasNominal.believed(here), cast(GasNominal, start).without_effects())
        tried = [fit(here, sigma, nominal, effects, self.stack) for nominal in begun]
        return min(tried, key=lambda j: (bool(j.effects and implausible(j)), j.cost))

    def rows_at(self, nominal: Nominal) -> tuple[Equation, ...]:
        """Return the equation at other values, without effects."""
        equation, plain = self.equations[0], cast(GasNominal, nominal).without_effects()
        measured = equation.rows(lambda b: cast(Any, b).pressure - plain.signal(cast(Any, b)))[:, 0]
        # The deviations of the constants do not depend on the effects.
        priors = np.where(equation.owner < 0, equation.sigma * self.residual, 0.0)
        return (replace(equation, residual=measured + priors),)

    def unseen(self, aside: Sequence[View]) -> Stack:
        """Return the stack of recordings set aside; only their state at the start is fitted."""
        here, nominal = cast(Any, aside), cast(GasNominal, self.nominal)
        start = replace(nominal, starts=GasNominal.believed(here).starts)
        found = fit(here, self.equations[0].sigma, start, self.effects, shared=False)
        return replace(found.stack, effect_basis=np.zeros((len(found.residual), 0)))

    def problem(self) -> tuple[Array, Array, tuple[Array, Array], Array]:
        """Return the linear problem of constants and sizes, without limits."""
        none, far = np.zeros(self.derivatives.shape[1]), np.full(self.derivatives.shape[1], np.inf)
        return self.derivatives, none, (-far, far), none


def fit(
    burns: Sequence[Burn],
    sigma: float,
    start: GasNominal,
    effects: Sequence[Added] = (),
    like: Stack | None = None,
    *,
    shared: bool = True,
) -> GasFit:
    """Fit constants and effects to recordings by least squares of the pressure.

    Args:
        burns: Recordings to fit.
        sigma: Noise of a row, Pa.
        start: Start values.
        effects: Effects with start values.
        like: A stack of the same recordings, whose blocks are used.
        shared: Whether constants and effects are fitted too; otherwise only the state at the start
            of each recording is fitted.
    """
    layout = _Layout(burns, start, effects, shared)
    measured = np.concatenate([b.pressure for b in burns])
    farthest = np.where(layout.firm, FIRM_FARTHEST, FARTHEST)
    x = layout.start
    for stiffness, tolerance, most_steps in STAGES:
        held = np.where(layout.firm, stiffness, 1.0) * layout.held

        def residuals(x: Array, held: Array = held) -> Array:
            if np.any(np.abs(layout.held * x) > farthest):
                return np.full(len(measured) + len(x), BEYOND)
            model = layout.model(x)
            simulated = np.concatenate([model.signal(b) for b in burns])
            return np.concatenate(((simulated - measured) / sigma, held * x))

        def jacobian(x: Array, _residual: Array, held: Array = held) -> Array:
            return np.concatenate((layout.tangent(burns, x) / sigma, np.diag(held)))

        x = minimise(
            residuals, jacobian, x, threshold=math.inf, tolerance=tolerance, most_steps=most_steps
        ).x
    nominal, placed = layout.model(x), layout.added(x) if shared else tuple(effects)
    simulated = [nominal.simulated(b) for b in burns]
    signal = np.concatenate([nominal.signal(b) for b in burns])
    prior = layout.held > 0.0
    residual = np.concatenate(((measured - signal) / sigma, -x[prior]))
    tangent = np.concatenate((layout.tangent(burns, x) / sigma, np.eye(len(x))[prior]))
    here = tuple(replace(b, simulated=s) for b, s in zip(burns, simulated, strict=True))
    priors = int(np.sum(prior))
    owner = np.concatenate([*(np.full(len(b.time), b.index) for b in burns), np.full(priors, -1)])
    equation = PressureEquation(
        PRESSURE,
        "Pa",
        cast(Any, here),
        (),
        sigma * residual,
        sigma * tangent[:, : layout.ends],
        (),
        owner,
        np.concatenate([*(b.time for b in burns), np.zeros(priors)]),
        sigma,
        firm=tuple((len(measured) + np.flatnonzero(layout.firm[prior])).tolist()),
    )
    acting = np.zeros(len(owner))
    for effect in placed:
        response = partial(nominal.response, term=_term(effect), shape=effect.shape)
        acting += effect.coefficients[0] * equation.rows(response)[:, 0]
    equation = replace(equation, residual=equation.residual + acting)
    stack = stack_of((equation,), nominal, like)
    states = np.linalg.qr(tangent[:, layout.shared : layout.ends])[0]
    own = np.delete(tangent, slice(layout.shared, layout.ends), axis=1)
    left = replace(stack, residual=stack.projected(residual[:, None])[:, 0])
    if shared:
        left = with_effect_basis(left, effect_derivatives(left, placed))
    return GasFit(nominal, placed, (equation,), residual, left, own - states @ (states.T @ own))


def diagnose_gas(
    dataset: Dataset, *, rng: np.random.Generator | None = None, progress: Progress | None = None
) -> Diagnosis:
    """Test whether physics is missing from the gas-generator model; identify and locate the missing
    effects.

    The constants of propellant, valve and sensors, within their tolerances (:data:`CONSTANTS`), and
    the state at the start of every recording are fitted together with the effects.
    """
    started, rng = perf_counter(), rng or np.random.default_rng(0)
    report: Progress = progress or (lambda _stage, _share: None)
    forget()
    report("nominal gas generator", 0.0)
    here, aside = burns(fitted_part(dataset)), cast(Any, burns(dataset.part("validate")))
    first = fit(here, noise(here), GasNominal.believed(here))
    found, judged = judge(
        search(first, GAS, rng, report, Options(thorough=True)), aside, GAS, rng, report
    )
    verdict, where, drawn, reason = judged
    effects = effects_of(found, rng) if verdict in IDENTIFIED else ()
    scored = cast(GasFit, found.final if effects else found.baseline)
    bandwidth = 0.5 / min(b.step for b in here)
    equation, both = found.baseline.equations[0], (found.baseline, scored)
    rms, corrected = (
        equation.sigma * math.sqrt(float(np.mean(j.residual[equation.owner >= 0] ** 2)))
        for j in both
    )
    traces = _traces_of(equation, *(j.residual for j in both))
    unseen = [seen for j in both if aside and (seen := validation_residual(j, aside)) is not None]
    held = [rms_by_equation(*seen)[equation.name] for seen in unseen]
    if unseen:
        (stack, before), (_, after) = unseen
        traces += _traces_of(stack.equations[0], before, after)
    main = Fit(equation.name, equation.unit, bandwidth, rms, corrected, equation.sigma, *held)
    units = {name: c.unit for name, c in {**CONSTANTS, "V_0": VOLUME}.items()}
    stated, fitted = (_constants(j) for j in both)
    return Diagnosis(
        verdict=verdict,
        statement=statement(verdict, effects, main, where, found.p_value, (), reason),
        effects=effects,
        fit=main,
        fits=(main,),
        parameters=fitted,
        parameter_shift={n: Shift(v, fitted[n], units[n]) for n, v in stated.items()},
        p_value=found.p_value,
        location=where,
        curve=_curve(drawn) if verdict is Verdict.OUTSIDE_CATALOGUE else None,
        maps=drawn,
        steps=found.steps,
        traces=traces,
        warnings=(
            *_warnings(found.baseline, aside, main),
            *dropped_effects(found),
            *unexplained(found, verdict, reason, rng),
        ),
        seconds=perf_counter() - started,
    )


def _constants(joint: Joint) -> dict[str, float]:
    """Return the constants that all recordings have in common, and the mean of the free volumes."""
    nominal = cast(GasNominal, joint.nominal)
    return {**nominal.values, "V_0": float(np.mean([s.volume for s in nominal.starts]))}


def _warnings(baseline: Joint, aside: Sequence[Burn], main: Fit) -> list[str]:
    warnings = [] if aside else [NONE_ASIDE]
    unseen = main.validate_final_rms
    if unseen is not None and unseen > VALIDATION_RATIO * main.noise_floor_rms:
        warnings.append(
            f"on recordings set aside the error is {unseen / main.noise_floor_rms:.2g} times the "
            f"noise (limit {VALIDATION_RATIO:g}): the fitted recordings do not determine the "
            "parameters of the gas generator; fit recordings with steps between narrow and wide "
            "throats too"
        )
    for burn in cast(Any, baseline.views):
        if float(np.ptp(burn.areas[0])) < 0.02 * float(np.mean(burn.areas[0])):
            warnings.append(
                f"{burn.recording.name}: the throat area hardly changes, so this recording shows "
                "no transient"
            )
    pulls = baseline.residual[baseline.equations[0].owner < 0]
    strained = [
        f"{name} by {abs(p):.1f} times "
        + (f"{100.0 * c.tolerance:.2g} %" if c.relative else f"{c.tolerance:.2g} {c.unit}")
        for (name, c), p in zip(CONSTANTS.items(), pulls, strict=False)
        if abs(p) > DEVIATION_LIMIT
    ]
    if strained:
        warnings.append(
            "a model without effects would need constants that differ from their nominal values: "
            f"{', '.join(strained)}; check these constants first"
        )
    return warnings


def _traces_of(equation: Equation, before: Array, after: Array) -> tuple[ResidualTrace, ...]:
    """Return whitened rows by two models as the mismatch of every recording."""
    return tuple(
        ResidualTrace(
            view.recording.name,
            view.recording.role,
            equation.name,
            equation.unit,
            equation.time[mine],
            equation.sigma * before[mine],
            equation.sigma * after[mine],
        )
        for view in equation.views
        for mine in [equation.owner == view.index]
        if np.any(mine)
    )


def _curve(drawn: Sequence[Map]) -> Curve | None:
    """Return the mean of a map as an empirical curve of the mismatch: of the location's map, if its
    mean explains about as much as the mean of any map; otherwise of the map whose mean explains
    most.

    The mean of the location's map may explain little, if the nominal parameters compensate a part
    of the missing torque, or if this torque is proportional to the load.
    """
    best = max(drawn, key=lambda m: m.mean_share, default=None)
    if best is None:
        return None
    if drawn[0].mean_share >= RULES.own_coordinate * best.mean_share:
        best = drawn[0]
    return best.curve(best.centre, best.mean)
