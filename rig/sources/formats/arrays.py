"""Readers of named arrays: MATLAB .mat files (versions 4 to 7), numpy .npz archives and .npy
arrays.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import scipy.io

from identification.recording import Array
from rig.common.errors import InputError
from rig.sources.formats.doubles import NotNumbersError, as_doubles
from rig.sources.formats.mat_elements import check_elements
from rig.sources.formats.table import Table, damaged, open_binary

_DAMAGED = (
    scipy.io.matlab.MatReadError,
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    ValueError,
    TypeError,
    LookupError,
    EOFError,
    OSError,
    MemoryError,
    RuntimeError,
)
"""Exceptions that scipy, numpy and zipfile raise for damaged data; zipfile raises a RuntimeError
for a member that is marked as encrypted.
"""


class _Column(NamedTuple):
    variable: str
    series: int | None


class ArrayTable(Table):
    """Named arrays as a table. Each series of a matrix is one column: ``name[0]``, ``name[1]``, ...

    The longer side of a matrix counts as time. Single numbers and text are not columns.
    """

    def __init__(self, path: Path, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self.path = path
        columns = [column for name, shape in shapes.items() for column in _columns(name, shape)]
        self._columns = columns
        self.names = tuple(
            c.variable if c.series is None else f"{c.variable}[{c.series}]" for c in columns
        )

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`."""
        wanted = [self._columns[k] for k in columns]
        try:
            arrays = self._load({column.variable for column in wanted})
        except _DAMAGED as error:
            raise damaged(self.path, error, "save it again") from error
        return [self._series(column, arrays[column.variable]) for column in wanted]

    @abstractmethod
    def _load(self, variables: Iterable[str]) -> dict[str, np.ndarray]:
        """Load whole variables by name."""

    def variable(self, column: int) -> str:
        """Return the variable to which a column belongs."""
        return self._columns[column].variable

    def _series(self, column: _Column, array: np.ndarray) -> Array:
        values = np.squeeze(array)
        if column.series is not None:
            values = (
                values[column.series]
                if values.shape[1] > values.shape[0]
                else values[:, column.series]
            )
        try:
            doubles, note = as_doubles(values)
        except NotNumbersError as error:
            raise InputError(
                f"{self.path}: variable {column.variable!r} does not contain real numbers ({error})"
            ) from None
        if note:
            self.note(f"`{column.variable}`: {note}")
        return doubles


class MatTable(ArrayTable):
    """A MATLAB file of version 4 to 7.

    Arrays inside structs are named with dots: ``data.t``, ``out.signals.values[0]``,
    ``recordings[1].angle``.

    Raises:
        InputError: The file has no arrays of numbers, or is not a MATLAB file.
    """

    def __init__(self, path: Path) -> None:
        try:
            with open_binary(path) as stream:
                unread = check_elements(stream)
                stream.seek(0)
                contents = scipy.io.whosmat(cast(Any, stream))
        except NotImplementedError as error:
            raise InputError(
                f"{path}: a MATLAB file of a version that this program cannot read ({error}); "
                "save it in MATLAB "
                f"with save(..., '-v7')"
            ) from error
        except _DAMAGED as error:
            raise damaged(path, error, "save it again with save(..., '-v7')") from error
        self._structs: dict[str, np.ndarray] = {}
        numeric = {
            "double",
            "single",
            "logical",
            *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
        }
        self.path = path
        shapes = {name: shape for name, shape, kind in contents if kind in numeric}
        structs = [name for name, _, kind in contents if kind in ("struct", "cell")]
        structs = [name for name in structs if name not in unread]
        if structs:
            try:
                inside = self._load(structs)
            except _DAMAGED as error:
                raise damaged(path, error, "save it again with save(..., '-v7')") from error
            for name in structs:
                self._structs |= dict(_members(name, inside[name]))
        shapes |= {name: array.shape for name, array in self._structs.items()}
        super().__init__(path, shapes)
        if not self.names:
            held = ", ".join(f"{name} ({kind})" for name, _, kind in contents) or "nothing"
            raise InputError(
                f"{path}: holds no arrays of numbers, but {held}; save .Time and .Data of a "
                "timeseries or Dataset object as separate variables"
            )

    def _load(self, variables: Iterable[str]) -> dict[str, np.ndarray]:
        wanted = [name for name in variables if name not in self._structs]
        loaded = {name: self._structs[name] for name in variables if name in self._structs}
        if wanted:
            with open_binary(self.path) as stream:
                loaded |= scipy.io.loadmat(cast(Any, stream), variable_names=wanted)
        return loaded


def _members(name: str, value: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Yield dotted name and array of every array of real numbers inside a struct or a cell.

    An element of a struct array is ``name[0]``, unless there is only one element.
    """
    if value.dtype.names is not None or value.dtype == object:
        for index, element in enumerate(value.ravel(order="F")):
            place = name if value.size == 1 else f"{name}[{index}]"
            if value.dtype.names is None:
                if isinstance(element, np.ndarray):
                    yield from _members(place, element)
                continue
            for field in value.dtype.names:
                member = element[field]
                if isinstance(member, np.ndarray):
                    yield from _members(f"{place}.{field}", member)
    elif value.dtype.kind in "biuf":
        yield name, value


class NpzTable(ArrayTable):
    """A numpy archive; pickled objects are never read.

    Raises:
        InputError: The file is damaged, or is not an archive.
    """

    def __init__(self, path: Path) -> None:
        self._fields: dict[str, tuple[str, str | None]] = {}
        shapes: dict[str, tuple[int, ...]] = {}
        try:
            with open_binary(path) as stream, zipfile.ZipFile(stream) as archive:
                for member in archive.namelist():
                    if member.endswith(".npy"):
                        shapes |= self._members(archive, member)
        except _DAMAGED as error:
            raise damaged(
                path, error, "save it again with numpy.savez, without object arrays"
            ) from error
        super().__init__(path, shapes)

    def _load(self, variables: Iterable[str]) -> dict[str, np.ndarray]:
        with open_binary(self.path) as stream, np.load(stream, allow_pickle=False) as archive:
            found = {name: self._fields[name] for name in variables}
            return {
                name: archive[member] if field is None else archive[member][field]
                for name, (member, field) in found.items()
            }

    def _members(self, archive: zipfile.ZipFile, member: str) -> dict[str, tuple[int, ...]]:
        """Return name and shape of an array, or of each field of a structured array."""
        name, shape, kind = _npy_header(archive, member)
        if kind.names is None:
            self._fields[name] = (name, None)
            return {name: shape}
        shapes = {}
        for field in kind.names:
            self._fields[f"{name}.{field}"] = (name, field)
            shapes[f"{name}.{field}"] = (*shape, *kind[field].shape)
        return shapes


class NpyTable(ArrayTable):
    """One numpy array; pickled objects are never read. The columns of a matrix are ``array[0]``,
    ...; those of a structured array are its fields.

    Raises:
        InputError: The file is damaged, or is not a numpy array.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with open_binary(path) as stream:
                array = np.load(stream, allow_pickle=False)
        except _DAMAGED as error:
            raise damaged(path, error, "save it again with numpy.save") from error
        if not isinstance(array, np.ndarray):
            raise InputError(
                f"{path}: the file contains several arrays; change its extension to .npz"
            )
        self._arrays = (
            {"array": array}
            if array.dtype.names is None
            else {name: array[name] for name in array.dtype.names}
        )
        super().__init__(path, {name: value.shape for name, value in self._arrays.items()})

    def _load(self, variables: Iterable[str]) -> dict[str, np.ndarray]:
        return {name: self._arrays[name] for name in variables}


def _npy_header(
    archive: zipfile.ZipFile, member: str
) -> tuple[str, tuple[int, ...], np.dtype[Any]]:
    """Read name, shape and type of one array without its data."""
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, _, kind = read(stream)
        return member.removesuffix(".npy"), shape, kind


def _columns(name: str, shape: tuple[int, ...]) -> list[_Column]:
    sides = [side for side in shape if side != 1]
    if len(sides) == 1:
        return [_Column(name, None)]
    if len(sides) == 2:
        return [_Column(name, index) for index in range(min(sides))]
    return []
