"""Fits within their limits, and what is within the noise."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from identification.diagnosis.joint import Joint, fit
from identification.diagnosis.rows import between_samples, equations
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import missing_test
from identification.diagnosis.significance import beyond_noise, size_p_value
from identification.diagnosis.within_limits import within_limits
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.estimate.bandwidth import common_bandwidth
from identification.estimate.equation_error import LEAST_MOTION, samples_in_motion
from identification.prepare import default_bandwidth, prepare
from identification.recording import Array, Recording
from identification.views.nominal import Nominal
from identification.views.view import View, views
from tests.identification.synthetic import sine

from .benches import campaign, honest, nominal_fit

TERM = {t.name: t for t in MOTION}


@lru_cache
def recordings() -> tuple[Recording, ...]:
    return campaign({}, 11, 6.0)


def here(joint: Joint) -> tuple[View, ...]:
    return joint.equations[0].views


def left_by(joint: Joint) -> Array:
    """Return what the reported constants leave of the torque's rows, evaluated anew."""
    rows = next(e for e in equations(here(joint), joint.nominal, "N m") if e.name == "torque")
    left = rows.residual.copy()
    for effect in joint.effects:
        columns = joint.stack.columns(effect.term, effect.shape)["torque"]
        left -= columns @ np.array(effect.coefficients)
    return left


def rubbed_off(recording: Recording, share: float) -> Recording:
    """Return a recording whose torque falls with speed, as no viscous friction does."""
    speed = np.gradient(recording.channels["motor_angle"], recording.time)
    current = recording.channels["current"] - share * speed
    return replace(recording, channels={**recording.channels, "current": current})


@pytest.mark.parametrize("share", [0.0, 0.08])
def test_what_is_left_is_what_the_reported_constants_leave(share: float) -> None:
    """Also where the rows ask for viscous friction below zero."""
    fitted = [rubbed_off(r, share) for r in recordings()[:2]]
    joint = nominal_fit(fitted)
    bounded = within_limits(joint)
    torque = next(e for e in joint.equations if e.name == "torque")
    rows = bounded.stack.part("torque")
    np.testing.assert_allclose(torque.sigma * bounded.residual[rows], left_by(bounded), atol=1e-9)
    assert all(v >= 0.0 for v in bounded.nominal.values.values())
    assert (bounded.nominal.get("sigma_2") == 0.0) == (share > 0.0)
    # Never more than the values that the fit ended at leave.
    assert np.sum(left_by(bounded) ** 2) <= (1.0 + 1e-9) * np.sum(left_by(joint) ** 2)


def test_with_the_speeds_as_they_are_it_is_bounded_least_squares() -> None:
    joint = nominal_fit([rubbed_off(r, 0.08) for r in recordings()[:2]])
    bounded = within_limits(joint)
    torque = next(e for e in equations(here(joint), bounded.nominal, "N m") if e.name == "torque")
    free = bounded.nominal.free
    use = [k for k, name in enumerate(free) if name != "omega_sf"]
    values = np.array(
        [
            bounded.nominal.get(free[k]) - (bounded.nominal.get("Mc") if free[k] == "Ms" else 0.0)
            for k in use
        ]
    )
    columns = torque.tangent[:, use]
    best = lsq_linear(columns, torque.residual + columns @ values, (0.0, np.inf))
    assert np.sum(torque.residual**2) == pytest.approx(2.0 * best.cost, rel=1e-4)
    np.testing.assert_allclose(best.x, values, rtol=2e-2, atol=1e-3)


def test_of_constants_that_cannot_be_told_apart_the_least_are_taken() -> None:
    """One way of motion: Coulomb friction and an offset are one column."""
    recording = recordings()[0]
    start = nominal_fit(recordings()[:1]).nominal
    there = views([recording], 25.0)
    ahead = tuple(replace(v, moving=v.moving & (v.low_pass(v.velocity) > 0.0)) for v in there)

    values = {**start.values, "offset": -7.0e5, "Mc": start.get("Mc") + 7.0e5}
    values["Ms"] = values["Mc"] + 3.0
    joint = fit(ahead, "N m", Nominal(values, (*start.free, "offset"), 2.0))
    found = within_limits(joint).nominal
    assert found.get("Mc") < 20.0
    assert abs(found.get("offset")) < 20.0
    assert found.get("Mc") + found.get("offset") == pytest.approx(start.get("Mc"), rel=0.1)


@pytest.mark.parametrize("averaged", [False, True])
def test_a_voltage_that_is_held_for_an_unknown_part_of_a_sample_may_be_late(averaged: bool) -> None:
    """A sample of lateness is no mismatch, unless the channel is declared as an average."""
    late = tuple(
        replace(
            r,
            channels={**r.channels, "voltage": np.roll(r.channels["voltage"], 1)},
            averaged=r.averaged | {"voltage"} if averaged else r.averaged - {"voltage"},
        )
        for r in recordings()[:2]
    )
    rows = equations(views(late, 25.0), nominal_fit(recordings()[:2]).nominal, "N m")
    voltage = next(e for e in rows if e.name == "voltage")
    basis, _ = np.linalg.qr(voltage.tangent)
    left = voltage.residual - basis @ (basis.T @ voltage.residual)
    assert (float(np.mean(left**2)) < 2.0 * voltage.sigma**2) is not averaged, left


COUNT_RAD = 2.0 * math.pi / 2048


@pytest.fixture(scope="module")
def joint() -> Joint:
    found = nominal_fit(honest())
    return replace(
        found, equations=tuple(replace(e, own={}, accuracy=0.0) for e in found.equations)
    )


def with_torque(joint: Joint, rows: np.ndarray) -> Joint:
    """Return the fit with other whitened torque rows, in its stack too."""
    residual = joint.residual.copy()
    residual[joint.stack.part("torque")] = rows
    return replace(joint, residual=residual, stack=replace(joint.stack, residual=residual))


def scaled(joint: Joint, power: float) -> np.ndarray:
    """Return torque rows of a mean square of ``power`` times the noise's."""
    rows = joint.residual[joint.stack.part("torque")]
    return np.asarray(rows * math.sqrt(power / float(np.mean(rows**2))))


@pytest.mark.parametrize(("power", "expected"), [(1.05, False), (1.15, True)])
def test_an_equation_is_beyond_the_noise_by_its_mean_square(joint, power, expected):
    assert ("torque" in beyond_noise(with_torque(joint, scaled(joint, power)))) is expected


def test_one_recording_with_twice_the_noise_is_enough(joint: Joint) -> None:
    rows = scaled(joint, 0.4)
    torque = joint.equations[0]
    mine = torque.owner == torque.views[0].index
    rows[mine] *= math.sqrt(2.2 / float(np.mean(rows[mine] ** 2)))
    assert float(np.mean(rows**2)) < 1.0
    assert "torque" in beyond_noise(with_torque(joint, rows))


def test_a_recording_is_judged_by_its_own_noise(joint: Joint) -> None:
    """One recording with three times the noise of the others hides nothing."""
    torque = joint.equations[0]
    first = torque.views[0].index
    rows = joint.residual[joint.stack.part("torque")] * np.where(torque.owner == first, 3.0, 1.0)
    louder = with_torque(joint, rows)
    assert "torque" in beyond_noise(louder)
    assert size_p_value(louder) < RULES.level
    known = replace(torque, own={first: 9.0})
    told = replace(louder, equations=(known, *louder.equations[1:]))
    assert "torque" not in beyond_noise(told)
    assert size_p_value(told) > 0.5


@pytest.mark.parametrize(("power", "missing"), [(0.9, False), (1.3, True)])
def test_a_sure_pattern_is_missing_physics_only_beyond_the_noise(joint, power, missing):
    """A weight out of balance, as large as the noise beside it."""
    torque, term = joint.equations[0], TERM["gravity_imbalance"]
    shape = term.shapes(Context(torque.views, joint.nominal))[0]
    columns = np.zeros((len(joint.residual), 2))
    columns[joint.stack.part("torque")] = joint.stack.columns(term, shape)["torque"]
    pattern = joint.stack.projected(columns)[joint.stack.part("torque"), 0]
    rows = scaled(joint, 0.5 * power)
    rows = rows + pattern * math.sqrt(0.5 * power / float(np.mean(pattern**2)))
    found = with_torque(joint, rows * math.sqrt(power / float(np.mean(rows**2))))
    assert (missing_test(found, [term], np.random.default_rng(0)).p_value <= RULES.level) is missing


@pytest.mark.parametrize("frequency_Hz", [2.0, 4.0, 6.0])
def test_quick_reversals_raise_the_bandwidth(frequency_Hz: float) -> None:
    moving = sine(frequency=frequency_Hz, amplitude=0.05, rate=500.0, duration=4.0)
    angle = np.floor(moving.channels["angle"] / COUNT_RAD) * COUNT_RAD
    channels = {k: v for k, v in moving.channels.items() if k != "velocity"}
    recording = replace(moving, channels={**channels, "angle": angle})
    usual = default_bandwidth(recording)
    assert samples_in_motion([prepare(recording, usual)]) < LEAST_MOTION
    found = common_bandwidth([recording])
    assert usual < found < 500.0 / 6.0
    assert samples_in_motion([prepare(recording, found)]) >= LEAST_MOTION
    slow = sine(rate=500.0)
    assert common_bandwidth([recording, slow]) == min(usual, default_bandwidth(slow))
    assert common_bandwidth([recording, replace(slow, stage="loaded")]) == found
    assert common_bandwidth([slow]) == default_bandwidth(slow)
    still = {k: v if k == "time" else np.full_like(v, v[0]) for k, v in channels.items()}
    resting = replace(recording, channels={**still, "angle": angle[:1].repeat(len(angle))})
    assert common_bandwidth([recording, replace(resting, stage="loaded")]) == found, (
        "a stage that rests leaves the bandwidth to the other"
    )


@pytest.mark.parametrize(("equation", "share"), [("torque", 2e-4), ("voltage", 2e-4)])
def test_what_the_best_sensor_may_read_wrong_is_within_the_noise(equation, share):
    """An error that repeats with the motion is in no noise, and no physics below this share."""
    found = next(e for e in nominal_fit(honest()).equations if e.name == equation)
    read = [v.torque if equation == "torque" else v.voltage for v in found.views]
    greatest = max(float(np.nanmax(np.abs(r))) for r in read)
    assert set(found.own) == {v.index for v in found.views}
    for sigma in (found.sigma, 0.1 * found.sigma):
        sensors = (share * greatest / sigma) ** 2
        assert np.all(replace(found, sigma=sigma).allowed() >= 1.0 + sensors)


@pytest.mark.parametrize("channel", ["voltage", "current"])
@pytest.mark.parametrize("averaged", [True, False])
def test_values_between_the_samples_are_unknown_unless_means_are_logged(channel, averaged):
    """A voltage that changes by 2 V from sample to sample is unknown by 2 V / sqrt(12)."""
    voltage = next(e for e in nominal_fit(honest()).equations if e.name == "voltage")
    declared = {"voltage", "current"} - (set() if averaged else {channel})
    swung = [
        replace(
            v,
            **{channel: np.where(np.arange(len(v.time)) % 2 == 0, -1.0, 1.0)},
            recording=replace(v.recording, averaged=frozenset(declared)),
        )
        for v in voltage.views
    ]
    ohm = swung[0].recording.bench.resistance
    change_V = 2.0 * (ohm if channel == "current" else 1.0)
    expected = 0.0 if averaged else change_V / math.sqrt(12.0)
    assert between_samples(swung) == pytest.approx(expected, rel=1e-3)
