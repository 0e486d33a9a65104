"""Renders a document as text for the terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from rig.common.tables import table
from rig.results.document import (
    Block,
    Document,
    Items,
    Note,
    Paragraph,
    Picture,
    Section,
    SideBySide,
    Table,
    Verdict,
)

_WIDTH = 110
_PREFIX = {"plain": "", "aside": "note: ", "warning": "warning: "}


def text(document: Document) -> str:
    """Return a document's summary; pictures have no text."""
    return "\n\n".join("\n".join(_lines(section)) for section in document.summary)


def _lines(block: Block) -> Iterator[str]:
    match block:
        case Table():
            yield table(block.header, block.rows, block.right)
        case Note():
            yield _PREFIX[block.tone] + block.text
        case Paragraph():
            yield textwrap.fill(f"{block.lead} {block.text}".lstrip(), _WIDTH)
        case Items():
            for name, what in block.items:
                yield f"  {name}: {what}" if name else f"  {what}"
        case Verdict():
            yield block.headline
            yield textwrap.fill(block.statement, _WIDTH)
        case Section():
            if block.title:
                yield block.title
            for inner in block.blocks:
                yield from _lines(inner)
        case SideBySide():
            yield from _lines(block.left)
            yield from _lines(block.right)
        case Picture():
            pass
