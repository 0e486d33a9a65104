"""Readers of named arrays: MATLAB files, HDF5, Parquet, numpy archives and numpy arrays."""

from __future__ import annotations

import zipfile
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rig.common.errors import InputError
from rig.sources.table import Array, Column, Table, library, open_binary

_NUMERIC = frozenset(
    {"double", "single", "logical"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
"""MATLAB classes of real or complex numbers."""


class _Series(NamedTuple):
    """A variable, or a series of a matrix."""

    variable: str
    number: int | None


class ArrayTable(Table):
    """Named arrays as a table; the series of a matrix are ``name[0]``, ``name[1]``, ...

    The longer side of a matrix counts as time. Single numbers and text are not columns.
    """

    def __init__(
        self,
        path: Path,
        shapes: Mapping[str, tuple[int, ...]],
        units: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.path = path
        columns: list[Column] = []
        for name, shape in shapes.items():
            sides, unit = [side for side in shape if side != 1], units.get(name, "")
            if len(sides) == 1:
                columns.append(Column(name, _Series(name, None), unit))
            elif len(sides) == 2:
                columns += [
                    Column(f"{name}[{k}]", _Series(name, k), unit) for k in range(min(sides))
                ]
        self._lay_out(columns)

    def _read(self, columns: Sequence[int]) -> list[Array]:
        wanted: list[_Series] = [self._sources[k] for k in columns]
        arrays = self._load({series.variable for series in wanted})
        return [self._values(series, arrays[series.variable]) for series in wanted]

    @abstractmethod
    def _load(self, variables: Iterable[str]) -> dict[str, NDArray[Any]]:
        """Load whole variables by name."""

    def _values(self, series: _Series, array: NDArray[Any]) -> Array:
        values = np.squeeze(array)
        if series.number is not None:
            wide = values.shape[1] > values.shape[0]
            values = values[series.number] if wide else values[:, series.number]
        return self.doubles(series.variable, values, "variable")


def _contents(matlab: Any, stream: Any) -> list[tuple[str, tuple[int, ...], str]]:
    """Return name, shape and kind of each variable, of objects of MATLAB's own as well."""
    try:
        return list(matlab.whosmat(stream))
    except TypeError:
        # whosmat does not list a file that holds a string, a table or a datetime of MATLAB.
        stream.seek(0)
        found = matlab.loadmat(stream)
    kinds = {"V": "struct", "O": "cell", "U": "char", "b": "logical"}
    return [
        (str(name), value.shape, kinds.get(value.dtype.kind, "double"))
        if isinstance(value, np.ndarray) and type(value).__name__ != "MatlabOpaque"
        else (str(name), (), "object")
        for name, value in found.items()
        if not str(name).startswith("__")
    ]


class MatTable(ArrayTable):
    """A MATLAB file of version 4 to 7.

    Arrays inside structs are named with dots: ``data.t``, ``out.signals.values[0]``,
    ``recordings[1].angle``. Members that are objects, functions or sparse arrays are left out.
    """

    remedy = "save it again with save(..., '-v7')"

    def __init__(self, path: Path, _: object = None) -> None:
        import scipy.io

        self.path = path
        self._matlab: Any = scipy.io
        try:
            with open_binary(path) as stream:
                contents = _contents(scipy.io, stream)
        except NotImplementedError as error:
            raise InputError(
                f"{path}: a MATLAB file of a version that this program cannot read ({error}); "
                "save it in MATLAB with save(..., '-v7')"
            ) from error
        self._structs: dict[str, NDArray[Any]] = {}
        shapes = {name: shape for name, shape, kind in contents if kind in _NUMERIC}
        structs = [name for name, _, kind in contents if kind in ("struct", "cell")]
        inside = self._load(structs)
        for name in structs:
            self._structs |= dict(self._members(name, inside[name]))
        shapes |= {name: array.shape for name, array in self._structs.items()}
        super().__init__(path, shapes)
        if any(kind == "object" for *_, kind in contents):
            self.notes = (*self.notes, "left out: objects of MATLAB (string, table, datetime)")
        if not self.names:
            held = ", ".join(f"{name} ({kind})" for name, _, kind in contents) or "nothing"
            raise InputError(
                f"{path}: holds no arrays of numbers, but {held}; save .Time and .Data of a "
                "timeseries or Dataset object as separate variables"
            )

    def _load(self, variables: Iterable[str]) -> dict[str, NDArray[Any]]:
        wanted = [name for name in variables if name not in self._structs]
        loaded = {name: self._structs[name] for name in variables if name in self._structs}
        if wanted:
            with open_binary(self.path) as stream:
                loaded |= self._matlab.loadmat(stream, variable_names=wanted)
        return loaded

    def _members(self, name: str, value: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
        """Yield dotted name and array of every array of real numbers inside a struct or a cell."""
        matlab = self._matlab.matlab
        if not isinstance(value, np.ndarray) or isinstance(
            value, matlab.MatlabOpaque | matlab.MatlabFunction
        ):
            return
        if value.dtype.kind in "biuf":
            yield name, value
        elif value.dtype.names is not None or value.dtype == object:
            for index, element in enumerate(value.ravel(order="F")):
                place = name if value.size == 1 else f"{name}[{index}]"
                if value.dtype.names is None:
                    yield from self._members(place, element)
                for field in value.dtype.names or ():
                    yield from self._members(f"{place}.{field}", element[field])


class NpzTable(ArrayTable):
    """A numpy archive; pickled objects are never read."""

    remedy = "save it again with numpy.savez, without object arrays"

    def __init__(self, path: Path, _: object = None) -> None:
        self._fields: dict[str, tuple[str, str | None]] = {}
        shapes: dict[str, tuple[int, ...]] = {}
        with open_binary(path) as stream, zipfile.ZipFile(stream) as archive:
            for member in archive.namelist():
                if member.endswith(".npy"):
                    with archive.open(member) as part:
                        version = np.lib.format.read_magic(part)
                        read = (
                            np.lib.format.read_array_header_1_0
                            if version == (1, 0)
                            else np.lib.format.read_array_header_2_0
                        )
                        shape, _, kind = read(part)
                    shapes |= self._named(member.removesuffix(".npy"), shape, kind)
        super().__init__(path, shapes)

    def _load(self, variables: Iterable[str]) -> dict[str, NDArray[Any]]:
        with open_binary(self.path) as stream, np.load(stream, allow_pickle=False) as archive:
            found = {name: self._fields[name] for name in variables}
            return {
                name: archive[member] if field is None else archive[member][field]
                for name, (member, field) in found.items()
            }

    def _named(
        self, name: str, shape: tuple[int, ...], kind: np.dtype[Any]
    ) -> dict[str, tuple[int, ...]]:
        """Return name and shape of an array, or of each field of a structured array."""
        if kind.names is None:
            self._fields[name] = (name, None)
            return {name: shape}
        self._fields |= {f"{name}.{field}": (name, field) for field in kind.names}
        return {f"{name}.{field}": (*shape, *kind[field].shape) for field in kind.names}


class NpyTable(ArrayTable):
    """One numpy array; pickled objects are never read. The columns of a matrix are ``array[0]``,
    ...; those of a structured array are its fields.
    """

    remedy = "save it again with numpy.save"

    def __init__(self, path: Path, _: object = None) -> None:
        with open_binary(path) as stream:
            array = np.load(stream, allow_pickle=False)
        if not isinstance(array, np.ndarray):
            raise InputError(
                f"{path}: the file contains several arrays; change its extension to .npz"
            )
        names = array.dtype.names
        self._arrays = {"array": array} if names is None else {name: array[name] for name in names}
        super().__init__(path, {name: value.shape for name, value in self._arrays.items()})

    def _load(self, variables: Iterable[str]) -> dict[str, NDArray[Any]]:
        return {name: self._arrays[name] for name in variables}


class ParquetTable(Table):
    """A Parquet file as a table; time stamps are read as seconds since the first stamp."""

    def __init__(self, path: Path, _: object = None) -> None:
        self.path = path
        self._arrow: Any = library("pyarrow", path, "Parquet", "parquet")
        self._parquet: Any = library("pyarrow.parquet", path, "Parquet", "parquet")
        with open_binary(path) as stream:
            self.names = tuple(self._parquet.read_schema(stream).names)

    def _read(self, columns: Sequence[int]) -> list[Array]:
        names = [self.names[k] for k in columns]
        with open_binary(self.path) as stream:
            table = self._parquet.read_table(stream, columns=names)
        return [self._numbers(name, table.column(name)) for name in names]

    def _numbers(self, name: str, column: Any) -> Array:
        arrow, types = self._arrow, self._arrow.types
        kind = column.type
        if types.is_duration(kind):
            column = column.cast(arrow.duration("ns")).cast(arrow.int64())
        if types.is_timestamp(kind) or types.is_duration(kind):
            column = column.cast(arrow.timestamp("ns"))
        elif types.is_boolean(kind):
            column = column.cast(arrow.int8())
        elif not types.is_integer(kind):
            try:
                column = column.cast(arrow.float64())
            except arrow.ArrowException as error:
                raise InputError(
                    f"{self.path}: column {name!r} does not contain numbers (type {kind})"
                ) from error
        missing = column.is_null().to_numpy()
        known = column.drop_null()
        if types.is_integer(column.type) and len(known):
            column = column.fill_null(known[0])
        values = self.doubles(name, column.to_numpy(), "column")
        return np.where(missing, np.nan, values) if missing.any() else values


_DEEPEST = 16
_UNITS = ("units", "unit", "Units", "Unit")
_FILLS = ("_FillValue", "missing_value")


class Hdf5Table(ArrayTable):
    """Table with one column for each dataset of numbers, named by its path with dots:
    ``run.motor.current``.

    A matrix is read as in :class:`ArrayTable`, a compound dataset by its fields. Structs and cells
    of MATLAB are named as in files of its version 7. ``scale_factor``, ``add_offset`` and
    ``_FillValue`` of the CF conventions are applied, with a note. Links to other files, virtual
    datasets and objects of MATLAB are left out, with a note.
    """

    def __init__(self, path: Path, _: object = None) -> None:
        self.path = path
        self._h5py = library("h5py", path, "HDF5 (MATLAB v7.3)", "hdf5")
        self._places: dict[str, tuple[str, str | None]] = {}
        self._left_out: list[str] = []
        shapes: dict[str, tuple[int, ...]] = {}
        units: dict[str, str] = {}
        with self._opened() as file:
            for name, dataset in self._members("", file, 0):
                for field in _fields(dataset):
                    whole = name if field is None else f"{name}.{field}"
                    self._places[whole] = (dataset.name, field)
                    kind = dataset.dtype if field is None else dataset.dtype[field]
                    shapes[whole] = (*_shape(dataset), *kind.shape)
                    units[whole] = _text(dataset.attrs, _UNITS)
        if self._left_out:
            listed = ", ".join(self._left_out[:4])
            more = f" and {len(self._left_out) - 4} others" if len(self._left_out) > 4 else ""
            self.note(f"left out: {listed}{more}")
        super().__init__(path, shapes, units)
        if not self.names:
            raise InputError(
                f"{path}: holds no arrays of numbers"
                + (f" ({', '.join(self._left_out[:4])})" if self._left_out else "")
                + "; of a timeseries or Dataset object, save .Time and .Data as separate variables"
            )

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        with open_binary(self.path) as stream, self._h5py.File(stream, "r") as file:
            yield file

    def _members(self, name: str, value: Any, depth: int) -> Iterator[tuple[str, Any]]:
        """Yield dotted name and dataset of all numbers below a group, struct, cell or dataset."""
        kind = _matlab_class(value)
        if depth > _DEEPEST or "MATLAB_sparse" in value.attrs or "MATLAB_empty" in value.attrs:
            return
        if "MATLAB_object_decode" in value.attrs or kind == "function_handle":
            self._left_out.append(f"{name} (an object of MATLAB)")
        elif isinstance(value, self._h5py.Group):
            for key in value:
                if depth == 0 and key in ("#refs#", "#subsystem#"):
                    continue
                link = value.get(key, getlink=True)
                inner = f"{name}.{key}" if name else str(key)
                if isinstance(link, self._h5py.ExternalLink):
                    self._left_out.append(f"{inner} (a link to another file)")
                elif (member := value.get(key)) is not None and hasattr(member, "attrs"):
                    yield from self._field(inner, name, str(key), member, kind, depth)
        elif not isinstance(value, self._h5py.Dataset):
            return
        elif value.is_virtual or value.external:
            self._left_out.append(f"{name} (its data are in other files)")
        elif kind == "cell":
            yield from self._referenced(name, "", value, depth)
        elif kind in _NUMERIC or (not kind and _holds_numbers(value.dtype)):
            yield name, value

    def _field(
        self, inner: str, name: str, key: str, member: Any, kind: str, depth: int
    ) -> Iterator[tuple[str, Any]]:
        """Yield the members of one field; in an array of structs, of each element."""
        references = isinstance(member, self._h5py.Dataset) and self._h5py.check_ref_dtype(
            member.dtype
        )
        if kind == "struct" and references and not _matlab_class(member):
            yield from self._referenced(name, f".{key}", member, depth)
        else:
            yield from self._members(inner, member, depth + 1)

    def _referenced(
        self, name: str, suffix: str, dataset: Any, depth: int
    ) -> Iterator[tuple[str, Any]]:
        found = np.ravel(dataset[()])
        for index, reference in enumerate(found):
            place = name if len(found) == 1 else f"{name}[{index}]"
            if reference:
                yield from self._members(place + suffix, dataset.file[reference], depth + 1)

    def _load(self, variables: Iterable[str]) -> dict[str, NDArray[Any]]:
        with self._opened() as file:
            return {name: self._array(file, name) for name in variables}

    def _array(self, file: Any, name: str) -> NDArray[Any]:
        place, field = self._places[name]
        dataset = file[place]
        values: NDArray[Any] = np.asarray(dataset[()] if field is None else dataset[field])
        if _matlab_class(dataset):
            # MATLAB stores matrices column by column, HDF5 row by row.
            values = values.T
        attributes = dataset.attrs
        fills = [float(v) for key in _FILLS if (v := _number(attributes, key)) is not None]
        missing = np.isin(values, fills) if fills and values.dtype.kind in "iuf" else None
        factor, offset = (_number(attributes, key) for key in ("scale_factor", "add_offset"))
        if (factor, offset) != (None, None) and values.dtype.kind in "iuf":
            values = values * (1.0 if factor is None else factor) + (offset or 0.0)
            self.note(f"`{name}`: scale_factor and add_offset of the file applied")
        if missing is not None and missing.any():
            values = np.where(missing, np.nan, values)
            self.note(f"`{name}`: the file's fill value read as missing samples")
        return values


def _matlab_class(value: Any) -> str:
    return _text(value.attrs, ("MATLAB_class",))


def _shape(dataset: Any) -> tuple[int, ...]:
    shape = tuple(dataset.shape or ())
    return shape[::-1] if _matlab_class(dataset) else shape


def _fields(dataset: Any) -> list[str | None]:
    """Return the fields of a compound dataset; for a plain dataset or complex numbers, [None]."""
    names = dataset.dtype.names
    if names is None or set(names) == {"real", "imag"}:
        return [None]
    return [field for field in names if _holds_numbers(dataset.dtype[field])]


def _holds_numbers(kind: np.dtype[Any]) -> bool:
    if kind.names is not None:
        return any(kind[name].base.kind in "biuf" for name in kind.names)
    return kind.base.kind in "biufc"


def _text(attributes: Any, keys: Iterable[str]) -> str:
    for key in keys:
        value = attributes.get(key)
        if isinstance(value, bytes):
            return value.decode("utf-8", "replace")
        if isinstance(value, str):
            return value
    return ""


def _number(attributes: Any, key: str) -> float | None:
    value = np.asarray(attributes.get(key, np.nan))
    if value.size != 1 or value.dtype.kind not in "iuf":
        return None
    number = float(value.ravel()[0])
    return number if np.isfinite(number) else None
