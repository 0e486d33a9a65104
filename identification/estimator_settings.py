"""Settings of the default estimator, as frozen records with their units; (M...) are equations of
docs/method.md.

:data:`DEFAULT` are the settings of ``rig identify``; the coverage of its 90 % intervals was
verified with these settings. Other settings are for studies and tests.
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
        error_ratio: Greatest ratio of the equation error at the refined values to the equation
            error at the start values; at the true values of simulated benches the ratio reaches
            1.14.
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
        pairs: Number of noise series in the first round; each series is simulated with both signs.
        most_pairs: Greatest number of noise series, used if the bias is uncertain.
        uncertain: Standard error of the bias, in standard errors of the estimate, above which more
            noise series are simulated.
        tried: Greatest number of pairs of replicates that are tried; a replicate fails if the
            filter diverges.
        enough: Least number of pairs that succeed; with fewer pairs the bias is not corrected.
        large: Bias, in standard errors of the estimate, above which the replicates are simulated
            again at the corrected values.
        turns: Greatest number of rounds of simulation, the first round included.
        unseen: Logged share of the noise variance (M34) that is assumed if the recordings do not
            determine this share.
        headroom: Ratio of the assumed torque limit of the drive to the greatest torque in the
            recordings.
        farthest: Step of the estimate of a replicate, in standard deviations, above which the
            filter counts as diverged and the replicate is dropped.
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
