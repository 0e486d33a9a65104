"""Writes the sentence that states a verdict, and warnings on the recordings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.diagnosis.result import Fit, IdentifiedEffect, Location, Verdict
from identification.diagnosis.rules import RULES
from identification.diagnosis.verdict.reasons import Reason
from identification.effects import EFFECTS
from identification.effects.effect import title
from identification.recording import Dataset
from identification.views.view import View

MOST = 0.5
"""Share of a mismatch from which a coordinate has most of it."""


def statement(
    verdict: Verdict,
    effects: Sequence[IdentifiedEffect],
    main: Fit,
    where: Location | None,
    p_value: float,
    unseen: Sequence[str],
    reason: Reason | None = None,
) -> str:
    """Return the sentence that states a verdict.

    Args:
        verdict: The verdict.
        effects: Identified effects.
        main: Errors of the equation in which the mismatch is judged.
        where: Location of the mismatch, or None if unknown.
        p_value: p-value of the test whether physics is missing.
        unseen: Names of effects that the recordings cannot show.
        reason: Reason why the verdict is *nothing missing* in spite of a mismatch, or None.
    """
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
    if verdict is Verdict.OUTSIDE_CATALOGUE:
        place = _place(where) if where is not None and where.share_of_mismatch > 0.0 else ""
        return (
            f"the {main.equation} equation has a mismatch that no effect of the catalogue "
            f"explains{place}; {error}"
        )
    words = "; and ".join(e.statement for e in effects)
    if verdict is Verdict.AMBIGUOUS:
        groups = [
            " or ".join(title(n) for n in e.alias_group) for e in effects if len(e.alias_group) > 1
        ]
        words = f"{words}. These recordings cannot distinguish {' and '.join(groups)}"
    return f"{words}. {change}"


def _place(where: Location) -> str:
    """Return the part of the sentence that states the location of a mismatch."""
    share = where.share_of_mismatch
    part = "most" if share > MOST else f"{max(1.0, 100.0 * share):.0f} %"
    return f", {part} of it over {where.coordinate}"


def unobservable_sentence(names: Sequence[str]) -> str:
    """Return the sentence that names effects that the recordings cannot show."""
    return (
        f"these recordings cannot show {', '.join(title(n) for n in names)}, because a "
        "change of the nominal parameters explains such an effect completely"
    )


def warnings_of(dataset: Dataset, here: Sequence[View], unseen: Sequence[str]) -> tuple[str, ...]:
    """Return warnings on effects that the recordings cannot show, on missing recordings with role
    ``validate``, and on recordings without steady motion.
    """
    warnings = []
    if unseen:
        warnings.append(
            f"{unobservable_sentence(unseen)}; an experiment that would show this: "
            f"{' '.join(EFFECTS[n].experiment for n in unseen)}"
        )
    if not dataset.part("validate"):
        warnings.append(
            "no recording is set aside (role: validate), so all errors are errors on the fitted "
            "recordings"
        )
    for view in here:
        if not np.any(view.moving):
            warnings.append(
                f"{view.recording.name}: no sample is in steady motion, so this recording does not "
                "contribute to the torque equation"
            )
    return tuple(warnings)
