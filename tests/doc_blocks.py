"""Code blocks of the documents, and what the HTML comment before each says to do with it.

| comment | the block |
|---|---|
| `file: NAME` | is written to that file; the suite reads it as the configuration it is |
| `run` | console commands that the suite runs |
| `run: long` | commands that `make docs-run` alone runs |
| `run: long, status 1` | the same; they end with this status |
| `run: long, type A; B` | the same; with these lines typed at the prompts |
| `run: long, needs FILE` | the same, where this file of the shared recordings is there |
| `not run: REASON` | is for the reader only |
"""

import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
KINDS = frozenset({"console", "yaml", "python"})
"""Languages whose blocks must be marked."""
LINKED = ("rig", "drivers", "identification", "tests", "benchmarks", "docs")
"""Folders of the repository that a block finds where it runs."""
_BLOCK = re.compile(
    r"(?:^ *<!-- ((?:file|run|not run)\b[^\n]*?) -->\n+)?^( *)```(\w+)\n(.*?)^\2```$",
    re.MULTILINE | re.DOTALL,
)


class Block(NamedTuple):
    """One fenced block.

    Attributes:
        page: The document.
        line: Of its fence, from 1.
        kind: Its language.
        mark: The comment before it; empty where there is none.
        text: Its content.
    """

    page: Path
    line: int
    kind: str
    mark: str
    text: str

    @property
    def place(self) -> str:
        """Document and line, for messages."""
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    @property
    def verb(self) -> str:
        """``file``, ``run``, ``not run`` or empty."""
        return self.mark.partition(":")[0]

    @property
    def rest(self) -> str:
        """What follows the verb."""
        return self.mark.partition(":")[2].strip()

    @property
    def commands(self) -> list[str]:
        """Lines that begin with the prompt, without it."""
        return [line[2:] for line in self.text.splitlines() if line.startswith("$ ")]

    @property
    def conditions(self) -> dict[str, str]:
        """``long``, ``status``, ``type`` and ``needs`` of a block that is run."""
        found = [part.strip().partition(" ") for part in self.rest.split(",")] if self.rest else []
        return {name: value for name, _, value in found}


def blocks(page: Path) -> Iterator[Block]:
    """Yield the blocks of a document whose language is in :data:`KINDS`."""
    text = page.read_text(encoding="utf-8")
    for match in _BLOCK.finditer(text):
        if match[3] in KINDS:
            line = text.count("\n", 0, match.start(3)) + 1
            yield Block(page, line, match[3], match[1] or "", textwrap.dedent(match[4]))


def workplace(folder: Path) -> None:
    """Give a folder what the documents expect beside them: the folders of the repository."""
    for name in LINKED:
        (folder / name).symlink_to(ROOT / name)
