"""Sections of the campaign file on how a file's columns become channels."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from rig.common.text import stored_path
from rig.config.configuration import Schema


def _not_zero(value: float) -> float:
    if value == 0:
        raise ValueError("the scale is 0, which makes all samples 0")
    return value


class ReadSection(Schema):
    """How to read a delimited text file or CAN traffic; other formats need no options.

    Attributes:
        delimiter: Delimiter of the columns, one character; detected from the first lines if left
            out.
        skip_rows: Number of lines before the header, or before the first row of numbers if there is
            no header.
        decimal: Decimal separator.
        dbc: DBC file of recorded CAN traffic, or a list of them, relative to the campaign file.
        bench: Bench file in place of `dbc`, relative to the campaign file, or the name of a
            packaged bench. The bench's map of drive and encoder frames is used, and the columns are
            channels in SI units.
        bus: Name in the file of the bus whose frames are used (`can0`, `1`); all buses if left
            out.
    """

    delimiter: str | None = Field(default=None, min_length=1, max_length=1)
    skip_rows: int = Field(default=0, ge=0)
    decimal: Literal[".", ","] = "."
    dbc: str | Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    bench: str | None = None
    bus: str | int | None = None

    @property
    def dbc_files(self) -> tuple[str, ...]:
        """The DBC files as written."""
        return (self.dbc,) if isinstance(self.dbc, str) else self.dbc or ()

    def beside(self, folder: Path) -> ReadSection:
        """Return a copy of the options in which file names are resolved from a folder."""
        named = tuple(str(folder / stored_path(name)) for name in self.dbc_files)
        bench = self.bench
        if bench is not None and Path(bench).suffix:
            bench = str(folder / stored_path(bench))
        return self.model_copy(update={"dbc": named or None, "bench": bench})

    @property
    def other_files(self) -> tuple[Path, ...]:
        """The files that are read beside the recording."""
        bench = (Path(self.bench),) if self.bench and Path(self.bench).suffix else ()
        return (*map(Path, self.dbc_files), *bench)

    @model_validator(mode="after")
    def _told_apart(self) -> ReadSection:
        if self.delimiter == self.decimal == ",":
            raise ValueError("delimiter and decimal are both a comma; change one of the two")
        if self.dbc is not None and self.bench is not None:
            raise ValueError(
                "dbc and bench are both given, but a bench replaces a DBC file; remove dbc or bench"
            )
        return self


class ChannelSection(Schema):
    """The column of a channel: SI value = scale * column + offset.

    Attributes:
        column: Name of the column, or its index from 0.
        scale: SI units per unit of the column; a negative scale reverses the sign.
        offset: Value that is added after the scale, SI.
        average: Whether each sample is the mean over the period that ends at its time.
        unsigned: Whether the column contains magnitudes; such a column is rejected, because the
            sign of the torque is needed.
    """

    column: str | Annotated[int, Field(ge=0)]
    scale: Annotated[float, AfterValidator(_not_zero)] = 1.0
    offset: float = 0.0
    average: bool = False
    unsigned: bool = False

    @model_validator(mode="before")
    @classmethod
    def _short_form(cls, data: object) -> object:
        return (
            {"column": data} if isinstance(data, str | int) and not isinstance(data, bool) else data
        )
