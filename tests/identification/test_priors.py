"""Priors of parameters, and the uncertainty of known constants in their intervals."""

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.covariance import uncertain_constants, with_priors
from identification.estimate.default import identify
from identification.numerics.spread import Spread
from identification.recording import Dataset, Model, Pendulum, Recording
from identification.result import Parameter
from tests.identification.synthetic import TRUTH, sine

NAMES = ("Mc", "sigma_2", "J")


def solved(rows: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least squares with unit variance: estimate and covariance."""
    information = rows.T @ rows
    return np.linalg.solve(information, rows.T @ wanted), np.linalg.inv(information)


def test_priors_are_one_more_row_each() -> None:
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(40, 3)) @ np.array([[1.0, 0.9, 0.0], [0.0, 0.3, 0.1], [0.0, 0.0, 1.0]])
    wanted = rows @ np.array([5.0, 2.0, 3.0]) + rng.normal(size=40)
    x, covariance = solved(rows, wanted)
    known = {"Mc": (5.5, 0.2), "J": (2.5, 0.1)}
    found, spread, used, warnings = with_priors(
        dict(zip(NAMES, map(float, x), strict=True)), Spread(NAMES, covariance, 37.0), known
    )
    more = np.array([[1.0 / 0.2, 0.0, 0.0], [0.0, 0.0, 1.0 / 0.1]])
    both, joint = solved(np.vstack([rows, more]), np.append(wanted, [5.5 / 0.2, 2.5 / 0.1]))
    assert [found[n] for n in NAMES] == pytest.approx(both)
    assert spread.matrix == pytest.approx(joint)
    assert [p.name for p in used] == ["Mc", "J"]
    assert used[0].alone == pytest.approx(x[0])
    assert used[0].posterior_uncertainty == pytest.approx(math.sqrt(joint[0, 0]))
    assert not [w for w in warnings if "has no effect" in w]


def test_contradictions_and_priors_of_what_is_absent_are_told() -> None:
    spread = Spread(NAMES, np.diag([0.01, 0.01, 0.01]), 30.0)
    *_, warnings = with_priors(
        {"Mc": 5.0, "sigma_2": 2.0, "J": 3.0}, spread, {"Mc": (7.0, 0.1), "mu_c": (0.1, 0.01)}
    )
    assert any("the prior of mu_c has no effect" in w for w in warnings)
    assert any("14.1 standard deviations apart" in w for w in warnings)
    found, _, _, warnings = with_priors(
        {"Mc": 5.0, "Ms": 5.1}, Spread(("Mc", "Ms"), np.eye(2), 30.0), {"Mc": (6.0, 1e-3)}
    )
    assert found["Ms"] == found["Mc"] == pytest.approx(6.0, abs=1e-3)
    assert any("Ms is set to the limit of its range" in w for w in warnings)


def test_an_identification_follows_its_priors() -> None:
    def noise(n: int) -> np.ndarray:
        return np.asarray(np.random.default_rng(n).normal(0.0, 0.3, n))

    dataset = Dataset((sine(noise=noise),))
    alone = identify(dataset, bandwidth_Hz=100.0)
    wished = replace(dataset, model=Model(priors={"J": (0.3, 1e-4), "Mc": (6.0, 1e3)}))
    found = identify(wished, bandwidth_Hz=100.0)
    j, mc = found.priors
    assert found.parameters["J"].value == pytest.approx(0.3, abs=1e-3)
    assert j.alone == alone.fitted["J"] == pytest.approx(TRUTH["J"], rel=0.3)
    assert mc.posterior_uncertainty <= mc.alone_uncertainty
    assert found.fit.train_rms > alone.fit.train_rms
    assert alone.priors == ()


NORMAL_90 = 1.6448536


def driven(recording: Recording, **uncertainties: float) -> Recording:
    """The same recording with the current in place of the torque."""
    channels = {k: v for k, v in recording.channels.items() if k != "torque"}
    channels["current"] = recording.channels["torque"] / recording.bench.ampere_torque
    places = {place.replace("__", "."): value for place, value in uncertainties.items()}
    return replace(recording, channels=channels, uncertainties=places)


def noise(n: int) -> np.ndarray:
    return np.asarray(np.random.default_rng(n).normal(0.0, 0.05, n))


def test_a_torque_constant_scales_all_that_is_measured_in_torque() -> None:
    exact = [driven(sine(noise=noise)), driven(sine(weight=30.6, name="load", noise=noise))]
    unsure = [replace(r, uncertainties={"bench.torque_constant": 0.003}) for r in exact]
    bare, result = (identify(Dataset(tuple(r)), bandwidth_Hz=100.0) for r in (exact, unsure))
    assert bare.known_constants == ()
    (constant,) = result.known_constants
    assert (constant.place, constant.value) == ("bench.torque_constant", 0.03)
    for name, share in (("Mc", 0.1), ("J", 0.1), ("mu_c", 0.1), ("omega_sf", 0.0)):
        p, own = result.parameters[name], bare.parameters[name]
        assert constant.shifts[name] == pytest.approx(share * TRUTH[name], abs=0.02 * TRUTH[name])
        assert p.value == own.value
        assert half(p) >= NORMAL_90 * abs(constant.shifts[name])
        assert half(p) == pytest.approx(
            np.hypot(half(own), NORMAL_90 * constant.shifts[name]), rel=0.05
        )


def half(parameter: Parameter) -> float:
    return 0.5 * (parameter.high - parameter.low)


def test_a_weight_moves_only_what_it_loads() -> None:
    loaded = replace(sine(weight=30.6, name="load"), uncertainties={"weight_mass": 3.06})
    dataset = Dataset((sine(), loaded, replace(loaded, name="again")))
    assert len(uncertain_constants(dataset.recordings)) == 1
    (constant,) = identify(dataset, bandwidth_Hz=100.0).known_constants
    assert constant.shifts["Mc"] == pytest.approx(0.0, abs=1e-9)
    assert constant.shifts["mu_c"] == pytest.approx(-0.1 * TRUTH["mu_c"], rel=0.05)


def test_a_pendulums_mass_moves_the_inertia_by_its_own() -> None:
    pendulum = Pendulum(mass=3.0, length=0.4, zero=0.2)
    hung = replace(sine(pendulum=pendulum), uncertainties={"pendulum.mass": 0.03})
    (constant,) = identify(Dataset((hung,)), bandwidth_Hz=100.0).known_constants
    # The drive's torque stays: more weight leaves less inertia, and more of its gravity is taken
    # for the acceleration of the sine, which is proportional to the angle.
    stiffness = 9.80665 * 0.4 * 0.03
    expected = -0.03 * 0.4**2 + stiffness * np.cos(0.2) / (2.0 * np.pi * 0.2) ** 2
    assert constant.shifts["J"] == pytest.approx(expected, rel=0.1)
