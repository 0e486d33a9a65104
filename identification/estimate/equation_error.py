"""Equation-error method (M7-M10): start values from torque equations, covariance, noise floor."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import optimize

from identification.model.friction import stribeck_shape, system_friction
from identification.model.parameters import LADDER, bears_load, rises
from identification.numerics.arrays import Array, BoolArray, IntArray
from identification.numerics.least_squares import Design, bounded_least_squares, unit_columns
from identification.numerics.spread import NO_SPREAD, Spread, correlation_samples
from identification.prepare import Prepared, joint_angle, prepare, uniform_grid, volts_per_torque
from identification.recording import Model, Recording, RecordingError
from identification.signals import quantum, resample

HIGHEST_SHARE = 1.0 / 3.0
"""Greatest Stribeck speed that is tried, relative to the greatest recorded speed; with a higher
Stribeck speed the falling part cannot be distinguished from a straight line.
"""
LEAST_MOTION = 40  # least number of moving samples, over all recordings of a stage, for a fit
LOWEST_SHARE = 1e-3  # least Stribeck speed that is tried, relative to the greatest recorded speed


def samples_in_motion(prepared: Sequence[Prepared]) -> int:
    """Return the number of samples in motion that a fit uses, over all recordings."""
    return sum(int(np.sum(_moving(p))) for p in prepared)


def _moving(p: Prepared) -> BoolArray:
    """Return whether each sample is used and in motion, shape (n,)."""
    return np.asarray(p.used & (p.velocity != 0.0))


SURE_REVERSAL = 0.01
"""Least way back that counts as a reversal, over the travel; and at least three encoder steps."""


def _reversals(p: Prepared) -> int:
    """Return how often the joint turns back, by more than the noise of its encoder."""
    angle = joint_angle(p.recording)
    if angle is None:
        angle = np.cumsum(p.raw_velocity) * p.recording.period
    least = max(3.0 * quantum(angle), SURE_REVERSAL * float(np.ptp(angle)))
    count, way, low, high = 0, 0, angle[0], angle[0]
    for value in angle:
        low, high = min(low, value), max(high, value)
        if way <= 0 and value - low > least:
            count, way, high = count + (way < 0), 1, value
        elif way >= 0 and high - value > least:
            count, way, low = count + (way > 0), -1, value
    return count


def _reversals_per_s(prepared: Sequence[Prepared]) -> float:
    """Return the mean number of reversals per second of motion, over all recordings."""
    seconds = sum(int(np.count_nonzero(p.raw_velocity)) * p.recording.period for p in prepared)
    return sum(map(_reversals, prepared)) / seconds if seconds > 0.0 else 0.0


def require_motion(prepared: Sequence[Prepared]) -> None:
    """Check that a stage has moving samples with nonzero torque."""
    moving = [_moving(p) for p in prepared]
    count = samples_in_motion(prepared)
    names = ", ".join(p.recording.name for p in prepared)
    if count < LEAST_MOTION:
        bandwidth, reversals = prepared[0].bandwidth_Hz, _reversals_per_s(prepared)
        in_motion = sum(int(np.count_nonzero(p.raw_velocity)) for p in prepared)
        rests = "nearly every window of the filter contains rest; choose a greater bandwidth, or"
        if reversals > bandwidth:
            remedy = (
                f"the motion reverses {reversals:.3g} times per second, so that {rests} add "
                "recordings with fewer reversals per second"
            )
        elif in_motion >= LEAST_MOTION:
            remedy = (
                f"the joint moves and rests in turn ({reversals:.2g} reversals per second), so "
                f"that {rests} add recordings in which the joint moves longer without a rest"
            )
        else:
            remedy = "add recordings in which the joint moves longer or further"
        raise RecordingError(
            f"{names}: at a bandwidth of {bandwidth:.3g} Hz, {count} samples are in motion; a fit "
            f"needs at least {LEAST_MOTION} samples in motion: {remedy}"
        )
    if not any(np.any(p.drive_torque[rows]) for p, rows in zip(prepared, moving, strict=True)):
        raise RecordingError(
            f"{names}: the drive's torque is zero at all samples in motion; check which column is "
            "declared as the torque"
        )


def filtered_shape(p: Prepared, omega_s: float, alpha: float) -> Array:
    """Return the filtered sgn(omega) exp(-|omega/omega_s|^alpha), shape (n,)."""
    return p.filter(stribeck_shape(p.raw_velocity, omega_s, alpha))


def filtered_sign(p: Prepared) -> Array:
    """Return sgn(omega), passed through the recording's filter, shape (n,)."""
    return p.filter(np.sign(p.raw_velocity))


def gear_sign(p: Prepared) -> Array:
    """Return |pendulum torque| sgn(omega), passed through the recording's filter, N m, (n,)."""
    return p.filter(p.raw_load * np.sign(p.raw_velocity))


def gear_shape(p: Prepared, omega_s: float, alpha: float) -> Array:
    """Return the filtered |pendulum torque| sgn(omega) exp(-|omega/omega_s|^alpha), N m, (n,)."""
    return p.filter(p.raw_load * stribeck_shape(p.raw_velocity, omega_s, alpha))


def friction_torque(p: Prepared, parameters: Mapping[str, float], alpha: float) -> Array:
    """Return the modelled friction plus offset (eq. 9 + 13), passed through the recording's filter,
    N m, shape (n,).

    Parameters that are absent count as zero.
    """
    q = parameters
    sign = filtered_sign(p)
    total = q.get("Mc", 0.0) * sign + q.get("sigma_2", 0.0) * p.velocity + q.get("offset", 0.0)
    if q.get("Ms", 0.0) > q.get("Mc", 0.0) and q.get("omega_sf", 0.0) > 0.0:
        total = total + (q["Ms"] - q["Mc"]) * filtered_shape(p, q["omega_sf"], alpha)
    if np.any(p.moment != 0.0):
        load = q.get("mu_c", 0.0) * sign + q.get("mu_2", 0.0) * p.velocity
        if q.get("mu_s", 0.0) > q.get("mu_c", 0.0) and q.get("omega_sL", 0.0) > 0.0:
            load = load + (q["mu_s"] - q["mu_c"]) * filtered_shape(p, q["omega_sL"], alpha)
        total = total + p.moment * load
    if "mu_gc" in q and np.any(p.raw_load != 0.0):
        total = total + q["mu_gc"] * gear_sign(p)
        if q.get("mu_gs", 0.0) > q["mu_gc"]:
            total = total + (q["mu_gs"] - q["mu_gc"]) * gear_shape(p, q["omega_sf"], alpha)
    return np.asarray(total)


def model_torque(p: Prepared, parameters: Mapping[str, float], alpha: float) -> Array:
    """Return the torque of the model (eq. 15), N m, shape (n,)."""
    return friction_torque(p, parameters, alpha) + parameters.get("J", 0.0) * p.acceleration


@dataclass(frozen=True)
class Stage:
    """One stage of the equation error: the names of its parameters, and its linear problem.

    The rise dM = Ms - Mc (dmu = mu_s - mu_c) is a coefficient in place of the static level, so that
    its lower bound can be 0.
    """

    name: str  # `unloaded` or `loaded`
    coulomb: str  # Mc or mu_c
    # Ms or mu_s, or None if the model has no static friction above Coulomb friction.
    static: str | None
    speed: str | None  # omega_sf or omega_sL, or None if the model has no Stribeck speed
    others: tuple[str, ...]  # names of the remaining coefficients
    prepared: tuple[Prepared, ...]
    model: Model
    # Parameters from the unloaded stage, which are fixed in the loaded stage.
    known: Mapping[str, float]

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the fitted coefficients in column order.

        ``rise`` is the static less the Coulomb level; ``gear_rise`` is mu_gs less mu_gc.
        """
        fixed = self.model.fixed
        names = [] if self.coulomb in fixed else [self.coulomb]
        names += [] if self.static is None or self.static in fixed else ["rise"]
        return tuple(names + [n for n in self.others if n not in fixed])

    def bounds(self) -> tuple[Array, Array]:
        """Return the least and greatest value of each coefficient in column order.

        Only the offset may be negative. The rise is at most the greatest recorded torque, because a
        joint that moved has overcome its static friction. Without this bound the rise would be
        unbounded if no sample lies on the falling branch of friction.
        """
        low = np.array([-np.inf if name == "offset" else 0.0 for name in self.free])
        high = np.full(len(self.free), np.inf)
        if "rise" in self.free:
            scales = [
                float(np.max(p.moment)) if self.name == "loaded" else 1.0 for p in self.prepared
            ]
            peaks = [
                float(np.max(np.abs(p.torque))) / s
                for p, s in zip(self.prepared, scales, strict=True)
            ]
            high[self.free.index("rise")] = max(*peaks, 1e-300)
        if "gear_rise" in self.free:
            peak = max(float(np.max(np.abs(p.torque))) for p in self.prepared)
            load = max(float(np.max(p.raw_load)) for p in self.prepared)
            high[self.free.index("gear_rise")] = peak / load if load > 0.0 else np.inf
        return low, high

    def speed_range(self) -> tuple[float, float]:
        """Return the range of Stribeck speeds that are tried, rad/s; (1, 1) without one."""
        if self.speed is None:
            return 1.0, 1.0
        if self.speed in self.model.fixed:
            held = float(self.model.fixed[self.speed])
            return held, held
        top = max(float(np.max(np.abs(p.velocity[p.used]), initial=0.0)) for p in self.prepared)
        return LOWEST_SHARE * top, HIGHEST_SHARE * top

    def design(self, omega_s: float) -> Design:
        """Return the linear least-squares problem at one Stribeck speed."""
        alpha, fixed = self.model.alpha, self.model.fixed
        columns: list[list[Array]] = [[] for _ in self.free]
        targets: list[Array] = []
        for p in self.prepared:
            scale = p.moment if self.name == "loaded" else np.ones(len(p.time))
            sign = scale * filtered_sign(p)
            shape = scale * filtered_shape(p, omega_s, alpha)
            basis = {
                "sigma_2": p.velocity,
                "mu_2": scale * p.velocity,
                "J": p.acceleration,
                "offset": np.ones(len(p.time)),
                "rise": shape,
                # If the static level is fixed, a higher Coulomb level reduces the rise by as much
                # as it is higher.
                self.coulomb: sign - shape if self.static in fixed else sign,
            }
            if "mu_gc" in self.free:
                basis["mu_gc"] = gear_sign(p)
            if "gear_rise" in self.free:
                basis["gear_rise"] = gear_shape(p, omega_s, alpha)
            target = p.torque - model_torque(p, self.known, alpha)
            for name in self.others:
                if name in fixed:
                    target = target - fixed[name] * basis[name]
            if self.coulomb in fixed:
                base = sign - shape if self.static in fixed else sign
                target = target - fixed[self.coulomb] * base
            if self.static is not None and self.static in fixed:
                target = target - fixed[self.static] * shape
            targets.append(target[p.used])
            for k, name in enumerate(self.free):
                columns[k].append(basis[name][p.used])
        stack = [np.concatenate(c) for c in columns]
        target = np.concatenate(targets)
        return Design(
            np.column_stack(stack) if stack else np.zeros((len(target), 0)), target, *self.bounds()
        )

    def named(self, omega_s: float, coefficients: Array) -> dict[str, float]:
        """Return the parameters of the stage by name, for coefficients at one Stribeck speed."""
        found = dict(zip(self.free, (float(c) for c in coefficients), strict=True))
        rise, gear_rise = found.pop("rise", None), found.pop("gear_rise", None)
        values = {**{n: float(v) for n, v in self.model.fixed.items() if n in self.names}, **found}
        if self.speed is not None:
            values[self.speed] = omega_s
        if self.static is not None and rise is not None:
            values[self.static] = values[self.coulomb] + rise
        if gear_rise is not None:
            values["mu_gs"] = values["mu_gc"] + gear_rise
        return values

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the stage's parameters."""
        falling = () if self.static is None or self.speed is None else (self.static, self.speed)
        others = ("mu_gs" if name == "gear_rise" else name for name in self.others)
        return (self.coulomb, *falling, *others)


def unloaded_stage(prepared: Sequence[Prepared], model: Model) -> Stage:
    """Return the unloaded stage (eq. 16) with the declared friction model. Its parameters are Mc,
    Ms, omega_sf, sigma_2, J and, if declared, mu_gc, mu_gs and the offset.
    """
    terms = LADDER[model.friction]
    if bears_load(model.friction) and not any(np.any(p.raw_load > 0.0) for p in prepared):
        raise RecordingError(
            f"the friction model {model.friction!r} depends on the torque of a pendulum, but no "
            "unloaded recording with role `fit` has a pendulum; declare the pendulum under "
            "`gravity`"
        )
    gear = [
        {"mu_gc": "mu_gc", "mu_gs": "gear_rise"}[name] for name in terms if name.startswith("mu_g")
    ]
    others = ("sigma_2", "J", *gear, *(("offset",) if "offset" in model.terms else ()))
    static, speed = ("Ms", "omega_sf") if rises(model.friction) else (None, None)
    return Stage("unloaded", "Mc", static, speed, others, tuple(prepared), model, {})


def loaded_stage(prepared: Sequence[Prepared], model: Model, known: Mapping[str, float]) -> Stage:
    """Return the loaded stage (eq. 15) with fixed system parameters: mu_c, mu_s, omega_sL, mu_2.

    Raises:
        RecordingError: A loaded recording has no load.
    """
    if free := [p.recording.name for p in prepared if not np.any(p.moment)]:
        raise RecordingError(
            f"{free[0]}: the recording is loaded, but its contact force is zero; state the mass, "
            "or `stage: unloaded`"
        )
    return Stage(
        "loaded", "mu_c", "mu_s", "omega_sL", ("mu_2",), tuple(prepared), model, dict(known)
    )


GRID = 40  # number of Stribeck speeds that are tried before the bracketed search


@dataclass(frozen=True)
class Solution:
    """Solution of one stage, with the history of its search."""

    omega_s: float  # Stribeck speed of least cost
    coefficients: Array  # linear coefficients at this Stribeck speed, shape (p,)
    cost: float  # sum of squared residuals
    evaluations: int  # number of least-squares solutions
    omega_history: Array  # best omega_s so far after each evaluation, shape (e,)
    coefficient_history: Array  # coefficients at these Stribeck speeds, shape (e, p)
    cost_history: Array  # costs at these Stribeck speeds, shape (e,)


def solve(design: Callable[[float], Design], low: float, high: float) -> Solution:
    """Minimise the cost of ``design(omega_s)`` over its coefficients and over log omega_s.

    Args:
        design: Function of omega_s that returns the remaining linear problem.
        low: Least omega_s that is tried, rad/s.
        high: Greatest omega_s that is tried, rad/s; equal to ``low`` to keep omega_s fixed.
    """
    tried: list[tuple[float, float, Array]] = []

    def cost(log_omega: float) -> float:
        omega_s = float(np.exp(log_omega))
        coefficients, value = bounded_least_squares(design(omega_s))
        if not tried or value < tried[-1][0]:
            tried.append((value, omega_s, coefficients))
        else:
            tried.append(tried[-1])
        return value

    if low == high:
        cost(float(np.log(low)))
    else:
        grid = np.linspace(np.log(low), np.log(high), GRID)
        costs = [cost(float(g)) for g in grid]
        k = int(np.argmin(costs))
        bracket = (grid[max(k - 1, 0)], grid[min(k + 1, GRID - 1)])
        optimize.minimize_scalar(cost, bounds=bracket, method="bounded", options={"xatol": 1e-9})
    best = tried[-1]
    return Solution(
        omega_s=best[1],
        coefficients=best[2],
        cost=best[0],
        evaluations=len(tried),
        omega_history=np.array([t[1] for t in tried]),
        coefficient_history=np.array([t[2] for t in tried]),
        cost_history=np.array([t[0] for t in tried]),
    )


BLOCK_CORRELATION_TIMES = 10.0  # ratio of the block length to the correlation time of the residual
LEAST_BLOCKS = 8


def block_sandwich(
    prepared: Sequence[Prepared], values: Mapping[str, float], names: Sequence[str], alpha: float
) -> Spread:
    """Return the sandwich covariance of the parameters ``names`` at ``values`` from all recordings
    jointly, clustered by blocks of time (M10).

    A block is ten correlation times of the residual long, or shorter so that there are at least
    eight blocks, and lies in one recording. The covariance therefore includes model errors that
    differ between blocks (Liang and Zeger, Biometrika 73 (1986) 13).
    """
    if not names:
        return NO_SPREAD
    rows = _linearised(prepared, values, names, alpha)
    return Spread(tuple(names), *_sandwich(rows, rows.residual))


class _Rows(NamedTuple):
    """Derivatives of the torque equation, (n, p), its residual, (n,), and the block of each row."""

    jacobian: Array
    residual: Array
    owner: IntArray


def _linearised(
    prepared: Sequence[Prepared],
    values: Mapping[str, float],
    names: Sequence[str],
    alpha: float,
    others: Sequence[Array] = (),
) -> _Rows:
    """Return the rows of all recordings; ``others`` holds one more column for each recording."""
    jacobians: list[Array] = []
    residuals: list[Array] = []
    owners: list[IntArray] = []
    blocks = 0
    total = sum(int(np.sum(p.used)) for p in prepared)
    for k, p in enumerate(prepared):
        used = p.used
        if not np.any(used):
            continue
        here = model_torque(p, values, alpha)
        residual = (p.torque - here)[used]
        columns = []
        for name in names:
            step = 1e-5 * max(abs(values[name]), 1e-9)
            columns.append(
                (model_torque(p, {**values, name: values[name] + step}, alpha) - here)[used] / step
            )
        columns += [others[k][used]] if others else []
        length = max(1, round(BLOCK_CORRELATION_TIMES * correlation_samples(residual)))
        length = max(1, min(length, total // LEAST_BLOCKS))
        count = max(1, round(len(residual) / length))
        owners.append(
            blocks
            + np.minimum(np.arange(len(residual)) * count // max(len(residual), 1), count - 1)
        )
        blocks += count
        jacobians.append(np.column_stack(columns))
        residuals.append(residual)
    return _Rows(np.concatenate(jacobians), np.concatenate(residuals), np.concatenate(owners))


def _sandwich(rows: _Rows, residual: Array) -> tuple[Array, float]:
    """Return the covariance of all columns, clustered by blocks, and its degrees of freedom."""
    blocks, count = int(rows.owner[-1]) + 1, rows.jacobian.shape[1]
    scaled, scale = unit_columns(rows.jacobian)
    blind = ~np.any(scaled, axis=0)
    bread = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    scores = np.zeros((blocks, count))
    np.add.at(scores, rows.owner, scaled * residual[:, None])
    freedom = max(blocks - count, 3)
    covariance = bread @ (scores.T @ scores) @ bread * blocks / freedom / np.outer(scale, scale)
    covariance[blind, :] = covariance[:, blind] = 0.0
    covariance[blind, blind] = math.inf
    return covariance, float(freedom)


SURE_MEAN, NEAR_MEAN = 0.1, 0.25
"""Greatest standard error of the measured shift of the drive channel, and greatest distance from
half a period, both in half periods, at which a warning states the shift.
"""


def averaging(
    prepared: Sequence[Prepared], values: Mapping[str, float], names: Sequence[str], alpha: float
) -> tuple[str, ...]:
    """Return a warning if the recordings show that the samples of the torque or current are means
    over the sample period although the recordings state instants, or the reverse.

    The mean over the period that ends at a sample is the value half a period earlier. The shift of
    the drive's torque is fitted as one more parameter, with the covariance of
    :func:`block_sandwich`.
    """
    drives = {
        next((c for c in ("torque", "current") if c in p.recording.channels), "") for p in prepared
    }
    (name, *others) = drives
    stated = {name in p.recording.averaged for p in prepared}
    if not name or others or len(stated) > 1 or not names:
        return ()
    shifts = []
    for p in prepared:
        other = replace(p.recording, averaged=p.recording.averaged ^ {name})
        shifts.append(p.torque - prepare(other, p.bandwidth_Hz).torque)
    rows = _linearised(prepared, values, names, alpha, shifts)
    even, scale = unit_columns(rows.jacobian)
    if not np.any(even[:, -1]):
        return ()
    step = np.linalg.lstsq(even, rows.residual)[0] / scale
    covariance, _ = _sandwich(rows, rows.residual - rows.jacobian @ step)
    shift, error = float(step[-1]), math.sqrt(max(float(covariance[-1, -1]), 0.0))
    if error > SURE_MEAN or abs(shift - 1.0) > NEAR_MEAN:
        return ()
    found, key = (
        ("values at its time", "false")
        if stated.pop()
        else ("means over the period that ends at its time", "true")
    )
    return (
        f"`{name}`: by the recordings its samples are {found} (measured shift {shift:.2f} +- "
        f"{1.645 * error:.2f} of the half period between the two): if this is so, state "
        f"`average: {key}` at the channel; J and sigma_2 depend on it, and their intervals do not "
        "include it",
    )


SPEED_CELLS, ACCELERATION_CELLS = 8, 4
"""Numbers of ranges of speed and acceleration in which a model discrepancy is constant."""


def discrepancy(
    prepared: Sequence[Prepared],
    values: Mapping[str, float],
    names: Sequence[str],
    alpha: float,
    rms: float,
    noise: float,
) -> Array:
    """Return the covariance of the parameters ``names`` due to a torque that the model lacks (M52),
    shape (p, p).

    The missing torque is an unknown function of speed, acceleration and load. It repeats with the
    motion, so that no repetition averages it, and least squares hide the part of it that the
    parameters can imitate. It counts as random with the expectation zero, constant in each cell of
    speed, acceleration and load, independent between cells, and as large in each cell as the
    residual without its noise, at least ``rms`` (model discrepancy: Kennedy and O'Hagan, Journal of
    the Royal Statistical Society B 63 (2001) 425).

    ``rms``: rms of the residual beyond its noise, N m or N. ``noise``: rms of the noise, N m or N.
    """
    here = [p for p in prepared if np.any(p.used)]
    rows = _linearised(here, values, names, alpha)
    scaled, scale = unit_columns(rows.jacobian)
    bread = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    loads = np.concatenate([np.full(int(np.sum(p.used)), np.median(p.moment)) for p in here])
    cells = np.unique(loads, return_inverse=True)[1]
    for signal, count in (("velocity", SPEED_CELLS), ("acceleration", ACCELERATION_CELLS)):
        series = np.concatenate([getattr(p, signal)[p.used] for p in here])
        edges = np.quantile(series, np.linspace(0.0, 1.0, count + 1)[1:-1])
        cells = cells * count + np.searchsorted(edges, series)
    number = int(np.max(cells)) + 1
    squares = np.bincount(cells, rows.residual**2, number) / np.maximum(np.bincount(cells), 1)
    sums = np.zeros((number, len(names)))
    np.add.at(sums, cells, scaled)
    reach = sums @ bread / scale
    missing = np.maximum(squares - noise**2, rms**2)
    return np.asarray((reach * missing[:, None]).T @ reach)


INPUTS = ("command", "feedforward", "load_force")
SAME = 2e-3
"""Greatest difference of inputs that count as equal, as a share of the range of each input."""
LEAST_CORRELATION = 0.95  # least autocorrelation of the command at a lag that counts as its period
NEAR, ROWS = 0.05, 2000
"""Range of lags around the first high autocorrelation, over its lag, and samples compared."""
NEIGHBOURS = 0.02  # share of the period, or repeat, over which inputs must be equal around a sample
LEAST_SAMPLES = 100


@dataclass(frozen=True)
class Floor:
    """Torque noise floor: the least torque error that any model of these recordings can have."""

    rms: float  # rms of the floor, in the unit of the fit
    samples: int  # number of pairs of samples used
    periods: int  # number of pairs of periods within recordings used
    repeats: int  # number of pairs of recordings used


def noise_floor(
    prepared: Sequence[Prepared], values: Mapping[str, float], alpha: float
) -> Floor | None:
    """Return the floor from periods within recordings and from repeated recordings, or None if no
    motion is repeated.

    ``values``: parameters of a fit; the repeating part of the fit's error cancels where the
    residuals of two periods, or of two recordings of one motion, are subtracted.
    """
    residuals = {id(p): p.torque - model_torque(p, values, alpha) for p in prepared}
    total = samples = 0.0
    periods = repeats = 0
    for p in prepared:
        lag = command_period(p.recording)
        if lag is None:
            continue
        share, count = _difference(p, p, lag, residuals, lag)
        total, samples, periods = total + share, samples + count, periods + (count > 0)
    for k, p in enumerate(prepared):
        other = next((q for q in prepared[k + 1 :] if _same_rig(p.recording, q.recording)), None)
        if other is None:
            continue
        shift = float(other.recording.time[0] - p.recording.time[0])
        share, count = _difference(p, other, shift, residuals, float(np.ptp(p.recording.time)))
        total, samples, repeats = total + share, samples + count, repeats + (count > 0)
    if samples < LEAST_SAMPLES:
        return None
    scale = volts_per_torque(prepared[0].recording) or 1.0
    return Floor(scale * math.sqrt(0.5 * total / samples), int(samples), periods, repeats)


def command_period(recording: Recording) -> float | None:
    """Return the period of the command, s, or None if the command does not repeat."""
    if "command" not in recording.channels:
        return None
    series = resample(recording.time, recording.channels["command"], uniform_grid(recording))
    centred = series - np.mean(series)
    n = len(centred)
    if not np.any(centred):
        return None
    size = 1 << (2 * n - 1).bit_length()
    product = np.fft.irfft(np.abs(np.fft.rfft(centred, size)) ** 2, size)[:n]
    power = np.concatenate(([0.0], np.cumsum(centred**2)))
    lags = np.arange(n)
    scale = np.sqrt((power[n - lags]) * (power[n] - power[lags]))
    correlation = np.divide(product, scale, out=np.zeros(n), where=scale > 1e-12 * power[n])[
        : n // 2 + 1
    ]
    away = np.flatnonzero(correlation < 0.5)
    if away.size == 0:
        return None
    peak = float(np.max(correlation[away[0] :]))
    if peak < LEAST_CORRELATION:
        return None
    # The autocorrelation has peaks of equal height at all multiples of the period; the first peak
    # is the period.
    first = int(away[0] + np.argmax(correlation[away[0] :] > peak - 0.005))
    return _sharpened(series, first) * recording.period


def _sharpened(series: Array, lag: int) -> int:
    """Return the lag near ``lag`` at which the greatest part of the series repeats."""
    reach = max(round(NEAR * lag), 1)
    lags = np.arange(max(lag - reach, 1), min(lag + reach, len(series) - 2) + 1)
    rows = np.arange(0, len(series) - int(lags[-1]), max(len(series) // ROWS, 1))
    changes = [float(np.median(np.abs(series[rows + k] - series[rows]))) for k in lags]
    return int(lags[int(np.argmin(changes))])


def _same_rig(one: Recording, other: Recording) -> bool:
    return (
        one.stage == other.stage
        and one.weight_mass == other.weight_mass
        and one.pendulum == other.pendulum
        and one.bench == other.bench
        and one.hoist == other.hoist
        and one.constant_torque == other.constant_torque
        and one.controller == other.controller
        and "command" in one.channels
        and "command" in other.channels
    )


def _difference(
    p: Prepared, q: Prepared, shift: float, residuals: Mapping[int, Array], span: float
) -> tuple[float, int]:
    """Return sum and number of squared residual differences where the inputs are equal."""
    later = p.time + shift
    inside = (later >= q.time[0]) & (later <= q.time[-1])
    moving = p.used & (np.interp(later, q.time, q.used.astype(np.float64)) > 0.999)
    both = inside & moving & _equal_inputs(p, q, later, span)
    error = residuals[id(p)] - np.interp(later, q.time, residuals[id(q)])
    return float(np.sum(error[both] ** 2)), int(np.sum(both))


def _equal_inputs(p: Prepared, q: Prepared, later: Array, span: float) -> BoolArray:
    equal = np.ones(len(p.time), dtype=bool)
    for name in INPUTS:
        ours, theirs = p.recording.channels.get(name), q.recording.channels.get(name)
        if ours is None and theirs is None:
            continue
        if ours is None or theirs is None:
            return np.zeros(len(p.time), dtype=bool)
        here = np.interp(p.time, p.recording.time, ours)
        there = np.interp(later, q.recording.time, theirs)
        equal &= np.abs(here - there) <= SAME * max(float(np.ptp(ours)), 1e-300)
    step = float(p.time[1] - p.time[0]) if len(p.time) > 1 else 1.0
    reach = max(round(NEIGHBOURS * span / step), 1)
    others = np.concatenate(([0], np.cumsum(~equal)))
    place = np.arange(len(equal))
    first, last = np.maximum(place - reach, 0), np.minimum(place + reach + 1, len(equal))
    return np.asarray(others[last] == others[first])


LEAST_S = 0.4  # shortest interval of constant commanded speed that is used
SETTLING_SHARE = 0.4
"""Share of each interval that is omitted at the start, while the joint accelerates."""
SMOOTHING_S = 0.02
"""Averaging time of the speed, s: removes the effect of encoder steps, but not slips."""
UNIFORM = 0.2
"""Greatest spread of the speed, rms relative to the mean, that counts as uniform motion."""
_SPEED_UNIT = 1e-9  # rad per sample: commanded speeds count as equal if they differ by less
_LEAST_SPEEDS = 4  # distinct speeds, as many as a curve has parameters
_DIGITS = 6  # decimals of a speed in rad/s; speeds count as equal if they agree in these decimals


@dataclass(frozen=True)
class UniformPoint:
    """One interval of constant commanded speed."""

    recording: str
    speed: float  # commanded speed with sign, rad/s
    torque: float  # mean torque of the motor at the joint, N m
    # Rms deviation of the measured speed from its mean, relative to the commanded speed.
    spread: float
    moment: float  # contact moment F_P L1, N m

    @property
    def uniform(self) -> bool:
        """Whether the joint moved uniformly, as the method assumes."""
        return self.spread <= UNIFORM

    @property
    def friction(self) -> float:
        """Friction at the commanded speed by eq. 14, in the direction of motion, N m."""
        return self.torque if self.speed > 0.0 else -self.torque


def uniform_points(recording: Recording) -> list[UniformPoint]:
    """Return a point for each interval of constant commanded speed."""
    channels = recording.channels
    steps = np.diff(channels["command"])
    ends = np.flatnonzero(np.abs(np.diff(steps)) > _SPEED_UNIT) + 1
    bounds = [0, *ends.tolist(), len(steps)]
    period = recording.period
    angle = channels["angle"]
    torque = (
        channels["torque"]
        if "torque" in channels
        else recording.bench.ampere_torque * channels["current"]
    )
    n = max(1, round(SMOOTHING_S / period))
    found = []
    for start, end in itertools.pairwise(bounds):
        speed = float(np.mean(steps[start:end])) / period
        if abs(speed) * period < _SPEED_UNIT or (end - start) * period < LEAST_S:
            continue
        first = start + round(SETTLING_SHARE * (end - start))
        measured = (angle[first + n : end] - angle[first : end - n]) / (n * period)
        found.append(
            UniformPoint(
                recording.name,
                speed,
                float(np.mean(torque[first:end])),
                float(np.sqrt(np.mean((measured - speed) ** 2)) / abs(speed)),
                recording.contact_force * (recording.bench.moment_arm or 0.0),
            )
        )
    return found


def fit_uniform(points: Sequence[UniformPoint], alpha: float = 2.0) -> dict[str, float]:
    """Fit eq. 9 to the unloaded points, then the bracket of eq. 12 to the loaded points.

    Returns:
        Parameter name to value; the parameters of a stage with fewer speeds than parameters are
        omitted.
    """
    unloaded = [p for p in points if p.moment == 0.0]
    loaded = [p for p in points if p.moment > 0.0]
    if _distinct(unloaded) < _LEAST_SPEEDS:
        return {}
    found = _fit(
        _speeds(unloaded), np.array([p.friction for p in unloaded]), np.ones(len(unloaded)), alpha
    )
    system = dict(zip(("Mc", "Ms", "omega_sf", "sigma_2"), found, strict=True))
    if _distinct(loaded) < _LEAST_SPEEDS:
        return system
    rest = np.array([p.friction for p in loaded]) - system_friction(_speeds(loaded), system, alpha)
    load = _fit(_speeds(loaded), rest, np.array([p.moment for p in loaded]), alpha)
    return {**system, **dict(zip(("mu_c", "mu_s", "omega_sL", "mu_2"), load, strict=True))}


def errors_percent(found: Mapping[str, float], truth: Mapping[str, float]) -> dict[str, float]:
    """Return the error of each estimated parameter in percent of the true value."""
    return {name: 100.0 * (value / truth[name] - 1.0) for name, value in found.items()}


def _distinct(points: Sequence[UniformPoint]) -> int:
    return len({round(abs(p.speed), _DIGITS) for p in points})


def _speeds(points: Sequence[UniformPoint]) -> Array:
    return np.array([abs(p.speed) for p in points])


def _fit(
    speed: Array, friction: Array, scale: Array, alpha: float
) -> tuple[float, float, float, float]:
    """Return Mc, Ms, Stribeck speed and viscous coefficient (or mu) fitted to points."""
    low = np.zeros(3)
    high = np.array([np.inf, 2.0 * float(np.max(np.abs(friction / scale))), np.inf])

    def design(omega_s: float) -> Design:
        columns = np.column_stack(
            [np.ones_like(speed), stribeck_shape(speed, omega_s, alpha), speed]
        )
        return Design(columns * scale[:, None], friction, low, high)

    best = solve(design, 0.5 * float(np.min(speed)), 2.0 * float(np.max(speed)))
    coulomb, rise, viscous = (float(c) for c in best.coefficients)
    return coulomb, coulomb + rise, best.omega_s, viscous
