"""Settings of the default estimator, as frozen records with their units; (M...) are equations of
docs/method.md.

:data:`DEFAULT` are the settings of ``rig identify``; the intervals were verified with them. Other
settings are for studies and tests.
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
        error_ratio: Greatest ratio of the equation error to the start values'; it reaches 1.14 at
            true values.
    """

    whiteness: float = 0.15
    noise_ratio: float = 2.0
    repeating_share: float = 0.25
    chi2: float = 10.0
    drop: float = 10.0
    error_ratio: float = 1.3


@dataclass(frozen=True)
class ReplicateSettings:
    """Settings of the Monte Carlo bias correction by simulated replicates (M33 to M36).

    Attributes:
        pairs: Number of noise series at first; each is used with both signs.
        most_pairs: Greatest number of noise series, where the bias is uncertain.
        uncertain: Standard error of the bias, in standard errors of the estimate, above which more
            noise series are simulated.
        tried: Greatest number of pairs tried; replicates fail where the filter diverges.
        enough: Least number of pairs that succeed; with fewer there is no correction.
        large: Bias, in standard errors, above which the simulation is repeated at corrected values.
        turns: Greatest number of such simulations.
        unseen: Logged share of the noise variance that is assumed where the recordings do not show
            it (M34).
        headroom: Assumed torque limit of the drive, over the greatest torque in the recordings.
        farthest: Step, in standard deviations, above which the filter counts as diverged and the
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
        acceptance: Limits of its acceptance tests.
        replicates: Settings of its bias correction.
    """

    acceptance: AcceptanceLimits = AcceptanceLimits()
    replicates: ReplicateSettings = ReplicateSettings()


DEFAULT = EstimatorSettings()
