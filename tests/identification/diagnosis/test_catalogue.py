"""Every effect is one class, whose words, parameters and regressors agree."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from identification.diagnosis.comparison import UNSCALED, _scale
from identification.diagnosis.rows import EQUATIONS, equations
from identification.diagnosis.stack import Stack, stack_of
from identification.effects import EFFECTS, GAS, MOTION
from identification.effects.effect import Context, Dimension, Effect
from identification.views.nominal import Nominal
from identification.views.view import views

from .benches import honest

TRUE = {
    "Mc": 6.825,
    "Ms": 12.025,
    "omega_sf": 0.0557,
    "sigma_2": 5.3462,
    "J": 0.204,
    "mu_c": 0.052,
    "mu_s": 0.086,
    "omega_sL": 0.0326,
    "mu_2": 0.032,
}


@lru_cache
def bench() -> tuple[Context, Stack]:
    here = views([r for r in honest() if r.role == "fit"], 25.0)
    nominal = Nominal(TRUE, tuple(TRUE), 2.0)
    return Context(here, nominal), stack_of(equations(here, nominal, "N m"), nominal)


def test_the_gas_generator_has_effects_of_its_own() -> None:
    assert len(EFFECTS) == len(MOTION) + len(GAS), "a name stands for two effects"
    assert {e.name for e in EFFECTS.values() if e.shows_in == "pressure"} == {e.name for e in GAS}
    for effect in GAS:
        assert [effect.linear, *effect.nonlinear] == [q.name for q in effect.parameters]
        assert len(set(effect.slots)) == len(effect.parameters)


@pytest.mark.parametrize("term", MOTION, ids=lambda t: t.name)
def test_fitted_values_are_the_parameters_and_back(term: Effect) -> None:
    context, stack = bench()
    shapes = term.shapes(context)
    if term.name in ("load_dependent_friction", "friction_play", "gear_friction", "encoder_ripple"):
        assert not shapes
        return
    columns = stack.columns(term, shapes[0])
    assert columns
    assert set(term.columns) <= set(EQUATIONS)
    width = {c.shape[1] for c in columns.values()}
    assert len(width) == 1
    found = term.read(np.full(width.pop(), 0.5), shapes[0], context)
    assert set(found) == {q.name for q in term.parameters}
    assert all(np.isfinite(v) for v in found.values())
    for index, (_, most) in term.limits.items():
        greatest = list(shapes[0])
        greatest[index] = most if np.isfinite(most) else greatest[index]
        read = term.read(np.full(1, 0.5), tuple(greatest), context)
        assert all(lo <= read[n] <= hi for n in read for lo, hi in [term.physical_range(n)])


@pytest.mark.parametrize("term", MOTION, ids=lambda t: t.name)
def test_an_effect_enters_the_equation_in_which_it_shows(term: Effect) -> None:
    assert term.shows_in in term.columns


def test_the_plausible_range_of_every_parameter_scales_with_the_machine() -> None:
    context = bench()[0]
    for dimension in {q.dimension for e in MOTION for q in e.parameters} - UNSCALED:
        assert _scale(dimension, context.views, context.nominal) > 0.0
    assert {q.dimension for e in GAS for q in e.parameters} <= UNSCALED
    with pytest.raises(KeyError):
        _scale(Dimension.HEAT_FLOW, context.views, context.nominal)


@pytest.mark.parametrize(
    ("name", "coefficient", "shape", "without"),
    [
        ("asymmetric_coulomb", 0.5, (), {"torque_Nm": 0.0}),
        ("transmission_efficiency", 0.25, (), {"efficiency": 1.0}),
        ("wrong_weight", 0.2, (2.0,), {"mass_kg": 10.0}),
        ("compliance", 1e-3, (), {"stiffness_Nm_rad": 0.0}),
        ("stribeck_shape", 1.0, (1.5, 1.0), {"alpha": 2.0}),
        ("load_exponent", 1.0, (0.8,), {"exponent": 1.0}),
        ("presliding", 1.0, (3e3,), {"stiffness_Nm_rad": 0.0}),
        ("coulomb_drift", 0.02, (60.0,), {"rate_Nm_s": 0.0}),
        ("position_dependent_friction", 1.0, (0.1, 0.05), {"torque_Nm": 0.0}),
    ],
)
def test_an_effect_states_the_sizes_that_mean_it_is_absent(name, coefficient, shape, without):
    """Of a stiffness, which is then infinite, an interval that contains zero is as wide as it."""
    sizes = EFFECTS[name].absent(np.array([coefficient]), shape, bench()[0])
    assert sizes == pytest.approx(without)


def test_a_wave_needs_a_period_of_travel_and_presliding_a_reversal() -> None:
    context = bench()[0]
    turn = max(float(np.ptp(v.motor)) for v in context.views) / (2.0 * np.pi)

    def least(name: str, turns: float) -> float:
        here = tuple(
            replace(v, motor=v.motor * turns / turn, angle=v.angle * turns / turn)
            for v in context.views
        )
        shapes = EFFECTS[name].shapes(replace(context, views=here))
        return min((shape[0] for shape in shapes), default=np.inf)

    for name in ("cogging", "torque_ripple"):
        assert (least(name, 0.26), least(name, 0.01)) == (4.0, np.inf)
    seat = EFFECTS["encoder_eccentricity"]
    assert not seat.shows_a_period(context.views), "the joint of the bench turns by 44 deg"
    assert seat.shows_a_period([replace(v, angle=10.0 * v.angle) for v in context.views])
    presliding = EFFECTS["presliding"]
    one_way = tuple(replace(v, sense=np.ones(len(v.time))) for v in context.views)
    assert presliding.shapes(context)
    assert not presliding.shapes(replace(context, views=one_way))


def test_the_true_values_leave_only_noise() -> None:
    _, stack = bench()
    torque = stack.residual[stack.part("torque")]
    assert 0.7 < np.sqrt(np.mean(torque**2)) < 1.2
    assert np.max(np.abs(torque)) < 6.0
