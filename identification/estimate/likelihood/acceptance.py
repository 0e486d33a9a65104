"""Acceptance tests of refined values: missing physics would be absorbed by parameters
(docs/method.md, section 12).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from identification.estimate.likelihood.stages import Refined

WHITE = 0.15
"""Greatest correlation of neighbouring innovations."""
GREATEST_CHI2 = 10.0
"""Greatest chi-square of the estimating equations of the unloaded fit (M29)."""
GREATEST_NOISE_RATIO = 2.0
"""Greatest torque noise over the torque scatter."""
GREATEST_DROP = 10.0
"""Greatest drop of the likelihood of the loaded fit, as deviance."""
GREATEST_REPEATING_SHARE = 0.25
"""Greatest repeating share of the correlated noise (M26)."""
GREATEST_ERROR_RATIO = 1.3
"""Greatest equation error over that of the start values; true values reach 1.14."""


def try_refinements(
    attempt: Callable[[bool], Refined | str],
    error: Callable[[Mapping[str, float]], float],
    values: Mapping[str, float],
) -> tuple[Refined | None, str]:
    """Refine with white torque noise, and with correlated noise where innovations refuse white
    noise.

    Args:
        attempt: Refines, with or without a correlated part; a text where prediction errors do not
        apply.
        error: Values to typical equation error.
        values: Start values.

    Returns:
        The refinement, None where there is none, and why it is refused; empty where it is accepted.
    """
    refined = attempt(False)
    if isinstance(refined, str):
        return None, refined
    before = error(values)
    fault = refusal(refined, before, error(refined.values))
    if fault and _coloured(refined):
        # What correlates may be noise of the sensor and not physics.
        other = attempt(True)
        if not isinstance(other, str):
            also = refusal(other, before, error(other.values))
            return (
                (refined, f"{fault}; nor is it noise of the torque: {also}")
                if also
                else (other, "")
            )
    return refined, fault


def _coloured(refined: Refined) -> bool:
    """Return whether innovations correlate, or require more torque noise than the torque
    scatters.
    """
    return (
        abs(refined.whiteness) > WHITE
        or refined.noise.torque > GREATEST_NOISE_RATIO * refined.torque_scatter
    )


def refusal(refined: Refined, before: float, after: float) -> str:
    """Return why the refined values are refused; empty where they are accepted.

    Args:
        refined: The refinement.
        before: Typical equation error of the start values.
        after: That of the refined values.
    """
    judged = (
        refined.whiteness,
        refined.equations_chi2,
        refined.likelihood_drop,
        after,
        *refined.values.values(),
    )
    if not np.all(np.isfinite(judged)):
        return "the search ran off to values that are no numbers"
    if abs(refined.whiteness) > WHITE:
        return (
            f"prediction errors stay correlated ({refined.whiteness:+.2f} from sample to sample, "
            f"limit {WHITE}), "
            "so physics is missing that the refinement would hide in the parameters"
        )
    if refined.noise.torque > GREATEST_NOISE_RATIO * refined.torque_scatter:
        return (
            f"prediction errors ask for a torque noise of {refined.noise.torque:.3g}, but the "
            f"torque scatters by "
            f"{refined.torque_scatter:.3g} from sample to sample, so physics is missing that the "
            f"refinement would hide "
            "in the parameters"
        )
    if refined.repeating_share > GREATEST_REPEATING_SHARE:
        return (
            f"{100.0 * refined.repeating_share:.0f} % of what correlates comes again with the "
            f"motion (limit "
            f"{100.0 * GREATEST_REPEATING_SHARE:.0f} %), so physics is missing"
        )
    if refined.equations_chi2 > GREATEST_CHI2:
        return (
            f"no start solves the estimating equations of the unloaded stage (defect "
            f"{refined.equations_chi2:.3g})"
        )
    if refined.likelihood_drop > GREATEST_DROP:
        return (
            f"the loaded stage's search ends less likely than it began (deviance "
            f"{refined.likelihood_drop:+.0f})"
        )
    if after > GREATEST_ERROR_RATIO * before:
        return f"the refined values raise the equation error from {before:.3g} to {after:.3g}"
    return ""
