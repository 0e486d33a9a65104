"""TDMS files written by npTDMS: the numbers come back to the last bit, or are refused in words."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from nptdms import ChannelObject, RootObject, TdmsWriter
from nptdms.types import Uint32

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.formats import open_table
from rig.sources.look import look_at_file
from tests.rig.formats.campaigns import ANGLE, CURRENT, TIME, N, load_file, same

PLAIN = ReadSection()
CHANNELS = "{time: time, current: i, angle: q}"
START = np.datetime64("2026-03-04T05:06:07.250000", "us")
WAVE = {"wf_increment": 1e-3, "wf_start_offset": 0.0, "wf_start_time": START}


def write(path: Path, *channels: tuple[str, str, object, Mapping[str, object]]) -> Path:
    objects = [ChannelObject(group, name, data, dict(more)) for group, name, data, more in channels]
    with TdmsWriter(path) as writer:
        writer.write_segment([RootObject({}), *objects])
    return path


def test_a_waveform_is_time_and_numbers_to_the_last_bit(tmp_path: Path) -> None:
    write(tmp_path / "log.tdms", ("g", "i", CURRENT, WAVE), ("g", "q", ANGLE, WAVE))
    recording = load_file(tmp_path, "log.tdms", CHANNELS)
    same(recording.time, TIME)
    same(recording.channels["current"], CURRENT)
    same(recording.channels["angle"], ANGLE)
    assert recording.notes == ()


def test_channels_alike_without_a_waveform(tmp_path: Path) -> None:
    none: dict[str, object] = {}
    write(tmp_path / "log.tdms", ("g", "t", TIME, none), ("g", "i", CURRENT, none))
    with TdmsWriter(tmp_path / "log.tdms", mode="a") as writer:
        writer.write_segment([ChannelObject("g", "q", ANGLE, {"unit_string": "rad"})])
    recording = load_file(tmp_path, "log.tdms", CHANNELS.replace("time: time", "time: t"))
    same(recording.time, TIME)
    same(recording.channels["angle"], ANGLE)
    look = look_at_file(tmp_path / "log.tdms", PLAIN)
    assert [(c.name, c.unit) for c in look.columns] == [("t", ""), ("i", ""), ("q", "rad")]


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
    path = write(tmp_path / "a.tdms", ("g", "x", counts, linear))
    same(open_table(path, PLAIN).read([0])[0], counts * 0.25 + 1.5)
    path = write(
        tmp_path / "b.tdms", ("g", "x", counts, {**linear, "NI_Scale[0]_Scale_Type": "Spline"})
    )
    with pytest.raises(InputError, match=r"scale cannot be applied .*Spline.*save the scaled"):
        open_table(path, PLAIN).read([0])


def test_groups_share_a_clock_where_their_start_is_known(tmp_path: Path) -> None:
    later = {"wf_increment": 2e-3, "wf_start_time": START + np.timedelta64(10_000, "us")}
    write(
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
    write(
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
