"""Output of a command as sections of text, tables and pictures.

A command makes one :class:`Document` from its result record; :mod:`rig.results.terminal` and
:mod:`rig.results.html` show the document. This module is independent of results, terminal and HTML.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from identification.plots.style import Figure


@dataclass(frozen=True)
class Table:
    """A table with text cells.

    Attributes:
        header: Column titles.
        rows: Cells, row by row.
        right: Indices of the columns of numbers.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    right: tuple[int, ...]


@dataclass(frozen=True)
class Note:
    """A line of text, which the terminal does not wrap; ``tone`` sets the emphasis."""

    text: str
    tone: Literal["plain", "aside", "warning"] = "plain"


@dataclass(frozen=True)
class Paragraph:
    """Running text with a bold beginning."""

    text: str
    lead: str = ""


@dataclass(frozen=True)
class Items:
    """A list.

    Attributes:
        items: Name and text of each item; the name, such as that of a file, may be empty.
    """

    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Verdict:
    """Overall verdict: ``good`` (no problem), ``found`` (a cause was found) or ``open``
    (undecided).
    """

    headline: str
    statement: str
    tone: Literal["good", "found", "open"]


@dataclass(frozen=True)
class Picture:
    """A rendered figure.

    Attributes:
        name: File name without its ending.
        caption: Description of its content.
        data: PNG.
        lead: Whether the picture is at the top of a page, drawn so that it can be read on a
            telephone.
    """

    name: str
    caption: str
    data: bytes
    lead: bool = False

    @classmethod
    def of(cls, name: str, caption: str, figure: Figure, *, lead: bool = False) -> Picture:
        """Render a figure. Characters of the name that are not safe in a file name become
        underscores.
        """
        # Imported late: documents without figures do not need the plotting library.
        from identification.plots.style import png

        return cls(re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_"), caption, png(figure), lead)

    @property
    def file(self) -> str:
        """Path of the picture's file, relative to the folder of the page."""
        return f"figures/{self.name}.png"

    @property
    def base64(self) -> str:
        """The PNG as base64 text for a data URI."""
        return base64.b64encode(self.data).decode("ascii")


@dataclass(frozen=True)
class Section:
    """Blocks with a title; blocks without a title belong to the section above.

    Attributes:
        title: Heading.
        blocks: Content of the section, in order.
        anchor: Name of the section in links.
    """

    title: str
    blocks: tuple[Block, ...]
    anchor: str = ""


@dataclass(frozen=True)
class SideBySide:
    """Two sections, which the page shows side by side if it is wide enough."""

    left: Section
    right: Section


Block = Table | Note | Paragraph | Items | Verdict | Picture | Section | SideBySide


@dataclass(frozen=True)
class Document:
    """Output of a command as a summary and in full.

    Attributes:
        title: Heading.
        subtitle: Line below the heading.
        summary: Summary for the terminal; blank lines separate its sections.
        sections: Full content for the page; empty if there is no page.
        facts: Name and value of the facts at the top of the page, such as bench, date and operator.
    """

    title: str
    subtitle: str
    summary: tuple[Section, ...]
    sections: tuple[Section, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()

    def pictures(self) -> Iterator[Picture]:
        """Yield the pictures of the page in their order."""
        yield from _pictures(self.sections)


def _pictures(blocks: Iterable[Block]) -> Iterator[Picture]:
    for block in blocks:
        match block:
            case Picture():
                yield block
            case Section():
                yield from _pictures(block.blocks)
            case SideBySide():
                yield from _pictures((block.left, block.right))
