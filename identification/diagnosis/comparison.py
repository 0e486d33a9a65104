"""Compares fits by the preference of the data, the number of parameters, and plausibility."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from identification.diagnosis.joint import Added, Joint
from identification.diagnosis.rules import RULES
from identification.diagnosis.stack import Candidate
from identification.diagnosis.within_limits import infeasible
from identification.effects.device import REFERENCE_MASS_KG
from identification.effects.effect import Context, Dimension
from identification.model.parameters import LINEAR, parameter_title
from identification.recording import Array
from identification.views.nominal import Nominal
from identification.views.view import View, speed_scale, torque_scale, travel_scale

USUAL_CURRENT_A, USUAL_VOLTAGE_V, USUAL_INERTIA_KG_M2 = 13.0, 40.0, 0.2
"""Greatest current and voltage, and inertia at the joint, on the practical bench."""
UNSCALED = frozenset(
    {
        Dimension.NUMBER,
        Dimension.CYCLES,
        Dimension.TIME,
        Dimension.FREQUENCY,
        Dimension.PHASE,
        Dimension.ANGLE,
        Dimension.LAYER_RATE,
        Dimension.TAPER,
        Dimension.EROSION,
        Dimension.HEAT_FLOW,
        Dimension.AREA,
    }
)
"""Dimensions whose ranges are the same on every bench."""


@dataclass(frozen=True)
class Contender:
    """A rival, fitted jointly with the nominal parameters, and the preference of the data for the
    selected effect over this rival.

    ``preference`` is the result of :func:`preference`, in standard errors. ``beyond`` is a text
    that names a parameter outside its plausible range, or empty if all parameters are plausible.
    """

    name: str
    joint: Joint
    preference: float
    beyond: str

    @property
    def open(self) -> bool:
        """Whether the data do not reject the rival, and its parameters are plausible."""
        return self.preference < RULES.rejected and not self.beyond

    @property
    def effect(self) -> Added:
        """The rival as it was fitted."""
        return next(e for e in self.joint.effects if e.term.name == self.name)


@dataclass(frozen=True)
class Round:
    """A selected effect and its rivals, best first.

    ``unconfirmed`` states that unused recordings selected the effect. They are used up thereby, so
    that no recording is left that confirms it.
    """

    name: str
    rivals: tuple[Contender, ...]
    unconfirmed: bool = False


def preference(chosen: Joint, rival: Joint, spread: float | None = None) -> float:
    """Return the preference of the data for ``chosen``, in standard errors of the difference: in
    ``spread``, or if it is None by blocks.

    A fit with more parameters explains more in any case, and the difference of two nearly equal
    fits has a small standard error. Therefore the preference is computed without and with Schwarz's
    correction for the number of parameters, and the result is the value of smaller magnitude; 0 if
    the two values have opposite signs.
    """
    loss, by_blocks = _loss(chosen, rival)
    spread = by_blocks if spread is None else spread
    if spread <= 0.0:
        return 0.0
    plain, corrected = loss / spread, (loss + _penalty(chosen, rival)) / spread
    if plain * corrected <= 0.0:
        return 0.0
    return min(plain, corrected, key=abs)


def advantage(chosen: Joint, rival: Joint, corrected: bool = False) -> float:
    """Return by how much ``chosen`` is better than ``rival``, in standard errors of the difference
    by blocks, without or with Schwarz's correction for the number of parameters (Vuong,
    Econometrica 57 (1989) 307).
    """
    loss, spread = _loss(chosen, rival)
    loss = loss + _penalty(chosen, rival) if corrected else loss
    return loss / spread if spread > 0.0 else 0.0


def _penalty(chosen: Joint, rival: Joint) -> float:
    """Return Schwarz's correction: log n squares for each further parameter of the rival."""
    more = _effect_parameters(rival) - _effect_parameters(chosen)
    return more * math.log(len(chosen.residual))


def _loss(chosen: Joint, rival: Joint) -> tuple[float, float]:
    """Return the difference of the whitened squares of two fits, and its standard error, which is 0
    if there is only one block of time, because one block shows no scatter.
    """
    stack = chosen.stack
    loss = stack.sums((rival.residual**2 - chosen.residual**2)[:, None])[:, 0]
    white = all(e.white for e in chosen.equations)
    if white and float(np.mean(chosen.residual**2)) <= RULES.tested_from:
        # White noise is left, so that the variance is known and need not be estimated from blocks.
        return float(np.sum(loss)), 2.0 * float(np.linalg.norm(rival.residual - chosen.residual))
    if len(loss) < 2:
        return float(np.sum(loss)), 0.0
    return float(np.sum(loss)), float(np.std(loss, ddof=1)) * math.sqrt(len(loss))


def _effect_parameters(joint: Joint) -> int:
    """Return the number of fitted parameters of all effects of a fit."""
    return sum(parameter_count(e) for e in joint.effects)


def probability(preferred: float) -> float:
    """Return the probability, by the normal distribution, that the preferred of two effects is the
    right one, from the preference in standard errors.
    """
    return float(stats.norm.cdf(preferred))


def implausible(joint: Joint) -> str:
    """Return the reason why a fit is implausible for a bench; empty if it is plausible.

    The reason is a parameter of an effect outside its range in the catalogue, scaled to this bench,
    or an infeasible fit (:func:`infeasible`), for example a fit whose static friction would
    be below Coulomb friction.
    """
    for effect in joint.effects:
        if why := effect.term.impossible(effect.coefficients, joint.nominal):
            return why
    if infeasible(joint):
        return "nominal parameters outside their physical limits"
    return next(filter(None, (_beyond_range(joint, e) for e in reversed(joint.effects))), "")


def _beyond_range(joint: Joint, effect: Added) -> str:
    """Return the first parameter of an effect outside its range, with the range, or nothing."""
    views = joint.views
    found = effect.parameters(Context(views, joint.nominal))
    motion = views[0].recording.bench.motion
    for q in effect.term.parameters:
        scale = 1.0
        if isinstance(q.dimension, Dimension) and q.dimension not in UNSCALED:
            scale = _scale(q.dimension, views, joint.nominal)
        low = q.low * (max(1.0, scale) if q.low < 0.0 else min(1.0, scale))
        high = q.high * max(1.0, scale)
        if motion == LINEAR and q.dimension is Dimension.ANGLE:
            # A range in rad does not apply to m; it is scaled by the ratio of the travels of the
            # two benches.
            low, high = (limit * travel_scale(views) for limit in (q.low, q.high))
        if not low <= found[q.name] <= high:
            name = parameter_title(motion, q.name)
            return (
                f"{name} = {found[q.name]:.3g}, outside the plausible range {low:.3g} to {high:.3g}"
            )
    return ""


def _scale(dimension: Dimension, views: Sequence[View], nominal: Nominal) -> float:
    """Return the scale of this bench relative to the practical bench, to which ranges refer."""
    torque, speed, angle = torque_scale(views), speed_scale(views), travel_scale(views)
    current = _greatest([v.current for v in views], USUAL_CURRENT_A)
    mass = max(v.recording.weight_mass for v in views) / REFERENCE_MASS_KG
    voltage = _greatest([v.voltage for v in views], USUAL_VOLTAGE_V)
    # A slow motion needs a small part of the supply voltage; the resistance of the supply does not
    # follow the motion.
    supply = _greatest([c for v in views for c in (v.voltage, v.supply)], USUAL_VOLTAGE_V)
    scales = {
        Dimension.CURRENT: current,
        Dimension.CURRENT_RATE: current,
        Dimension.VOLTAGE: voltage,
        Dimension.RESISTANCE: supply / current,
        Dimension.THERMAL_RESISTANCE: 1.0 / (voltage * current),
        Dimension.MASS: mass,
        Dimension.TORQUE: torque,
        Dimension.TORQUE_RATE: torque,
        Dimension.SLOPE: 1.0 / angle,
        Dimension.STIFFNESS: torque / angle,
        Dimension.VISCOSITY: torque / speed,
        Dimension.DRAG: torque / speed**2,
        Dimension.STRAY: torque / (current**2 * speed),
        # The inertia of a load is stated for the reference mass. The scale is that of the
        # identified inertia too, because a fast machine moves more inertia than follows from
        # torque, travel and speed.
        Dimension.INERTIA: max(torque * angle / speed**2, nominal.get("J") / USUAL_INERTIA_KG_M2)
        / (mass or 1.0),
    }
    return scales[dimension]


def _greatest(channels: Sequence[Array | None], usual: float) -> float:
    """Return the greatest absolute value over the usual value; 1 if nothing was recorded."""
    known = [float(np.nanmax(np.abs(c))) for c in channels if c is not None]
    return max(known, default=usual) / usual or 1.0


def simplest(joints: Sequence[Joint], sizes: Sequence[int]) -> int:
    """Return the index of the fit with the fewest parameters among the fits that are less than
    `simpler` standard errors worse than the best fit; of fits with equally many parameters the
    first. The best fit and the differences are computed with Schwarz's correction for the number of
    parameters.
    """
    best = min(joints, key=lambda j: j.cost + _effect_parameters(j) * math.log(len(j.residual)))
    near = [
        k
        for k, joint in enumerate(joints)
        if joint is best or advantage(best, joint, corrected=True) < RULES.simpler
    ]
    return min(near, key=lambda k: (sizes[k], k))


def preferred(name: str, preference: float, beyond: str = "") -> str:
    """Return a text that states why an effect is preferred to another effect."""
    if preference > 0.0:
        return f"preferred to {name} by {preference:.1f} standard errors"
    if beyond:
        return f"{name} fits as well or better, but only with {beyond}"
    return (
        f"{name} fits as well or better, but by no more than its additional parameters explain by "
        "chance"
    )


def parameter_count(effect: Added) -> int:
    """Return the number of fitted parameters of an effect."""
    return effect.term.freedom + len(effect.coefficients)


def contains(rival: Added, its: Joint, chosen: Added, best: Joint) -> bool:
    """Whether a rival contains the chosen effect as a special case, that is, has more parameters
    and an equal fit. Such a rival is not in the alias group.
    """
    difference = its.residual - best.residual
    return (
        parameter_count(rival) > parameter_count(chosen)
        and float(difference @ difference) < RULES.same_fit * best.cost
    )


def one_of_each(trials: Sequence[tuple[Candidate, Joint]]) -> tuple[list[Candidate], list[Joint]]:
    """Return the best candidate and fit of each effect, in the given order."""
    best: dict[str, tuple[Candidate, Joint]] = {}
    for candidate, joint in trials:
        if candidate.name not in best or joint.cost < best[candidate.name][1].cost:
            best[candidate.name] = candidate, joint
    return [c for c, _ in best.values()], [j for _, j in best.values()]
