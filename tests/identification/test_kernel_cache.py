"""Compiled kernels: their store on disk, the second thread, the exponential."""

import ast
import importlib
import logging
import os
import pkgutil
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import drivers.mock.plant.parts.compiled
import identification.numerics.compiled
from identification.numerics.compiled import LEAST, THREAD, both, compiled, each, exponential
from rig.cli.entry import find_kernel_folder

KERNEL = """
from {compiled} import compiled

@compiled
def shifted(value):
    return 1.0 + value

shifted.py_func.__module__ = {compiled!r}
"""
COPIES = [identification.numerics.compiled, drivers.mock.plant.parts.compiled]

Load = Callable[[], ModuleType]


@pytest.fixture(params=COPIES, ids=["identification", "drivers"])
def copy(request: pytest.FixtureRequest) -> ModuleType:
    for said in (request.param._say_not_kept, request.param._say_compiling):
        said.cache_clear()
    return request.param  # type: ignore[no-any-return]


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, copy: ModuleType) -> Load:
    """Return a function that imports a module with one kernel as a new process would."""
    name = f"kernel_{tmp_path.name}"
    monkeypatch.syspath_prepend(str(tmp_path))
    text = KERNEL.format(compiled=copy.__name__)
    (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")

    def imported() -> ModuleType:
        monkeypatch.delitem(sys.modules, name, raising=False)
        module = importlib.import_module(name)
        assert module.shifted(3.0) == 4.0
        return module

    return imported


def test_a_kernel_is_loaded_until_a_shared_source_changes(load, copy, monkeypatch):
    assert load().shifted.stats.cache_misses
    assert load().shifted.stats.cache_hits
    monkeypatch.setattr(copy, "_shared_sources", lambda: "changed")
    assert load().shifted.stats.cache_misses
    assert load().shifted.stats.cache_hits


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("content", [b"", b"not a pickle"])
def test_a_damaged_file_costs_a_compilation(load, tmp_path, ending, content):
    load()
    for file in (tmp_path / "__pycache__").glob(f"*.{ending}"):
        file.write_bytes(content)
    load()
    assert load().shifted.stats.cache_hits


def test_without_any_folder_a_kernel_computes_all_the_same(load, tmp_path, monkeypatch, caplog):
    blocked = tmp_path / "blocked"
    blocked.write_bytes(b"")
    (tmp_path / "__pycache__").write_bytes(b"")
    monkeypatch.setenv("HOME", str(blocked))
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    with caplog.at_level(logging.WARNING):
        load()
    assert len(caplog.records) == 1


@pytest.mark.parametrize("how", ["private", "writable by others", "a link", "a file"])
def test_only_a_private_temporary_folder_is_used(how, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_, **__: False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "to be restored")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    place = tmp_path / f"loadrig-kernels-{os.geteuid()}"
    if how == "a link":
        place.symlink_to(tmp_path)
    elif how == "a file":
        place.write_bytes(b"")
    elif how == "writable by others":
        place.mkdir()
        place.chmod(0o777)
    find_kernel_folder()
    assert os.environ.get("NUMBA_CACHE_DIR") == (str(place) if how == "private" else None)


def test_kernels_of_the_estimator_contain_only_their_own_file_and_shared_folders() -> None:
    """Otherwise a change of the other file would leave old machine code in use."""
    shared = tuple(f"identification.{folder}." for folder in COPIES[0]._SHARED)
    kernels = 0
    for found in pkgutil.walk_packages(identification.__path__, "identification."):
        module = importlib.import_module(found.name)
        imported = {
            alias.asname or alias.name: node.module or ""
            for node in ast.parse(Path(module.__file__).read_text(encoding="utf-8")).body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }
        for value in vars(module).values():
            if hasattr(value, "py_func") and value.py_func.__module__ == found.name:
                kernels += 1
                used = {imported.get(name, "") for name in value.py_func.__code__.co_names}
                own = {name for name in used if name.startswith("identification.")}
                assert all(name.startswith(shared) for name in own), (found.name, own)
    assert kernels > 40


def _name() -> str:
    return threading.current_thread().name


def test_the_second_function_runs_in_a_thread_that_stays() -> None:
    first, second = both(_name, _name)
    assert first == threading.main_thread().name
    assert second.startswith(THREAD)
    assert both(_name, _name) == (first, second)


def test_inside_a_call_the_functions_run_one_after_the_other() -> None:
    inside, beside = both(lambda: both(_name, _name), lambda: both(_name, _name))
    assert len(set(inside)) == len(set(beside)) == 1
    assert inside != beside


@pytest.mark.parametrize("failing", [0, 1])
def test_a_failure_is_raised_after_both_have_ended_and_the_thread_goes_on(failing: int) -> None:
    ended = []

    def work(number: int) -> None:
        if number == failing:
            raise ValueError(str(number))
        ended.append(number)

    with pytest.raises(ValueError, match=str(failing)):
        both(lambda: work(0), lambda: work(1))
    assert ended == [1 - failing]
    assert both(_name, _name)[1].startswith(THREAD)


def test_two_items_run_at_the_same_time_and_results_keep_the_order_of_the_items() -> None:
    meeting = threading.Barrier(2, timeout=10.0)

    def work(item: int) -> int:
        if item < 2:
            meeting.wait()  # passes only if another item is worked on meanwhile
        return 10 * item

    assert each(work, range(5)) == [0, 10, 20, 30, 40]
    assert each(work, []) == []


@compiled
def of_all(x: np.ndarray) -> np.ndarray:
    out = np.empty_like(x)
    for k in range(len(x)):
        out[k] = exponential(x[k])
    return out


def test_the_exponential_is_the_librarys_to_a_unit_in_the_last_place() -> None:
    x = np.concatenate([np.linspace(LEAST, 0.0, 100_001), -np.geomspace(1e-300, 1.0, 10_001)])
    assert np.max(np.abs(of_all(x) / np.exp(x) - 1.0)) < 1.1 * np.finfo(float).eps
