"""Compiles numeric kernels with numba, with the same options for all kernels.

:mod:`identification.numerics.compiled` keeps the machine code on disk for the next process.
"""

from __future__ import annotations

import hashlib
import logging
import math
import os
import stat
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import cache
from pathlib import Path
from threading import Event, Lock
from types import CodeType, FunctionType, ModuleType
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
from numba import njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache

_LOG = logging.getLogger(__name__)
_DIGEST_DIGITS = 12
_SAID, _COMPILING = Event(), Event()


class KernelCache:
    """Cache of one kernel's machine code; replaces numba's cache in a dispatcher.

    The cache computes the digest at the first call of the kernel, when all kernels that the kernel
    calls are defined.

    Args:
        function: The kernel's Python function.
    """

    def __init__(self, function: FunctionType) -> None:
        self._function = function
        self._files: Any = None

    @property
    def cache_path(self) -> str | None:
        """The cache folder, or None before the first use of the cache."""
        return None if self._files is None else str(self._files.cache_path)

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return the compiled code of a signature, or None if the code is missing or damaged."""
        try:
            found = self._opened().load_overload(signature, target)
            if found is None:
                _say_compiling()
            return found
        except Exception as error:  # noqa: BLE001 - unpickling a damaged file raises anything; compiling is the remedy
            _LOG.info("%s is compiled anew: %s", self._function.__qualname__, error)
            if self._files is not None:
                self._files.remove()
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Write the compiled code of a signature to the cache; warn on failure."""
        try:
            files = self._opened()
            files.save_overload(signature, compiled)
            files.remove(outdated=True)
        except OSError as error:
            _say_not_kept(f"{self.cache_path}: {error.strerror}")
        except RuntimeError:
            # The message of numba is replaced, because it states the name of a kernel, which does
            # not help an operator.
            _say_not_kept("no cache folder is writable")

    def enable(self) -> None:
        """Do nothing, because the cache is always enabled."""

    def disable(self) -> None:
        """Do nothing, because numba never calls this method."""

    def flush(self) -> None:
        """Remove the kernel from the cache index."""
        self._opened().flush()

    def _opened(self) -> Any:
        if self._files is None:
            self._files = _Files(self._function)
        return self._files


def digest(kernel: Callable[..., Any]) -> str:
    """Return a digest of everything that is compiled into a kernel: its code, the constants that
    the code uses, and the kernels that the code calls.

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
    """Yield the globals that a function uses, with attributes of modules and classes."""
    names = function.__code__.co_names
    for name in names:
        value = function.__globals__.get(name)
        if not isinstance(value, ModuleType | type):
            yield name, value
        elif _home(value) == __name__.partition(".")[0]:
            yield from ((f"{name}.{inner}", getattr(value, inner, None)) for inner in names)


def _home(value: ModuleType | type) -> str:
    """Return the top-level package of a module or a class.

    Code of other packages is not part of the digest, because it changes only with their version.
    """
    return (value.__module__ if isinstance(value, type) else value.__name__).partition(".")[0]


def _content(value: Any) -> bytes:
    if isinstance(value, np.ndarray):
        return repr((value.dtype.str, value.shape)).encode() + value.tobytes()
    if isinstance(value, set | frozenset):
        # The order of a set differs by process.
        return repr(sorted(map(repr, value))).encode()
    return repr(value).encode()


class _TemporaryFolder:
    """Cache locator of numba for a private folder among the temporary files.

    No other user may have write access to the folder, because its machine code is executed. The
    locators of numba are tried first.
    """

    def __init__(self, function: FunctionType, file: str) -> None:
        self._line = function.__code__.co_firstlineno
        self._source = Path(file)
        self._path = Path(tempfile.gettempdir()) / f"loadrig-kernels-{_user()}"

    @classmethod
    def from_function(cls, function: FunctionType, file: str) -> _TemporaryFolder | None:
        """Return the locator, or None if the folder cannot be made private and writable."""
        try:
            locator = cls(function, file)
            locator.ensure_cache_path()
        except OSError:
            return None
        return locator

    def ensure_cache_path(self) -> None:
        """Create the folder.

        Raises:
            OSError: The folder cannot be created, or is not private to this user.
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
        """Return a string that distinguishes functions of equal name in modules of equal name."""
        folder = hashlib.sha256(os.fsencode(self._source.resolve().parent)).hexdigest()[
            :_DIGEST_DIGITS
        ]
        return f"{self._line}-{folder}"


class _Naming(CompileResultCacheImpl):
    """File names of a kernel's cache; each name ends in the digest of the kernel."""

    _locator_classes: Any = [*CompileResultCacheImpl._locator_classes, _TemporaryFolder]  # noqa: RUF012 - numba's

    def __init__(self, function: Any) -> None:
        self.digest = digest(function)
        super().__init__(function)

    def get_filename_base(self, fullname: str, abiflags: str) -> str:
        """Return the common first part of the file names of a kernel."""
        return f"{super().get_filename_base(fullname, abiflags)}-{self.digest}"


class _Files(FunctionCache):
    """Cache files of one kernel, in numba's format."""

    _impl_class = _Naming

    def remove(self, *, outdated: bool = False) -> None:
        """Remove the kernel's cache files; with ``outdated`` only the files with another digest."""
        current: str = self._impl.filename_base
        names = current.removesuffix(self._impl.digest) if outdated else current
        for file in Path(self.cache_path).glob(f"{names}*.nb[ci]"):
            if not (outdated and file.name.startswith(f"{current}.")):
                with suppress(OSError):
                    file.unlink()


def _user() -> int:
    # On Windows users have no numbers.
    return os.geteuid() if hasattr(os, "geteuid") else 0


def _say_compiling() -> None:
    """Log once for all kernels, if a person may be waiting, that compiling makes the first start
    slow.
    """
    if not _COMPILING.is_set() and sys.stderr is not None and sys.stderr.isatty():
        _COMPILING.set()
        _LOG.warning(
            "compiling numeric kernels for this computer, once for each version of the program; "
            "this takes up to a minute"
        )


def _say_not_kept(reason: str) -> None:
    """Log once, for all kernels, why machine code cannot be cached."""
    if not _SAID.is_set():
        _SAID.set()
        _LOG.warning(
            "compiled kernels cannot be stored, so each start of the program compiles them again "
            "(%s)",
            reason,
        )


P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a numeric kernel with numba and keep the machine code for the next process.

    The kernel releases the interpreter lock; therefore a kernel must read and write nothing but its
    arguments.
    """
    return _kept(function, nogil=True, error_model="numpy")


def compiled_sums(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a kernel of long sums; the compiler may reorder additions, vectorise them, and fuse
    them with multiplications.
    """
    return _kept(function, error_model="numpy", fastmath={"reassoc", "contract"})


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small kernel into every caller, because a call would take as long as the kernel
    itself.
    """
    return cast(Callable[P, R], njit(inline="always", error_model="numpy")(function))


def _kept(function: Callable[P, R], **options: Any) -> Callable[P, R]:
    kernel = njit(**options)(function)
    kernel._cache = KernelCache(kernel.py_func)
    return cast(Callable[P, R], kernel)


LEAST = -700.0
"""Least exponent; for a smaller exponent the result would not be a normal floating-point number."""
_LOG2_E = 1.0 / math.log(2.0)
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
"""Natural logarithm of 2 as a sum of two numbers; the first number has 32 bits, so that its small
multiples are exact (fdlibm, e_exp.c).
"""
_ROUNDING = 1.5 * 2.0**52
"""Number that is added to a value so that the last bits of the sum hold the nearest integer."""
_BIAS, _FRACTION = 1023, 52
_2, _3, _4, _5, _6, _7, _8, _9, _10, _11, _12, _13 = (1.0 / math.factorial(k) for k in range(2, 14))


@inlined
def exponential(x: float) -> float:
    """Return exp(x) for ``LEAST`` <= x <= 0, to 1.1 units in the last place.

    exp(x) = 2^n exp(r) with |r| <= ln(2) / 2, where 14 terms of the series suffice.
    """
    shifted = x * _LOG2_E + _ROUNDING
    n = shifted - _ROUNDING
    r = (x - n * _LN2_HIGH) - n * _LN2_LOW
    square = r * r
    fourth = square * square
    low = (_2 + r * _3) + square * (_4 + r * _5)
    middle = (_6 + r * _7) + square * (_8 + r * _9)
    high = (_10 + r * _11) + square * (_12 + r * _13)
    series = 1.0 + (r + square * (low + fourth * (middle + fourth * high)))
    power = (np.float64(shifted).view(np.int64) + _BIAS) << _FRACTION
    return float(series * np.int64(power).view(np.float64))


One = TypeVar("One")
Other = TypeVar("Other")
Item = TypeVar("Item")
THREAD = "second thread of the kernels"
"""First part of the name of the thread."""


@cache
def _second(_process: int) -> tuple[ThreadPoolExecutor, Lock]:
    """Return the second thread of a process, and the lock of the caller that uses the thread.

    The process is an argument, so that a forked process, which inherits only its main thread, gets
    a new second thread.
    """
    return ThreadPoolExecutor(1, thread_name_prefix=THREAD), Lock()


def idle() -> bool:
    """Return whether the second thread is free."""
    return not _second(os.getpid())[1].locked()


def both(one: Callable[[], One], other: Callable[[], Other]) -> tuple[One, Other]:
    """Return the results of two functions that are called at the same time.

    If the second thread is busy, for example because one of the functions uses it, the functions
    are called one after the other.
    """
    thread, used = _second(os.getpid())
    if not used.acquire(blocking=False):
        return one(), other()
    try:
        beside = thread.submit(other)
        try:
            first = one()
        finally:
            wait([beside])
        return first, beside.result()
    finally:
        used.release()


def each(function: Callable[[Item], One], items: Iterable[Item]) -> list[One]:
    """Return the results of a function for all items, in their order, with two items at a time.

    The function must not change data that another call of it reads.
    """
    todo, found, taking = iter(enumerate(items)), dict[int, One](), Lock()

    def work() -> None:
        while True:
            with taking:
                number, item = next(todo, (None, None))
            if number is None:
                return
            found[number] = function(cast(Item, item))

    both(work, work)
    return [found[number] for number in range(len(found))]
