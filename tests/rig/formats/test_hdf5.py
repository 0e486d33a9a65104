"""HDF5 by h5py, MATLAB v7.3 by MATLAB and hdf5storage: to the last bit, or refused in words."""

from __future__ import annotations

from pathlib import Path

import h5py
import hdf5storage
import numpy as np
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
