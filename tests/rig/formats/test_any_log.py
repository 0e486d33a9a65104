"""Random and damaged logs of every format, and the second process that reads them."""

import importlib
import subprocess
import sys
from pathlib import Path
from random import Random

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.common.errors import InputError
from rig.config.campaign_sections import ReadSection
from rig.sources import formats, served
from rig.sources.formats import FORMATS, SERVED, open_table
from tests.rig.formats.shapes import PROPERTIES
from tests.rig.formats.test_look_formats import WRITERS


@pytest.mark.parametrize("kind", PROPERTIES)
def test_any_log_is_read_right_or_something_is_said(kind: str, tmp_path: Path) -> None:
    logs, holds = PROPERTIES[kind]

    @settings(max_examples=40, suppress_health_check=list(HealthCheck))
    @given(st.integers(0, 2**63))
    def run(number: int) -> None:
        holds(logs(Random(number)), tmp_path)

    run()


PLAIN = ReadSection()
TIME = np.arange(40.0)


def mat(path: Path) -> None:
    scipy.io.savemat(path, {"t": TIME, "s": {"x": TIME, "word": "abc"}})


@pytest.mark.parametrize("kind", [*WRITERS, "mat"])
def test_any_damage_is_read_or_refused_with_the_name_of_the_file(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"a.{kind}"
    (WRITERS | {"mat": mat})[kind](path)
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    for _ in range(25):
        data = bytearray(whole[: int(rng.integers(1, len(whole) + 1))])
        for place in rng.integers(0, len(data), 3):
            data[place] = rng.integers(256)
        path.write_bytes(data)
        try:
            table = open_table(path, PLAIN)
            for column in range(len(table.names)):
                table.read([column])
        except InputError as error:
            assert str(path) in str(error)  # noqa: PT017 - either outcome is right


def test_a_library_that_ends_its_process_is_an_error_and_the_next_file_is_read(tmp_path):
    path, good = tmp_path / "a.mat", tmp_path / "good.mat"
    mat(good)
    scipy.io.savemat(path, {"t": np.arange(9.0)})
    raw = bytearray(path.read_bytes())
    raw[128 + 48] = 14  # the element of the numbers states that it is a matrix
    path.write_bytes(raw)
    with pytest.raises(InputError, match=r"a\.mat: cannot be read \(.* with SIG"):
        open_table(path, PLAIN).read([0])
    np.testing.assert_array_equal(open_table(good, PLAIN).read([0])[0], TIME)


def test_an_open_table_outlives_its_process(tmp_path: Path) -> None:
    mat(tmp_path / "a.mat")
    table = open_table(tmp_path / "a.mat", PLAIN)
    served.READER.process.kill()
    served.READER.process.wait()
    np.testing.assert_array_equal(table.read([1])[0], TIME)


def test_a_request_that_is_interrupted_leaves_no_half_answer(tmp_path, monkeypatch):
    mat(tmp_path / "a.mat")
    table = open_table(tmp_path / "a.mat", PLAIN)

    def interrupted(*_: object, **__: object) -> object:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(np, "empty", interrupted)
        with pytest.raises(KeyboardInterrupt):
            table.read([0])
    assert served.READER.process is None
    np.testing.assert_array_equal(table.read([0])[0], TIME)


@pytest.mark.parametrize(
    ("kind", "extra"), [("h5", "hdf5"), ("mf4", "mdf"), ("tdms", "tdms"), ("parquet", "parquet")]
)
def test_a_library_that_is_not_installed_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, extra: str
) -> None:
    (tmp_path / f"a.{kind}").write_bytes(b"x")
    module, name = FORMATS[kind].split(":")
    importlib.import_module(f"rig.sources.{module}")

    def refuse(name: str) -> object:
        raise ImportError(name)

    monkeypatch.setattr("rig.sources.table.importlib.import_module", refuse)
    with pytest.raises(InputError, match=rf"pip install 'loadrig\[{extra}\]'"):
        getattr(sys.modules[f"rig.sources.{module}"], name)(tmp_path / f"a.{kind}")


def test_the_second_process_imports_no_driver_and_no_numerics() -> None:
    code = (
        "import sys; from rig.sources import arrays, served; "
        "print([m for m in sys.modules if m.split('.')[0] in ('drivers', 'numba', 'pydantic')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert formats.FORMATS.keys() >= SERVED
