"""The uncertainty of known constants in the intervals of the parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.default import identify
from identification.estimate.known_constants import (
    NORMAL_90,
    uncertain_constants,
    with_uncertain_constants,
)
from identification.recording import Dataset, Pendulum, Recording

from .synthetic import TRUTH, sine


def driven(recording: Recording, **uncertainties: float) -> Recording:
    """The same recording with the current in place of the torque."""
    channels = {k: v for k, v in recording.channels.items() if k != "torque"}
    channels["current"] = recording.channels["torque"] / recording.bench.ampere_torque
    places = {place.replace("__", "."): value for place, value in uncertainties.items()}
    return replace(recording, channels=channels, uncertainties=places)


def noise(n: int) -> np.ndarray:
    return np.asarray(np.random.default_rng(n).normal(0.0, 0.05, n))


def test_a_torque_constant_scales_all_that_is_measured_in_torque() -> None:
    dataset = Dataset(
        (
            driven(sine(noise=noise), bench__torque_constant=0.003),
            driven(sine(weight=30.6, name="load", noise=noise), bench__torque_constant=0.003),
        )
    )
    bare = identify(dataset, bandwidth_Hz=100.0)
    result = with_uncertain_constants(bare, dataset)
    (constant,) = result.known_constants
    assert (constant.place, constant.value) == ("bench.torque_constant", 0.03)
    for name, share in (("Mc", 0.1), ("J", 0.1), ("mu_c", 0.1), ("omega_sf", 0.0)):
        p, own = result.parameters[name], bare.parameters[name]
        assert constant.shifts[name] == pytest.approx(share * TRUTH[name], abs=0.02 * TRUTH[name])
        assert p.value == own.value
        assert p.low is not None
        assert p.high is not None
        assert own.high is not None
        assert own.value is not None
        assert p.high - p.low >= 2.0 * NORMAL_90 * abs(constant.shifts[name]) * 0.999
        assert p.high - own.value == pytest.approx(
            np.hypot(own.high - own.value, NORMAL_90 * constant.shifts[name])
        )


def test_a_weight_moves_only_what_it_loads() -> None:
    loaded = replace(sine(weight=30.6, name="load"), uncertainties={"weight_mass": 3.06})
    dataset = Dataset((sine(), loaded, replace(loaded, name="again")))
    assert len(uncertain_constants(dataset.recordings)) == 1
    (constant,) = with_uncertain_constants(
        identify(dataset, bandwidth_Hz=100.0), dataset
    ).known_constants
    assert constant.shifts["Mc"] == pytest.approx(0.0, abs=1e-9)
    assert constant.shifts["mu_c"] == pytest.approx(-0.1 * TRUTH["mu_c"], rel=0.05)


def test_a_pendulums_mass_moves_the_inertia_by_its_own() -> None:
    pendulum = Pendulum(mass=3.0, length=0.4, zero=0.2)
    hung = replace(sine(pendulum=pendulum), uncertainties={"pendulum.mass": 0.03})
    dataset = Dataset((hung,))
    (constant,) = with_uncertain_constants(
        identify(dataset, bandwidth_Hz=100.0), dataset
    ).known_constants
    # The drive's torque stays: more weight leaves less inertia, and more of its gravity is taken
    # for the acceleration of the sine, which is proportional to the angle.
    stiffness = 9.80665 * 0.4 * 0.03
    expected = -0.03 * 0.4**2 + stiffness * np.cos(0.2) / (2.0 * np.pi * 0.2) ** 2
    assert constant.shifts["J"] == pytest.approx(expected, rel=0.1)


def test_exact_constants_leave_a_result_as_it_is() -> None:
    dataset = Dataset((sine(),))
    result = identify(dataset, bandwidth_Hz=100.0)
    assert with_uncertain_constants(result, dataset) is result
