"""Compiled kernels are stored on disk, are renewed with everything that is compiled in, and a store
that fails never costs a result.
"""

from __future__ import annotations

import ast
import importlib
import logging
import os
import pkgutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

import drivers.mock.plant.parts.compiled
import identification.numerics.compiled
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


def test_a_kernel_is_loaded_until_a_shared_source_changes(
    load: Load, copy: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert load().shifted.stats.cache_misses
    assert load().shifted.stats.cache_hits
    monkeypatch.setattr(copy, "_shared_sources", lambda: "changed")
    assert load().shifted.stats.cache_misses
    assert load().shifted.stats.cache_hits


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("content", [b"", b"not a pickle"])
def test_a_damaged_file_costs_a_compilation(
    load: Load, tmp_path: Path, ending: str, content: bytes
) -> None:
    load()
    for file in (tmp_path / "__pycache__").glob(f"*.{ending}"):
        file.write_bytes(content)
    load()
    assert load().shifted.stats.cache_hits


def test_without_any_folder_a_kernel_computes_all_the_same(
    load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    blocked = tmp_path / "blocked"
    blocked.write_bytes(b"")
    (tmp_path / "__pycache__").write_bytes(b"")
    monkeypatch.setenv("HOME", str(blocked))
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    with caplog.at_level(logging.WARNING):
        load()
    assert len(caplog.records) == 1


@pytest.mark.parametrize("how", ["private", "writable by others", "a link", "a file"])
def test_only_a_private_temporary_folder_is_used(
    how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
