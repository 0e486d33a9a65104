"""Checks the channels of a recording for plausible sizes, units and mutual signs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import cast

import numpy as np

from identification.recording import CHANNELS, Array

BLOCK_S = 0.02
"""Time over which samples are averaged before the check of signs, s, against quantisation."""
OPPOSED = -0.3
"""Correlation of torque and velocity in motion below which the signs count as opposite."""
LARGEST, SMALLEST = 1e12, 1e-12
"""Greatest plausible magnitude of a channel, and least of one of drive or motion, SI units."""
_MOVING = frozenset({"torque", "current", "voltage", "angle", "motor_angle", "velocity"})
UNRELATED = 0.5
"""Ratio of the mean square step of a position to twice its variance above which neighbouring
samples count as unrelated. The ratio is 1 for rows in random order and for noise, and smaller for a
sine with a frequency up to a sixth of the sample rate.
"""
STILL_LEVELS = 8
"""Greatest number of values of a position at rest, where an encoder may flicker between counts."""
LARGE_CURRENT_A, LARGE_VOLTAGE_V = 500.0, 2000.0
"""Peak of each channel above which a note suggests that its unit is a thousandth of the SI unit."""
RELATED = 0.9  # least magnitude of the correlation of two angles of one motion
RATIO_TOLERANCE = 0.05
"""Relative deviation of the measured from the declared gear ratio above which a note results."""


def findings(
    channels: Mapping[str, Array],
    gear_ratio: float | None,
    *,
    driven_by_weight: bool,
    has_lever: bool,
) -> tuple[list[str], list[str]]:
    """Return errors and notes on the channels of a recording.

    Args:
        channels: Canonical channels in SI units, shape (n,); time increasing.
        gear_ratio: Gear ratio of the bench; None if it is unknown, so that motor and joint cannot
            be compared.
        driven_by_weight: Whether a weight that turns with the joint is declared.
        has_lever: Whether the joint carries a lever, which cannot turn round.
    """
    gear = 1.0 if gear_ratio is None else gear_ratio
    problems, notes = list(value_errors(channels)), list[str]()
    if not problems:
        problems += _sign_errors(channels, driven_by_weight=driven_by_weight)
        notes += unit_hints(channels, gear, has_lever=has_lever)
        notes += doubts(channels, gear, driven_by_weight=driven_by_weight)
    if gear_ratio is not None and "motor_angle" in channels and "angle" in channels:
        found = _gear_finding(channels["motor_angle"], channels["angle"], gear)
        if found is not None:
            (problems if found[1] else notes).append(found[0])
    return problems, notes


def _sign_errors(channels: Mapping[str, Array], *, driven_by_weight: bool) -> Iterator[str]:
    """Yield an error for each pair of channels with opposite sign conventions.

    Over a whole recording friction takes energy from the motor, so torque and velocity must
    correlate positively, unless a turning weight drives the joint.
    """
    time = channels["time"]
    position = "angle" if "angle" in channels else "motor_angle"
    block = max(1, min(round(BLOCK_S / float(np.median(np.diff(time)))), len(time) // 2))
    mean = {
        name: _block_mean(channels[name], block)
        for name in ("time", position, "velocity")
        if name in channels
    }
    derived = cast(Array, np.gradient(mean[position], mean["time"])) if position in mean else None
    measured = mean.get("velocity")
    if derived is not None and measured is not None:
        correlation = _correlation(derived, measured, derived)
        if correlation < OPPOSED:
            yield (
                f"`velocity` runs against `{position}` (correlation {correlation:.2f}); negate "
                f"the scale of one of the two channels"
            )
    velocity, mover = (measured, "velocity") if derived is None else (derived, position)
    effort = next((name for name in ("torque", "current", "voltage") if name in channels), None)
    if velocity is None or effort is None or driven_by_weight:
        return
    correlation = _correlation(_block_mean(channels[effort], block), velocity, velocity)
    if correlation < OPPOSED and (other := one_signed(channels[effort])) is not None:
        yield (
            f"`{effort}` opposes the motion (correlation {correlation:.2f} with velocity while "
            f"moving) and keeps one sign ({other} of {len(time)} samples have the other), as a "
            f"magnitude does: {MAGNITUDE}; if in recordings of the other direction it has the "
            f"other sign, its sign convention is opposite to that of `{mover}`"
        )
    elif correlation < OPPOSED:
        yield (
            f"`{effort}` opposes the motion (correlation {correlation:.2f} with velocity while "
            f"moving), as if the load drove the motor: negate the scale of `{effort}` or of "
            f"`{mover}`; a weight that turns with the joint is declared by `gravity`"
        )


MAGNITUDE = (
    "log it with its sign, or map another channel that has one (`torque`, `current` or "
    "`voltage`); `unsigned: true` only declares a magnitude, which is then not used"
)
FEW, SMALL = 0.05, 0.03
"""Greatest share of samples of a magnitude that noise puts below zero, and of their sum."""


def one_signed(values: Array) -> int | None:
    """Return how many samples of a one-signed channel have the other sign; else None."""
    known = values[np.isfinite(values)]
    above, below = known[known > 0], known[known < 0]
    fewer, more = sorted((above, below), key=lambda part: float(np.sum(np.abs(part))))
    few = len(fewer) <= FEW * len(known)
    small = abs(float(np.sum(fewer))) <= SMALL * abs(float(np.sum(more)))
    return len(fewer) if more.size and few and small else None


def value_errors(channels: Mapping[str, Array]) -> Iterator[str]:
    """Yield an error for each channel with impossible values or rows out of order."""
    for name, values in channels.items():
        top = _peak(values)
        if name != "time" and (top > LARGEST or (name in _MOVING and 0.0 < top < SMALLEST)):
            yield f"`{name}` has its peak at {top:.3g} {CHANNELS[name]}; check its scale"
    for name in ("angle", "motor_angle"):
        if name in channels and _unrelated(channels[name]):
            yield (
                f"`{name}` jumps from sample to sample as far as over the whole recording: its "
                "rows are out of order, or it contains only noise; sort the rows by time, or "
                "leave the file out"
            )


def unit_hints(
    channels: Mapping[str, Array], gear_ratio: float, *, has_lever: bool
) -> Iterator[str]:
    """Yield a note for each channel whose values suggest another unit."""
    for name, limit, unit in (
        ("current", LARGE_CURRENT_A, "mA"),
        ("voltage", LARGE_VOLTAGE_V, "mV"),
    ):
        if name in channels and (top := _peak(channels[name])) > limit:
            yield (
                f"`{name}` reaches {top:.4g} {CHANNELS[name]}: if it is in {unit}, set its "
                f"scale to 0.001"
            )
    for name, gear in (("angle", 1.0), ("motor_angle", gear_ratio)):
        way = float(np.ptp(channels[name])) if name in channels and has_lever else 0.0
        if (turns := way / (2.0 * np.pi * gear)) > 1.0:
            yield (
                f"`{name}` turns the joint {turns:.3g} times, which a lever with weights cannot: "
                "if it is in degrees, set its scale to 0.017453292519943295"
            )


def _gear_finding(motor_angle: Array, angle: Array, gear_ratio: float) -> tuple[str, bool] | None:
    """Compare motor and joint angle; return None, or a text, and whether it is an error."""
    motor, joint = _finite(motor_angle, angle)
    motor, joint = motor - motor.mean(), joint - joint.mean()
    energy = float(joint @ joint)
    alike = float(motor @ joint) / math.sqrt(max(energy * float(motor @ motor), 1e-300))
    if energy == 0.0 or abs(alike) < RELATED:
        # At rest, the encoders only flicker, which gives no information on their signs.
        return None
    ratio = float(motor @ joint) / energy
    if ratio < 0:
        return "`motor_angle` runs against `angle`; negate the scale of one of the two", True
    if abs(ratio / gear_ratio - 1.0) > RATIO_TOLERANCE:
        return f"motor_angle / angle is {ratio:.4g}, bench.gear_ratio is {gear_ratio:.4g}", False
    return None


def _peak(values: Array) -> float:
    return float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))


def _unrelated(position: Array) -> bool:
    if len(np.unique(position)) <= STILL_LEVELS:
        return False
    spread = float(np.sum((position - position.mean()) ** 2))
    return spread > 0.0 and float(np.sum(np.diff(position) ** 2)) > 2.0 * UNRELATED * spread


def _block_mean(values: Array, block: int) -> Array:
    count = len(values) // block
    return cast(Array, values[: count * block].reshape(count, block).mean(axis=1))


def _correlation(a: Array, b: Array, velocity: Array) -> float:
    """Return sum(a b) / sqrt(sum a^2 sum b^2) over the blocks in motion; 0 without motion."""
    a, b, velocity = _finite(a, b, velocity)
    if not velocity.size:
        return 0.0
    moving = np.abs(velocity) > 0.05 * np.abs(velocity).max()
    a, b = a[moving], b[moving]
    scale = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / scale if scale > 0 else 0.0


def _finite(*arrays: Array) -> tuple[Array, ...]:
    good = np.logical_and.reduce([np.isfinite(array) for array in arrays])
    return tuple(array[good] for array in arrays)


FACTOR_TOLERANCE = 0.1
"""Relative deviation of a measured speed from the derivative of the position for a note."""
AGREEMENT = 0.9
"""Correlation of speed and derivative above which the ratio of the two is meaningful."""
BOTH_WAYS = 0.1
"""Least share of the motion in each direction that the check of the current's sign requires."""
ALIKE = 1.5  # greatest ratio of the efforts in the two directions of a log of magnitudes
FAR = 100.0
"""Distance of an outlier from its neighbours, over the greatest such distance of the others."""
OUTLIERS = 3
_FACTORS = (
    (30.0 / np.pi, "rpm", "0.10471975511965977"),
    (180.0 / np.pi, "degrees per second", "0.017453292519943295"),
    (1.0 / (2.0 * np.pi), "turns per second", "6.283185307179586"),
    (1e3, "thousandths", "0.001"),
)


def doubts(
    channels: Mapping[str, Array], gear_ratio: float, *, driven_by_weight: bool
) -> Iterator[str]:
    """Yield a note for each channel that contradicts another one or itself."""
    time = channels["time"]
    position = "angle" if "angle" in channels else "motor_angle"
    if position in channels:
        block = max(1, min(round(BLOCK_S / float(np.median(np.diff(time)))), len(time) // 4))
        mean = {name: _block_mean(values, block) for name, values in channels.items()}
        derived = cast(Array, np.gradient(mean[position], mean["time"]))
        if "velocity" in mean:
            gear = gear_ratio if position == "motor_angle" else 1.0
            yield from _speed(position, derived, mean["velocity"], gear)
        if not driven_by_weight:
            yield from _signless(channels, mean, derived)
    for name, values in channels.items():
        if name not in ("time", "angle_time", "enabled"):
            yield from _single(name, values, time)


def _speed(position: str, derived: Array, measured: Array, gear: float) -> Iterator[str]:
    good = np.isfinite(measured) & np.isfinite(derived)
    a, b = derived[good], measured[good]
    energy = float((a @ a) * (b @ b))
    if energy <= 0.0 or float(a @ b) / np.sqrt(energy) < AGREEMENT:
        return
    factor = float(a @ b) / float(a @ a)
    # The velocity is at the joint, whether the position is that of the motor or of the joint.
    ratio = factor * gear
    if abs(ratio - 1.0) <= FACTOR_TOLERANCE:
        return
    guess = next(
        (
            f": if it is in {unit}, set its scale to {scale}"
            for size, unit, scale in _FACTORS
            if abs(ratio / size - 1.0) <= FACTOR_TOLERANCE
        ),
        ": check its scale, the gear ratio, and whether both channels belong to one shaft",
    )
    yield f"`velocity` is {ratio:.4g} times the speed of the joint by `{position}`{guess}"


def _signless(
    channels: Mapping[str, Array], mean: Mapping[str, Array], derived: Array
) -> Iterator[str]:
    """Yield a note if the effort (torque, current or voltage) keeps one sign and is about equally
    large in both directions of motion.

    With a load in one direction the effort may also keep one sign, but then the effort is greater
    against the load than with the load.
    """
    time = channels["time"]
    moving = np.abs(derived) > BOTH_WAYS * np.max(np.abs(derived), initial=0.0)
    forward = float(np.mean(derived[moving] > 0)) if moving.any() else 0.0
    if not BOTH_WAYS <= forward <= 1.0 - BOTH_WAYS:
        return
    for name in ("torque", "current", "voltage"):
        if name not in channels:
            continue
        other = one_signed(channels[name])
        if other is None:
            continue
        known = moving & np.isfinite(mean[name])
        ahead, back = known & (derived > 0), known & (derived < 0)
        if not ahead.any() or not back.any():
            continue
        sizes = sorted(abs(float(mean[name][part].mean())) for part in (ahead, back))
        if sizes[1] < ALIKE * sizes[0]:
            noise = f" ({other} of {len(time)} samples have the other)" if other else ""
            yield (
                f"`{name}` keeps one sign{noise} while the joint moves both ways: the log may "
                f"contain its magnitude only, and the fit is then wrong; {MAGNITUDE}"
            )


def _single(name: str, values: Array, time: Array) -> Iterator[str]:
    known = np.isfinite(values)
    x, t = values[known], time[known]
    if len(x) < 10:
        return
    steps = np.diff(x)
    apart = np.where(
        steps[:-1] * steps[1:] < 0, np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])), 0.0
    )
    order = np.sort(apart)
    usual = max(float(order[-1 - OUTLIERS]), float(np.percentile(np.abs(steps), 99)))
    far = np.flatnonzero(apart > FAR * usual) if usual > 0 else np.empty(0, int)
    if 0 < far.size <= OUTLIERS:
        row = int(far[0]) + 1
        yield (
            f"`{name}` has {far.size} single {'sample' if far.size == 1 else 'samples'} more than "
            f"{FAR:g} times as far from the neighbours as all others, first {x[row]:.6g} "
            f"{CHANNELS[name]} at {t[row]:.6g} s: repair the file if the value is wrong"
        )
