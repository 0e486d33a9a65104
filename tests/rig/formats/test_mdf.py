"""MDF files written by asammdf: the numbers come back to the last bit, or are refused in words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from asammdf import MDF, Signal

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
