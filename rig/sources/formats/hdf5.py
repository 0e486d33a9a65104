"""Reads HDF5 files, including MATLAB v7.3 files, with the optional library h5py."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rig.common.errors import InputError
from rig.common.places import require_plain
from rig.sources.formats.arrays import ArrayTable
from rig.sources.formats.table import damaged, library, open_binary

SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""Signature of an HDF5 file, which follows a user block of 0, 512, 1024, ... bytes."""
_DAMAGED = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    MemoryError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
    struct.error,
)
"""Exceptions that h5py raises on damaged files."""
_REMEDY = "check that the file was copied completely, or save it again"
_DEEPEST = 16
_NUMERIC = frozenset(
    {"double", "single", "logical"}
    | {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
"""MATLAB classes of real or complex numbers."""
_UNITS = ("units", "unit", "Units", "Unit")
_FILLS = ("_FillValue", "missing_value")


def is_hdf5(path: Path) -> bool:
    """Return whether a file is HDF5, by its first bytes; a gzip file is decompressed first.

    Raises:
        OSError, EOFError, zlib.error: The file cannot be read.
    """
    with open_binary(path) as stream:
        head = stream.read(2048 + len(SIGNATURE))
    return any(head[at : at + 8] == SIGNATURE for at in (0, 512, 1024, 2048))


class Hdf5Table(ArrayTable):
    """Table with one column for each dataset of numbers, named by its path with dots:
    ``run.motor.current``.

    A matrix is read as in :class:`ArrayTable`, a compound dataset by its fields. Structs and cells
    of MATLAB are named as in files of its version 7. ``scale_factor``, ``add_offset`` and
    ``_FillValue`` of the CF conventions are applied, with a note. Links to other files, virtual
    datasets and objects of MATLAB are left out, with a note.

    Raises:
        InputError: h5py is not installed, or the file is damaged or holds no numbers.
    """

    def __init__(self, path: Path) -> None:
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
        super().__init__(path, shapes)
        if not self.names:
            raise InputError(
                f"{path}: holds no arrays of numbers"
                + (f" ({', '.join(self._left_out[:4])})" if self._left_out else "")
                + "; of a timeseries or Dataset object, save .Time and .Data as separate variables"
            )
        stated = [units.get(self.variable(k), "") for k in range(len(self.names))]
        self.units = tuple(stated) if any(stated) else ()

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        """Open the file with h5py, and close it at the end.

        Raises:
            InputError: The file is damaged.
        """
        require_plain(self.path)
        try:
            with open_binary(self.path) as stream, self._h5py.File(stream, "r") as file:
                yield file
        except InputError:
            raise
        except _DAMAGED as error:
            raise damaged(self.path, error, _REMEDY) from error

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
        """Yield the members of one field; in an array of structs, each element has its own
        members.
        """
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
            return {name: self._values(file, name) for name in variables}

    def _values(self, file: Any, name: str) -> NDArray[Any]:
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
    """Return the first of these attributes that is a text; empty if none is a text."""
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
