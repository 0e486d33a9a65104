"""Output of ``rig paper`` as a document: the paper's tables and figures with our results."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rig.common.provenance import Provenance
from rig.results.document import (
    Document,
    Items,
    Note,
    Paragraph,
    Section,
    SideBySide,
    provenance_section,
)
from rig.results.paper.exhibit import Exhibit
from rig.results.paper.tables import Reproduction, chosen, remarks, tables

PAGE_FILE = "paper.html"


def paper_document(
    found: Reproduction,
    figures: Sequence[Exhibit],
    of_tables: Sequence[Exhibit],
    provenance: Provenance,
) -> Document:
    """Return the reproduction of the paper as a document.

    Args:
        found: The reproduced tables.
        figures: Exhibits of the figures.
        of_tables: Exhibits of the tables; the terminal shows only the tables.
        provenance: Seed, inputs, time.
    """
    sections = (
        *map(_section, (*figures, *of_tables)),
        Section("Chosen here, because the paper does not state it", (_listed(chosen()),), "chosen"),
        provenance_section(provenance),
    )
    return Document(
        "The paper's figures and tables, reproduced",
        "Load Characteristics and Modeling Methods for the Flow Regulator of a Solid Ducted Rocket",
        tuple(_summary(found, figures)),
        sections,
    )


def _summary(found: Reproduction, figures: Sequence[Exhibit]) -> Iterator[Section]:
    for title, cells in tables(found).items():
        yield Section(title, (cells,))
    yield Section("", tuple(map(Note, remarks(found))))
    for exhibit in figures:
        yield Section(exhibit.title, (_listed(exhibit.found),))


def _section(exhibit: Exhibit) -> Section:
    paper = Section("The paper", (Paragraph(exhibit.paper),))
    here = Section("Here", tuple(map(Paragraph, exhibit.found)))
    values = () if exhibit.table is None else (exhibit.table,)
    return Section(
        exhibit.title, (SideBySide(paper, here), *values, *exhibit.pictures), exhibit.name
    )


def _listed(lines: Sequence[str]) -> Items:
    return Items(tuple(("", line) for line in lines))
