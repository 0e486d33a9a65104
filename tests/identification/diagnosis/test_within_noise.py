"""What is within the noise is not tested, and noise is never below the encoders' rounding; the
bandwidth is as great as the motion needs.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.joint import Joint
from identification.diagnosis.rows import between_samples
from identification.diagnosis.rules import RULES
from identification.diagnosis.search import missing_test
from identification.diagnosis.significance import beyond_noise, size_p_value
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.estimate.equation_error import LEAST_MOTION, common_bandwidth, samples_in_motion
from identification.prepare import default_bandwidth, prepare
from tests.identification.synthetic import sine

from .benches import honest, nominal_fit

TERM = {t.name: t for t in MOTION}
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
def test_an_equation_is_beyond_the_noise_by_its_mean_square(
    joint: Joint, power: float, expected: bool
) -> None:
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
def test_a_sure_pattern_is_missing_physics_only_beyond_the_noise(
    joint: Joint, power: float, missing: bool
) -> None:
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
def test_what_the_best_sensor_may_read_wrong_is_within_the_noise(
    equation: str, share: float
) -> None:
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
def test_values_between_the_samples_are_unknown_unless_means_are_logged(
    channel: str, averaged: bool
) -> None:
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
