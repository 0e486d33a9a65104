"""HDF5, MATLAB v7.3, JSON and arrays of numpy: to the last bit, or refused in words."""

import json
from pathlib import Path

import h5py
import hdf5storage
import numpy as np
import pandas as pd
import pytest
import scipy.io.matlab

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources.formats import open_table
from tests.rig.formats.campaigns import ANGLE, CURRENT, TIME, N, load_file, same

PLAIN = ReadSection()
CHANNELS = "{time: t, current: i, angle: q}"


def matlab(path: Path, **variables: object) -> Path:
    hdf5storage.savemat(str(path), variables, format="7.3", appendmat=False)
    return path


def columns(path: Path) -> dict[str, np.ndarray]:
    table = open_table(path, ReadSection())
    return {name: table.read([k])[0] for k, name in enumerate(table.names)}


def test_a_file_of_matlab_itself() -> None:
    path = Path(scipy.io.matlab.__file__).parent / "tests" / "data" / "testhdf5_7.4_GLNX86.mat"
    if not path.exists():
        pytest.skip("scipy's test data are not installed")
    found = columns(path)
    assert list(found) == ["testdouble"]
    same(found["testdouble"], np.arange(9) * np.pi / 4)


def test_variables_rows_and_matrices_of_matlab(tmp_path: Path) -> None:
    path = matlab(
        tmp_path / "log.mat",
        t=TIME[:, None],
        i=CURRENT[None, :],
        both=np.column_stack([100 * ANGLE, ANGLE]),
        on=np.arange(N)[:, None] > 3,
        big=np.arange(N, dtype=np.uint64)[:, None] + 2**63,
        word="text",
        z=np.exp(1j * ANGLE)[:, None],
    )
    channels = "{time: t, current: i, motor_angle: 'both[0]', angle: 'both[1]', enabled: 'on'}"
    recording = load_file(tmp_path, path.name, channels)
    same(recording.time, TIME)
    same(recording.channels["current"], CURRENT)
    same(recording.channels["motor_angle"], 100 * ANGLE)
    same(recording.channels["angle"], ANGLE)
    table = open_table(path, PLAIN)
    assert "word" not in table.names
    same(table.read([table.names.index("big")])[0], np.arange(N))
    assert "beyond 2^53" in table.notes[0]
    with pytest.raises(InputError, match=r"'z' does not contain real numbers \(complex"):
        table.read([table.names.index("z")])


def test_structs_and_cells_of_matlab(tmp_path: Path) -> None:
    cell = np.empty(2, dtype=object)
    cell[:] = [TIME[:, None], CURRENT[:, None]]
    path = matlab(tmp_path / "log.mat", run={"t": TIME[:, None], "m": {"i": CURRENT[:, None]}})
    found = columns(path)
    same(found["run.t"], TIME)
    same(found["run.m.i"], CURRENT)
    path = matlab(tmp_path / "cell.mat", c=cell)
    found = columns(path)
    same(found["c[0]"], TIME)
    same(found["c[1]"], CURRENT)
    assert found.keys() == {"c[0]", "c[1]"}


def test_groups_compounds_units_and_fills_of_hdf5(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    spoiled = np.rint(1000 * CURRENT).astype(np.int16)
    spoiled[[50, 51]] = -9999
    table = np.zeros(N, dtype=[("t", "f8"), ("name", "S4"), ("q", ">f4")])
    table["t"], table["q"] = TIME, ANGLE
    with h5py.File(path, "w") as file:
        data = file.create_dataset("run/motor/i", data=spoiled, compression="gzip")
        data.attrs.update({"units": "A", "scale_factor": 0.001, "_FillValue": np.int16(-9999)})
        file["table"] = table
        file["both"] = np.stack([CURRENT, ANGLE])
        file["outside"] = h5py.ExternalLink("other.h5", "/x")
        layout = h5py.VirtualLayout((N,), "f8")
        layout[:] = h5py.VirtualSource("other.h5", "x", shape=(N,))
        file.create_virtual_dataset("elsewhere", layout)
    found = open_table(path, ReadSection())
    assert found.names == ("both[0]", "both[1]", "run.motor.i", "table.t", "table.q")
    assert found.units == ("", "", "A", "", "")
    assert set(found.notes[0].removeprefix("left out: ").split(", ")) == {
        "elsewhere (its data are in other files)",
        "outside (a link to another file)",
    }
    recording = load_file(tmp_path, "log.h5", "{time: t, current: i, angle: table.q}")
    known = spoiled != -9999
    same(recording.channels["current"][known], spoiled[known] * 0.001)
    same(recording.channels["angle"], ANGLE.astype(np.float32).astype(float))
    assert any("scale_factor and add_offset of the file applied" in n for n in recording.notes)
    assert "`current`: 2 missing samples interpolated" in recording.notes


NAMED = "{time: t, current: i, angle: q}"
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
    recording = load_file(tmp_path, "log.json", NAMED)
    np.testing.assert_allclose(recording.time, TIME, rtol=0, atol=1e-15)
    np.testing.assert_allclose(recording.channels["current"], CURRENT, rtol=0, atol=1e-14)
    np.testing.assert_allclose(recording.channels["angle"], ANGLE, rtol=0, atol=1e-14)


def test_dates_nulls_and_nanoseconds(tmp_path: Path) -> None:
    stamps = pd.to_datetime(1_700_000_000_000_000_000 + np.arange(N) * 1_000_001)
    current: list[object] = [*CURRENT]
    current[30] = None
    rows = {"t": [f"{s.isoformat()}Z" for s in stamps], "i": current, "q": [*ANGLE]}
    (tmp_path / "log.json").write_text(json.dumps(rows))
    recording = load_file(tmp_path, "log.json", NAMED)
    same(recording.time, np.arange(N) * 1_000_001 / 1e9)
    assert "`current`: 1 missing samples interpolated" in recording.notes
    (tmp_path / "log.json").write_text(json.dumps(rows | {"t": [int(s.value) for s in stamps]}))
    channels = NAMED.replace("time: t", "time: {column: t, scale: 1.0e-9}")
    recording = load_file(tmp_path, "log.json", channels)
    np.testing.assert_allclose(recording.time, np.arange(N) * 1.000001e-3, atol=1e-15)
    assert any("integers beyond 2^53" in note for note in recording.notes)


def test_columns_of_two_tables_share_no_rows(tmp_path: Path) -> None:
    value = {"a": {"t": [*TIME], "i": [*CURRENT]}, "b": {"q": [*ANGLE[:100]]}}
    (tmp_path / "log.json").write_text(json.dumps(value))
    with pytest.raises(InputError, match=r"a \(300 rows\), b \(100 rows\).* use columns of one"):
        load_file(tmp_path, "log.json", NAMED)


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
    channels = NAMED.replace("time: t", "time: {column: t, scale: 1.0e-9}")
    recording = load_file(tmp_path, "log.npz", channels)
    same(recording.time, np.arange(N) * 1_000_001 * 1e-9)
    with pytest.raises(InputError, match=r"'z' does not contain real numbers \(complex numbers\)"):
        load_file(tmp_path, "log.npz", "{time: t, current: i, angle: z}")


def test_a_signalling_not_a_number_is_missing(tmp_path: Path) -> None:
    values = np.array([0x3F800000, 0x7FA00000], np.uint32).view(np.float32)
    np.save(tmp_path / "log.npy", values)
    (found,) = open_table(tmp_path / "log.npy", ReadSection()).read([0])
    same(found, np.array([1.0, np.nan]))
