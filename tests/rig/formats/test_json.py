"""JSON files as Python, pandas and browsers write them, and arrays of numpy."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.formats import open_table
from tests.rig.formats.campaigns import ANGLE, CURRENT, TIME, N, load_file, same

CHANNELS = "{time: t, current: i, angle: q}"
FRAME = pd.DataFrame({"t": TIME, "i": CURRENT, "q": ANGLE})
COLUMNS = FRAME.to_dict("list")
ROWS = FRAME.to_numpy().tolist()


@pytest.mark.parametrize(
    "value",
    [
        {"meta": [1, {"a": 2}], "run": COLUMNS},
        [["t", "i", "q"], *ROWS],
        json.loads(FRAME.to_json(orient="table", double_precision=15)),
    ],
    ids=["beside", "rows", "table"],
)
def test_every_shape_is_the_truth(tmp_path: Path, value: object) -> None:
    (tmp_path / "log.json").write_text(json.dumps(value))
    recording = load_file(tmp_path, "log.json", CHANNELS)
    np.testing.assert_allclose(recording.time, TIME, rtol=0, atol=1e-15)
    np.testing.assert_allclose(recording.channels["current"], CURRENT, rtol=0, atol=1e-14)
    np.testing.assert_allclose(recording.channels["angle"], ANGLE, rtol=0, atol=1e-14)


def test_numbers_come_back_to_the_last_bit(tmp_path: Path) -> None:
    (tmp_path / "log.json").write_text("\ufeff" + json.dumps(COLUMNS), encoding="utf-8")
    recording = load_file(tmp_path, "log.json", CHANNELS)
    same(recording.time, TIME)
    same(recording.channels["current"], CURRENT)
    same(recording.channels["angle"], ANGLE)
    assert recording.notes == ()


def test_dates_nulls_and_nanoseconds(tmp_path: Path) -> None:
    stamps = pd.to_datetime(1_700_000_000_000_000_000 + np.arange(N) * 1_000_001)
    current: list[object] = [*CURRENT]
    current[30] = None
    rows = {"t": [f"{s.isoformat()}Z" for s in stamps], "i": current, "q": [*ANGLE]}
    (tmp_path / "log.json").write_text(json.dumps(rows))
    recording = load_file(tmp_path, "log.json", CHANNELS)
    same(recording.time, np.arange(N) * 1_000_001 / 1e9)
    assert "`current`: 1 missing samples interpolated" in recording.notes
    (tmp_path / "log.json").write_text(json.dumps(rows | {"t": [int(s.value) for s in stamps]}))
    channels = CHANNELS.replace("time: t", "time: {column: t, scale: 1.0e-9}")
    recording = load_file(tmp_path, "log.json", channels)
    np.testing.assert_allclose(recording.time, np.arange(N) * 1.000001e-3, atol=1e-15)
    assert any("integers beyond 2^53" in note for note in recording.notes)


def test_columns_of_two_tables_share_no_rows(tmp_path: Path) -> None:
    value = {"a": {"t": [*TIME], "i": [*CURRENT]}, "b": {"q": [*ANGLE[:100]]}}
    (tmp_path / "log.json").write_text(json.dumps(value))
    with pytest.raises(InputError, match=r"a \(300 rows\), b \(100 rows\).* use columns of one"):
        load_file(tmp_path, "log.json", CHANNELS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not JSON"),
        ('{"t": 1}\n{"t": 2}\n', r"not JSON .*one object a line is named \.jsonl"),
        ('{"t": [1, 2], "t": [3, 4]}', "the key 't' twice"),
        ('{"t": 1}', "holds no table of numbers"),
        ("[[1, 2], [3]]", "row 1 of the file has 1 values, but the first has 2"),
        ("[" * 100_000, "not JSON"),
        (json.dumps([10**400, 10**400]), "holds no table"),
    ],
    ids=["empty", "lines", "twice", "no-table", "ragged", "deep", "huge"],
)
def test_what_is_no_table_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "log.json").write_text(text)
    with pytest.raises(InputError, match=words):
        open_table(tmp_path / "log.json", ReadSection())


def test_types_of_numpy(tmp_path: Path) -> None:
    rows = np.zeros(N, dtype=[("t", "M8[us]"), ("i", ">f8"), ("q", "f4", (2,))])
    rows["t"] = np.datetime64("2026-01-01T00:00:00", "us") + np.arange(N) * 1000
    rows["i"], rows["q"][:, 1] = CURRENT, ANGLE
    truth = ANGLE.astype(np.float32).astype(float)
    for name, prefix in (("log.npy", ""), ("log.npz", "run.")):
        if prefix:
            np.savez_compressed(tmp_path / name, run=rows, other=np.arange(3))
        else:
            np.save(tmp_path / name, rows)
        channels = f"{{time: {prefix}t, current: {prefix}i, angle: '{prefix}q[1]'}}"
        recording = load_file(tmp_path, name, channels)
        same(recording.time, np.arange(N) / 1e3)
        same(recording.channels["current"], CURRENT)
        same(recording.channels["angle"], truth)
        assert any("dates: read as seconds since 2026-01-01" in n for n in recording.notes)


def test_nanoseconds_in_numpy_are_exact_and_complex_numbers_refused(tmp_path: Path) -> None:
    stamps = 1_700_000_000_000_000_000 + np.arange(N) * 1_000_001
    np.savez(tmp_path / "log.npz", t=stamps, i=CURRENT, q=ANGLE, z=ANGLE * 1j)
    channels = CHANNELS.replace("time: t", "time: {column: t, scale: 1.0e-9}")
    recording = load_file(tmp_path, "log.npz", channels)
    same(recording.time, np.arange(N) * 1_000_001 * 1e-9)
    with pytest.raises(InputError, match=r"'z' does not contain real numbers \(complex numbers\)"):
        load_file(tmp_path, "log.npz", "{time: t, current: i, angle: z}")


def test_a_signalling_not_a_number_is_missing(tmp_path: Path) -> None:
    values = np.array([0x3F800000, 0x7FA00000], np.uint32).view(np.float32)
    np.save(tmp_path / "log.npy", values)
    (found,) = open_table(tmp_path / "log.npy", ReadSection()).read([0])
    same(found, np.array([1.0, np.nan]))
