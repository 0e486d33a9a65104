"""Writes findings as plain sentences, with values and intervals in common engineering units.

A sentence of the catalogue has parameters in braces. A colon is followed by the unit of the printed
value (``{gap_rad:deg}``; with ``abs`` before the unit, the magnitude is printed), or by two words
of which the sign of the value selects one (``{torque_Nm:?higher/lower}``). ``{recordings}`` is
replaced by the recordings in which the effect shows, ``{channel}`` by the logged quantity from
which the drive's torque is computed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from string import Formatter

from identification.diagnosis.result import Estimate
from identification.effects.effect import Effect, title

COUNT = "1/turn"
"""Unit that the sentence of the catalogue states in words, so that it is not printed."""
_DEG = math.degrees(1.0)
_FACTORS: Mapping[tuple[str, str], float] = {
    ("rad", "deg"): _DEG,
    ("N m/rad", "N m/deg"): 1.0 / _DEG,
    ("1/rad", "%/deg"): 100.0 / _DEG,
    ("", "%"): 100.0,
    ("s", "ms"): 1e3,
    ("A", "mA"): 1e3,
    ("A/s", "mA/min"): 6e4,
    ("N m/s", "N m/h"): 3600.0,
    ("N/s", "N/h"): 3600.0,
    ("m/s", "mm/min"): 6e4,
    ("m^2", "mm^2"): 1e6,
    ("1/m", "%/m"): 100.0,
    ("s/m", "%/(m/s)"): 100.0,
    ("W", "kW"): 1e-3,
}
_SIZE = "abs "
_CHOICE = "?"


def sentence(
    entry: Effect,
    estimates: Mapping[str, Estimate],
    recordings: Sequence[str] = (),
    channel: str = "current",
) -> str:
    """Return the finding of one effect with its parameters, as values followed by 90 % intervals.

    Args:
        entry: Row of the catalogue.
        estimates: Name of each parameter of the sentence to its estimate.
        recordings: Names of the recordings in which the effect shows.
        channel: Logged quantity from which the drive's torque is computed.

    Raises:
        KeyError: The sentence names a parameter without an estimate.
    """
    words = []
    for text, name, form, _ in Formatter().parse(entry.sentence):
        words.append(text)
        if name == "recordings":
            words.append(_listed(recordings))
        elif name == "channel":
            words.append(channel)
        elif name is not None:
            words.append(_field(estimates[name], form or ""))
    return "".join(words)


def finding(
    entry: Effect,
    estimates: Mapping[str, Estimate],
    recordings: Sequence[str] = (),
    channel: str = "current",
) -> str:
    """Return the sentence of an effect with the effect's name and the assumption that it violates.

    The arguments are those of :func:`sentence`.

    Raises:
        KeyError: The sentence names a parameter without an estimate.
    """
    what = f"{title(entry.name)} ({entry.group})"
    return f"{sentence(entry, estimates, recordings, channel)}: {what}, against {entry.assumption}"


def readable(estimate: Estimate, unit: str = "") -> str:
    """Return value, unit and 90 % interval, such as ``0.42 deg (0.39 to 0.45)``.

    Args:
        estimate: Estimate in its own unit.
        unit: Unit of the printed value; ignored if the unit of the estimate cannot be converted to
            this unit.
    """
    factor = _FACTORS.get((estimate.unit, unit))
    shown = unit if factor else estimate.unit
    value, low, high = (x * (factor or 1.0) for x in (estimate.value, estimate.low, estimate.high))
    behind = f" {shown}" if shown and shown != COUNT else ""
    if not (math.isfinite(low) and math.isfinite(high)) or high <= low:
        return f"{value:.3g}{behind}"
    places = _places(high - low)
    if places is None:
        return f"{value:.4g}{behind} ({low:.4g} to {high:.4g})"
    return f"{value:.{places}f}{behind} ({low:.{places}f} to {high:.{places}f})"


def _field(estimate: Estimate, form: str) -> str:
    if form.startswith(_CHOICE):
        plus, _, minus = form.removeprefix(_CHOICE).partition("/")
        return plus if estimate.value >= 0.0 else minus
    if form.startswith(_SIZE):
        form = form.removeprefix(_SIZE)
        if estimate.value < 0.0:
            estimate = Estimate(-estimate.value, -estimate.high, -estimate.low, estimate.unit)
    return readable(estimate, form)


def _places(width: float) -> int | None:
    """Return the number of decimals with which an interval of this width has one or two digits, or
    None for values that need an exponent.
    """
    exponent = math.floor(math.log10(width))
    places = -exponent + (1 if width / 10.0**exponent < 3.0 else 0)
    return max(places, 0) if places <= 6 and exponent <= 5 else None


def _listed(names: Sequence[str]) -> str:
    if not names:
        return "one recording"
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
