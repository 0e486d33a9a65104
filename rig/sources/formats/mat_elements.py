"""Checks the element headers of a MATLAB file (-v6, -v7) for damage before scipy reads the file.

scipy does not check these headers: a wrong type or length in an uncompressed file ends the whole
process instead of raising an error. Compressed elements have a checksum, which scipy checks. The
format is MATLAB level 5.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from math import prod
from typing import IO, NamedTuple

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
