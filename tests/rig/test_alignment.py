"""Clocks on one time base, stamps that jitter, and values that cannot be."""

from pathlib import Path

import numpy as np
import pytest

from drivers.mock.plant.machine import simulate
from drivers.mock.plant.parts.constants import Machine
from identification.estimate.default import identify, solve_stages
from identification.prepare import prepare
from identification.recording import Array, Bench, Dataset, Model, Recording
from rig.common.errors import InputError
from rig.runs.alignment import aligned, taken_at
from rig.sources import load_source
from rig.sources.build import even_stamps
from rig.sources.plausible import LARGEST, SMALLEST, STILL_LEVELS, unit_hints, value_errors

from ..identification.practical import CURRENT_QUANTUM_A, DURATION_S, command
from ..identification.synthetic import TRUTH

FINE = 20
COUNT_RAD = 2.0 * np.pi / (1 << 18)
MEANS = frozenset({"current"})


def free_running(samples: int, ppm: float, start: float = 0.3) -> tuple[Array, Array, Array]:
    """Row times, the stamps of an encoder with its own clock, and when they were taken."""
    rows = 1e-3 * np.arange(1, samples + 1)
    period = 1e-3 / (1.0 + 1e-6 * ppm)
    ticks = np.floor((rows - start * 1e-3) / period)
    return rows, 65.0 + 1e-3 * ticks, start * 1e-3 + period * ticks


@pytest.mark.parametrize("ppm", [-400.0, 250.0, 1000.0])
def test_the_instants_are_recovered(ppm: float) -> None:
    rows, stamps, true = free_running(20_000, ppm)
    assert np.max(np.abs(taken_at(rows, stamps) - true)) < 4e-5
    assert np.max(rows - true) > 9e-4


@pytest.mark.parametrize("ppm", [0.0, 60.0])
def test_latched_together_nothing_is_moved(ppm: float) -> None:
    """As on one SYNC: the clocks drift, the samples do not."""
    time = 1e-3 * np.arange(5000)
    channels = {"time": time, "angle": np.sin(time)}
    found, words = aligned(channels, 12.0 + time * (1.0 + 1e-6 * ppm), MEANS, 100.0)
    assert words == ""
    assert all(found[name] is values for name, values in channels.items())


def test_stamps_that_jump_back_are_not_believed() -> None:
    time = 1e-3 * np.arange(5000)
    assert aligned({"time": time, "angle": time}, time[::-1].copy(), MEANS, 1.0)[1] == ""


def test_the_finer_motor_encoder_keeps_the_drives_time() -> None:
    rows, stamps, true = free_running(5000, 300.0)
    channels = {
        "time": rows,
        "angle": np.sin(true),
        "motor_angle": np.floor(1e5 * np.sin(rows)) * 1e-3,
    }
    found, words = aligned(channels, stamps, MEANS, 100.0)
    assert "interpolated at the drive's time stamps" in words
    assert found["motor_angle"] is channels["motor_angle"]
    assert np.max(np.abs(found["angle"] - np.sin(rows))[1:-1]) < 5e-5
    assert np.max(np.abs(channels["angle"] - np.sin(rows))) > 7e-4


def test_means_stay_means_and_overwritten_samples_are_filled() -> None:
    rows, stamps, true = free_running(5000, 1000.0)
    integral = -np.cos(rows)
    current = np.diff(np.concatenate(([-np.cos(0.0)], integral))) / 1e-3
    channels = {"time": rows, "angle": np.round(true / 1e-5) * 1e-5, "current": current}
    found, words = aligned(channels, stamps, MEANS, 1.0)
    assert "angles interpolated that were overwritten" in words
    assert np.ptp(np.diff(found["time"])) < 1e-6
    assert np.max(np.abs(found["angle"] - found["time"])) < 6e-5
    middle = found["time"] - 0.5e-3
    assert np.max(np.abs(found["current"] - np.sin(middle))[2:]) < 5e-4


def logged(weight: float, seed: int) -> tuple[dict[str, Array], Array]:
    """Rows of the practical bench with a joint encoder on its own clock, +300 ppm."""
    rng = np.random.default_rng(seed)
    fine = simulate(Machine(), command, DURATION_S, 1000.0 * FINE, weight, rng=rng)
    rows, stamps, true = free_running(round(1000.0 * DURATION_S) - 1, 300.0)
    current = np.convolve(fine["mean_current"], np.ones(FINE) / FINE, mode="full")[
        FINE * np.arange(1, len(rows) + 1)
    ]
    angle = np.interp(true, fine["time"], fine["angle"])
    return {
        "time": rows,
        "angle": np.floor(angle / COUNT_RAD) * COUNT_RAD,
        "current": np.round(current / CURRENT_QUANTUM_A) * CURRENT_QUANTUM_A,
    }, stamps


@pytest.mark.proof
def test_the_inertia_is_biased_before_and_not_after() -> None:
    channels, stamps = logged(0.0, 1)
    bench = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095)
    before = prepare(Recording(name="before", channels=channels, bench=bench, averaged=MEANS), 40.0)
    biased, _ = solve_stages([before], [], Model(), lambda _stage, _share: None)
    assert biased["J"] < 0.9 * TRUTH["J"]
    on_one_clock = Recording(
        name="after",
        channels=aligned(channels, stamps, MEANS, 100.0)[0],
        bench=bench,
        averaged=MEANS,
    )
    result = identify(Dataset((on_one_clock,)))
    assert result.warnings == ()
    for name, value in result.values.items():
        assert value == pytest.approx(TRUTH[name], rel=0.02 if name == "J" else 0.006), name


CAMPAIGN = """\
campaign: 1
bench: {torque_constant: 0.03, gear_ratio: 100, moment_arm: 0.095}
recordings:
  - file: log.npz
    channels: {time: t, angle: q, angle_time: stamp, current: {column: i, average: true}}
"""


def test_a_campaign_may_have_the_encoders_stamps(tmp_path: Path) -> None:
    rows, stamps, true = free_running(5000, 300.0)
    np.savez(
        tmp_path / "log.npz",
        t=rows,
        q=np.round(np.sin(true) / 1e-5) * 1e-5,
        stamp=stamps,
        i=np.cos(rows),
    )
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN)
    (found,) = load_source(tmp_path / "campaign.yaml").recordings
    assert "angle_time" not in found.channels
    assert any("samples by its own clock" in note for note in found.notes)
    assert np.max(np.abs(found.channels["angle"] - np.sin(found.time))) < 6e-5


def test_a_missing_mean_stays_alone() -> None:
    """A voltage that is not measured while the power is off."""
    time = np.arange(4000) / 1000.0
    voltage = np.where((time > 1.0) & (time < 1.5), np.nan, np.sin(time))
    channels = {"time": time, "angle": np.sin(time), "voltage": voltage}
    found, _ = aligned(channels, time + 0.0003, frozenset({"voltage"}), 100.0)
    there = (found["time"] < 0.9) | (found["time"] > 1.6)
    assert np.max(np.abs(found["voltage"] - np.sin(found["time"] - 0.0005))[there]) < 1e-3
    assert np.all(np.isnan(found["voltage"][(found["time"] > 1.01) & (found["time"] < 1.49)]))


def test_stamps_without_an_angle_are_refused(tmp_path: Path) -> None:
    (tmp_path / "campaign.yaml").write_text(CAMPAIGN.replace("angle: q", "motor_angle: q"))
    with pytest.raises(InputError, match="time stamps of an encoder without its `angle`"):
        load_source(tmp_path / "campaign.yaml")


PERIOD, COUNT = 0.005, 4000
JITTERING = """\
campaign: 1
bench: {torque_constant: 0.03, gear_ratio: 100}
defaults: {channels: {time: t, motor_angle: q, current: i}}
recordings:
  - {file: a.csv, stage: unloaded}
"""


def angle_at(time: Array) -> Array:
    return np.asarray(
        30.0 * np.sin(2.0 * np.pi * 0.7 * time) + 3.0 * np.sin(2.0 * np.pi * 3 * time)
    )


def grid() -> Array:
    return 12.5 + PERIOD * np.arange(COUNT)


def jittering(share: float, seed: int = 3) -> Array:
    rng = np.random.default_rng(seed)
    late = np.clip(share * rng.standard_normal(COUNT), -0.45, 0.45)
    return np.asarray(grid() + PERIOD * late)


@pytest.mark.parametrize("kind", ["normal", "late", "late at times"])
def test_jitter_of_any_distribution_gives_even_times(kind: str) -> None:
    """Stamps of a host are late, never early, and now and then by several periods."""
    rng, count = np.random.default_rng(0), 20_000
    true = PERIOD * np.arange(count)
    late = {
        "normal": 0.13 * rng.standard_normal(count),
        "late": rng.exponential(0.13, count),
        "late at times": rng.exponential(0.05, count) + 2.0 * (rng.uniform(size=count) < 1e-3),
    }[kind]
    stamps = np.maximum.accumulate(true + PERIOD * late)
    found = even_stamps(stamps, angle_at(true))
    offset = found[0] - true
    assert np.ptp(offset) < 0.03 * PERIOD
    assert np.mean(offset) == pytest.approx(PERIOD * np.mean(late), abs=0.02 * PERIOD)


@pytest.mark.parametrize("share", [0.01, 0.1, 0.25])
def test_uneven_samples_keep_their_stamps(share: float) -> None:
    assert even_stamps(jittering(share), angle_at(jittering(share))) is None


def test_even_stamps_stay() -> None:
    assert even_stamps(grid(), angle_at(grid())) is None


def test_noise_that_hides_the_jitter_keeps_the_stamps() -> None:
    noise = 5.0 * np.random.default_rng(1).standard_normal(COUNT)
    assert even_stamps(jittering(0.05), angle_at(grid()) + noise) is None


def test_lost_samples_are_allowed_for() -> None:
    kept = np.random.default_rng(5).uniform(size=COUNT) > 0.02
    found = even_stamps(jittering(0.05)[kept], angle_at(grid())[kept])
    assert np.max(np.abs(found[0] - grid()[kept])) < 0.03 * PERIOD


@pytest.mark.parametrize("drift", [0.3, 3.0])
def test_a_rate_that_changes_is_no_grid(drift: float) -> None:
    time = grid() + drift * PERIOD * np.sin(np.linspace(0.0, 6.0, COUNT))
    assert even_stamps(time, angle_at(time)) is None


def test_a_campaign_says_that_it_did_so(tmp_path: Path) -> None:
    rows = np.column_stack([jittering(0.1), angle_at(grid()), np.cos(grid())])
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header="t,q,i", comments="", fmt="%.9g")
    (tmp_path / "c.yaml").write_text(JITTERING)
    (recording,) = load_source(tmp_path / "c.yaml").recordings
    assert np.ptp(np.diff(recording.time)) < 1e-9
    notes = [n for n in recording.notes if "jitter" in n or "uneven" in n]
    assert len(notes) == 1
    assert notes[0].startswith("time stamps jitter by 0.0005 s rms (10 % of the period)")


TIME = np.arange(2000) * 1e-3


def channels(**replaced: Array) -> dict[str, Array]:
    swing = np.sin(2.0 * np.pi * TIME)
    return {"time": TIME + 1.7e9, "angle": 0.3 * swing, "current": 2.0 * swing, **replaced}


def test_a_plain_recording_passes() -> None:
    assert (
        list(value_errors(channels(pressure=np.full(2000, 6e6), temperature=np.full(2000, 1e-300))))
        == []
    )
    assert list(unit_hints(channels(), 100.0, has_lever=True)) == []


@pytest.mark.parametrize(
    ("top", "bad"), [(LARGEST, False), (1.01 * LARGEST, True), (SMALLEST, False), (1e-300, True)]
)
def test_impossible_size(top: float, bad: bool) -> None:
    found = list(value_errors(channels(current=np.where(TIME > 1.0, top, np.nan))))
    assert [("`current` has its peak at" in text) for text in found] == [True] * bad


def test_a_channel_of_zeros_has_no_impossible_size() -> None:
    assert list(value_errors(channels(current=np.zeros(2000)))) == []


def test_rows_out_of_order_and_noise_are_refused() -> None:
    rng = np.random.default_rng(0)
    for position in (rng.permutation(channels()["angle"]), rng.standard_normal(2000)):
        (found,) = value_errors(channels(angle=position))
        assert found.startswith("`angle` jumps from sample to sample")


@pytest.mark.parametrize(("share_of_rate", "bad"), [(0.15, False), (0.19, True)])
def test_both_sides_of_the_fastest_sine(share_of_rate: float, bad: bool) -> None:
    fast = np.sin(2.0 * np.pi * share_of_rate * np.arange(2000))
    assert bool(list(value_errors(channels(angle=fast)))) is bad


def test_a_position_at_rest_is_left_to_the_fit() -> None:
    assert list(value_errors(channels(angle=np.full(2000, 0.1)))) == []


@pytest.mark.parametrize(("levels", "bad"), [(2, False), (STILL_LEVELS, False), (9, True)])
def test_an_encoder_that_flickers_at_rest_is_no_noise(levels: int, bad: bool) -> None:
    counts = np.random.default_rng(0).integers(0, levels, 2000)
    assert bool(list(value_errors(channels(angle=0.1 + 1e-3 * counts)))) is bad


def test_units_are_asked_for() -> None:
    (mA,) = unit_hints(channels(current=np.full(2000, -501.0)), 1.0, has_lever=False)
    assert "reaches 501 A: if it is in mA, set its scale to 0.001" in mA
    (mV,) = unit_hints({"voltage": np.array([np.nan, 2001.0])}, 1.0, has_lever=False)
    assert "if it is in mV" in mV
    assert list(unit_hints({"voltage": np.array([np.nan, np.nan])}, 1.0, has_lever=False)) == []


def test_a_lever_does_not_turn_round() -> None:
    turning = {"motor_angle": np.linspace(0.0, 2.02 * np.pi * 50.0, 100)}
    (found,) = unit_hints(turning, 50.0, has_lever=True)
    assert "turns the joint 1.01 times" in found
    assert list(unit_hints(turning, 51.0, has_lever=True)) == []
    assert list(unit_hints(turning, 50.0, has_lever=False)) == []
