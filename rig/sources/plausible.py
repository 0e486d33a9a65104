"""Do the channels of a recording agree with each other? Signs above all.

Pure functions of arrays; each returns words for an error or a note, or nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import cast

import numpy as np

from identification.recording import Array

BLOCK_S = 0.02
"""Samples are averaged over this time first, s, so that encoder steps and noise do not hide the sign."""
OPPOSED = -0.3
"""Correlation of torque and velocity while moving below which the torque drives against the motion."""
RATIO_TOLERANCE = 0.05
"""Deviation of the measured from the declared gear ratio that is noted."""


def sign_errors(channels: Mapping[str, Array], *, driven_by_weight: bool) -> Iterator[str]:
    """Yield an error for each pair of channels with opposite sign conventions.

    Over a whole recording friction takes energy from the motor, so torque and velocity must correlate positively,
    unless a turning weight drives the joint.

    Args:
        channels: Canonical channels in SI units, shape (n,); time increasing.
        driven_by_weight: Whether a turning weight is declared; torque is then not judged.
    """
    time = channels["time"]
    position = "angle" if "angle" in channels else "motor_angle"
    block = max(1, min(round(BLOCK_S / float(np.median(np.diff(time)))), len(time) // 2))
    mean = {name: _block_mean(channels[name], block) for name in ("time", position, "velocity") if name in channels}
    derived = cast(Array, np.gradient(mean[position], mean["time"])) if position in mean else None
    measured = mean.get("velocity")
    if derived is not None and measured is not None:
        correlation = _correlation(derived, measured, derived)
        if correlation < OPPOSED:
            yield f"`velocity` runs against `{position}` (correlation {correlation:.2f}); negate the scale of one"
    velocity, mover = (measured, "velocity") if derived is None else (derived, position)
    effort = next((name for name in ("torque", "current", "voltage") if name in channels), None)
    if velocity is None or effort is None or driven_by_weight:
        return
    correlation = _correlation(_block_mean(channels[effort], block), velocity, velocity)
    if correlation < OPPOSED:
        yield (
            f"`{effort}` opposes the motion (correlation {correlation:.2f} with velocity while moving), as if the load"
            f" drove the motor: negate the scale of `{effort}` or of `{mover}`; a weight that turns with the joint is"
            " declared by `gravity`"
        )


def gear_finding(motor_angle: Array, angle: Array, gear_ratio: float) -> tuple[str, bool] | None:
    """Compare motor and joint angle; return (words, whether it is an error) where they disagree."""
    motor, joint = _finite(motor_angle, angle)
    motor, joint = motor - motor.mean(), joint - joint.mean()
    energy = float(joint @ joint)
    if energy == 0.0:
        return None
    ratio = float(motor @ joint) / energy
    if ratio < 0:
        return "`motor_angle` runs against `angle`; negate the scale of one of them", True
    if abs(ratio / gear_ratio - 1.0) > RATIO_TOLERANCE:
        return f"motor_angle / angle is {ratio:.4g}, bench.gear_ratio says {gear_ratio:.4g}", False
    return None


def _block_mean(values: Array, block: int) -> Array:
    count = len(values) // block
    return cast(Array, values[: count * block].reshape(count, block).mean(axis=1))


def _correlation(a: Array, b: Array, velocity: Array) -> float:
    """Return sum(a b) / sqrt(sum a^2 sum b^2) over the blocks that move; 0 where nothing does."""
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
