"""Computes the regressors of friction effects that eq. 9 and 13 omit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from identification.diagnosis.rows.nominal import SPEEDS, Nominal
from identification.diagnosis.rows.recent import recent
from identification.diagnosis.rows.scales import torque_scale, travel_scale
from identification.diagnosis.rows.view import View
from identification.diagnosis.terms.memory import dahl, first_order_lag
from identification.diagnosis.terms.term import (
    CLOSE,
    EXACT,
    Context,
    Shape,
    Term,
    in_motion,
    one,
    rows,
    shaped,
)
from identification.recording import Array

AT_START_S = 0.02
"""Duration over which a straight line is fitted to the torque to determine the presliding force at
the start, s.
"""
ALPHAS = (0.5, 0.7, 0.9, 1.2, 1.5, 2.6, 3.4, 4.5)
SAME_FALL = (0.6, 0.1)
"""Shares of the rise that remain at the speed at which the friction with a trial exponent equals
the nominal friction. The right share depends on the speeds of the recordings.
"""
LEVEL_OR_SPEED = (0.0, 1.0)
"""Quantity that lags: the level of friction (0), or the speed on which this level depends (1)."""
LAGS: tuple[Shape, ...] = tuple(
    (t, of_speed) for of_speed in LEVEL_OR_SPEED for t in (0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
)
DWELLS_S: tuple[Shape, ...] = tuple((t,) for t in (0.1, 0.3, 1.0, 3.0, 10.0))
STIFFNESSES = np.geomspace(3e2, 1e6, 15)
"""Trial stiffnesses of presliding on the practical bench, N m/rad."""
STEADY_S = 1e6
"""Time constant of a drift that does not level off, s."""
WARM_UPS_S: tuple[Shape, ...] = tuple((t,) for t in (20.0, 60.0, 150.0, 400.0))
PATCH_CENTRES = 12
PATCH_WIDTHS = (0.02, 0.05, 0.12)
"""Trial widths (standard deviations) of a worn patch, relative to the travel."""


def _stribeck_shape(view: View, nominal: Nominal, shape: Shape) -> Array:
    total = _fall(view, nominal, "omega_sf", shape) * (nominal.get("Ms") - nominal.get("Mc"))
    if view.loaded:
        rise = view.moment * (nominal.get("mu_s") - nominal.get("mu_c"))
        total = total + _fall(view, nominal, "omega_sL", shape) * rise
    return rows(view.sense * total)


def _fall(view: View, nominal: Nominal, name: str, shape: Shape) -> Array:
    omega_s = nominal.get(name)
    if omega_s <= 0.0:
        return np.zeros(len(view.velocity))
    alpha, wider = shape
    return np.asarray(
        _falls(view, omega_s, alpha, wider) - _falls(view, omega_s, nominal.alpha, 1.0)
    )


@recent
def _falls(view: View, omega_s: float, alpha: float, wider: float) -> Array:
    return np.asarray(np.exp(-((np.abs(view.velocity) / omega_s / wider) ** alpha)))


def _exponents(context: Context) -> list[Shape]:
    """Return trial exponents, each with a ratio of the trial to the nominal Stribeck speed. With
    this ratio trial and nominal friction are equal at the speed at which a share :data:`SAME_FALL`
    of the rise remains.
    """
    usual = context.nominal.alpha
    return [
        (a, float((-np.log(share)) ** (1.0 / usual - 1.0 / a)))
        for a in ALPHAS
        for share in SAME_FALL
    ]


def _start_with_exponent(nominal: Nominal, shape: Shape) -> tuple[Nominal, Shape]:
    """Return nominal values with Stribeck speeds multiplied by the ratio in the trial parameters,
    as start values of a joint fit.
    """
    alpha, wider = shape
    values = {n: v * wider if n in SPEEDS else v for n, v in nominal.values.items()}
    return replace(nominal, values=values, fitted_alpha=alpha), (alpha, 1.0)


@recent
def _level(view: View, nominal: Nominal) -> Array:
    """Return the part of friction that is not proportional to speed, without its sign, N m."""
    total = nominal.level(view) - nominal.get("sigma_2") * np.abs(view.velocity)
    if view.loaded:
        slope = nominal.get("mu_2") * np.abs(view.velocity)
        total = total + view.moment * (nominal.coefficient(view) - slope)
    return np.asarray(total)


def _memory(view: View, nominal: Nominal, shape: Shape) -> Array:
    time_s, of_speed = shape
    level = _level(view, nominal)
    late = (
        _level(_with_lagged_speed(view, time_s), nominal)
        if of_speed
        else first_order_lag(level, view.step, time_s)
    )
    if nominal.presliding_stiffness:  # the presliding deflection then has the lag
        start = _initial_friction(view, nominal)
        late, level = (
            dahl(view.angle, each, nominal.presliding_stiffness, start) for each in (late, level)
        )
        return rows(late - level)
    return rows(view.sense * (late - level))


@recent
def _with_lagged_speed(view: View, time_s: float) -> View:
    """Return the view with its speed after a first-order lag."""
    return replace(view, velocity=first_order_lag(view.velocity, view.step, time_s))


def _presliding(view: View, nominal: Nominal, shape: Shape) -> Array:
    level = _level(view, nominal)
    return rows(
        dahl(view.angle, level, shape[0], _initial_friction(view, nominal)) - view.sense * level
    )


def _stiffnesses(context: Context) -> list[Shape]:
    """Return trial stiffnesses of presliding, at the scale of this bench."""
    scale = torque_scale(context.views) / travel_scale(context.views)
    return [(float(k * scale),) for k in STIFFNESSES]


def _start_with_presliding(nominal: Nominal, shape: Shape) -> tuple[Nominal, Shape]:
    """Return nominal values with the presliding stiffness, for the regressors of other effects."""
    return replace(nominal, presliding_stiffness=shape[0]), shape


@recent
def _initial_friction(view: View, nominal: Nominal) -> float:
    """Return the friction that balances the drive's torque at rest at the start of a recording, N
    m.

    The presliding stiffness of a resting joint may hold any friction up to the static friction in
    either direction, which depends on the motion before the recording. The friction at the start is
    therefore computed from the measured torque. Its contribution decays with the first slip, so
    that an error of the friction at the start cannot explain any other mismatch.
    """
    places = np.arange(max(2, round(AT_START_S / view.step)))
    left = view.torque[places] - nominal.get("J") * view.acceleration[places]
    return float(np.polyval(np.polyfit(places, left, 1), 0.0))


def _patch(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return rows(view.sense * np.exp(-0.5 * ((view.angle - shape[0]) / shape[1]) ** 2))


def _patches(context: Context) -> list[Shape]:
    low = min(float(np.min(v.angle)) for v in context.views)
    high = max(float(np.max(v.angle)) for v in context.views)
    centres = np.linspace(low, high, PATCH_CENTRES + 2)[1:-1]
    return [(float(c), w * (high - low)) for c in centres for w in PATCH_WIDTHS]


# The friction that is added during a rest vanishes after a short travel: it appears at the
# breakaway and not in steady motion.
def _dwell(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return rows(view.sense * (1.0 - np.exp(-_last_rest(view) / shape[0])))


def _last_rest(view: View) -> Array:
    """Return the duration of the last rest at each sample, s; the sample that ends a rest has the
    duration of this rest.
    """
    return np.asarray(np.maximum(view.rest_time, np.roll(view.rest_time, 1)))


def _thermal(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return rows(view.velocity * (1.0 - _left_of_the_start(view, shape)))


def _coulomb_drift(view: View, _nominal: Nominal, shape: Shape) -> Array:
    return rows(-view.sense * shape[0] * np.expm1(-view.run_time / shape[0]))


def _left_of_the_start(view: View, shape: Shape) -> Array:
    """Return the remaining share of a state that decays from 1 at the start of the running time,
    shape (m,).
    """
    return np.asarray(np.exp(-view.run_time / shape[0]))


TERMS = (
    Term(
        "asymmetric_coulomb",
        in_motion(lambda v, _n, _s: rows(np.ones(len(v.time)))),
        one("torque_Nm"),
        shape_error=EXACT,
    ),
    Term(
        "asymmetric_viscous",
        in_motion(lambda v, _n, _s: rows(np.abs(v.velocity))),
        one("coefficient_Nms_rad"),
        shape_error=CLOSE,
    ),
    Term(
        "quadratic_drag",
        in_motion(lambda v, _n, _s: rows(v.velocity * np.abs(v.velocity))),
        one("coefficient_Nms2_rad2"),
        positive=(0,),
    ),
    Term(
        "stribeck_shape",
        {"torque": _stribeck_shape},
        shaped("alpha"),
        _exponents,
        refine={0: 0.0},
        positive=(0,),
        size=1.0,
        follows=True,
        limits={0: (0.3, 8.0)},
        begin=_start_with_exponent,
    ),
    Term(
        "friction_memory",
        {"torque": _memory},
        lambda _coefficients, shape, _context: {"time_s": shape[0], "of_speed": shape[1]},
        lambda _context: LAGS,
        refine={0: 0.0},
        forms={1: LEVEL_OR_SPEED},
        positive=(0,),
        size=1.0,
        follows=True,
        shape_error=EXACT,
    ),
    Term(
        "dwell_static_friction",
        {"breakaway": _dwell},
        lambda c, shape, _context: {"growth_Nm": float(c[0]), "time_s": shape[0]},
        lambda _context: DWELLS_S,
        refine={0: 0.0},
        positive=(0,),
    ),
    Term(
        "presliding",
        {"torque": _presliding},
        shaped("stiffness_Nm_rad"),
        _stiffnesses,
        refine={0: 0.0},
        positive=(0,),
        size=1.0,
        follows=True,
        begin=_start_with_presliding,
        shape_error=CLOSE,
    ),
    Term(
        "position_dependent_friction",
        in_motion(_patch),
        lambda c, shape, _context: {
            "torque_Nm": float(c[0]),
            "center_rad": shape[0],
            "width_rad": shape[1],
        },
        _patches,
        refine={0: 0.1, 1: 0.0},
        at_angle=True,
        shape_error=CLOSE,
    ),
    Term(
        "viscous_thermal_drift",
        in_motion(_thermal),
        lambda c, shape, context: {
            "fraction": -float(c[0]) / max(context.nominal.get("sigma_2"), 1e-300),
            "time_s": shape[0],
        },
        lambda context: WARM_UPS_S if context.nominal.get("sigma_2") > 0.0 else (),
        refine={0: 0.0},
        start=in_motion(lambda v, _n, s: rows(v.velocity * _left_of_the_start(v, s))),
        shape_error=EXACT,
    ),
    Term(
        "coulomb_drift",
        in_motion(_coulomb_drift),
        lambda c, shape, _context: {"rate_Nm_s": float(c[0]), "time_s": shape[0]},
        lambda _context: (*WARM_UPS_S, (STEADY_S,)),
        refine={0: 0.0},
        start=in_motion(lambda v, _n, s: rows(v.sense * _left_of_the_start(v, s))),
        shape_error=EXACT,
    ),
)
