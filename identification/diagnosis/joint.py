"""Fits nominal parameters and effects jointly by Gauss-Newton steps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from scipy import stats

from identification.diagnosis.linear import (
    DERIVATIVE_STEP,
    Solution,
    contribution,
    effect_columns,
    effect_derivatives,
    moved_parameters,
    predicted_and_attained,
    size_entries,
    solve,
)
from identification.diagnosis.linear import Added as Added
from identification.diagnosis.result import Estimate
from identification.diagnosis.rows import Equation, equations, held_voltage, least_noise, own_noise
from identification.diagnosis.stack import Stack, connected, stack_of, with_effect_basis
from identification.effects.effect import Context, Shape
from identification.numerics.least_squares import (
    least_squares,
    scaled_least_squares,
    unit_columns,
)
from identification.numerics.spread import CONFIDENCE
from identification.recording import Array, RecordingError
from identification.result import MOST_FLOORS, WIDEST
from identification.signals import noise, without_tones
from identification.views.nominal import STATICS, Nominal
from identification.views.view import View

ROUNDS = 30  # greatest number of Gauss-Newton rounds of one joint fit
LARGEST_STEP = 0.3
"""Greatest change of a nonlinear parameter in one round, relative to half its search width."""
CONVERGED = 1e-4  # relative change of the cost below which the fit ends
CLOSING_STEPS, CLOSING_EXCESS = 3, 0.02
"""Greatest number of closing steps after convergence, and the relative excess of the attained over
the predicted mean-square torque mismatch from which a closing step is tried.
"""
CLOSING_SHARES = (1.0, 0.5)
"""Shares of a closing step that are tried: a whole step may worsen the breakaway equation."""
LEAST_CLOSING_GAIN = 0.1
"""Least share of the excess of the attained torque mismatch that a closing step must remove."""
DAMPING = 0.3  # factor on the length of the next step after a step that increases the cost
MOST_FAILURES = 2  # greatest number of steps that may increase the cost
GRID_REACHES = (1.0, 0.2)
"""Half widths of the first grids of a nonlinear parameter, over the half width of its search."""
GRID_POINTS = 9
GRID_REFINEMENTS = 3
MOST_OWN_STEPS, LEAST_STEP_SHARE = 4, 1.0 / 64.0
"""Greatest number of Gauss-Newton steps of an effect in a round, and least share of a step."""


@dataclass(frozen=True, eq=False)
class Joint:
    """A model fitted to all equations."""

    nominal: Nominal
    effects: tuple[Added, ...]
    # Equations at the nominal values, without the contributions of the effects.
    equations: tuple[Equation, ...]
    residual: Array  # whitened rows less the nominal model and the effects, shape (n,)
    # Stack whose effect basis spans the effects and the derivatives of their nonlinear parameters.
    stack: Stack
    limited: ClassVar[bool] = False
    """Whether the fit keeps all parameters within their limits."""

    @property
    def cost(self) -> float:
        """Sum of whitened squares."""
        return float(self.residual @ self.residual)

    @property
    def views(self) -> tuple[View, ...]:
        """The fitted recordings."""
        return self.equations[0].views

    @property
    def unit(self) -> str:
        """Unit of the first equation."""
        return self.equations[0].unit

    def again(self, start: Nominal, effects: Sequence[Added]) -> Joint:
        """Return a fit of these effects from other nominal values, with this fit's noise."""
        return fit(self.views, self.unit, start, effects, self)

    def rows_at(self, nominal: Nominal) -> tuple[Equation, ...]:
        """Return the equations of the fitted recordings at other nominal values."""
        return equations(self.views, nominal, self.unit, self.stack.equations)

    def problem(self) -> tuple[Array, Array, tuple[Array, Array], Array]:
        """Return the linear problem of a fit that is within its limits: whitened derivatives,
        present values, limits, and centre of the ridge penalty.
        """
        raise NotImplementedError

    def unseen(self, aside: Sequence[View]) -> Stack | None:
        """Return the stack of recordings set aside, over this fit's noise; None if too short."""
        sigma = {e.name: e.sigma for e in self.equations}
        rows = equations(aside, self.nominal, self.unit)
        known = [with_noise(e, sigma[e.name]) for e in rows if e.name in sigma]
        return stack_of(known, self.nominal) if known else None


def fit(
    views: Sequence[View],
    unit: str,
    start: Nominal,
    effects: Sequence[Added] = (),
    before: Joint | None = None,
) -> Joint:
    """Fit nominal parameters, coefficients and nonlinear parameters together.

    Args:
        views: Recordings to fit.
        unit: Unit of the torque.
        start: Nominal values from which the fit starts.
        effects: Effects with trial values of their nonlinear parameters; the fit finds the
            coefficients.
        before: A fit to these recordings, whose noise and blocks are used.
    """
    nominal, effects = start_fit(start.limited(views), effects)
    best: Joint | None = None
    least, share, failures = math.inf, 1.0, 0
    stack = None if before is None else before.stack
    for k in range(ROUNDS):
        rows = equations(views, nominal, unit, () if stack is None else stack.equations)
        if not any(equation.name == "torque" for equation in rows):
            raise RecordingError(
                "no sample of the recordings with role fit is in steady motion at this bandwidth: "
                "each window of the filter contains a rest, a reversal or a change of the speed; "
                "state a greater bandwidth, or add a recording with longer steady motion"
            )
        here = stack = stack_of(rows, nominal, stack)
        effects = _with_nonlinear_parameters(here, effects, k)
        solved = solve(here, effects)
        effects = solved.effects
        settled = solved.cost >= (1.0 - CONVERGED) * least
        if solved.cost < (1.0 + CONVERGED) * least:
            best = Joint(nominal, effects, here.equations, solved.residual, here)
            step, share, least = solved, min(1.0, 2.0 * share), min(least, solved.cost)
            if settled:
                break
        else:
            failures, share = failures + 1, DAMPING * share
            if failures > MOST_FAILURES:
                break
        assert best is not None
        # Regressors that depend on the nominal values make the problem nonlinear in them.
        follow = share if any(e.term.follows for e in best.effects) else 1.0
        nominal = best.nominal.moved(follow * step.linear_step, step.speed_step, share)
        effects = (
            _effects_after_step(best.effects, share * step.shapes)
            if k + 1 >= len(GRID_REACHES)
            else best.effects
        )
        nominal, effects = start_fit(nominal_after_effects(nominal, best.effects), effects)
    assert best is not None
    best = _closing_steps(best, step)
    if before is None:
        # Blocks of the first round are too long: errors of the start values are correlated longer.
        best = replace(best, stack=stack_of(best.equations, best.nominal))
    # The residual of the stack still contains the effects of known size, which have no column.
    left = replace(best.stack, residual=best.residual)
    return replace(best, stack=with_effect_basis(left, effect_derivatives(left, best.effects)))


def _with_nonlinear_parameters(
    stack: Stack, effects: tuple[Added, ...], round_: int
) -> tuple[Added, ...]:
    """Fit nonlinear parameters: on a grid in the first rounds, later by Gauss-Newton steps."""
    for place in range(len(effects)):
        if round_ < len(GRID_REACHES):
            shaped = _grid_search(stack, effects, place, GRID_REACHES[round_])
        else:
            shaped = _gauss_newton(stack, effects, place)
        effects = (*effects[:place], shaped, *effects[place + 1 :])
    return effects


def _closing_steps(best: Joint, solved: Solution) -> Joint:
    """Return the fit after closing steps of the nominal parameters, which lower the attained torque
    mismatch.

    In a closing step, static friction may change by half of its value if hardly any row is slow
    enough to determine it. If no share of the step lowers the mismatch enough, a step without
    static friction is tried, because the other nominal parameters are better determined.
    """
    for _ in range(CLOSING_STEPS):
        predicted, attained = predicted_and_attained(best.stack, best.effects, best.residual)
        if attained <= (1.0 + CLOSING_EXCESS) * predicted:
            break
        enough = attained - LEAST_CLOSING_GAIN * (attained - predicted)
        steps = [share * solved.linear_step for share in CLOSING_SHARES]
        after = next(
            (a for step in steps if (a := _fit_after_step(best, step, enough)) is not None), None
        )
        if after is None:
            without = solve(best.stack, best.effects, STATICS).linear_step
            after = _fit_after_step(best, without, enough)
        if after is None:
            break
        best, solved = after
    return best


def _fit_after_step(best: Joint, step: Array, enough: float) -> tuple[Joint, Solution] | None:
    """Return the fit after a step, or None if it leaves ``enough`` or raises the cost."""
    nominal = best.nominal.moved(step, np.zeros(len(step)))
    stack = stack_of(best.rows_at(nominal), nominal, best.stack)
    solved = solve(stack, best.effects)
    there = predicted_and_attained(stack, solved.effects, solved.residual)[1]
    if there >= enough or solved.cost > (1.0 + CLOSING_EXCESS) * best.cost:
        return None
    return Joint(nominal, solved.effects, stack.equations, solved.residual, stack), solved


def start_fit(nominal: Nominal, effects: Sequence[Added]) -> tuple[Nominal, tuple[Added, ...]]:
    """Return the nominal values and effects from which a fit starts."""
    placed, nominal = [], replace(nominal, fitted_alpha=None, presliding_stiffness=0.0, late_s=0.0)
    for effect in effects:
        nominal, shape = effect.term.begin(nominal, effect.shape)
        placed.append(replace(effect, shape=shape))
    return nominal, tuple(placed)


def _effects_after_step(effects: Sequence[Added], steps: Array) -> tuple[Added, ...]:
    """Return the effects after a step of the nonlinear parameters that determine a size."""
    left, placed = list(steps), []
    for effect in effects:
        shape = effect.shape
        for index, reach in size_entries(effect).items():
            step = max(-LARGEST_STEP, min(LARGEST_STEP, float(left.pop(0))))
            trial = moved_parameters(shape, index, reach, step)
            shape = trial if effect.term.physical(trial) else shape
        placed.append(replace(effect, shape=shape))
    return tuple(placed)


def nominal_after_effects(nominal: Nominal, effects: Sequence[Added]) -> Nominal:
    """Return the nominal values with those effects' values on which other regressors depend."""
    nominal = nominal.without_effects()
    for effect in effects:
        if effect.coefficients:
            nominal = effect.term.feeds_back(nominal, effect.shape, effect.coefficients)
    return nominal


class _SingleEffect(NamedTuple):
    """The fit of one effect with the nominal tangent and all other effects projected out."""

    stack: Stack
    effect_basis: Array
    left: Array

    def columns(self, effect: Added, shape: Shape) -> Array:
        """Return an effect's regressors at trial parameters, less all other effects, (n, k)."""
        columns = self.stack.projected(self.stack.whitened(self.stack.columns(effect.term, shape)))
        return np.asarray(columns - self.effect_basis @ (self.effect_basis.T @ columns))

    def rest(self, effect: Added, columns: Array) -> Array:
        """Return the residual after a fit of the coefficients of one effect."""
        if effect.term.size is not None:
            return np.asarray(self.left - effect.term.size * columns[:, 0])
        return np.asarray(self.left - columns @ least_squares(columns, self.left))


def _single_effect(stack: Stack, effects: Sequence[Added], k: int) -> _SingleEffect:
    # Rows to which neither this effect nor connected effects contribute have a constant cost.
    stack = stack.only(connected(effects[k].term.columns, [e.term.columns for e in effects]))
    here = {e.name for e in stack.equations}
    others, known = effect_columns(
        stack, [e for j, e in enumerate(effects) if j != k and here & e.term.columns.keys()]
    )
    effect_basis, _ = np.linalg.qr(stack.projected(others)) if others.shape[1] else (others, None)
    left = stack.projected((stack.measured - known)[:, None])[:, 0]
    return _SingleEffect(stack, effect_basis, left - effect_basis @ (effect_basis.T @ left))


def _grid_search(stack: Stack, effects: Sequence[Added], k: int, share: float) -> Added:
    """Return effect ``k`` with its nonlinear parameters from a grid, all else free."""
    effect = effects[k]
    if not effect.term.refine:
        return effect
    others = _single_effect(stack, effects, k)

    def cost(shape: Shape) -> float:
        rest = others.rest(effect, others.columns(effect, shape))
        return float(rest @ rest)

    return replace(effect, shape=_grid_minimum(cost, effect, share))


def _gauss_newton(stack: Stack, effects: Sequence[Added], k: int) -> Added:
    """Return effect ``k`` with its nonlinear parameters after Gauss-Newton steps from the best
    point of the grid, with the coefficients free.

    The finest step of the grid is 1/250 of a frequency or a time, but the rows of an oscillation
    with many cycles determine frequency or time more precisely. :func:`_effects_after_step` changes
    the nonlinear parameters that determine an effect's size.
    """
    effect = effects[k]
    if not effect.term.refine or effect.term.size is not None:
        return effect
    others = _single_effect(stack, effects, k)
    reaches = effect.term.refine.items()
    columns = others.columns(effect, effect.shape)
    for _ in range(MOST_OWN_STEPS):
        coefficients = least_squares(columns, others.left)
        rest = others.left - columns @ coefficients
        moved = [
            others.columns(effect, moved_parameters(effect.shape, i, reach, DERIVATIVE_STEP))
            for i, reach in reaches
        ]
        slopes = np.stack([(m - columns) @ coefficients / DERIVATIVE_STEP for m in moved], axis=1)
        every = np.concatenate([columns, slopes], axis=1)
        step = scaled_least_squares(every, rest)[columns.shape[1] :]
        shape = _decreasing_step(
            others, effect, np.clip(step, -LARGEST_STEP, LARGEST_STEP), float(rest @ rest)
        )
        if shape is None:
            break
        effect = replace(effect, shape=shape)
        columns = others.columns(effect, shape)
    return effect


def _decreasing_step(
    others: _SingleEffect, effect: Added, step: Array, least: float
) -> Shape | None:
    """Return the nonlinear parameters after the largest share of a step that lowers the cost."""
    share = 1.0
    while share >= LEAST_STEP_SHARE:
        shape = effect.shape
        for (index, reach), part in zip(effect.term.refine.items(), share * step, strict=True):
            shape = moved_parameters(shape, index, reach, float(part))
        if effect.term.physical(shape):
            rest = others.rest(effect, others.columns(effect, shape))
            if float(rest @ rest) < (1.0 - CONVERGED) * least:
                return shape
        share *= DAMPING
    return None


def _grid_minimum(cost: Callable[[Shape], float], effect: Added, share: float) -> Shape:
    """Return the nonlinear parameters of least cost, by finer and finer grids."""
    best, least = effect.shape, cost(effect.shape)
    width = share
    for _ in range(GRID_REFINEMENTS):
        for index, reach in effect.term.refine.items():
            centre = best
            for place in np.linspace(-width, width, GRID_POINTS):
                trial = moved_parameters(centre, index, reach, float(place))
                if place != 0.0 and effect.term.physical(trial) and (value := cost(trial)) < least:
                    best, least = trial, value
        width *= 2.0 / (GRID_POINTS - 1)
    return best


# The part of a fit that is due to one of its effects.

SET_BY_EFFECTS = ("fitted_alpha", "presliding_stiffness", "late_s")
"""Nominal values that an effect sets at the start of a fit (`Effect.begin`)."""


def without_effect(joint: Joint, k: int) -> Stack:
    """Return the stack of a fit in which effect ``k`` is missing: its residual contains this
    effect; the nominal tangent and the other effects are projected out.
    """
    others = tuple(e for j, e in enumerate(joint.effects) if j != k)
    plain, _ = start_fit(joint.nominal, ())
    begun, _ = joint.effects[k].term.begin(plain, joint.effects[k].shape)
    own = [name for name in SET_BY_EFFECTS if getattr(begun, name) != getattr(plain, name)]
    left_out = replace(joint.nominal, **{name: getattr(plain, name) for name in own})
    nominal = nominal_after_effects(left_out, others)
    rows = joint.rows_at(nominal)
    bare = stack_of(rows, nominal, joint.stack)
    left = bare.measured
    for effect in others:
        left = left - contribution(bare, effect)
    bare = replace(bare, residual=bare.projected(left[:, None])[:, 0])
    return with_effect_basis(bare, effect_derivatives(bare, others))


ANGLES = ("phase", "center", "zero", "rest")
"""First words of the parameters that are places, whose errors do not grow with their values."""


def estimates(joint: Joint, form: bool = True) -> tuple[dict[str, Estimate], ...]:
    """Return the parameters of each effect with 90 % intervals, from the scatter of the scores over
    blocks of time.

    With ``form``, the intervals include the error of the form of the effect, which is not in this
    scatter (:func:`_form_error`). A parameter that the fit selects from a list, such as a number of
    periods per turn, has an interval of zero width; one that was measured apart has that
    measurement's.

    The fields for units are empty, because the catalogue states the units.
    """
    if not joint.effects:
        return ()
    context = Context(joint.views, joint.nominal)
    stack = stack_of(joint.equations, joint.nominal, joint.stack)
    columns = stack.projected(effect_derivatives(stack, joint.effects))
    scaled, scale = unit_columns(columns)
    bread = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    sums = stack.sums(scaled * joint.residual[:, None])
    covariance = bread @ (sums.T @ sums) @ bread / np.outer(scale, scale)
    wide = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(stack.blocks - columns.shape[1], 3)))
    out, at = [], 0
    for effect in joint.effects:
        moves = _parameters_after_steps(effect, context)
        part = covariance[at : at + len(moves), at : at + len(moves)]
        at += len(moves)
        values = effect.parameters(context)
        off = _form_error(joint, stack, effect) if form else 0.0
        absent = effect.term.absent(np.array(effect.coefficients), effect.shape, context)
        slopes = {
            name: np.array([move[name] - values[name] for move in moves]) / DERIVATIVE_STEP
            for name in values
        }
        half = {
            name: math.hypot(
                wide * math.sqrt(max(float(s @ part @ s), 0.0)),
                off * (1.0 if name.split("_")[0] in ANGLES else abs(value - absent.get(name, 0.0))),
            )
            if np.any(s != 0.0)
            else wide * effect.term.measured.get(name, 0.0)
            for (name, s), value in zip(slopes.items(), values.values(), strict=True)
        }
        out.append(
            {
                name: Estimate(v, max(v - half[name], low), min(v + half[name], high), "")
                for name, v in values.items()
                for low, high in [effect.term.physical_range(name)]
            }
        )
    return tuple(out)


def _form_error(joint: Joint, stack: Stack, effect: Added) -> float:
    """Return the error of an effect's form, as a share of its size and, rad, of its angles: the
    root of the class of its regressor's error, a share of the squares, or of what is left beyond
    noise in its rows over what it contributes, if the fit leaves more than noise.
    """
    given = contribution(stack, effect)
    rows = given != 0.0
    left, gain = float(np.sum(joint.residual[rows] ** 2)), float(given @ given)
    noises = float(np.sum(np.concatenate([e.allowed() for e in stack.equations])[rows]))
    missing = left - noises if left > MOST_FLOORS**2 * noises else 0.0
    return math.sqrt(max(effect.term.shape_error, missing / gain if gain > 0.0 else 0.0))


def undetermined_size(joint: Joint, k: int) -> str | None:
    """Return a text if the intervals of all sizes of effect ``k`` contain the values without the
    effect (:meth:`~identification.effects.effect.Effect.absent`), or None. One size may be
    zero, such as the inertia behind a gap; the effect is determined if any other size is.
    """
    effect, sizes = joint.effects[k], estimates(joint, form=False)[k]
    context = Context(joint.views, joint.nominal)
    nothing = effect.term.absent(np.array(effect.coefficients), effect.shape, context)
    reasons = []
    for name, none in nothing.items():
        low, high = sizes[name].low, sizes[name].high
        # An interval that is not a number determines nothing either.
        if low > none or high < none:
            return None
        without = f"{none:.3g}, its value without the effect" if none else "zero"
        reasons.append(f"the 90 % interval of {name}, {low:.3g} to {high:.3g}, contains {without}")
    return "; ".join(reasons) or None


def identifiable(joint: Joint, name: str) -> bool:
    """Whether a nominal parameter is identifiable: its 90 % half width is below half its value (for
    a static level, half its rise; for a Stribeck speed, 0.5 in the logarithm).
    """
    nominal = joint.nominal
    torque = next(e for e in joint.equations if e.name == "torque")
    if name not in nominal.free:
        return True
    place = nominal.free.index(name)
    if not np.linalg.norm(torque.tangent[:, place]) > 0.0:
        return False
    scaled, scale = unit_columns(torque.tangent)
    variances = np.diag(np.linalg.pinv(scaled.T @ scaled, rcond=1e-12, hermitian=True))
    spread = np.sqrt(np.maximum(variances, 0.0)) / scale
    rows = joint.residual[joint.stack.part("torque")]
    noise = torque.sigma * max(1.0, float(np.sqrt(np.mean(rows**2))))
    half = float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE)) * noise * float(spread[place])
    if name in ("omega_sf", "omega_sL"):
        return half < WIDEST
    base = {"Ms": "Mc", "mu_s": "mu_c"}.get(name)
    size = nominal.get(name) - (nominal.get(base) if base else 0.0)
    return half < WIDEST * abs(size) or name == "offset"


def _parameters_after_steps(effect: Added, context: Context) -> list[dict[str, float]]:
    """Return the parameters after a step along each column of :func:`effect_derivatives`."""
    moves = []
    coefficients = np.array(effect.coefficients)
    if effect.term.size is None:
        here = effect.term.read(coefficients, effect.shape, context)
        scale = float(np.max(np.abs(coefficients))) or 1.0
        for k in range(len(coefficients)):
            step = np.zeros(len(coefficients))
            step[k] = DERIVATIVE_STEP * scale
            there = effect.term.read(coefficients + step, effect.shape, context)
            moves.append(
                {name: value + (there[name] - value) / scale for name, value in here.items()}
            )
    for index, reach in effect.term.refine.items():
        moves.append(
            dict(
                effect.term.read(
                    coefficients,
                    moved_parameters(effect.shape, index, reach, DERIVATIVE_STEP),
                    context,
                )
            )
        )
    return moves


LOWER_NOISE_RATIO = 0.5
"""Ratio of the new to the old noise estimate, below which the new estimate is used.

On simulated benches with strong periodic effects the ratio was 0.13 to 0.2. On a real motor with
cogging and a mismatch outside the catalogue the ratio was 0.55.
"""


def with_lower_noise(baseline: Joint, joint: Joint) -> tuple[Joint, Joint]:
    """Return the fit of the nominal model and the fit with effects, both with the noise that is
    estimated from the fit with effects, if this noise is lower.

    The function is called only after a fast effect is identified: slow effects do not change the
    differences from row to row, from which the noise is estimated.
    """
    if not joint.effects[-1].term.fast:
        return baseline, joint
    before = _with_lower(baseline, [noise_left(e, joint) for e in joint.equations])
    if before is baseline:
        return baseline, joint
    return before, before.again(joint.nominal, joint.effects)


def noise_left(equation: Equation, joint: Joint) -> Equation:
    """Return an equation with the noise of a fit's residual if lower and if it judges a model."""
    if not equation.judges:
        return equation
    rest = without_tones(
        joint.residual[joint.stack.part(equation.name)], equation.owner, equation.time
    )
    scatter = equation.sigma * noise(rest, equation.owner, equation.views[0].low_pass)
    least = max(math.hypot(scatter, held_voltage(equation)), least_noise(equation))
    sigma = min(equation.sigma, least)
    ratio = equation.sigma / sigma
    return replace(equation, sigma=sigma, own=own_noise(equation, rest * ratio))


def _with_lower(baseline: Joint, equations: Sequence[Equation]) -> Joint:
    """Return the fit of the nominal model with the noise of ``equations``, if in one equation this
    noise is less than `LOWER_NOISE_RATIO` times the present noise. Otherwise, if the own noise of
    one recording is lower by this ratio, return the fit with the own noise of the recordings. The
    equations have no common parameters, so that the fit does not change.
    """
    pairs = list(zip(equations, baseline.equations, strict=True))
    if all(e.sigma >= LOWER_NOISE_RATIO * old.sigma for e, old in pairs):
        pairs = [(with_noise(e, old.sigma), old) for e, old in pairs]
        if all(
            power >= LOWER_NOISE_RATIO**2 * old.own.get(index, 1.0)
            for e, old in pairs
            for index, power in e.own.items()
        ):
            return baseline
    shares = {e.name: e.sigma / old.sigma for e, old in pairs}
    residual = baseline.residual.copy()
    for name, share in shares.items():
        residual[baseline.stack.part(name)] /= share
    kept = tuple(replace(old, sigma=e.sigma, own=e.own) for e, old in pairs)
    stack = replace(baseline.stack, equations=kept, residual=residual)
    return replace(baseline, equations=kept, residual=residual, stack=stack)


def with_noise(equation: Equation, sigma: float) -> Equation:
    """Return an equation with another noise; greater noises of single recordings stay."""
    ratio = equation.sigma / sigma
    own = {index: max(1.0, power * ratio**2) for index, power in equation.own.items()}
    return replace(equation, sigma=sigma, own=own)
