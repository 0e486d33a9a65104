"""Output of a command as sections of text, tables and pictures.

A command makes one :class:`Document` from its result record; the module shows it on a terminal or
as a page of HTML, and computes nothing.
"""

from __future__ import annotations

import base64
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import jinja2

from identification.recording import Recording
from rig.common.places import replacing, usable, write_json, write_text
from rig.common.provenance import Provenance
from rig.common.tables import table

if TYPE_CHECKING:
    from identification.plots.style import Figure


_ELSEWHERE = "give --out or --json another place"


@dataclass(frozen=True)
class Table:
    """A table with text cells."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    right: tuple[int, ...]  # indices of the columns of numbers


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
    """A list."""

    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Verdict:
    """Overall verdict: ``good``, ``found`` (a cause was found) or ``open`` (undecided)."""

    headline: str
    statement: str
    tone: Literal["good", "found", "open"]


@dataclass(frozen=True)
class Picture:
    """A rendered figure."""

    name: str
    caption: str
    data: bytes
    lead: bool = False

    @classmethod
    def of(cls, name: str, caption: str, figure: Figure, *, lead: bool = False) -> Picture:
        """Render a figure under a name that is safe for a file."""
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
    """Blocks with a title; blocks without a title belong to the section above."""

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
    """Output of a command as a summary and in full."""

    title: str
    subtitle: str
    summary: tuple[Section, ...]  # summary for the terminal; blank lines separate its sections
    sections: tuple[Section, ...] = ()  # full content for the page; empty if there is no page
    # Name and value of the facts at the top of the page, such as bench, date and operator.
    facts: tuple[tuple[str, str], ...] = ()

    def pictures(self) -> Iterator[Picture]:
        """Yield the pictures of the page in their order."""
        yield from _pictures(self.sections)


def columns(
    items: Iterable[Any], right: tuple[int, ...], *titled: tuple[str, Callable[[Any], str]]
) -> Table:
    """Return a table of one row per item, from titles and cells of its columns."""
    rows = tuple(tuple(cell(item) for _, cell in titled) for item in items)
    return Table(tuple(title for title, _ in titled), rows, right)


def _pictures(blocks: Iterable[Block]) -> Iterator[Picture]:
    for block in blocks:
        match block:
            case Picture():
                yield block
            case Section():
                yield from _pictures(block.blocks)
            case SideBySide():
                yield from _pictures((block.left, block.right))


def page(document: Document) -> str:
    """Return a document as HTML; all text is escaped, an undefined name is an error."""
    return filled("page.html.j2", document)


def filled(template: str, document: Document) -> str:
    """Return a document in a template of this package."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("rig.results"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["form"] = lambda block: type(block).__name__
    return environment.get_template(template).render(document=document)


Drawn = TypeVar("Drawn")
_NUMBER = re.compile(r"\d[\d.e+-]*")


def provenance_section(provenance: Provenance) -> Section:
    """Return the last section of every page: program, time and input files."""
    facts = (
        (
            "versions",
            ", ".join(f"{name} {release}" for name, release in provenance.versions.items()),
        ),
        ("created", provenance.created),
        ("seed", str(provenance.seed)),
        ("time spent", f"{provenance.seconds:.3g} s"),
    )
    files = tuple(provenance.inputs.items())
    inputs = (Table(("input file", "SHA-256"), files, ()),) if files else ()
    return Section("Provenance", (Table(("fact", "value"), facts, ()), *inputs))


def reading_notes(recordings: Sequence[Recording]) -> list[str]:
    """Return notes on corrections; of notes that differ in numbers only, the first."""
    alike: dict[str, list[str]] = {}
    for recording in recordings:
        for note in recording.notes:
            alike.setdefault(_NUMBER.sub("#", note), []).append(
                f"reading: {recording.name}: {note}"
            )
    return [
        lines[0] + (f" ({len(lines) - 1} similar notes: see the report)" if len(lines) > 1 else "")
        for lines in alike.values()
    ]


def few_of_each_role(
    drawn: Sequence[Drawn],
    role: Callable[[Drawn], str],
    most: int,
    roles: Sequence[str] = ("fit", "validate"),
) -> list[Drawn]:
    """Return the first recordings of each role, in the order of the roles."""
    return [one for each in roles for one in [one for one in drawn if role(one) == each][:most]]


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


PAGE_FILE = "report.html"


def write_record(record: Mapping[str, Any], file: Path, json_file: Path | None) -> None:
    """Write a result file into its folder, which is created, and a copy if requested."""
    places = " or ".join(map(str, filter(None, (file.parent, json_file))))
    with usable(places, "written", _ELSEWHERE):
        file.parent.mkdir(parents=True, exist_ok=True)
        for path in filter(None, (file, json_file)):
            write_json(path, record)


def write_page(document: Document, file: Path) -> None:
    """Write a document as a page, with its pictures embedded and as files in ``figures``."""
    with usable(file.parent, "written", _ELSEWHERE):
        (file.parent / "figures").mkdir(parents=True, exist_ok=True)
        for picture in document.pictures():
            (file.parent / picture.file).write_bytes(picture.data)
        write_text(file, page(document))


def shown(document: Document, file: Path, what: str = "report") -> str:
    """Write the page of a document; return its summary and the place of the page."""
    write_page(document, file)
    return f"{text(document)}\n{what}: {file}"


def write_texts(texts: Mapping[str, str | bytes], folder: Path) -> None:
    """Write files into a folder, by their paths relative to the folder."""
    with usable(folder, "written", _ELSEWHERE):
        for name, text in texts.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            if isinstance(text, str):
                write_text(folder / name, text)
            else:
                with replacing(folder / name) as draft:
                    draft.write_bytes(text)
