"""Computes the parameter table: values, intervals, reasons for withheld values (M43), errors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.estimate.equation_error import (
    HIGHEST_SHARE,
    LEAST_SAMPLES,
    LOWEST_SHARE,
    SAME,
    command_period,
    model_torque,
)
from identification.model.parameters import (
    GEAR_PARAMETERS,
    LOAD_PARAMETERS,
    STRIBECK_TERMS,
    SYSTEM_PARAMETERS,
    UNITS_ROTARY,
    unit_on,
)
from identification.numerics.arrays import Array
from identification.numerics.spread import Spread
from identification.prepare import Prepared, torque_unit, volts_per_torque
from identification.recording import Model, Recording
from identification.result import WIDEST, Fit, Parameter, Trace, Tradeoff
from identification.views.nominal import Nominal
from identification.views.predicted import Predicted, noise_floor, predicted_torque, relative, rms
from identification.views.view import views

OFFSET_SHARE = 0.1
"""Greatest half width of the interval of an identified offset, relative to the rms torque."""
LEAST_RISE = 1e-3  # ratio of the rise to the Coulomb level below which the rise is not identifiable


def units_of(prepared: Sequence[Prepared]) -> dict[str, str]:
    """Return the unit of each parameter; torques are in A without a torque constant."""
    recording = prepared[0].recording
    amperes = torque_unit(recording) == "A"
    motion = recording.bench.motion
    return {name: unit_on(motion, unit, amperes) for name, unit in UNITS_ROTARY.items()}


def fit_of(
    prepared: Sequence[Prepared],
    values: Mapping[str, float],
    alpha: float,
    validate: Sequence[Prepared] = (),
) -> Fit:
    """Return the torque error over the used samples, and over the validation recordings.

    The unit is that of the torque; if only the voltage was measured, the unit is V, and the error
    is the armature voltage R I of the torque error.
    """
    found = _fit(prepared[0], *_errors(prepared, values, alpha))
    if not validate:
        return found
    held = _fit(prepared[0], *_errors(validate, values, alpha))
    return replace(found, validate_rms=held.train_rms, validate_relative=held.train_relative)


def _fit(first: Prepared, rms: float, relative: float) -> Fit:
    """Return an rms torque error and its ratio to the torque, in the unit of the recordings."""
    volts = volts_per_torque(first.recording)
    return Fit(
        unit=torque_unit(first.recording) if volts is None else "V",
        bandwidth_Hz=first.bandwidth_Hz,
        train_rms=(1.0 if volts is None else volts) * rms,
        train_relative=relative,
        validate_rms=None,
        validate_relative=None,
    )


def printed_fit(
    prepared: Sequence[Prepared], cut: bool, values: Mapping[str, float], alpha: float
) -> tuple[Fit, dict[str, Fit]]:
    """Return the torque error as every command prints it (:mod:`identification.views.predicted`),
    over all recordings, with the noise floor, and over each recording.

    Without a sample in steady motion the error is that of the rows of the fit.

    ``prepared``: all recordings, or all pieces of them. ``cut``: whether the recordings are cut
    into pieces, which are processed one by one.
    """
    nominal, bandwidth = Nominal(values, (), alpha), prepared[0].bandwidth_Hz
    every = [p.recording for p in prepared if p.recording.role in ("fit", "validate")]
    seen = [
        view
        for group in ([[r] for r in every] if cut else [every])
        for view in views(group, bandwidth)
    ]
    parts = [predicted_torque(view, nominal) for view in seen]
    fitted = [p for p in prepared if p.recording.role == "fit"]
    whole = _printed([p for p in parts if p.role == "fit"], prepared[0])
    held = _printed([p for p in parts if p.role == "validate"], prepared[0])
    whole = whole or fit_of(fitted, values, alpha)
    differences = noise_floor([p for p in parts if p.role == "fit"], seen[0].low_pass)
    if differences is not None:
        pairs = [(v.recording, p) for v, p in zip(seen, parts, strict=True) if p.role == "fit"]
        floor = max(differences, _unrepeated(pairs))
        volts = volts_per_torque(fitted[0].recording) or 1.0
        whole = replace(whole, noise_floor_rms=volts * floor)
    if held is not None:
        whole = replace(whole, validate_rms=held.train_rms, validate_relative=held.train_relative)
    each = {}
    for name in dict.fromkeys(p.recording.name for p in prepared):
        own = _printed([part for part in parts if part.recording == name], prepared[0])
        each[name] = own or fit_of([p for p in prepared if p.recording.name == name], values, alpha)
    return whole, each


def _unrepeated(pairs: Sequence[tuple[Recording, Predicted]]) -> float:
    """Return the rms of errors that differ between periods of a command, over sqrt(2); or 0."""
    squares, count = 0.0, 0
    for recording, part in pairs:
        lag = command_period(recording)
        if lag is None:
            continue
        error, when, command = part.measured - part.model, part.time, recording.channels["command"]
        here, there = (np.interp(t, recording.time, command) for t in (when, when + lag))
        change = error - np.interp(when + lag, when, error, right=math.nan)
        known = np.isfinite(change) & (np.abs(here - there) <= SAME * float(np.ptp(command)))
        squares, count = squares + float(np.sum(change[known] ** 2)), count + int(np.sum(known))
    return math.sqrt(0.5 * squares / count) if count >= LEAST_SAMPLES else 0.0


def _printed(parts: Sequence[Predicted], first: Prepared) -> Fit | None:
    """Return the error of some recordings, or None without a sample."""
    error = rms(parts)
    return None if error is None else _fit(first, error, relative(parts) or 0.0)


def typical_error(prepared: Sequence[Prepared], values: Mapping[str, float], alpha: float) -> float:
    """Return the geometric mean over the recordings of their rms torque errors, N m or N.

    The size of the error differs between recordings: a recording whose motion is too fast for the
    bandwidth has an error many times that of other recordings. In the geometric mean all recordings
    have equal weight, whatever their length and error.
    """
    errors = [_errors([p], values, alpha)[0] for p in prepared if np.any(p.used)]
    return math.exp(math.fsum(math.log(max(e, 1e-300)) for e in errors) / max(len(errors), 1))


def _errors(
    prepared: Sequence[Prepared], values: Mapping[str, float], alpha: float
) -> tuple[float, float]:
    """Return the rms torque error over the used samples, and its ratio to the rms drive torque."""
    error = torque = 0.0
    count = 0
    for p in prepared:
        used = p.used
        residual = (p.torque - model_torque(p, values, alpha))[used]
        error += float(residual @ residual)
        torque += float(p.drive_torque[used] @ p.drive_torque[used])
        count += int(np.sum(used))
    return math.sqrt(error / max(count, 1)), math.sqrt(error / torque) if torque > 0.0 else 0.0


def trace_of(p: Prepared, values: Mapping[str, float], alpha: float) -> Trace:
    """Return the signals of one recording as used in the fit."""
    return Trace(
        recording=p.recording.name,
        role=p.recording.role,
        stage=p.recording.stage,
        time=p.time,
        angle=p.angle,
        velocity=p.velocity,
        torque=p.torque,
        torque_model=model_torque(p, values, alpha),
        friction=np.asarray(p.torque - values.get("J", 0.0) * p.acceleration),
        used=p.used,
    )


def parameter_table(
    prepared: Sequence[Prepared],
    values: Mapping[str, float],
    spread: Spread,
    model: Model,
    floors: Mapping[str, float],
    discrepant: bool = False,
) -> dict[str, Parameter]:
    """Return every parameter with its interval and, if known, its floor; a parameter without
    interval has a reason.

    ``floors``: name to the least half width by the Cramer-Rao bound. ``discrepant``: whether the
    equation error leaves a torque that the model lacks. A static level whose Stribeck speed is not
    identifiable is then withheld: it is an extrapolation.
    """
    units = units_of(prepared)
    table: dict[str, Parameter] = {}
    order = [
        n for n in (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS, *GEAR_PARAMETERS, "offset") if n in values
    ]
    for name in order:
        value = values[name]
        if name in model.fixed:
            table[name] = Parameter(
                name, units[name], value, value, value, reason="fixed in the campaign, not fitted"
            )
        elif name not in spread.names:
            coulomb, static, _ = next(terms for terms in STRIBECK_TERMS if name in terms[1:])
            reason = (
                f"static friction does not exceed Coulomb friction in these recordings: {static} "
                f"would fall to {coulomb}, its lower bound"
            )
            table[name] = _withheld(name, units[name], reason, at_bound=True)
        else:
            judged = _judge(name, units[name], spread.half_width(name), prepared, values)
            table[name] = replace(judged, floor=floors.get(name))
    seen = {
        names
        for names in STRIBECK_TERMS
        if names[1] in spread.names and _rise_is_seen(names, values, spread)
    }
    for names in STRIBECK_TERMS:
        if names[1] in spread.names:
            shared = any(other[2] == names[2] for other in seen - {names})
            _judge_rise(table, names, values, spread, keep_speed=shared)
            level, speed = table[names[1]], table[names[2]]
            if discrepant and level.identifiable and not speed.identifiable:
                reason = f"{level.name} is extrapolated with {speed.name}: {speed.reason}"
                table[level.name] = _withheld(level.name, level.unit, reason)
    return table


def widened(table: Mapping[str, Parameter], spread: Spread) -> dict[str, Parameter]:
    """Return the parameters with the intervals of another covariance where these are wider."""
    out = dict(table)
    for name, p in table.items():
        if p.value is None or p.low is None or p.high is None or name not in spread.names:
            continue
        half = spread.half_width(name)
        out[name] = replace(p, low=min(p.low, p.value - half), high=max(p.high, p.value + half))
    return out


def _rise_is_seen(names: tuple[str, str, str], values: Mapping[str, float], spread: Spread) -> bool:
    coulomb, static, _ = names
    half = spread.half_width_above(static, coulomb)
    return values[static] - values[coulomb] >= max(half, LEAST_RISE * values[coulomb])


def _judge_rise(
    table: dict[str, Parameter],
    names: tuple[str, str, str],
    values: Mapping[str, float],
    spread: Spread,
    *,
    keep_speed: bool,
) -> None:
    """Withhold a static level, and its Stribeck speed, if the rise is not significant."""
    coulomb, static, speed = names
    rise, half = values[static] - values[coulomb], spread.half_width_above(static, coulomb)
    if not _rise_is_seen(names, values, spread):
        unit = "" if table[static].unit == "1" else f" {table[static].unit}"
        reason = (
            f"the rise from Coulomb to static friction, {rise:.2g} +- {half:.2g}{unit}, is not "
            "significant in these recordings"
        )
        withheld = (static,) if keep_speed else (static, speed)
        for name in (n for n in withheld if n in spread.names and table[n].identifiable):
            table[name] = _withheld(name, table[name].unit, reason)
    elif table[speed].at_bound and table[static].identifiable:
        reason = f"{static} is the friction at the slow end of the falling part, and for {speed} "
        reason += f"{table[speed].reason}"
        table[static] = _withheld(static, table[static].unit, reason)


def _withheld(name: str, unit: str, reason: str, at_bound: bool = False) -> Parameter:
    return Parameter(name, unit, None, identifiable=False, at_bound=at_bound, reason=reason)


def _judge(
    name: str, unit: str, half: float, prepared: Sequence[Prepared], values: Mapping[str, float]
) -> Parameter:
    """Return the parameter, with a reason where the data do not determine it."""
    value, moving = values[name], [p for p in prepared if np.any(p.used)]
    if name in ("omega_sf", "omega_sL"):
        fastest = max(float(np.max(np.abs(p.velocity[p.used]), initial=0.0)) for p in prepared)
        if value >= 0.999 * HIGHEST_SHARE * fastest or value <= 1.001 * LOWEST_SHARE * fastest:
            reason = (
                f"the search ends at the bound of this parameter, {value:.3g} {unit}: the "
                "recordings do not show the falling part of friction"
            )
            return _withheld(name, unit, reason, at_bound=True)
    elif name != "offset" and value <= 0.0:
        reason = "the best fit would have a value below 0, which is the lower bound"
        return _withheld(name, unit, reason, at_bound=True)
    most, rule = WIDEST * abs(value), f"{100.0 * WIDEST:g} % of the value"
    if name == "offset":
        rms = math.sqrt(sum(float(np.mean(p.torque[p.used] ** 2)) for p in moving))
        most, rule = OFFSET_SHARE * rms, f"{100.0 * OFFSET_SHARE:g} % of the rms torque"
    if half <= most:
        return Parameter(name, unit, value, value - half, value + half)
    suffix = "" if unit == "1" else f" {unit}"
    interval = (
        f"its 90 % interval, {value - half:.3g} to {value + half:.3g}{suffix}, is too wide for "
        f"the value to count as identified: its half width, {half:.3g}{suffix}, exceeds {rule}"
    )
    if name == "J":
        inertia = max(float(np.std(value * p.acceleration[p.used])) for p in moving)
        torque = max(float(np.std(p.torque[p.used])) for p in moving)
        interval = (
            f"J domega/dt is only {100.0 * inertia / torque:.2g} % of the torque, and {interval}"
        )
    return _withheld(name, unit, interval)


TRADE_OFF = 0.9  # least correlation, as a magnitude, at which two parameters count as a trade-off
_SHOWN = 0.3
"""A parameter is listed in a combination if its share is at least this part of the greatest share.
"""

_AT_SPEED = {("Mc", "sigma_2"), ("mu_c", "mu_2")}
"""Pairs (a, b): a + b omega is the friction well above the Stribeck speed (eq. 9 and 13)."""
_AT_LOAD = {("Mc", "mu_c"), ("Ms", "mu_s"), ("sigma_2", "mu_2")}
"""Pairs (a, b) whose sum a + b F_P L1 is the friction under a contact moment F_P L1 (eq. 15)."""


def tradeoffs(
    spread: Spread, values: Mapping[str, float], units: Mapping[str, str]
) -> tuple[Tradeoff, ...]:
    """Return pairs with a correlation of :data:`TRADE_OFF` or more, the highest first."""
    names, correlation = _correlation(spread, values)
    found = []
    for j, first in enumerate(names):
        for k in range(j + 1, len(names)):
            rho = float(correlation[j, k])
            if abs(rho) >= TRADE_OFF:
                second = names[k]
                pinned = _pinned(first, second, spread, values, units)
                words = (
                    f"the errors of {first} and {second} depend on each other (correlation "
                    f"{rho:+.3f}): {pinned}"
                )
                found.append(Tradeoff((first, second), rho, words))
    return tuple(sorted(found, key=lambda pair: -abs(pair.correlation)))


def least_pinned(spread: Spread, values: Mapping[str, float]) -> str:
    """Return a text with the least determined combination of relative changes of the parameters;
    empty if no parameter was fitted.

    The least determined combination is the eigenvector of the relative covariance with the greatest
    eigenvalue.
    """
    names, correlation = _correlation(spread, values)
    if not names:
        return ""
    variance = dict(zip(spread.names, np.diag(spread.matrix), strict=True))
    relative = np.array([math.sqrt(variance[n]) / abs(values[n]) for n in names])
    shares, vectors = np.linalg.eigh(correlation * np.outer(relative, relative))
    vector = vectors[:, -1] / vectors[np.argmax(np.abs(vectors[:, -1])), -1]
    shown = [(names[k], vector[k]) for k in np.argsort(-np.abs(vector)) if abs(vector[k]) >= _SHOWN]
    changes = [f"{name} by {share:+.2g} %" for name, share in shown]
    where = (
        f"{shown[0][0]} alone" if len(shown) == 1 else f"the combination {' with '.join(changes)}"
    )
    upper = np.triu(np.abs(correlation), 1)
    line = (
        f"least accurate is {where}, with a standard deviation of "
        f"{100.0 * math.sqrt(max(shares[-1], 0.0)):.2g} %"
    )
    if len(names) > 1:
        j, k = np.unravel_index(int(np.argmax(upper)), upper.shape)
        line += (
            f"; the errors that depend most on each other are those of {names[j]} and {names[k]}, "
            f"with a correlation of {correlation[j, k]:+.2f}"
        )
    return line


def _correlation(spread: Spread, values: Mapping[str, float]) -> tuple[list[str], Array]:
    """Return the names whose variance is finite and above 0, and their correlations."""
    variance = np.diag(spread.matrix)
    kept = [
        k for k, n in enumerate(spread.names) if 0.0 < variance[k] < math.inf and values[n] != 0.0
    ]
    deviation = np.sqrt(variance[kept])
    return [spread.names[k] for k in kept], spread.matrix[np.ix_(kept, kept)] / np.outer(
        deviation, deviation
    )


def _pinned(
    a: str, b: str, spread: Spread, values: Mapping[str, float], units: Mapping[str, str]
) -> str:
    """Return a text with the combination of two parameters that has the least variance."""
    j, k = spread.names.index(a), spread.names.index(b)
    c = spread.matrix
    weight = -float(c[j, k] / c[k, k])
    if weight > 0.0 and ((a, b) in _AT_SPEED or (a, b) in _AT_LOAD):
        total = values[a] + weight * values[b]
        half = spread.half_width_along({a: 1.0, b: weight})
        unit = "" if units[a] == "1" else f" {units[a]}"
        scale = "rad/s" if units["omega_sf"].endswith("rad/s") else "m/s"
        at = (
            f"{weight:.3g} {scale}"
            if (a, b) in _AT_SPEED
            else f"a contact moment of {weight:.3g} {units['Mc']}"
        )
        return (
            f"only their sum at {at} is determined, {a} + {weight:.3g} {b} = {total:.5g} +- "
            f"{half:.2g}{unit}"
        )
    power = -float(c[j, k] / c[k, k] * values[b] / values[a])
    half = 100.0 * spread.half_width_along({a: 1.0 / values[a], b: power / values[b]})
    kind, shown = (
        ("product", f"{a} {b}^{power:.2g}") if power > 0.0 else ("ratio", f"{a} / {b}^{-power:.2g}")
    )
    return f"only the {kind} {shown} is determined, to {half:.2g} %"
