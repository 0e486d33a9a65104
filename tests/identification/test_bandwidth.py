"""One choice of bandwidth and recordings, and the better of angle and velocity."""

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.within_limits import long_enough
from identification.estimate.bandwidth import choose_bandwidth, common_bandwidth, moving_samples
from identification.estimate.default import identify
from identification.estimate.equation_error import LEAST_MOTION
from identification.filter.segments import lacking
from identification.prepare import coarser_than_velocity, prepare
from identification.recording import Array, Dataset, Pendulum, Recording, RecordingError

from .synthetic import sine


def with_channels(recording: Recording, **channels: Array | None) -> Recording:
    merged = {**recording.channels, **channels}
    return replace(recording, channels={k: v for k, v in merged.items() if v is not None})


LONG = replace(sine(name="long", rate=100.0, duration=60.0), source="long.csv")


def piece(number: int, samples: int, role: str = "fit") -> Recording:
    """Return a short piece of the long recording."""
    cut = {name: values[40 : 40 + samples] for name, values in LONG.channels.items()}
    return replace(LONG, name=f"long[{number}]", channels=cut, role=role)  # type: ignore[arg-type]


def test_short_pieces_are_left_out_with_one_line() -> None:
    """By identification and diagnosis alike; 100 samples are 1 s, the filter at 2 Hz has 1.6 s."""
    pieces = [piece(k, 100) for k in range(4)]
    whole = Dataset((LONG, *pieces, piece(4, 100, "validate")))
    chosen = choose_bandwidth(whole, 2.0)
    assert [r.name for r in chosen.dataset.recordings] == ["long"]
    (warning,) = chosen.warnings
    assert warning.startswith("long[0], long[1], long[2] and 2 more: left out, because shorter")
    assert long_enough(whole, 2.0) == chosen
    found = identify(whole, bandwidth_Hz=2.0)
    assert found.parameters["Mc"].value == pytest.approx(
        identify(Dataset((LONG,)), bandwidth_Hz=2.0).parameters["Mc"].value, rel=1e-12
    )
    assert [w for w in found.warnings if "left out" in w] == [warning]


@pytest.mark.parametrize("share", [0.02, 0.09, 0.2, 0.5])
def test_a_bandwidth_that_was_chosen_serves_all_but_a_small_part(share: float) -> None:
    """The filter at the greatest allowed default bandwidth is longer than the short recordings."""
    low = 1.8
    samples = 150
    count = max(1, round(share / (1.0 - share) * len(LONG.time) / samples))
    pieces = tuple(piece(k, samples) for k in range(count))
    with pytest.raises(RecordingError, match="needs at least"):
        prepare(pieces[0], low)
    chosen = choose_bandwidth(Dataset((LONG, *pieces)), most_Hz=low)
    for recording in chosen.dataset.recordings:
        prepare(recording, chosen.bandwidth)
    assert (chosen.bandwidth == low) is (share < 0.1)
    assert len(chosen.dataset.recordings) == 1 + count * (share >= 0.1)
    assert len(chosen.warnings) == (share < 0.1)


def test_no_file_is_left_out_as_a_whole() -> None:
    other = replace(piece(0, 150), source="other.csv")
    chosen = choose_bandwidth(Dataset((LONG, other)), most_Hz=1.8)
    assert chosen.bandwidth > 1.8
    assert [r.name for r in chosen.dataset.recordings] == ["long", "long[0]"]


def test_a_stage_is_not_left_out_as_a_whole() -> None:
    loaded = replace(piece(0, 100), stage="loaded", weight_mass=30.6)
    dataset = Dataset((LONG, loaded))
    assert choose_bandwidth(dataset, 2.0).dataset == dataset
    with pytest.raises(RecordingError, match=r"long\[0\]: the recording has 100 samples"):
        identify(dataset, bandwidth_Hz=2.0)


STEP = 4e-4


def sticking(rate: float = 38.0, seconds: float = 40.0) -> Recording:
    """Return a joint that slips for 0.5 s and rests for 0.8 s, and reverses every 10 s; at rest its
    encoder flickers by one step.
    """
    noise = np.random.default_rng(1)
    time = np.arange(round(rate * seconds)) / rate
    way = np.where((time // 10.0) % 2.0 == 0.0, 1.0, -1.0)
    velocity = 0.5 * way * (time % 1.3 < 0.5)
    angle = np.cumsum(velocity) / rate + STEP * (noise.random(len(time)) < 0.2)
    torque = way * 0.15 + 0.01 * noise.standard_normal(len(time))
    channels = {"time": time, "angle": np.floor(angle / STEP) * STEP, "torque": torque}
    return with_channels(replace(LONG, name="sticking"), velocity=None, **channels)


def test_a_slow_log_of_slips_gets_a_bandwidth_above_a_sixth_of_its_rate() -> None:
    recording = sticking()
    found = common_bandwidth([recording])
    assert 38.0 / 6.0 < found <= 0.4 * 38.0
    assert moving_samples([recording], found) >= LEAST_MOTION
    assert moving_samples([recording], found / 1.25) < LEAST_MOTION


def test_reversals_are_counted_without_the_noise_of_the_encoder() -> None:
    with pytest.raises(RecordingError, match="moves and rests in turn") as refused:
        identify(Dataset((sticking(),)), bandwidth_Hz=2.0)
    stated = float(str(refused.value).split("(")[1].split()[0])
    assert stated <= 3.0 / 12.0, "three reversals in at least 12 s of motion"
    assert stated > 0.0


def test_what_a_recording_lacks_is_said() -> None:
    uneven = np.sort(np.random.default_rng(0).random(len(LONG.time))) * 60.0
    cases = {
        "a quantised encoder": LONG,
        "a measured torque or current": with_channels(
            LONG, torque=None, voltage=LONG.channels["torque"]
        ),
        "even sampling": with_channels(LONG, time=uneven),
        "two breakaways from rest": with_channels(
            LONG, angle=np.round(LONG.channels["angle"] / STEP) * STEP
        ),
    }
    assert {what: lacking(r) for what, r in cases.items()} == {what: what for what in cases}
    (warning,) = [w for w in identify(Dataset((LONG,))).warnings if "prediction errors need" in w]
    assert warning.endswith("; long lacks a quantised encoder")


@pytest.mark.parametrize(
    ("step", "velocity_step", "coarse"),
    [(1e-4, 1e-6, False), (0.05, 1e-6, True), (0.05, 0.5, False), (0.0, 1e-6, False)],
)
def test_the_finer_of_angle_and_velocity_is_used(step, velocity_step, coarse):
    def rounded(values: Array, by: float) -> Array:
        return np.round(values / by) * by if by else values

    recording = with_channels(
        LONG,
        angle=rounded(LONG.channels["angle"], step),
        velocity=rounded(LONG.channels["velocity"], velocity_step),
    )
    assert bool(coarser_than_velocity(recording)) is coarse
    assert f"steps of {step:.3g} rad" in coarser_than_velocity(recording) or not coarse
    weighted = replace(recording, pendulum=Pendulum(1.0, 0.5, 0.0))
    assert coarser_than_velocity(weighted) == "", "a weight that turns needs the angle"
