"""What is kept of compiled kernels: renewed with everything that is compiled in, and never in the
way of a result.
"""

from __future__ import annotations

import errno
import importlib.util
import logging
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba.core.caching import IndexDataCacheFile

import drivers.mock.plant.parts.compiled
import identification.numerics.compiled
from identification.numerics.compiled import KernelCache, digest

CALLED = """
from identification.numerics.compiled import compiled
from {constants} import FACTOR

@compiled
def scaled(value):
    return FACTOR * value
"""
CALLER = """
from identification.numerics.compiled import compiled
from {called} import scaled

@compiled
def shifted(value):
    return 1.0 + scaled(value)
"""
DIGESTS = """
import importlib, pkgutil
import drivers.mock.plant, identification
from drivers.mock.plant.parts import kernel_cache
for package in (identification, drivers.mock.plant):
    for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        for name, value in sorted(vars(importlib.import_module(found.name)).items()):
            if hasattr(value, "py_func"):
                print(found.name, name, kernel_cache.digest(value))
"""

Package = Callable[[float], ModuleType]


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Package:
    """Write three modules that call each other, with a constant in the last, and load the first
    anew.
    """
    names = {name: f"{name}_{tmp_path.name}" for name in ("constants", "called", "caller")}
    monkeypatch.syspath_prepend(str(tmp_path))
    identification.numerics.compiled._SAID.clear()

    def load(factor: float) -> ModuleType:
        texts = {"constants": f"FACTOR = {factor}\n", "called": CALLED, "caller": CALLER}
        for name, text in texts.items():
            (tmp_path / f"{names[name]}.py").write_text(text.format(**names), encoding="utf-8")
            monkeypatch.delitem(sys.modules, names[name], raising=False)
        importlib.invalidate_caches()
        for file in (
            (tmp_path / "__pycache__").glob("*.pyc") if (tmp_path / "__pycache__").is_dir() else ()
        ):
            file.unlink()
        return importlib.import_module(names["caller"])

    return load


def test_the_two_copies_are_one() -> None:
    first, second = (
        identification.numerics.compiled.__file__,
        drivers.mock.plant.parts.compiled.__file__,
    )
    assert first != second
    assert Path(first).read_text(encoding="utf-8") == Path(second).read_text(encoding="utf-8")


def test_machine_code_is_kept_and_used(package: Package) -> None:
    first = package(2.0)
    assert first.shifted(3.0) == 7.0
    assert first.shifted.stats.cache_misses
    again = package(2.0)
    assert again.shifted(3.0) == 7.0
    assert again.shifted.stats.cache_hits
    assert not again.shifted.stats.cache_misses


@pytest.mark.parametrize("terminal", [True, False])
def test_a_person_who_waits_is_told_of_the_first_compilation(
    package: Package,
    terminal: bool,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    identification.numerics.compiled._COMPILING.clear()
    for _ in range(2):
        assert package(2.0).shifted(3.0) == 7.0
    said = [r for r in caplog.messages if "compiling" in r]
    assert len(said) == terminal


def test_a_changed_constant_of_a_called_kernel_renews_the_caller(
    package: Package, tmp_path: Path
) -> None:
    assert package(2.0).shifted(3.0) == 7.0
    before = kept(tmp_path / "__pycache__")
    assert package(4.0).shifted(3.0) == 13.0
    after = kept(tmp_path / "__pycache__")
    assert len(after) == len(before)
    assert not before & after, "what was compiled before is removed"


def test_a_full_disk_costs_a_compilation(
    package: Package,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(IndexDataCacheFile, "_save_data", full)
    with caplog.at_level(logging.WARNING):
        assert package(2.0).shifted(3.0) == 7.0
        assert package(2.0).shifted(3.0) == 7.0
    assert [record.getMessage() for record in caplog.records] == [
        "compiled kernels cannot be stored, so each start of the program compiles them again "
        f"({tmp_path / '__pycache__'}: No space left on device)"
    ]


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("content", [b"", b"not a pickle", b"\x80\x04."])
def test_a_damaged_file_costs_a_compilation(
    package: Package, tmp_path: Path, ending: str, content: bytes
) -> None:
    assert package(2.0).shifted(3.0) == 7.0
    for file in (tmp_path / "__pycache__").glob(f"*.{ending}"):
        file.write_bytes(content)
    assert package(2.0).shifted(3.0) == 7.0


def test_without_a_folder_of_its_own_it_is_kept_in_a_private_temporary_one(
    package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = nowhere_but_temporary(tmp_path, monkeypatch)
    assert package(2.0).shifted(3.0) == 7.0
    private = next(folder.iterdir())
    assert private.stat().st_mode & 0o077 == 0
    assert kept(private)
    again = package(2.0)
    assert again.shifted(3.0) == 7.0
    assert again.shifted.stats.cache_hits
    assert package(4.0).shifted(3.0) == 13.0


@pytest.mark.parametrize("how", ["writable by others", "a link", "a file"])
def test_a_temporary_folder_that_others_could_write_is_not_used(
    package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    folder = nowhere_but_temporary(tmp_path, monkeypatch)
    place = folder / f"loadrig-kernels-{os.geteuid()}"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir(mode=0o700)
    if how == "a link":
        place.symlink_to(elsewhere)
    elif how == "a file":
        place.write_bytes(b"")
    else:
        place.mkdir()
        place.chmod(0o777)
    assert package(2.0).shifted(3.0) == 7.0
    assert not kept(elsewhere)
    assert not (place.is_dir() and kept(place))


def test_without_any_folder_it_computes_all_the_same(
    package: Package,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    nowhere_but_temporary(tmp_path, monkeypatch)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with caplog.at_level(logging.WARNING):
        assert package(2.0).shifted(3.0) == 7.0
    assert len(caplog.records) == 1


def test_every_kernel_has_the_same_digest_in_every_process() -> None:
    found = [
        subprocess.run(
            [sys.executable, "-c", DIGESTS],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(sys.path)},
        ).stdout
        for seed in ("1", "2")
    ]
    assert found[0].count("\n") > 80
    assert found[0] == found[1]


def test_the_digest_follows_options_and_nested_values() -> None:
    def plain(value: float) -> float:
        return value

    class Dispatcher:
        py_func = plain
        targetoptions: dict[str, Any]

    first, second = Dispatcher(), Dispatcher()
    first.targetoptions, second.targetoptions = {"nogil": True}, {"nogil": False}
    assert digest(first) != digest(second)  # type: ignore[arg-type]
    assert digest(first) == digest(first)  # type: ignore[arg-type]


def test_numba_still_keeps_a_cache_where_it_is_replaced() -> None:
    """A version of numba that looks elsewhere for it would compile at every start."""
    from identification.numerics.series import __dict__ as names

    kernels = [value for value in names.values() if hasattr(value, "py_func")]
    assert kernels
    assert all(isinstance(kernel._cache, KernelCache) for kernel in kernels)


def kept(folder: Path) -> set[str]:
    return {file.name for file in folder.glob("*.nb[ci]")}


def nowhere_but_temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put files where numba would make its folders; return the folder of temporary files."""
    blocked = tmp_path / "blocked"
    blocked.write_bytes(b"")
    (tmp_path / "__pycache__").write_bytes(b"")
    monkeypatch.setenv("HOME", str(blocked))
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder
