"""All numbers by which effects are tested, selected and judged, in one frozen record.

All other numbers in this package are settings of numerics (steps, tolerances, grids of trial
values) or constants of nature.
"""

from __future__ import annotations

from dataclasses import dataclass

from identification.result import LEAST_EXPLAINED, MOST_FLOORS
from identification.views.predicted import ACCURACY


@dataclass(frozen=True)
class SelectionRules:
    """Rules of a diagnosis."""

    # Significance level of the tests whether physics, or further physics, is missing. Basis: false
    # alarms in at most 1 % of diagnoses; sign flips of blocks of time have this level by
    # construction (D4, D5).
    level: float = 0.01
    # Ratio of an equation's mean-square mismatch to that of the noise, from which the equation is
    # tested. Basis: some hundred independent rows determine the mean square of the noise to about a
    # tenth (decision 13).
    tested_from: float = 1.1
    # Ratio of the mean-square mismatch to that of the noise, up to which the mismatch is attributed
    # to noise, or counts as explained. Basis: chosen on development trials; the noise may be
    # underestimated, because it is estimated from frequencies above the bandwidth.
    excess: float = 1.5
    # Mismatch, as a share of the greatest torque or voltage, that may be an error of the sensor.
    # Basis: current sensors and converters of drives are linear to 0.1 to 1 %; the share is a fifth
    # of the best of these values.
    accuracy: float = ACCURACY
    # Ratio of the mean-square mismatch of torque or transmission in one recording to that of the
    # noise, up to which the mismatch is attributed to noise. Basis: one recording has a few half
    # cycles, whose mean square scatters more, and too few blocks for sign flips.
    excess_of_one: float = 2.0
    # Power of an effect's contribution, over the power of the noise in the equations of the effect,
    # below which the contribution is negligible. Basis: a tenth of the noise's amplitude.
    least_share: float = 0.01
    # The same for rows of white noise. Basis: effects that are nearly collinear with the nominal
    # constants leave a small remainder, which is significant in white noise.
    least_share_white: float = 5e-4
    # Magnitude of a row, over the noise, from which the row is an outlier. Basis: normal noise
    # exceeds this value in one of 5e8 rows.
    outlier: float = 6.0
    # Share of blocks in which an outlier may occur by chance. Basis: on simulated benches without
    # effects no block has an outlier.
    outlier_blocks: float = 0.01
    # Share of a regressor's norm that remains after projection, below which the regressor counts as
    # collinear with the nominal model. Basis: a smaller remainder would be determined by errors of
    # 0.1 % of the regressor.
    collinear_below: float = 1e-3
    # Least number of blocks in which a regressor must be active (inverse participation ratio).
    # Basis: the variance between blocks needs several.
    least_active: float = 3.0
    # Ratio of the attained to the predicted mean-square torque mismatch, from which a fit is
    # infeasible. Basis: in simulated trials the ratio was 1.00 to 1.03 with the right effects, and
    # 490 000 with an effect with which friction would have had to rise with speed.
    infeasible: float = 1.5
    # Greatest number of effects that are tried, each fitted jointly with the nominal parameters,
    # before one of them is selected. Basis: chosen; the time of a search grows with this number.
    finalists: int = 4
    # Least score of a finalist, relative to the best score. Basis: the gain in a joint fit is at
    # most `gain_ratio` times the score.
    rival_share: float = 0.3
    # Greatest ratio of the gain in a joint fit to the gain that an effect's regressors predict.
    # Basis: chosen; the cause of a larger gain is a change of other parameters than those of the
    # effect.
    gain_ratio: float = 3.0
    # Greatest number of effects that are identified together. Basis: one more than the proofs
    # inject.
    most_effects: int = 3
    # Number of standard errors by which a rival must be worse to be rejected, and by which an
    # effect must reduce the error on unused recordings. Basis: one-sided level of 5 %.
    rejected: float = 1.645
    # Preference, in standard errors, below which the effect with fewer parameters is selected.
    # Basis: one-standard-error rule of cross-validation.
    simpler: float = 1.0
    # Square of the difference of two fits over the square of their mismatch, below which the fits
    # are equal. Basis: a difference of a tenth of the mismatch.
    same_fit: float = 0.01
    # Share of the mismatch beyond the noise that one more effect must explain. Basis: chosen on
    # development trials (decision 13); the error of the first effect's regressor leaves a smaller
    # share.
    further_share: float = 0.4
    # Least gain of one more effect, as a multiple of the error of the regressors of the other
    # effects. Basis: chosen; ten times the gain that this error may cause (decision 13).
    shape_errors: float = 10.0
    # Share of the mismatch beyond the noise from which one more effect is accepted even if its gain
    # is less than `shape_errors` requires. Basis: chosen on development trials (decision 13).
    nearly_all: float = 0.8
    # Greatest number of further searches, each without the effects that were dropped before. Basis:
    # one search for each effect that was selected in place of another (decision 13).
    further_searches: int = 2
    # Number of parts of the cross-validation, made of blocks of time, if one recording alone
    # determines a parameter. Basis: chosen; three quarters of the rows remain for the fit.
    parts: int = 4
    # Share of the squares of a parameter's derivative in one part, above which this part alone
    # determines the parameter. Basis: without this part the standard error of the parameter is ten
    # times as large.
    sole_share: float = 0.99
    # Ratio of the torque that closes a hysteresis loop to the torque of the motion, from which a
    # crossing shows a loop and not a gap. Basis: three times `gap_scatter`.
    loop_share: float = 0.06
    # Standard deviation of this ratio for a gap. Basis: simulated trials with a gap.
    gap_scatter: float = 0.02
    # Least number of crossings that decide between a gap and a loop. Basis: the mean over so many
    # crossings has a third of the scatter of one crossing.
    least_crossings: int = 10
    # Share of the mismatch beyond the noise that travel or time since the last reversal must
    # explain for the mismatch to count as hysteretic. Basis: chosen on development trials.
    hysteretic_share: float = 1.0 / 3.0
    # Share of the mismatch's power beyond the noise that the effects must explain together. Basis:
    # chosen on development trials; the proofs in docs/measurements.md were run with this value.
    adequate: float = 0.70
    # The same in an equation with white noise. Basis: the gas balance, unlike friction, has no
    # unmodelled details, so that the right effect explains nearly all.
    adequate_white: float = 0.9
    # Share of the mismatch's power beyond the noise that the remaining effects must explain if
    # others were dropped because they do not reduce the error on unused recordings. Basis: chosen;
    # more than half must be explained.
    adequate_after_removal: float = 0.5
    # Share of the mismatch's power beyond the noise that right effects explain. If the effects
    # explain less, the remainder is tested for hysteresis; if they explain less on recordings set
    # aside, further physics counts as missing. Basis: in simulated trials right effects explained
    # at least 95.9 %, springs in place of hysteresis 76 to 89 %.
    nearly_complete: float = 0.95
    # Power of the sum of two contributions over the sum of their powers, below which the two
    # contributions cancel each other. Basis: for independent contributions the ratio is 1 on
    # average; below the limit, each of two equal contributions is more than twice their sum.
    cancelled: float = 0.1
    # Greatest confidence in any effect. Basis: chosen; on machines made by others an identified
    # effect is right less often (docs/measurements.md).
    greatest_confidence: float = 0.99
    # Greatest confidence in an effect if the test finds further missing physics, or in an effect
    # that was not selected first and whose mismatch is faint. Basis: on three simulators 22 of 33
    # such effects were right (48 to 82 %).
    incomplete_confidence: float = 0.7
    # Greatest confidence in an effect whose mismatch is faint. Basis: another effect may cause a
    # tenth of the mismatch (docs/measurements.md).
    faint_confidence: float = 0.9
    # Greatest confidence in an effect that recordings set aside selected, or that is not separated
    # from a function of speed or load. Basis: an even chance.
    undecided_confidence: float = 0.5
    # Confidence in a rival that fits as well, but with a parameter outside its plausible range.
    # Basis: the one-sided level of 5 % of `rejected`.
    implausible_confidence: float = 0.05
    # Ratio of the share of the mismatch that the catalogue's coordinate of an effect explains to
    # the greatest share of any coordinate, from which the catalogue's coordinate is reported.
    # Basis: chosen on development trials.
    own_coordinate: float = 0.8
    # Share of the mean square of blocks left out that an empirical curve must remove. Basis: a
    # curve through noise removes nothing of them; a smaller share is not worth the curve.
    least_curve_gain: float = 0.05
    # Share of the torque's power that the nominal model must explain for the verdict *nothing
    # missing*. Basis: a model that explains less than half does not describe the machine.
    explained: float = LEAST_EXPLAINED
    # Ratio of the error to the noise floor up to which nothing is missing. Basis: as `excess`, of
    # an amplitude.
    floors: float = MOST_FLOORS
    # Ratio of the error to the noise floor from which a model leaves physics unexplained if its
    # effects explain less than `nearly_complete`. Basis: eight ninths of such an error's power are
    # no noise.
    floors_left: float = 3.0
    # Greatest confidence in effects that leave so much. Basis: chosen; of seven such effects on
    # real machines five are right (29 to 96 %).
    part_confidence: float = 0.4
    # Ratio of a recording's mean-square mismatch to that of the noise, from which the mismatch is
    # present in the recording. Basis: equal to `excess_of_one`.
    recording: float = 2.0
    # Share of an effect's regressor that another effect explains, from which the two are
    # indistinguishable. Basis: the definition of an alias group.
    alike: float = 0.9
    # Share of an effect's trial parameters at which another effect must explain the share `alike`
    # of the regressor. Basis: chosen; most of the trial parameters.
    alike_shapes: float = 0.5


RULES = SelectionRules()  # the rules of `rig diagnose`
