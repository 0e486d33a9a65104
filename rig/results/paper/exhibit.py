"""One figure or table of the paper beside what came out here."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from identification.recording import Array
from rig.common.places import write_text
from rig.results.document import Picture, Table
from rig.results.report import save

Rows = tuple[tuple[str, ...], Sequence[Sequence[float | str]]]
"""Column titles with their units, and the rows under them."""


@dataclass(frozen=True)
class Exhibit:
    """What the page shows under one heading.

    Attributes:
        name: Key in the result file, and file name of its data: ``fig_2``.
        title: Heading.
        paper: What the paper prints or shows, in words.
        found: What came out here, a sentence each.
        pictures: Figures; the first is named like the exhibit.
        data: Picture name to the numbers in it.
        table: Values side by side, where there are any.
    """

    name: str
    title: str
    paper: str
    found: tuple[str, ...]
    pictures: tuple[Picture, ...] = ()
    data: Mapping[str, Rows] | None = None
    table: Table | None = None


def columns(**named: Array) -> Rows:
    """Return arrays of one length, shape (n,), as rows; the titles are ``name`` with its unit
    (``time_s``).
    """
    return tuple(named), list(zip(*(values.tolist() for values in named.values()), strict=True))


def write_exhibits(exhibits: Sequence[Exhibit], folder: Path) -> dict[str, list[str]]:
    """Write every picture and its numbers into ``folder``; return picture name to files, relative
    to it.

    Raises:
        OSError: The folder cannot be written.
    """
    files = {
        name: [file]
        for name, file in save([p for e in exhibits for p in e.pictures], folder).items()
    }
    target = folder / "data"
    target.mkdir(parents=True, exist_ok=True)
    for exhibit in exhibits:
        for name, rows in (exhibit.data or {}).items():
            write_text(target / f"{name}.csv", _csv(rows))
            files.setdefault(name, []).append(f"data/{name}.csv")
    return files


def _csv(rows: Rows) -> str:
    titles, lines = rows
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(titles)
    writer.writerows(
        [cell if isinstance(cell, str) else f"{cell:.9g}" for cell in line] for line in lines
    )
    return text.getvalue()
