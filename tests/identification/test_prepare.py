"""The equation-error view of a recording: alignment, torque sources, rests, one filter for all."""

from dataclasses import replace

import numpy as np
import pytest

from identification.prepare import (
    Prepared,
    default_bandwidth,
    drive_torque,
    joint_angle,
    prepare,
    resting,
    uniform_grid,
)
from identification.recording import Bench, Pendulum, Recording, RecordingError

from .synthetic import TRUTH, sine

RATE = 1000.0
ROLLING = {**TRUTH, "Ms": TRUTH["Mc"]}
"""Without the rise toward rest the model is linear."""


def linear_fit(p: Prepared) -> np.ndarray:
    """Mc, sigma_2, J by ordinary least squares on the used samples."""
    columns = np.column_stack([p.filter(np.sign(p.raw_velocity)), p.velocity, p.acceleration])
    return np.linalg.lstsq(columns[p.used], p.torque[p.used], rcond=None)[0]


def with_channels(recording: Recording, **channels: np.ndarray | None) -> Recording:
    """Replace channels; None removes one."""
    merged = {**recording.channels, **channels}
    return replace(recording, channels={k: v for k, v in merged.items() if v is not None})


@pytest.mark.parametrize("bandwidth", [10.0, 40.0, 150.0, 500.0])
@pytest.mark.parametrize("source", ["angle", "velocity"])
def test_linear_model_comes_back_at_any_bandwidth(bandwidth: float, source: str) -> None:
    recording = sine(
        ROLLING, drift=0.6, frequency=0.7, duration=8.0
    )  # speed never crosses zero: all signals smooth
    other = {"angle": "velocity", "velocity": "angle"}[source]
    found = linear_fit(prepare(with_channels(recording, **{other: None}), bandwidth))
    tolerance = 1e-4 if source == "angle" else 1e-5
    offset_sees = [ROLLING["Mc"], ROLLING["sigma_2"], ROLLING["J"]]
    assert found == pytest.approx(offset_sees, rel=10.0 * tolerance)


def test_averaged_channel_stands_half_a_period_earlier() -> None:
    recording = sine(frequency=2.0)
    time, h = recording.time, 1.0 / RATE
    w = 2.0 * np.pi * 10.0
    mean = (np.cos(w * (time - h)) - np.cos(w * time)) / (
        w * h
    )  # of sin(w t) over the period that ends at each time
    averaged = replace(with_channels(recording, torque=mean), averaged=frozenset({"torque"}))
    grid = uniform_grid(recording)
    inner = slice(5, -5)
    aligned = drive_torque(averaged, grid, grid)[inner]
    expected = np.sin(w * grid[inner])
    assert aligned == pytest.approx(expected, abs=2e-3)
    late = drive_torque(replace(averaged, averaged=frozenset()), grid, grid)[inner]
    assert np.max(np.abs(late - expected)) > 10.0 * np.max(np.abs(aligned - expected))


def test_current_from_voltage_leaves_out_the_back_emf() -> None:
    recording = sine()
    volts = (
        1.56 * recording.channels["torque"] / 3.0 + 0.02588 * 100.0 * recording.channels["velocity"]
    )
    measured = with_channels(recording, torque=None, voltage=volts)
    assert prepare(measured, 40.0).torque == pytest.approx(
        prepare(recording, 40.0).torque, abs=1e-3
    )


@pytest.mark.parametrize("mark", ["nan", "enabled"])
def test_voltage_counts_for_nothing_while_the_power_stage_is_off(mark: str) -> None:
    recording = sine()
    velocity = recording.channels["velocity"]
    volts = np.full(len(velocity), 10.0)
    off = recording.time > 2.5
    extra = {"enabled": np.where(off, 0.0, 1.0)} if mark == "enabled" else {}
    volts[off] = np.nan if mark == "nan" else 10.0
    measured = with_channels(recording, torque=None, voltage=volts, **extra)
    torque = drive_torque(measured, recording.time, velocity)
    assert np.all(torque[off] == 0.0)
    on = recording.time < 2.5 - 1.0 / RATE
    assert torque[on] == pytest.approx(3.0 * (10.0 - 2.588 * velocity[on]) / 1.56)


def test_pendulum_torque_and_inertia_are_known_loads() -> None:
    pendulum = Pendulum(mass=3.0, length=0.4, zero=0.2)
    hanging = prepare(sine(pendulum=pendulum), 40.0)
    bare = prepare(sine(), 40.0)
    assert hanging.torque == pytest.approx(bare.torque, abs=2e-3)
    assert np.max(np.abs(hanging.drive_torque - bare.drive_torque)) > 1.0


def test_uneven_sampling_is_brought_to_an_even_grid() -> None:
    even = sine(ROLLING, drift=0.6, frequency=0.7, duration=8.0)
    rng = np.random.default_rng(5)
    keep = np.sort(rng.choice(len(even.time), size=7000, replace=False))
    uneven = replace(even, channels={k: v[keep] for k, v in even.channels.items()})
    prepared = prepare(uneven, 20.0)
    assert np.ptp(np.diff(prepared.time)) < 1e-9
    assert linear_fit(prepared) == pytest.approx(
        [ROLLING["Mc"], ROLLING["sigma_2"], ROLLING["J"]], rel=0.01
    )


def test_motor_encoder_counts_through_the_gear_and_keeps_the_joint_zero() -> None:
    recording = sine()
    angle = recording.channels["angle"]
    fine, coarse = 1e-5, 1e-4
    both = with_channels(
        recording,
        motor_angle=np.floor((angle + 1.0) / fine) * fine * 100.0,
        angle=np.floor(angle / coarse) * coarse,
    )
    found = joint_angle(both)
    assert found == pytest.approx(angle, abs=coarse)
    alone = joint_angle(with_channels(both, angle=None))
    assert alone == pytest.approx(angle + 1.0, abs=2.0 * fine)
    swapped = with_channels(
        recording,
        motor_angle=np.floor(angle / coarse) * coarse * 100.0,
        angle=np.floor(angle / fine) * fine,
    )
    assert joint_angle(swapped) is swapped.channels["angle"]


FLICKER = np.array([0.0, 0, 0, 0, 0, 0, 0, 0, 0, -1, 1, 0, 0, 0, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("step", [1e-5, 0.3])
def test_an_encoder_that_flickers_to_either_side_rests(step: float) -> None:
    moving = np.arange(1.0, 41.0) * 7.0
    angle = step * np.concatenate([FLICKER, moving, 280.0 + FLICKER])
    marks = resting(angle)
    count = len(FLICKER)
    assert np.all(marks[:count])
    assert np.all(marks[-count:])
    assert not np.any(marks[count + 1 : -count - 1])


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_slip_from_rest_to_rest_is_no_flicker(side: float) -> None:
    slip = np.concatenate([np.zeros(12), [2.0, 4.0], np.full(12, 6.0), 6.0 + np.arange(1.0, 60.0)])
    marks = resting(1e-4 * side * slip)
    assert np.all(marks[:12])
    assert not np.any(marks[12:14])
    assert np.all(marks[14:26])


def test_samples_touched_by_rest_are_not_used() -> None:
    recording = sine(frequency=0.5, duration=6.0)
    time = recording.time
    held = np.where(
        (time > 2.0) & (time < 2.5), np.interp(2.0, time, recording.channels["angle"]), 0.0
    )
    angle = np.where((time > 2.0) & (time < 2.5), held, recording.channels["angle"])
    prepared = prepare(with_channels(recording, angle=angle, velocity=None), 40.0)
    reach = prepared.filter.half / RATE
    inside = (prepared.time > 2.0 - reach + 2e-3) & (prepared.time < 2.5 + reach - 2e-3)
    assert not np.any(prepared.used[inside])
    reach += 0.025  # one more of the filter on position, whose memory at 40 Hz is below that
    outside = (prepared.time < 2.0 - reach) | (prepared.time > 2.5 + reach)
    assert np.all(prepared.used[outside])


def test_a_rest_in_the_noise_of_an_angle_is_not_used() -> None:
    """At rest the sign of a noisy speed would give Coulomb friction without a torque."""
    recording = sine(ROLLING, frequency=0.5, duration=30.0)
    rests, angle = recording.time > 6.0, recording.channels["angle"]
    held = np.where(rests, np.interp(6.0, recording.time, angle), angle)
    held += 2e-5 * np.random.default_rng(3).standard_normal(len(angle))
    torque = np.where(rests, 0.0, recording.channels["torque"])
    found = prepare(with_channels(recording, angle=held, velocity=None, torque=torque), 40.0)
    assert np.mean(found.used[found.time > 6.2]) < 0.02
    assert np.mean(found.used[found.time < 5.8]) > 0.8
    assert linear_fit(found)[:2] == pytest.approx([ROLLING["Mc"], ROLLING["sigma_2"]], rel=0.02)


def test_exact_channels_leave_out_what_the_rate_cannot_resolve() -> None:
    """A jump of speed within one sample, as at breakaway."""
    recording = sine(drift=0.6, frequency=0.7)
    velocity = recording.channels["velocity"] + np.where(recording.time > 2.0, 0.2, 0.0)
    angle = np.cumsum(velocity) / RATE
    prepared = prepare(with_channels(recording, velocity=velocity, angle=angle), 500.0)
    near = np.abs(prepared.time - 2.0) < 2e-3
    assert not np.any(prepared.used[near])
    assert np.mean(prepared.used) > 0.95


def test_coarser_encoder_asks_for_less_bandwidth() -> None:
    recording = with_channels(sine(frequency=1.0), velocity=None)
    angle = recording.channels["angle"]
    widths = []
    for unit in (0.0, 1e-6, 1e-4, 1e-3):
        seen = np.floor(angle / unit) * unit if unit else angle
        widths.append(default_bandwidth(with_channels(recording, angle=seen)))
    assert widths[0] == pytest.approx(RATE / 25.0)
    assert widths == sorted(widths, reverse=True)
    assert widths[-1] < 0.9 * widths[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"torque": None}, "no torque, current or voltage channel"),
        ({"angle": None, "velocity": None}, "no angle, motor_angle or velocity channel"),
        ({"torque": None, "voltage": np.zeros(5000)}, r"bench\.resistance"),
    ],
)
def test_missing_channels_are_named(change: dict[str, np.ndarray | None], message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        prepare(with_channels(sine(name="run7", bench=Bench()), **change), 40.0)


@pytest.mark.parametrize(
    ("bandwidth", "duration", "key"),
    [
        *((bandwidth, 5.0, "500 Hz") for bandwidth in (0.0, -1.0, np.nan, np.inf, 500.1)),
        (5.0, 0.1, "has 100 samples"),
        (1e-9, 5.0, "needs at least 32000"),  # refused before the filter is built
    ],
)
def test_a_bandwidth_that_rate_or_length_do_not_allow(bandwidth, duration, key):
    with pytest.raises(RecordingError, match=key):
        prepare(sine(duration=duration), bandwidth)


def test_samples_about_a_jerk_between_late_samples_are_left_out() -> None:
    recording = sine(ROLLING, drift=0.6, frequency=0.7, duration=8.0)
    seen = np.ones(len(recording.time), dtype=bool)
    torque = recording.channels["torque"].copy()
    for at in range(400, 7600, 800):
        seen[at : at + 4] = False
        torque[at - 1 : at + 6] += 10.0
    channels = {
        name: values[seen] for name, values in {**recording.channels, "torque": torque}.items()
    }
    kept = prepare(replace(recording, channels=channels), 20.0)
    assert linear_fit(kept) == pytest.approx(
        [ROLLING["Mc"], ROLLING["sigma_2"], ROLLING["J"]], rel=2e-3
    )
    assert 0.2 < float(np.mean(kept.used)) < 0.95
