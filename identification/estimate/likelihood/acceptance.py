"""Acceptance tests of the values refined by likelihood: they reject values that compensate
unmodelled physics.

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
            it returns the reason as text if prediction errors do not apply.
        error: Function of the values that returns the mean equation error over the recordings.
        values: Start values.
        limits: Limits of the tests.

    Returns:
        The refinement, or None if prediction errors do not apply, and the reason for the rejection,
        which is empty if the refinement is accepted.
    """
    refined = attempt(False)
    if isinstance(refined, str):
        return None, refined
    before = error(values)
    fault = refusal(refined, before, error(refined.values), limits)
    if fault and refined.stopped:
        return refined, f"{fault}; the search stopped at its greatest number of filter runs"
    if fault and _coloured(refined, limits):
        # The cause of the correlation may be noise of the current sensor, and not unmodelled
        # physics.
        other = attempt(True)
        if not isinstance(other, str):
            also = refusal(other, before, error(other.values), limits)
            return (
                (refined, f"{fault}; with correlated torque noise: {also}") if also else (other, "")
            )
    return refined, fault


def _coloured(refined: Refined, limits: AcceptanceLimits) -> bool:
    """Return whether innovations are correlated, or imply a torque noise above the torque
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
        before: Mean equation error of the start values over the recordings.
        after: Mean equation error of the refined values over the recordings.
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
            f"neighbouring prediction errors have a correlation of {refined.whiteness:+.2f} "
            f"(limit {limits.whiteness}), so the parameters would compensate physics that the "
            "model lacks"
        )
    if refined.noise.torque > limits.noise_ratio * refined.torque_scatter:
        return (
            f"the torque noise by the prediction errors, {refined.noise.torque:.3g}, is greater "
            f"than {limits.noise_ratio:g} times the torque scatter from sample to sample, "
            f"{refined.torque_scatter:.3g}, so the parameters would compensate physics that the "
            "model lacks"
        )
    if refined.repeating_share > limits.repeating_share:
        return (
            f"{100.0 * refined.repeating_share:.0f} % of the correlated noise repeats in matching "
            f"half cycles (limit {100.0 * limits.repeating_share:.0f} %), so the recordings show "
            "physics that the model lacks"
        )
    if refined.equations_chi2 > limits.chi2:
        return (
            "no search of the unloaded fit solves the estimating equations (least chi-square "
            f"{refined.equations_chi2:.3g}, limit {limits.chi2:g})"
        )
    if refined.likelihood_drop > limits.drop:
        return (
            "the search of the loaded fit ends at a lower likelihood than it starts (change of "
            f"the deviance {refined.likelihood_drop:+.0f}, limit {limits.drop:+g})"
        )
    if after > limits.error_ratio * before:
        return (
            f"the refined values raise the equation error from {before:.3g} to {after:.3g}, that "
            f"is, by more than a factor of {limits.error_ratio:g}"
        )
    return ""
