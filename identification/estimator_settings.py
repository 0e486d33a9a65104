"""Settings of the default estimator, as frozen records with their units; (M...) are equations of
docs/method.md.

:data:`DEFAULT` are the settings of ``rig identify``. Others are for studies and tests: intervals
were verified with these.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AcceptanceLimits:
    """Limits of the acceptance tests (docs/method.md, section 12).

    Attributes:
        whiteness: Greatest correlation of neighbouring innovations.
        noise_ratio: Greatest torque noise over the torque scatter.
        repeating_share: Greatest repeating share of the correlated noise (M26).
        chi2: Greatest chi-square of the estimating equations of the unloaded fit (M29).
        drop: Greatest drop of the likelihood of the loaded fit, as deviance (M24).
        error_ratio: Greatest equation error over that of the start values; true values reach 1.14.
    """

    whiteness: float = 0.15
    noise_ratio: float = 2.0
    repeating_share: float = 0.25
    chi2: float = 10.0
    drop: float = 10.0
    error_ratio: float = 1.3


@dataclass(frozen=True)
class ReplicateSettings:
    """How the bias of the likelihood is measured by simulated replicates (M33 to M36).

    Attributes:
        pairs: Noises at first, each used with both signs.
        most_pairs: Noises at most, where the bias is uncertain.
        uncertain: Error of the bias, in standard errors of the estimate, up to which no more noises
            are taken.
        tried: Pairs tried at most, where replicates fail because the filter loses the joint.
        enough: Least number of pairs that succeed; with fewer there is no correction.
        large: Bias, in standard errors, above which the simulation is repeated at corrected values.
        turns: Simulations at most.
        unseen: Logged share of the noise variance where the recordings do not show it (M34).
        headroom: The drive's greatest torque over the greatest in the recordings.
        farthest: Step, in standard deviations, above which the filter has lost the joint and the
            replicate is dropped.
    """

    pairs: int = 3
    most_pairs: int = 6
    uncertain: float = 0.15
    tried: int = 9
    enough: int = 2
    large: float = 2.0
    turns: int = 3
    unseen: float = 0.5
    headroom: float = 2.0
    farthest: float = 20.0


@dataclass(frozen=True)
class EstimatorSettings:
    """Settings of the default estimator.

    Attributes:
        acceptance: When a refinement is accepted.
        replicates: How its bias is measured.
    """

    acceptance: AcceptanceLimits = AcceptanceLimits()
    replicates: ReplicateSettings = ReplicateSettings()


DEFAULT = EstimatorSettings()
