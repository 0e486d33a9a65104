"""Computes the parameter table with values, intervals and reasons for withheld values (M43), and
the fit errors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from identification.estimate.equation_error.regression import (
    HIGHEST_SHARE,
    LOWEST_SHARE,
    model_torque,
)
from identification.model.parameters import (
    GEAR_PARAMETERS,
    LOAD_PARAMETERS,
    STRIBECK_TERMS,
    SYSTEM_PARAMETERS,
    UNITS_ROTARY,
)
from identification.model.units import unit_on
from identification.numerics.spread import Spread
from identification.prepare import Prepared, torque_unit, volts_per_torque
from identification.recording import Model
from identification.result import Fit, Parameter, Trace

WIDEST = 0.5
"""Ratio of the 90 % interval's half width to the value above which a parameter is not
identifiable.
"""
LEAST_RISE = 1e-3
"""Ratio of the rise to the Coulomb level below which the rise is not identifiable."""


def units_of(prepared: Sequence[Prepared]) -> dict[str, str]:
    """Return the unit of each parameter by name; torques are in A if the torque constant is
    unknown.
    """
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
    first = prepared[0]
    volts = volts_per_torque(first.recording)
    rms, relative = _errors(prepared, values, alpha)
    held: tuple[float | None, float | None] = (
        _errors(validate, values, alpha) if validate else (None, None)
    )
    scale = 1.0 if volts is None else volts
    return Fit(
        unit=torque_unit(first.recording) if volts is None else "V",
        bandwidth_Hz=first.bandwidth_Hz,
        train_rms=scale * rms,
        train_relative=relative,
        validate_rms=None if held[0] is None else scale * held[0],
        validate_relative=held[1],
    )


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
) -> dict[str, Parameter]:
    """Return every parameter with its interval and, if known, its floor; a parameter without
    interval has a reason.
    """
    units = units_of(prepared)
    fastest = max(float(np.max(np.abs(p.velocity[p.used]), initial=0.0)) for p in prepared)
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
            table[name] = Parameter(
                name, units[name], None, identifiable=False, at_bound=True, reason=_absent(name)
            )
        else:
            judged = _judge(
                name, units[name], value, spread.half_width(name), fastest, prepared, values
            )
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
    return table


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
    """If the rise is not significant, withhold the static level, and also the Stribeck speed unless
    another rise determines it.
    """
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
            table[name] = Parameter(name, table[name].unit, None, identifiable=False, reason=reason)
    elif table[speed].at_bound and table[static].identifiable:
        reason = f"{static} is the friction at the slow end of the falling part, and for {speed} "
        reason += f"{table[speed].reason}"
        table[static] = Parameter(
            static, table[static].unit, None, identifiable=False, reason=reason
        )


def _absent(name: str) -> str:
    coulomb, static, _ = next(names for names in STRIBECK_TERMS if name in names[1:])
    return (
        f"static friction does not exceed Coulomb friction in these recordings: {static} would "
        f"fall to {coulomb}, its lower bound"
    )


def _judge(
    name: str,
    unit: str,
    value: float,
    half: float,
    fastest: float,
    prepared: Sequence[Prepared],
    values: Mapping[str, float],
) -> Parameter:
    """Return the parameter, with a reason where the data do not determine it."""
    speed = name in ("omega_sf", "omega_sL")
    at_bound = value <= 0.0 if name != "offset" and not speed else False
    if speed:
        at_bound = (
            value >= 0.999 * HIGHEST_SHARE * fastest or value <= 1.001 * LOWEST_SHARE * fastest
        )
    if name == "offset":
        scale = math.sqrt(
            sum(float(np.mean(p.torque[p.used] ** 2)) for p in prepared if np.any(p.used))
        )
        loose = half > 0.1 * scale
    else:
        loose = not half <= WIDEST * abs(value)
    if loose or at_bound:
        return Parameter(
            name,
            unit,
            None,
            identifiable=False,
            at_bound=at_bound,
            reason=_why(name, unit, value, half, at_bound, prepared, values),
        )
    return Parameter(name, unit, value, value - half, value + half)


def _why(
    name: str,
    unit: str,
    value: float,
    half: float,
    at_bound: bool,
    prepared: Sequence[Prepared],
    values: Mapping[str, float],
) -> str:
    """Return the reason why a parameter is not identifiable."""
    if at_bound and name in ("omega_sf", "omega_sL"):
        return (
            f"the search ends at the bound of this parameter, {value:.3g} {unit}: the recordings "
            "do not show the falling part of friction"
        )
    if at_bound:
        return "the best fit would have a value below 0, which is the lower bound"
    suffix = "" if unit == "1" else f" {unit}"
    interval = (
        f"its 90 % interval, {value - half:.3g} to {value + half:.3g}{suffix}, is too wide for "
        "the value to count as identified"
    )
    if name == "J":
        inertia = max(
            float(np.std((values["J"] * p.acceleration)[p.used]))
            for p in prepared
            if np.any(p.used)
        )
        torque = max(float(np.std(p.torque[p.used])) for p in prepared if np.any(p.used))
        return f"J domega/dt is only {100.0 * inertia / torque:.2g} % of the torque, and {interval}"
    return interval
