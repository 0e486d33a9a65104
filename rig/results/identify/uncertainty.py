"""Shows the uncertainty of an identification as text, tables and pictures: trade-offs, active
bounds, starts and profiles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from identification.model.parameters import LINEAR
from identification.plots import fit as fit_plots
from identification.result import Identification, MeasuredNoise, Profile, Resampled
from rig.common.tables import interval, number
from rig.results.document import Picture, Table

PROFILE_NOTE = (
    "Profile: the range in which -2 log likelihood rises by at most 2.71, with all other "
    "parameters optimised. Scaled: factor on the likelihood, because the scatter of the scores "
    "contradicts the curvature of the likelihood. Skew: distance of the estimate from the upper "
    "end of the range over its distance from the lower end."
)


BOOTSTRAP_NOTE = (
    "Bootstrap: the central 90 % of estimates from motion segments drawn with replacement. "
    "The bootstrap assumes only that the errors of different segments are independent; with few "
    "segments its ranges are somewhat too narrow."
)


CONSTANTS_NOTE = (
    "The 90 % intervals of the parameters contain the uncertainty (one standard deviation) of "
    "these constants; the values of the parameters are for the constants as given. Floor, "
    "profiles and bootstrap do not contain this uncertainty."
)
PRIORS_NOTE = (
    "Prior and recordings are combined as independent; +- is one standard deviation, which for the "
    "recordings includes the uncertainty of the constants. A prior also changes the values and "
    "intervals of the parameters that correlate with its parameter. Trade-offs, profiles and "
    "bootstrap are from the recordings alone."
)
_MOVED = 4
"""Largest number of parameters in a row of the table of constants."""


def uncertainty_notes(result: Identification) -> list[str]:
    """Return lines on trade-offs, active bounds, and the number of starts that reached the best
    optimum.
    """
    lines = [pair.statement for pair in result.tradeoffs]
    if result.least_pinned:
        lines.append(result.least_pinned)
    hit = [p.name for p in result.parameters.values() if p.at_bound]
    lines.append(f"bounds hit: {', '.join(hit)}" if hit else "bounds hit: none")
    if result.noise:
        lines.append(_noise_statement(result.noise, result.motion))
    lines += [
        f"starts of the {s.stage} stage: {s.best} of {len(s.ends)} "
        + (
            f"solved its estimating equations (chi-square up to {number(s.reached)})"
            if s.absolute
            else "ended at the best"
        )
        for s in result.starts
    ]
    return [f"{result.method}: {line}" for line in lines]


def _noise_statement(noise: MeasuredNoise, motion: str) -> str:
    """Return text on the estimated noise of the recordings."""
    torque = f"torque {number(noise.torque, 3)} {noise.unit} rms, white"
    if noise.correlated:
        over = f"correlated over {number(1e3 * noise.correlation_s, 2)} ms"
        torque += f", and {number(noise.correlated, 3)} {noise.unit} rms, {over}"
    factor, unit = (1e6, "um") if motion == LINEAR else (math.degrees(1.0), "deg")
    step, beyond = (
        f"{number(factor * each, 3)} {unit}" for each in (noise.encoder_step_rad, noise.angle_rad)
    )
    return (
        f"noise estimated from the prediction errors: {torque}; encoder step {step}, and "
        f"{beyond} rms in addition"
    )


def profile_table(result: Identification) -> Table:
    """Return one row for each profile: the 90 % range of the profile and the interval."""
    rows = [_profile_row(curve, result) for curve in result.profiles]
    return Table(
        ("parameter", "90 % interval", "profile", "skew", "scaled", "unit"),
        tuple(rows),
        (1, 2, 3, 4),
    )


def _profile_row(curve: Profile, result: Identification) -> tuple[str, ...]:
    p = result.parameters[curve.name]
    skew = None
    if curve.low is not None and curve.high is not None:
        here = result.fitted[curve.name]
        skew = (curve.high - here) / (here - curve.low)
    reach = interval(curve.low, curve.high) if skew is not None else _open(curve)
    return (
        curve.name,
        interval(p.low, p.high),
        reach,
        number(skew, 3),
        number(curve.scale, 3),
        curve.unit,
    )


def _open(curve: Profile) -> str:
    """Return the range of a profile as text; an end beyond the scanned values is open."""
    low = f"< {curve.values[0]:.4g}" if curve.low is None else f"{curve.low:.4g}"
    high = f"> {curve.values[-1]:.4g}" if curve.high is None else f"{curve.high:.4g}"
    return f"[{low}, {high}]"


def uncertainty_tables(result: Identification) -> list[tuple[Table, str]]:
    """Return the requested tables, each with its note."""
    tables = []
    if result.priors:
        tables.append((priors_table(result), PRIORS_NOTE))
    if result.known_constants:
        tables.append((constants_table(result), CONSTANTS_NOTE))
    if result.profiles:
        tables.append((profile_table(result), PROFILE_NOTE))
    if result.resampled:
        tables.append((bootstrap_table(result), BOOTSTRAP_NOTE))
    return tables


def priors_table(result: Identification) -> Table:
    """Return one row for each prior: the prior, the estimate from the recordings alone, and the
    combined estimate.
    """
    rows = tuple(
        (
            p.name,
            f"{number(p.value)} +- {number(p.uncertainty, 2)}",
            f"{number(p.alone)} +- {number(p.alone_uncertainty, 2)}",
            f"{number(p.posterior)} +- {number(p.posterior_uncertainty, 2)}",
            result.parameters[p.name].unit,
        )
        for p in result.priors
    )
    return Table(("parameter", "prior", "recordings alone", "both", "unit"), rows, (1, 2, 3))


def constants_table(result: Identification) -> Table:
    """Return one row for each uncertain constant: value, uncertainty, and the parameters that it
    changes most.
    """
    rows = []
    for constant in result.known_constants:
        shares = {
            name: shift / value
            for name, shift in constant.shifts.items()
            if (value := result.parameters[name].value)
        }
        most = sorted(shares, key=lambda name: -abs(shares[name]))[:_MOVED]
        rows.append(
            (
                constant.place,
                number(constant.value),
                f"+- {number(constant.uncertainty, 3)}",
                ", ".join(f"{name} {100.0 * shares[name]:+.3g} %" for name in most) or "nothing",
            )
        )
    return Table(
        ("constant", "value", "uncertainty", "changed most by one uncertainty"), tuple(rows), (1, 2)
    )


def bootstrap_table(result: Identification) -> Table:
    """Return one row for each parameter: the spread of the bootstrap estimates and the interval."""
    rows = [_bootstrap_row(r, result) for r in result.resampled]
    return Table(
        ("parameter", "90 % interval", "bootstrap", "draws solved", "unit"), tuple(rows), (1, 2, 3)
    )


def _bootstrap_row(r: Resampled, result: Identification) -> tuple[str, ...]:
    p = result.parameters[r.name]
    return (
        r.name,
        interval(p.low, p.high),
        interval(r.low, r.high),
        f"{r.solved} of {r.draws}",
        r.unit,
    )


def uncertainty_pictures(results: Sequence[Identification]) -> list[Picture]:
    """Return figures of profiles and of costs over starts (for more than one start)."""
    pictures = []
    for result in results:
        several = [s for s in result.starts if len(s.ends) > 1]
        if result.profiles:
            made = fit_plots.profiles(result.profiles, list(result.parameters.values()))
            pictures.append(Picture.of(f"profiles_{result.method}", "Likelihood profiles", made))
        if several:
            made = fit_plots.waterfall(several)
            pictures.append(Picture.of(f"starts_{result.method}", "Where the starts ended", made))
    return pictures
