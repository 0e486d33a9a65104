"""Writes the sentence that states a verdict, and warnings on the recordings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from string import Formatter

import numpy as np

from identification.diagnosis.reasons import Reason
from identification.diagnosis.result import Estimate, Fit, IdentifiedEffect, Location, Verdict
from identification.diagnosis.rules import RULES
from identification.effects.effect import Effect, title
from identification.recording import Dataset
from identification.views.view import View

# Writes findings as plain sentences, with values and intervals in common engineering units.
#
# A sentence of the catalogue has parameters in braces. A colon is followed by the unit of the
# printed value (``{gap_rad:deg}``; with ``abs`` before the unit, the magnitude is printed), or by
# two words of which the sign of the value selects one (``{torque_Nm:?higher/lower}``), or by words
# that are printed with the value unless it is zero (``{other_rad:|, another one at |deg}``).
# ``{recordings}`` is replaced by the recordings in which the effect shows, ``{channel}`` by the
# logged quantity from which the drive's torque is computed.

COUNT = "1/turn"
"""Unit that the sentence of the catalogue states in words, so that it is not printed."""
_DEG = math.degrees(1.0)
FACTORS: Mapping[tuple[str, str], float] = {
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
_UNLESS_ZERO = "|"


def sentence(
    entry: Effect,
    estimates: Mapping[str, Estimate],
    recordings: Sequence[str] = (),
    channel: str = "current",
) -> str:
    """Return the finding of one effect with its parameters and their 90 % intervals."""
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
    factor = FACTORS.get((estimate.unit, unit))
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
    if form.startswith(_UNLESS_ZERO):
        words, _, form = form.removeprefix(_UNLESS_ZERO).partition(_UNLESS_ZERO)
        return f"{words}{readable(estimate, form)}" if estimate.value != 0.0 else ""
    if form.startswith(_SIZE):
        form = form.removeprefix(_SIZE)
        if estimate.value < 0.0:
            estimate = Estimate(-estimate.value, -estimate.high, -estimate.low, estimate.unit)
    return readable(estimate, form)


def _places(width: float) -> int | None:
    """Return the decimals of an interval of this width; None for values with an exponent."""
    exponent = math.floor(math.log10(width))
    places = -exponent + (1 if width / 10.0**exponent < 3.0 else 0)
    return max(places, 0) if places <= 6 and exponent <= 5 else None


def _listed(names: Sequence[str]) -> str:
    if not names:
        return "one recording"
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


MOST = 0.5  # share of a mismatch from which a coordinate has most of it


def statement(
    verdict: Verdict,
    effects: Sequence[IdentifiedEffect],
    main: Fit,
    where: Location | None,
    p_value: float,
    unseen: Sequence[str],
    reason: Reason | None = None,
) -> str:
    """Return the sentence that states a verdict."""
    error = (
        f"{main.equation} error {main.baseline_rms:.3g} {main.unit}; noise floor "
        f"{main.noise_floor_rms:.3g}"
    )
    if verdict is Verdict.NOTHING_MISSING:
        within = "the mismatch is within the noise" if reason is None else reason.kind.value
        evidence = f"p = {p_value:.2g}" if p_value > RULES.level else within
        said = f"nothing is missing that these recordings could show ({evidence}); {error}"
        return f"{said}; {unobservable_sentence(unseen)}" if unseen else said
    held = main.validate_baseline_rms is not None and main.validate_final_rms is not None
    before, after = (
        (main.validate_baseline_rms, main.validate_final_rms)
        if held
        else (main.baseline_rms, main.final_rms)
    )
    recordings = "recordings set aside" if held else "the recordings it was fitted to"
    change = (
        f"{main.equation.capitalize()} error on {recordings} {before:.3g} -> {after:.3g} "
        f"{main.unit}; "
        f"noise floor {main.noise_floor_rms:.3g}."
    )
    words = "; and ".join(e.statement for e in effects)
    groups = [
        " or ".join(title(n) for n in e.alias_group) for e in effects if len(e.alias_group) > 1
    ]
    if verdict is not Verdict.NAMED and groups:
        words = f"{words}. These recordings cannot distinguish {' and '.join(groups)}"
    if verdict is Verdict.OUTSIDE_CATALOGUE:
        place = ""
        if where is not None and where.share_of_mismatch > 0.0:
            share = where.share_of_mismatch
            part = "most" if share > MOST else f"{max(1.0, 100.0 * share):.0f} %"
            place = f", {part} of it over {where.coordinate}"
        unexplained = "a mismatch that no effect of the catalogue explains"
        if not effects:
            return f"the {main.equation} equation has {unexplained}{place}; {error}"
        return f"a part is found: {words}. Beside it there is {unexplained}. {change}"
    return f"{words}. {change}"


def unobservable_sentence(names: Sequence[str]) -> str:
    """Return the sentence that names effects that the recordings cannot show."""
    return (
        f"these recordings cannot show {', '.join(title(n) for n in names)}, because a "
        "change of the nominal parameters explains such an effect completely"
    )


NONE_ASIDE = (
    "no recording is set aside (role: validate), so all errors are errors on the fitted recordings"
)
"""Warning on missing recordings with role ``validate``."""


def warnings_of(
    dataset: Dataset, here: Sequence[View], unseen: Sequence[Effect]
) -> tuple[str, ...]:
    """Return warnings on effects that the recordings cannot show, on missing recordings with role
    ``validate``, and on recordings without steady motion.
    """
    warnings = []
    if unseen:
        warnings.append(
            f"{unobservable_sentence([e.name for e in unseen])}; an experiment that would show "
            f"this: {' '.join(e.experiment for e in unseen)}"
        )
    if not dataset.part("validate"):
        warnings.append(NONE_ASIDE)
    for view in here:
        if not np.any(view.moving):
            warnings.append(
                f"{view.recording.name}: no sample is in steady motion, so this recording does not "
                "contribute to the torque equation"
            )
    return tuple(warnings)
