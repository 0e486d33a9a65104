"""Notes on channels that contradict each other or themselves: wrong units, wrong signs, single
outliers.

The functions yield notes and depend only on their arguments. No function changes or drops data.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import cast

import numpy as np

from identification.recording import CHANNELS, Array
from rig.config.campaign_sections import RecordingSection
from rig.sources.columns import UNITS
from rig.sources.formats import Table

BLOCK_S = 0.02
"""Time over which samples are averaged before a position is differentiated, s."""
FACTOR_TOLERANCE = 0.1
"""Relative deviation of a measured speed from the derivative of the position above which a note
results.
"""
AGREEMENT = 0.9
"""Correlation of speed and derivative above which the ratio of the two is meaningful."""
BOTH_WAYS = 0.1
"""Least share of the motion in each direction that is required to check whether the current changes
its sign.
"""
ALIKE = 1.5
"""Greatest ratio of the efforts (torque, current or voltage) in the two directions at which a log
may contain magnitudes only.
"""
FAR = 100.0
"""Ratio of a sample's distance from its neighbours to the greatest such distance of all other
samples, above which a note results.
"""
OUTLIERS = 3
"""Greatest number of samples of a channel that count as single outliers."""
_FACTORS = (
    (30.0 / np.pi, "rpm", "0.10471975511965977"),
    (180.0 / np.pi, "degrees per second", "0.017453292519943295"),
    (1.0 / (2.0 * np.pi), "turns per second", "6.283185307179586"),
    (1e3, "thousandths", "0.001"),
)


def unit_row_doubts(table: Table, section: RecordingSection) -> Iterator[str]:
    """Yield a note for each channel with scale 1 whose unit, by the file's row of units, is not
    SI.
    """
    if not table.units:
        return
    for name, channel in section.channels.items():
        column = channel.column
        place = column if isinstance(column, int) else _index(table.names, column)
        if place is None or place >= len(table.units) or channel.scale != 1.0:
            continue
        unit = table.units[place].strip("[]() ")
        si, size = UNITS.get(unit.lower(), ("", 1.0))
        if size != 1.0 and name in CHANNELS and si == CHANNELS[name]:
            yield (
                f"`{name}` is in {unit} by the file's row of units, but its scale is 1: set the "
                f"scale to {size:.10g}"
            )


def _index(names: tuple[str, ...], column: str) -> int | None:
    return names.index(column) if column in names else None


def doubts(
    channels: Mapping[str, Array], gear_ratio: float, *, driven_by_weight: bool
) -> Iterator[str]:
    """Yield a note for each channel that contradicts another channel or has contradictory samples.

    Args:
        channels: Canonical channels in SI units, shape (n,); time increasing.
        gear_ratio: Gear ratio of the bench.
        driven_by_weight: Whether a weight that turns with the joint is declared; the torque may
            then have one sign.
    """
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
    moving = np.abs(derived) > BOTH_WAYS * np.max(np.abs(derived), initial=0.0)
    forward = float(np.mean(derived[moving] > 0)) if moving.any() else 0.0
    if not BOTH_WAYS <= forward <= 1.0 - BOTH_WAYS:
        return
    for name in ("torque", "current", "voltage"):
        if name not in channels:
            continue
        values = channels[name][np.isfinite(channels[name])]
        if not values.size or not np.any(values):
            continue
        known = moving & np.isfinite(mean[name])
        ahead, back = known & (derived > 0), known & (derived < 0)
        if not ahead.any() or not back.any():
            continue
        sizes = sorted(abs(float(mean[name][part].mean())) for part in (ahead, back))
        if (values.min() >= 0.0 or values.max() <= 0.0) and sizes[1] < ALIKE * sizes[0]:
            yield (
                f"`{name}` keeps one sign while the joint moves both ways: the log may contain "
                "its magnitude only, and the fit is then wrong; log the channel with its sign, or "
                "use `voltage` instead"
            )


def _single(name: str, values: Array, time: Array) -> Iterator[str]:
    """Yield a note if single samples are far from both neighbours."""
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


def _block_mean(values: Array, block: int) -> Array:
    count = len(values) // block
    return cast(Array, values[: count * block].reshape(count, block).mean(axis=1))
