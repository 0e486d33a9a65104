"""Whether a refinement is to be taken: where physics is missing it would hide that in the parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from identification.estimate.likelihood.stages import Refined

WHITE = 0.15
"""Greatest correlation of neighbouring innovations at which the refined values are taken."""
UNSOLVED = 10.0
"""Greatest defect of the first stage's estimating equations at which the refined values are taken."""
NOISE_EXCESS = 2.0
"""Greatest torque noise, over the torque's own scatter, at which the refined values are taken."""
STRAYED = 10.0
"""Greatest growth of the loaded stage's deviance over its search at which the refined values are taken."""
REPEATED = 0.25
"""Greatest share of the noise's correlated part that comes again, at which the refined values are taken."""
NO_WORSE = 1.3
"""Greatest growth of the equation error at which the refined values are taken; the true values made it up to 1.14."""


def try_refinements(
    attempt: Callable[[bool], Refined | str], error: Callable[[Mapping[str, float]], float], values: Mapping[str, float]
) -> tuple[Refined | None, str]:
    """Refine with white noise of the torque, and where that is refused for correlation, with correlated noise.

    Args:
        attempt: Refines, with a correlated part or without; words where that does not apply.
        error: Values to typical equation error.
        values: Those begun from.

    Returns:
        The refinement, None where there is none, and why it is not to be taken; empty where it is.
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
            return (refined, f"{fault}; nor is it noise of the torque: {also}") if also else (other, "")
    return refined, fault


def _coloured(refined: Refined) -> bool:
    """Return whether prediction errors correlate, or ask for more noise of the torque than scatters."""
    return abs(refined.whiteness) > WHITE or refined.noise.torque > NOISE_EXCESS * refined.torque_scatter


def refusal(refined: Refined, before: float, after: float) -> str:
    """Say why the refined values are not taken; empty where they are.

    ``before`` and ``after`` are typical equation errors, of the values begun from and of the refined ones.
    """
    told = (refined.whiteness, refined.unsolved, refined.strayed, after, *refined.values.values())
    if not np.all(np.isfinite(told)):
        return "the search ran off to values that are no numbers"
    if abs(refined.whiteness) > WHITE:
        return (
            f"prediction errors stay correlated ({refined.whiteness:+.2f} from sample to sample, limit {WHITE}), "
            "so physics is missing that the refinement would hide in the parameters"
        )
    if refined.noise.torque > NOISE_EXCESS * refined.torque_scatter:
        return (
            f"prediction errors ask for a torque noise of {refined.noise.torque:.3g}, but the torque scatters by "
            f"{refined.torque_scatter:.3g} from sample to sample, so physics is missing that the refinement would hide "
            "in the parameters"
        )
    if refined.repeated > REPEATED:
        return (
            f"{100.0 * refined.repeated:.0f} % of what correlates comes again with the motion (limit "
            f"{100.0 * REPEATED:.0f} %), so physics is missing"
        )
    if refined.unsolved > UNSOLVED:
        return f"no start solves the estimating equations of the unloaded stage (defect {refined.unsolved:.3g})"
    if refined.strayed > STRAYED:
        return f"the loaded stage's search ends less likely than it began (deviance {refined.strayed:+.0f})"
    if after > NO_WORSE * before:
        return f"the refined values raise the equation error from {before:.3g} to {after:.3g}"
    return ""
