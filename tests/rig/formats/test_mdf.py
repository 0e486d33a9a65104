"""MDF by asammdf and TDMS by npTDMS: numbers to the last bit, or refused in words."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from asammdf import MDF, Signal
from nptdms import ChannelObject, RootObject, TdmsWriter
from nptdms.types import Uint32

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.formats import open_table
from rig.sources.look import look_at_file
from tests.rig.formats.campaigns import ANGLE, CURRENT, TIME, N, load_file, same

PLAIN = ReadSection()
CHANNELS = "{time: time, current: i, angle: q}"


def write(
    path: Path, *groups: Sequence[Signal], names: Sequence[str] = (), version: str = "4.10"
) -> Path:
    with MDF(version=version) as mdf:
        for k, group in enumerate(groups):
            mdf.append(list(group), acq_name=names[k] if names else None)
        return Path(mdf.save(path, overwrite=True))


def of(name: str, values: np.ndarray, time: np.ndarray = TIME, **more: object) -> Signal:
    return Signal(values, time, name=name, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("version", ["2.14", "3.30", "4.20"])
def test_channels_of_every_version_to_the_last_bit(tmp_path: Path, version: str) -> None:
    signals = [of("i", CURRENT, unit="A"), of("q", ANGLE)]
    path = write(tmp_path / "log.mdf", signals, version=version)
    recording = load_file(tmp_path, path.name, CHANNELS)
    same(recording.time, TIME)
    same(recording.channels["current"], CURRENT)
    same(recording.channels["angle"], ANGLE)
    assert recording.notes == ()


def test_a_linear_conversion_is_applied_and_the_unit_is_known(tmp_path: Path) -> None:
    counts = np.rint(1000 * CURRENT).astype(np.int16)
    path = write(
        tmp_path / "log.mf4",
        [of("i", counts, unit="mA", conversion={"a": 0.5, "b": 3.0}), of("q", ANGLE)],
    )
    table = open_table(path, PLAIN)
    same(table.read([1])[0], counts * 0.5 + 3.0)
    assert table.units[1] == "mA"
    channels = "{time: time, current: {column: i, scale: 0.001}, angle: q}"
    recording = load_file(tmp_path, "log.mf4", channels)
    same(recording.channels["current"], (counts * 0.5 + 3.0) * 0.001)
    doubted = load_file(tmp_path, "log.mf4", CHANNELS).notes
    assert any("`current` is in mA by the file" in note for note in doubted)


@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_a_scaled_counter_through_its_end_is_unwrapped(tmp_path: Path, version: str) -> None:
    turns = np.rint(40000 * np.sin(12.0 * TIME)).astype(int)
    factor = 360.0 / 65536
    stored = (turns % 65536).astype(np.uint16)
    signals = [of("i", CURRENT), of("q", stored, conversion={"a": factor, "b": -5.0})]
    path = write(tmp_path / "log.mdf", signals, version=version)
    recording = load_file(tmp_path, path.name, CHANNELS)
    np.testing.assert_allclose(
        np.diff(recording.channels["angle"]), np.diff(turns * factor), atol=1e-9
    )
    assert any("a counter of 16 bits that overflows" in n for n in recording.notes)


def test_invalidated_samples_are_missing(tmp_path: Path) -> None:
    invalid = np.zeros(N, dtype=bool)
    invalid[[40, 41]] = True
    spoiled = np.where(invalid, 1e6, CURRENT)
    signals = [of("i", spoiled, invalidation_bits=invalid), of("q", ANGLE)]
    recording = load_file(tmp_path, write(tmp_path / "log.mf4", signals).name, CHANNELS)
    current = recording.channels["current"]
    same(current[~invalid], CURRENT[~invalid])
    assert np.all(np.abs(current[invalid] - CURRENT[invalid]) < 0.01)
    assert "`current`: 2 missing samples interpolated" in recording.notes


def test_groups_at_several_rates_are_brought_to_that_of_time(tmp_path: Path) -> None:
    slow = TIME[::2]
    write(
        tmp_path / "log.mf4",
        [of("i", CURRENT)],
        [of("q", 2.0 * slow, slow)],
        names=("fast", "slow"),
    )
    with pytest.raises(InputError, match=r"or the whole name: fast\.time, slow\.time"):
        load_file(tmp_path, "log.mf4", CHANNELS)
    recording = load_file(tmp_path, "log.mf4", CHANNELS.replace("time: time", "time: fast.time"))
    same(recording.channels["current"], CURRENT[:-1])
    np.testing.assert_allclose(recording.channels["angle"], 2.0 * TIME[:-1], atol=1e-15)
    assert any("`angle`: of slow (500 Hz), interpolated" in n for n in recording.notes)
    assert any("1 rows of fast outside" in n for n in recording.notes)
    recording = load_file(tmp_path, "log.mf4", CHANNELS.replace("time: time", "time: slow.time"))
    same(recording.channels["current"], CURRENT[::2])
    same(recording.channels["angle"], 2.0 * slow)
    assert any(
        "`current`: of fast (1000 Hz)" in n and "its rate is higher" in n for n in recording.notes
    )
    with pytest.raises(InputError, match="map `time` to the stamps of one"):
        load_file(tmp_path, "log.mf4", "{current: i, angle: q}", more="    rate: 1000\n")


def test_labels_text_and_mixtures_are_told_apart(tmp_path: Path) -> None:
    state = (np.arange(N) > 20).astype(np.uint8)
    labels = {"val_0": 0, "text_0": b"off", "val_1": 1, "text_1": b"on", "default": b"?"}
    words = np.array([b"x", b"y"] * (N // 2))
    signals = [of("i", CURRENT), of("q", ANGLE), of("on", state, conversion=labels)]
    signals.append(of("text", words, encoding="utf-8"))
    path = write(tmp_path / "log.mf4", signals)
    recording = load_file(tmp_path, path.name, CHANNELS[:-1] + ", enabled: on}")
    same(recording.channels["enabled"], state.astype(np.float64))
    assert "`on` holds labels (off, on): read as its raw numbers" in recording.notes
    with pytest.raises(InputError, match=r"channel 'text' does not contain real numbers \(text\)"):
        load_file(tmp_path, path.name, "{time: time, current: i, angle: text}")
    (problem,) = [c.problem for c in look_at_file(path, PLAIN).columns if c.name == "text"]
    assert "does not contain real numbers" in problem


START = np.datetime64("2026-03-04T05:06:07.250000", "us")
WAVE = {"wf_increment": 1e-3, "wf_start_offset": 0.0, "wf_start_time": START}


def write_tdms(path: Path, *channels: tuple[str, str, object, Mapping[str, object]]) -> Path:
    objects = [ChannelObject(group, name, data, dict(more)) for group, name, data, more in channels]
    with TdmsWriter(path) as writer:
        writer.write_segment([RootObject({}), *objects])
    return path


def test_a_waveform_is_time_and_numbers_to_the_last_bit(tmp_path: Path) -> None:
    write_tdms(tmp_path / "log.tdms", ("g", "i", CURRENT, WAVE), ("g", "q", ANGLE, WAVE))
    recording = load_file(tmp_path, "log.tdms", CHANNELS)
    same(recording.time, TIME)
    same(recording.channels["current"], CURRENT)
    same(recording.channels["angle"], ANGLE)
    assert recording.notes == ()


def test_scales_are_applied_or_refused(tmp_path: Path) -> None:
    counts = np.rint(1000 * CURRENT).astype(np.int16)
    linear = {
        "NI_Scaling_Status": "unscaled",
        "NI_Number_Of_Scales": 1,
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 0.25,
        "NI_Scale[0]_Linear_Y_Intercept": 1.5,
        "NI_Scale[0]_Linear_Input_Source": Uint32(0xFFFFFFFF),
    }
    path = write_tdms(tmp_path / "a.tdms", ("g", "x", counts, linear))
    same(open_table(path, PLAIN).read([0])[0], counts * 0.25 + 1.5)
    path = write_tdms(
        tmp_path / "b.tdms", ("g", "x", counts, {**linear, "NI_Scale[0]_Scale_Type": "Spline"})
    )
    with pytest.raises(InputError, match=r"scale cannot be applied .*Spline.*save the scaled"):
        open_table(path, PLAIN).read([0])


def test_groups_share_a_clock_where_their_start_is_known(tmp_path: Path) -> None:
    later = {"wf_increment": 2e-3, "wf_start_time": START + np.timedelta64(10_000, "us")}
    write_tdms(
        tmp_path / "log.tdms",
        ("fast", "i", CURRENT, WAVE),
        ("slow", "q", 3.0 * (TIME[: N // 2] * 2 + 0.01), later),
    )
    channels = CHANNELS.replace("time: time", "time: fast.time")
    recording = load_file(tmp_path, "log.tdms", channels)
    same(recording.channels["current"], CURRENT[10:])
    np.testing.assert_allclose(recording.channels["angle"], 3.0 * TIME[10:], atol=1e-12)
    assert any("`angle`: of slow (500 Hz), interpolated" in note for note in recording.notes)
    assert any("10 rows of fast outside" in note for note in recording.notes)


def test_groups_without_a_common_clock_are_refused(tmp_path: Path) -> None:
    write_tdms(
        tmp_path / "log.tdms",
        ("fast", "i", CURRENT, WAVE),
        ("slow", "q", ANGLE, {"wf_increment": 2e-3}),
    )
    with pytest.raises(InputError, match="slow has no stamps on a clock that all"):
        load_file(tmp_path, "log.tdms", CHANNELS.replace("time: time", "time: fast.time"))


def test_a_file_that_was_cut_off_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "log.tdms"
    with TdmsWriter(path) as writer:
        for part in range(3):
            rows = slice(100 * part, 100 * part + 100)
            writer.write_segment(
                [
                    ChannelObject("g", "i", CURRENT[rows], WAVE),
                    ChannelObject("g", "q", ANGLE[rows], WAVE),
                ]
            )
    whole = path.read_bytes()
    for cut, rows in ((1700, 200), (900, 200), (100, 287)):
        path.write_bytes(whole[:-cut])
        recording = load_file(tmp_path, path.name, CHANNELS)
        same(recording.channels["current"], CURRENT[:rows])
        same(recording.channels["angle"], ANGLE[:rows])
        assert any("cut off" in n or "is incomplete" in n for n in recording.notes)
