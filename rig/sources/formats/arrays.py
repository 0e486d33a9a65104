"""Readers of named arrays: MATLAB .mat files (versions 4 to 7), numpy .npz archives and .npy
arrays.
"""

from __future__ import annotations

import importlib
import struct
import zipfile
import zlib
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import prod
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

import numpy as np
import scipy.io

from identification.recording import Array
from rig.common.errors import InputError
from rig.sources.formats.table import NotNumbersError, Table, as_doubles, damaged, open_binary

HEADER_BYTES = 128
LEVEL_5 = 0x0100
MATRIX, COMPRESSED = 14, 15
INT8, INT32, UINT32, UTF8 = 1, 5, 6, 16
SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8}
"""Bytes per number of each numeric data type, miINT8 to miUINT64."""
NUMERIC_CLASSES = range(6, 16)
"""Array classes mxDOUBLE to mxUINT64; of text and of sparse arrays, only the header is read."""
CLASSES = range(1, 19)
CELL_CLASS, STRUCT_CLASS, CHAR_CLASS = 1, 2, 4
_MEMBERS = frozenset({CELL_CLASS, STRUCT_CLASS, CHAR_CLASS, *NUMERIC_CLASSES})
OPAQUE_CLASS = 17
"""Class of a MATLAB object, which has no dimensions."""
COMPLEX_FLAG = 0x0800
_MOST_DIMENSIONS = 32


class DamagedElementError(ValueError):
    """A header does not fit the file; the message states the byte."""


class _Element(NamedTuple):
    kind: int
    length: int
    start: int
    end: int


class UnreadMemberError(ValueError):
    """A struct or cell contains a member that is not supported: an object, a function or a sparse
    array.
    """


def check_elements(stream: IO[bytes]) -> frozenset[str]:
    """Check every variable of a level 5 file; files of another level are not checked.

    Args:
        stream: The file, seekable and at its start; its position afterwards is undefined.

    Returns:
        Names of the structs and cells that must not be read, because of one of their members.

    Raises:
        DamagedElementError: An element's type or length is impossible.
    """
    header = stream.read(HEADER_BYTES)
    order = {b"IM": "<", b"MI": ">"}.get(header[126:128])
    if order is None or struct.unpack(f"{order}H", header[124:126])[0] != LEVEL_5:
        return frozenset()
    size = stream.seek(0, 2)
    unread: set[str] = set()
    for element in _elements(stream, order, HEADER_BYTES, size):
        if element.kind == MATRIX:
            try:
                _check_matrix(stream, order, element)
            except UnreadMemberError as error:
                unread.add(str(error))
        elif element.kind != COMPRESSED:
            raise DamagedElementError(
                f"at byte {element.start}, where a variable must start, is no variable"
            )
    return frozenset(unread)


def _elements(stream: IO[bytes], order: str, start: int, stop: int) -> Iterator[_Element]:
    """Yield the elements between two places of the file."""
    while start < stop:
        stream.seek(start)
        tag = stream.read(8)
        if len(tag) < 8:
            raise DamagedElementError(f"cut off inside an element header, at byte {start}")
        first, length = struct.unpack(f"{order}II", tag)
        if first >> 16:  # a small element: type and length in one word, data in the next
            element = _Element(first & 0xFFFF, first >> 16, start + 4, start + 8)
            fits = element.length <= 4
        else:
            padding = 0 if first == COMPRESSED else -length % 8
            element = _Element(first, length, start + 8, start + 8 + length + padding)
            fits = start + 8 + length <= stop
        if not fits:
            raise DamagedElementError(
                f"an element of {element.length} bytes does not fit into the file, at byte {start}"
            )
        yield element
        start = element.end


def _check_matrix(stream: IO[bytes], order: str, matrix: _Element) -> None:
    parts = _elements(stream, order, matrix.start, matrix.start + matrix.length)
    flags = _part(parts, matrix, "flags", UINT32)
    if flags.length != 8:
        raise DamagedElementError(
            f"the array flags at byte {flags.start} have {flags.length} bytes; they must have 8"
        )
    stream.seek(flags.start)
    word = int(struct.unpack(f"{order}I", stream.read(4))[0])
    if word & 0xFF not in CLASSES:
        raise DamagedElementError(
            f"an array has the impossible class {word & 0xFF}, at byte {flags.start}"
        )
    if word & 0xFF == OPAQUE_CLASS:
        return
    dimensions = _part(parts, matrix, "dimensions", INT32, UINT32)
    count, odd = divmod(dimensions.length, 4)
    if odd or not 2 <= count <= _MOST_DIMENSIONS:
        raise DamagedElementError(
            f"the array dimensions at byte {dimensions.start} take {dimensions.length} bytes; "
            f"expected 4 bytes per dimension, for 2 to {_MOST_DIMENSIONS} dimensions"
        )
    stream.seek(dimensions.start)
    shape = struct.unpack(f"{order}{count}i", stream.read(4 * count))
    title = _part(parts, matrix, "name", INT8, UTF8)
    if word & 0xFF in (CELL_CLASS, STRUCT_CLASS):
        try:
            _check_members(stream, order, matrix, parts, shape, word & 0xFF)
        except UnreadMemberError:
            stream.seek(title.start)
            raise UnreadMemberError(stream.read(title.length).decode("latin-1")) from None
        return
    if word & 0xFF == CHAR_CLASS:
        _part(parts, matrix, "text", *SIZES, UTF8, 17, 18)
        return
    if word & 0xFF not in NUMERIC_CLASSES:
        return
    for name in ("values", "imaginary values")[: 2 if word & COMPLEX_FLAG else 1]:
        values = _part(parts, matrix, name, *SIZES)
        if min(shape) < 0 or values.length != prod(shape) * SIZES[values.kind]:
            raise DamagedElementError(
                f"{values.length} bytes of {name} do not fit "
                f"{' x '.join(map(str, shape))} numbers, at byte {values.start}"
            )


def _check_members(
    stream: IO[bytes],
    order: str,
    matrix: _Element,
    parts: Iterator[_Element],
    shape: tuple[int, ...],
    kind: int,
) -> None:
    """Check the matrices inside a cell or a struct array."""
    fields = 1
    if kind == STRUCT_CLASS:
        length = _part(parts, matrix, "field name length", INT32)
        names = _part(parts, matrix, "field names", INT8)
        stream.seek(length.start)
        size = struct.unpack(f"{order}i", stream.read(4))[0] if length.length == 4 else 0
        if size <= 0 or names.length % size:
            raise DamagedElementError(
                f"{names.length} bytes of field names do not fit names of {size} bytes each, at "
                f"byte {names.start}"
            )
        fields = names.length // size
    members = list(parts)
    if min(shape) < 0 or len(members) != prod(shape) * fields:
        raise DamagedElementError(
            f"{len(members)} members do not fit {' x '.join(map(str, shape))} elements of {fields} "
            f"fields, at byte {matrix.start}"
        )
    for member in members:
        if member.kind != MATRIX:
            raise DamagedElementError(
                f"at byte {member.start}, where a matrix must start, is no matrix"
            )
        if not member.length:
            continue
        flags = next(_elements(stream, order, member.start, member.start + member.length))
        stream.seek(flags.start)
        word = struct.unpack(f"{order}I", stream.read(4).ljust(4, b"\0"))[0] & 0xFF
        if word in CLASSES and word not in _MEMBERS:
            raise UnreadMemberError
        _check_matrix(stream, order, member)


def _part(parts: Iterator[_Element], matrix: _Element, name: str, *kinds: int) -> _Element:
    part = next(parts, None)
    if part is None:
        raise DamagedElementError(f"the variable at byte {matrix.start} has no {name}")
    if part.kind not in kinds:
        raise DamagedElementError(
            f"{name} has the impossible type {part.kind}, at byte {part.start}"
        )
    return part


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


class ParquetTable(Table):
    """A Parquet file as a table; time stamps are read as seconds since the first stamp.

    Raises:
        InputError: pyarrow is not installed, or the file is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._arrow: Any = importlib.import_module("pyarrow")
            parquet: Any = importlib.import_module("pyarrow.parquet")
        except ImportError as error:
            raise InputError(
                f"{path}: reading Parquet needs pyarrow; install it with: pip install "
                f"loadrig[parquet]"
            ) from error
        self._parquet = parquet
        try:
            with open_binary(path) as stream:
                self.names = tuple(parquet.read_schema(stream).names)
        except (self._arrow.ArrowException, OSError, EOFError) as error:
            raise damaged(path, error, "check that the file was copied completely") from error

    def read(self, columns: Sequence[int]) -> list[Array]:
        """Read columns by index; see :meth:`Table.read`."""
        names = [self.names[k] for k in columns]
        try:
            with open_binary(self.path) as stream:
                table = self._parquet.read_table(stream, columns=names)
        except (self._arrow.ArrowException, OSError, EOFError) as error:
            raise damaged(self.path, error, "check that the file was copied completely") from error
        return [self._numbers(name, table.column(name)) for name in names]

    def _numbers(self, name: str, column: Any) -> Array:
        arrow, types = self._arrow, self._arrow.types
        try:
            if types.is_timestamp(column.type):
                ticks = column.cast(arrow.timestamp("ns")).cast(arrow.int64())
                return _differences(ticks) / 1e9
            if types.is_duration(column.type):
                return _differences(column.cast(arrow.duration("ns")).cast(arrow.int64())) / 1e9
            if types.is_integer(column.type) and _exceeds_doubles(column):
                self.notes = (
                    *self.notes,
                    f"column {name!r} holds 64-bit integers beyond 2^53: read as the difference to "
                    f"the first, {_first(column)}",
                )
                return _differences(column)
            if types.is_boolean(column.type):
                column = column.cast(arrow.int8())
            values = column.cast(arrow.float64()).to_numpy()
        except arrow.ArrowException as error:
            raise InputError(
                f"{self.path}: column {name!r} does not contain numbers (type {column.type})"
            ) from error
        return np.asarray(values, dtype=np.float64)


EXACT = 2**53
"""Greatest integer up to which doubles represent every integer exactly."""


def _first(column: Any) -> int:
    """Return the first value that is not missing; 0 if all values are missing."""
    known = column.drop_null()
    return int(known[0].as_py()) if len(known) else 0


def _exceeds_doubles(column: Any) -> bool:
    known = column.drop_null().to_numpy()
    return bool(known.size) and (int(known.max()) > EXACT or int(known.min()) < -EXACT)


def _differences(column: Any) -> Array:
    """Return integers minus the first integer, exact if a double represents the difference."""
    first = _first(column)
    missing = column.is_null().to_numpy()
    whole = column.fill_null(first).to_numpy()
    differences = whole - whole.dtype.type(first)
    if whole.dtype.kind == "u":
        differences = differences.view(np.int64)
    return cast(Array, np.where(missing, np.nan, differences.astype(np.float64)))
