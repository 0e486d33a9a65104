"""Where the machine code of compiled kernels is kept between processes, and when it is compiled
anew.

numba's own cache has three gaps that this module closes. It refuses to compile where no folder can
be written, and a disk that fills up ends the call. It renews machine code when the module of a
kernel changes, but not when a kernel or a constant of another module changes that was compiled into
it. Here whatever fails in the cache costs a compilation and nothing else, and the file name carries
a digest of everything that is compiled in.

The same file stands in `identification` and in `drivers.mock.plant`, which never import each other;
a test compares the two.
"""

from __future__ import annotations

import hashlib
import logging
import os
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from threading import Event
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache

_LOG = logging.getLogger(__name__)
_DIGEST_DIGITS = 12
_SAID = Event()


class KernelCache:
    """Keeps the machine code of one kernel; takes the place of numba's cache in a dispatcher.

    Nothing is looked up before the first call, when every kernel that this one calls is defined.

    Args:
        function: The kernel's Python function.
    """

    def __init__(self, function: FunctionType) -> None:
        self._function = function
        self._files: Any = None

    @property
    def cache_path(self) -> str | None:
        """The folder, or None where there is none yet."""
        return None if self._files is None else str(self._files.cache_path)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return what was compiled for a signature, or None where that is not there or cannot be
        used.
        """
        try:
            return self._opened().load_overload(signature, target)
        except Exception as error:  # noqa: BLE001 - unpickling a damaged file raises anything; compiling is the remedy
            _LOG.info("%s is compiled anew: %s", self._function.__qualname__, error)
            if self._files is not None:
                self._files.remove()
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep what was compiled for a signature, if that is possible."""
        try:
            files = self._opened()
            files.save_overload(signature, compiled)
            files.remove(outdated=True)
        except OSError as error:
            _say_not_kept(f"{self.cache_path}: {error.strerror}")
        except RuntimeError:
            # numba's word for it names a kernel, which tells an operator nothing.
            _say_not_kept("no folder for them can be written")

    def enable(self) -> None:
        """Stay as it is: it is always on."""

    def disable(self) -> None:
        """Stay as it is; numba calls this nowhere."""

    def flush(self) -> None:
        """Forget what is kept for this kernel."""
        self._opened().flush()

    def _opened(self) -> Any:
        if self._files is None:
            self._files = _Files(self._function)
        return self._files


def digest(kernel: Callable[..., Any]) -> str:
    """Return a digest of everything that is compiled into a kernel: its own code, constants, and
    the kernels it calls.

    Args:
        kernel: A Python function, or numba's dispatcher of one.
    """
    found = hashlib.sha256()
    seen: set[CodeType] = set()
    todo: list[Any] = [kernel]
    while todo:
        item = todo.pop()
        function = getattr(item, "py_func", item)
        if function.__code__ in seen:
            continue
        seen.add(function.__code__)
        for name, value in getattr(item, "targetoptions", {}).items():
            found.update(f"{name}:".encode() + _content(value))
        for part in _parts(function.__code__):
            found.update(part)
        for name, value in _named(function):
            if isinstance(getattr(value, "py_func", value), FunctionType):
                todo.append(value)
                value = value.__name__
            found.update(f"{name}=".encode())
            found.update(_content(value))
    return found.hexdigest()[:_DIGEST_DIGITS]


def _parts(code: CodeType) -> Iterator[bytes]:
    yield code.co_code
    yield repr((code.co_names, code.co_varnames)).encode()
    for constant in code.co_consts:
        # The representation of nested code holds an address, which differs by process.
        yield from _parts(constant) if isinstance(constant, CodeType) else (_content(constant),)


def _named(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield the globals that a function names, and what it may take from modules and classes among
    them.
    """
    names = function.__code__.co_names
    for name in names:
        value = function.__globals__.get(name)
        if not isinstance(value, ModuleType | type):
            yield name, value
        elif _home(value) == __name__.partition(".")[0]:
            yield from ((f"{name}.{inner}", getattr(value, inner, None)) for inner in names)


def _home(value: ModuleType | type) -> str:
    """Return the package that a module or a class belongs to; what others change comes with another
    version of them.
    """
    return (value.__module__ if isinstance(value, type) else value.__name__).partition(".")[0]


def _content(value: Any) -> bytes:
    if isinstance(value, np.ndarray):
        return repr((value.dtype.str, value.shape)).encode() + value.tobytes()
    if isinstance(value, set | frozenset):
        # Its order differs by process.
        return repr(sorted(map(repr, value))).encode()
    return repr(value).encode()


class _TemporaryFolder:
    """Keeps machine code among the temporary files, in a folder that nobody else can write: it is
    executed.

    One of numba's cache locators, asked after all of its own.
    """

    def __init__(self, function: FunctionType, file: str) -> None:
        self._line = function.__code__.co_firstlineno
        self._source = Path(file)
        self._path = Path(tempfile.gettempdir()) / f"loadrig-kernels-{_user()}"

    @classmethod
    def from_function(cls, function: FunctionType, file: str) -> _TemporaryFolder | None:
        """Return the locator, or None where there is no such folder."""
        try:
            locator = cls(function, file)
            locator.ensure_cache_path()
        except OSError:
            return None
        return locator

    def ensure_cache_path(self) -> None:
        """Make the folder.

        Raises:
            OSError: It cannot be made, or belongs to somebody else.
        """
        self._path.mkdir(mode=0o700, exist_ok=True)
        found = self._path.lstat()
        shared = os.name == "posix" and (found.st_uid != _user() or found.st_mode & 0o077)
        if not stat.S_ISDIR(found.st_mode) or shared:
            raise PermissionError(f"{self._path}: is not a private folder of this user")
        tempfile.TemporaryFile(dir=self._path).close()

    def get_cache_path(self) -> str:
        """Return the folder."""
        return str(self._path)

    def get_source_stamp(self) -> str:
        """Return a digest of the kernel's module."""
        return hashlib.sha256(self._source.read_bytes()).hexdigest()

    def get_disambiguator(self) -> str:
        """Return what tells functions of one name in modules of one name apart."""
        folder = hashlib.sha256(os.fsencode(self._source.resolve().parent)).hexdigest()[
            :_DIGEST_DIGITS
        ]
        return f"{self._line}-{folder}"


class _Naming(CompileResultCacheImpl):
    """Names the files of a kernel after its digest."""

    _locator_classes: Any = [*CompileResultCacheImpl._locator_classes, _TemporaryFolder]  # noqa: RUF012 - numba's

    def __init__(self, function: Any) -> None:
        self.digest = digest(function)
        super().__init__(function)

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Return how the names of a kernel's files begin."""
        return f"{super().get_filename_base(fullname, abiflags)}-{self.digest}"


class _Files(FunctionCache):
    """numba's files of one kernel."""

    _impl_class = _Naming

    def remove(self, *, outdated: bool = False) -> None:
        """Remove this kernel's files, or only what an earlier version of it left behind."""
        current: str = self._impl.filename_base
        names = current.removesuffix(self._impl.digest) if outdated else current
        for file in Path(self.cache_path).glob(f"{names}*.nb[ci]"):
            if not (outdated and file.name.startswith(f"{current}.")):
                with suppress(OSError):
                    file.unlink()


def _user() -> int:
    return os.geteuid() if os.name == "posix" else 0


def _say_not_kept(reason: str) -> None:
    """Say why machine code is not kept: once, as there are many kernels."""
    if not _SAID.is_set():
        _SAID.set()
        _LOG.warning(
            "compiled kernels cannot be kept, so that each start compiles them again (%s)", reason
        )
