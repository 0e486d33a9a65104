"""All numbers by which effects are tested, selected and judged, in one frozen record.

All other numbers in this package are settings of numerics (steps, tolerances, grids of trial
values) or constants of nature.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SelectionRules:
    """Rules of a diagnosis.

    Attributes:
        level: Significance level of the tests whether (further) physics is missing. Basis: alarms
            at most 1 %; sign flips within blocks of time give the level by construction (D4, D5).
        tested_from: Ratio of an equation's mean-square mismatch to that of the noise, from which it
            is tested. Basis: some hundred independent rows give the noise's mean square to about a
            tenth (decisions 36, 43).
        excess: Ratio of the mean-square mismatch to that of the noise, up to which an
            underestimated noise may be the cause, and below which a mismatch counts as explained.
            Basis: chosen on development trials: the noise is estimated above the bandwidth.
        accuracy: Share of the greatest torque or voltage within which a mismatch may be an error of
            its sensor. Basis: current sensors and converters of drives are linear to 0.1 to 1 %;
            this is a fifth of the best.
        excess_of_one: The same ratio for one recording, up to which its torque mismatch counts as
            noise. Basis: a recording has a few half cycles, whose mean square scatters more; too
            few blocks for sign flips.
        least_share: Power of a contribution, over the noise's power in its equations, below which
            it is negligible. Basis: a tenth of the noise's amplitude.
        outlier: Magnitude of a row, over the noise, from which it is an outlier. Basis: normal
            noise exceeds it in one of 5e8 rows.
        outlier_blocks: Share of blocks in which an outlier may occur by chance. Basis: simulated
            benches without effects have none.
        collinear_below: Share of a regressor's norm after projection, below which it counts as
            collinear with the nominal parameters. Basis: beyond it, errors of 0.1 % of the
            regressor decide.
        least_active: Least number of blocks in which a regressor must be active (inverse
            participation ratio). Basis: the variance between blocks needs several.
        infeasible: Ratio of the attained to the predicted mean-square torque mismatch, from which a
            fit is infeasible. Basis: simulated trials: 1.00 to 1.03 with the right effects, 490 000
            where friction had to rise with speed.
        finalists: Greatest number of effects that are fitted jointly before one of them is
            selected. Basis: chosen: the time of a search grows with it.
        rival_share: Least score of a finalist, over the best score. Basis: a joint fit raises a
            score by at most `gain_ratio`.
        gain_ratio: Greatest ratio of the gain in a joint fit to the gain predicted by an effect's
            regressors. Basis: chosen: a larger gain comes from parameters other than those of the
            effect.
        most_effects: Greatest number of effects that are identified together. Basis: one more than
            the proofs inject.
        rejected: Standard errors by which a rival must be worse to be rejected, and by which an
            effect must reduce the error on unused recordings. Basis: 5 %, one-sided.
        simpler: Standard errors of preference below which the effect with fewer parameters is
            taken. Basis: one-standard-error rule of cross-validation.
        same_fit: Square of the difference of two fits over the square of their mismatch, below
            which they are equal. Basis: a tenth of the mismatch.
        further_share: Share of the mismatch beyond the noise that one more effect must explain.
            Basis: chosen on development trials (decision 21): the shape error of the first
            regressor leaves less.
        shape_errors: Least gain of one more effect, in multiples of the shape error of the other
            regressors. Basis: chosen: a factor of ten over what that error may leave (decision 21).
        nearly_all: Share of the mismatch beyond the noise from which an effect is accepted with
            less gain than `shape_errors`. Basis: chosen on development trials (decision 21).
        further_searches: Number of searches without the effects that validation dropped. Basis: one
            for each effect that stands in for another (decision 43).
        parts: Number of parts of the blocks of time, used if one recording alone determines a
            parameter. Basis: chosen; three quarters of the rows remain for the fit.
        sole_share: Share of the squares of a parameter's derivative in one part, above which that
            part alone determines it. Basis: the others then give it ten times its standard error.
        loop_share: Ratio of the closing torque to the motion's torque, from which a crossing shows
            a loop and not a gap. Basis: three times `gap_scatter`.
        gap_scatter: Standard deviation of that ratio for a gap. Basis: simulated trials with a gap.
        least_crossings: Least number of crossings that decide between a gap and a loop. Basis:
            their mean has a third of the scatter of one.
        hysteretic_share: Share of the mismatch beyond the noise that a coordinate of hysteresis
            must explain. Basis: chosen on development trials.
        adequate: Share of the mismatch's power beyond the noise that the effects must explain
            together. Basis: chosen on development trials; the proofs in docs/diagnosis.md were run
            with it.
        adequate_after_removal: The same share where some effects were dropped as they do not reduce
            the error on unused recordings. Basis: chosen; more than half must be explained.
        nearly_complete: Share of the mismatch's power beyond the noise, below which the remainder
            is tested for hysteresis, and on recordings set aside further physics counts as missing.
            Basis: simulated trials: right effects explained at least 95.9 %, springs in place of
            hysteresis 76 to 89 %.
        cancelled: Power of the sum of two contributions over the sum of their powers, below which
            the two cancel each other. Basis: independent contributions have 1 on average; below
            it, equal ones are more than twice their sum.
        greatest_confidence: Greatest confidence in any effect. Basis: chosen;
            on machines made by others such names are right less often (docs/diagnosis.md).
        incomplete_confidence: Greatest confidence in an effect if the test finds that more is
            missing, or in a further effect whose mismatch is faint. Basis: 22 of 33 such names were
            right (48 to 82 %), on three simulators.
        faint_confidence: Greatest confidence in an effect whose mismatch is faint. Basis: a tenth
            of it may be something else (docs/diagnosis.md).
        implausible_confidence: Confidence in a rival that fits as well, but with a parameter
            outside its plausible range. Basis: the one-sided 5 % of `rejected`.
        own_coordinate: Ratio of the share of an effect's own coordinate to the best share, from
            which the own one is reported. Basis: chosen on development trials.
        recording: Ratio of a recording's mean-square mismatch to that of the noise, from which the
            mismatch is present in it. Basis: equal to `excess_of_one`.
        alike: Share of an effect's regressor that another explains, from which the two are
            indistinguishable. Basis: the definition of an alias group.
        alike_shapes: Share of an effect's trial parameters for which this must hold. Basis: chosen;
            most of them.
    """

    level: float = 0.01
    tested_from: float = 1.1
    excess: float = 1.5
    accuracy: float = 2e-4
    excess_of_one: float = 2.0
    least_share: float = 0.01
    outlier: float = 6.0
    outlier_blocks: float = 0.01
    collinear_below: float = 1e-3
    least_active: float = 3.0
    infeasible: float = 1.5
    finalists: int = 4
    rival_share: float = 0.3
    gain_ratio: float = 3.0
    most_effects: int = 3
    rejected: float = 1.645
    simpler: float = 1.0
    same_fit: float = 0.01
    further_share: float = 0.4
    shape_errors: float = 10.0
    nearly_all: float = 0.8
    further_searches: int = 2
    parts: int = 4
    sole_share: float = 0.99
    loop_share: float = 0.06
    gap_scatter: float = 0.02
    least_crossings: int = 10
    hysteretic_share: float = 1.0 / 3.0
    adequate: float = 0.70
    adequate_after_removal: float = 0.5
    nearly_complete: float = 0.95
    cancelled: float = 0.1
    greatest_confidence: float = 0.99
    incomplete_confidence: float = 0.7
    faint_confidence: float = 0.9
    implausible_confidence: float = 0.05
    own_coordinate: float = 0.8
    recording: float = 2.0
    alike: float = 0.9
    alike_shapes: float = 0.5


RULES = SelectionRules()
"""The rules of ``rig diagnose``."""
