"""Acceptance tests of the likelihood's values: reject a fit whose parameters compensate unmodelled
physics.

The tests are stated in docs/method.md, section 12.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from identification.estimate.likelihood.stages import Refined
from identification.estimator_settings import DEFAULT, AcceptanceLimits


def try_refinements(
    attempt: Callable[[bool], Refined | str],
    error: Callable[[Mapping[str, float]], float],
    values: Mapping[str, float],
    limits: AcceptanceLimits = DEFAULT.acceptance,
) -> tuple[Refined | None, str]:
    """Refine the values with white torque noise, and with correlated noise if the innovations
    contradict white noise.

    Args:
        attempt: Function that refines the values, with or without a correlated part of the noise;
            the function returns a text if prediction errors do not apply.
        error: Function of the values that returns the typical equation error.
        values: Start values.
        limits: Limits of the tests.

    Returns:
        The refinement, or None, and the reason for its rejection; the reason is empty if the
        refinement is accepted.
    """
    refined = attempt(False)
    if isinstance(refined, str):
        return None, refined
    before = error(values)
    fault = refusal(refined, before, error(refined.values), limits)
    if fault and refined.stopped:
        return refined, f"{fault}; the search stopped at its greatest number of passes"
    if fault and _coloured(refined, limits):
        # The correlation may be noise of the sensor instead of unmodelled physics.
        other = attempt(True)
        if not isinstance(other, str):
            also = refusal(other, before, error(other.values), limits)
            return (
                (refined, f"{fault}; correlated torque noise does not explain it either: {also}")
                if also
                else (other, "")
            )
    return refined, fault


def _coloured(refined: Refined, limits: AcceptanceLimits) -> bool:
    """Return whether innovations are correlated, or their torque noise exceeds the torque
    scatter.
    """
    return (
        abs(refined.whiteness) > limits.whiteness
        or refined.noise.torque > limits.noise_ratio * refined.torque_scatter
    )


def refusal(
    refined: Refined,
    before: float,
    after: float,
    limits: AcceptanceLimits = DEFAULT.acceptance,
) -> str:
    """Return the reason why the refined values are rejected; empty if they are accepted.

    Args:
        refined: The refinement.
        before: Typical equation error of the start values.
        after: Typical equation error of the refined values.
        limits: Limits of the tests.
    """
    judged = (
        refined.whiteness,
        refined.equations_chi2,
        refined.likelihood_drop,
        after,
        *refined.values.values(),
    )
    if not np.all(np.isfinite(judged)):
        return "the search diverged to values that are not finite"
    if abs(refined.whiteness) > limits.whiteness:
        return (
            f"prediction errors stay correlated ({refined.whiteness:+.2f} from sample to sample, "
            f"limit {limits.whiteness}), "
            "so the parameters would absorb physics that the model lacks"
        )
    if refined.noise.torque > limits.noise_ratio * refined.torque_scatter:
        return (
            f"prediction errors imply a torque noise of {refined.noise.torque:.3g}, but the "
            f"torque scatter is {refined.torque_scatter:.3g} from sample to sample, so the "
            f"parameters would absorb physics that the model lacks"
        )
    if refined.repeating_share > limits.repeating_share:
        return (
            f"{100.0 * refined.repeating_share:.0f} % of the correlated noise repeats with the "
            f"motion (limit "
            f"{100.0 * limits.repeating_share:.0f} %), so there is physics that the model lacks"
        )
    if refined.equations_chi2 > limits.chi2:
        return (
            f"no start solves the estimating equations of the unloaded stage (chi-square "
            f"{refined.equations_chi2:.3g})"
        )
    if refined.likelihood_drop > limits.drop:
        return (
            f"the loaded stage's search ends at a lower likelihood than its start (deviance "
            f"{refined.likelihood_drop:+.0f})"
        )
    if after > limits.error_ratio * before:
        return f"the refined values raise the equation error from {before:.3g} to {after:.3g}"
    return ""
