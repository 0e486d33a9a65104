"""What a command says, as sections of text, tables and pictures.

A command makes one :class:`Document` of its result record; :mod:`rig.results.terminal` and
:mod:`rig.results.html` show it. Nothing here knows a result, a terminal or HTML.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

from identification.plots.style import Figure, png


@dataclass(frozen=True)
class Table:
    """Cells as text.

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
    """A line of text, which a terminal does not wrap; its tone says how it stands out."""

    text: str
    tone: Literal["plain", "aside", "warning"] = "plain"


@dataclass(frozen=True)
class Paragraph:
    """Running text, with words that lead it in."""

    text: str
    lead: str = ""


@dataclass(frozen=True)
class Items:
    """A list.

    Attributes:
        items: Name, such as that of a file, and text of each; the name may be empty.
    """

    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Verdict:
    """What the whole comes to; ``good`` is that all is well, ``found`` a cause, ``open`` a
    question.
    """

    headline: str
    statement: str
    tone: Literal["good", "found", "open"]


@dataclass(frozen=True)
class Picture:
    """A rendered figure.

    Attributes:
        name: File name without its ending.
        caption: What it shows.
        data: PNG.
    """

    name: str
    caption: str
    data: bytes

    @classmethod
    def of(cls, name: str, caption: str, figure: Figure) -> Picture:
        """Render a figure; characters that do not belong in a file name become underscores."""
        return cls(re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("_"), caption, png(figure))

    @property
    def file(self) -> str:
        """Path of its file, relative to the folder of the page."""
        return f"figures/{self.name}.png"

    @property
    def base64(self) -> str:
        """The PNG for a data URI."""
        return base64.b64encode(self.data).decode("ascii")


@dataclass(frozen=True)
class Section:
    """Blocks under a title; without one they follow what stands above.

    Attributes:
        title: Heading.
        blocks: What it shows, in order.
        anchor: Name that links lead to.
    """

    title: str
    blocks: tuple[Block, ...]
    anchor: str = ""


@dataclass(frozen=True)
class SideBySide:
    """Two sections side by side, where the page is wide enough."""

    left: Section
    right: Section


Block = Table | Note | Paragraph | Items | Verdict | Picture | Section | SideBySide


@dataclass(frozen=True)
class Document:
    """What a command says, in short and in full.

    Attributes:
        title: Heading.
        subtitle: Line under it.
        summary: In short, for the terminal; blank lines stand between its sections.
        sections: In full, for the page; empty where there is none.
    """

    title: str
    subtitle: str
    summary: tuple[Section, ...]
    sections: tuple[Section, ...] = ()

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
