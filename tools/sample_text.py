"""Draws files and sentences for a reader's test: ``python tools/sample_text.py SEED``.

Prints 30 modules, and 60 sentences: 20 of docstrings, 20 messages of errors, 20 of documents. How
the test is made: ``docs/studies/2026-11-27-reader.md``.
"""

from __future__ import annotations

import ast
import random
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FILES, EACH = 30, 20
LEAST, MOST, LEAST_MESSAGE = 40, 260, 50
"""Lengths of the sentences and messages that are drawn, characters."""
DOCUMENTS = ("docs/*.md", "docs/guides", "docs/tutorials", "docs/decisions", "README.md")
_END = re.compile(r"(?<=[.;])\s+(?=[A-Z`*])")
_SECTIONS = re.compile(r"\n(Args|Attributes|Raises|Returns):")


class Sentence(NamedTuple):
    """A sentence, the kind and file of its source, and the name of its class or function."""

    kind: str
    file: str
    name: str
    text: str


def listed(*patterns: str) -> list[str]:
    """Return the tracked files of these patterns, relative to the root."""
    out = subprocess.check_output(["git", "ls-files", *patterns], text=True, cwd=ROOT)
    return out.split()


def sentences(text: str) -> list[str]:
    """Return the sentences of a text that are neither very short nor very long."""
    return [re.sub(r"\s+", " ", s).strip() for s in _END.split(text) if LEAST < len(s) < MOST]


def docstrings(file: str) -> Iterator[Sentence]:
    """Yield the sentences of docstrings, without the sections on arguments and results."""
    for node in ast.walk(ast.parse((ROOT / file).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef):
            text = _SECTIONS.split(ast.get_docstring(node) or "")[0]
            for each in sentences(text):
                yield Sentence("docstring", file, getattr(node, "name", ""), each)


def messages(file: str) -> Iterator[Sentence]:
    """Yield the texts of exceptions as they are in the code."""
    for node in ast.walk(ast.parse((ROOT / file).read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Raise) or not isinstance(node.exc, ast.Call):
            continue
        for argument in node.exc.args:
            if isinstance(argument, ast.JoinedStr | ast.Constant):
                text = re.sub(r"\s+", " ", ast.unparse(argument))
                if len(text) > LEAST_MESSAGE:
                    yield Sentence("message", file, "", text)


def paragraphs(file: str) -> Iterator[Sentence]:
    """Yield the sentences of a document, without code, comments, headings, tables and pictures.
    Each item of a list is a paragraph of its own.
    """
    text = (ROOT / file).read_text(encoding="utf-8")
    plain = re.sub(r"```.*?```|<!--.*?-->", "", text, flags=re.DOTALL)
    for part in re.split(r"\n\n|\n(?=\s*(?:[-*]|\d+\.)\s)", plain):
        if not part.lstrip().startswith(("|", "#", "!")):
            for each in sentences(part.replace("\n", " ")):
                yield Sentence("document", file, "", each)


def main(seed: int) -> None:
    """Print the files and sentences of one draw."""
    rng = random.Random(seed)
    modules = [
        f
        for f in listed("rig", "drivers", "identification")
        if f.endswith(".py") and not f.endswith("__init__.py")
    ]
    print("# Files")
    for number, file in enumerate(rng.sample(modules, FILES), 1):
        print(f"{number}. {file}")
    sources = (
        [s for f in modules for s in docstrings(f)],
        [s for f in modules for s in messages(f)],
        [s for f in listed(*DOCUMENTS) if f.endswith(".md") for s in paragraphs(f)],
    )
    print("\n# Sentences")
    drawn = [each for source in sources for each in rng.sample(source, EACH)]
    for number, (kind, file, name, text) in enumerate(drawn, 1):
        print(f"{number}. [{kind}] {' '.join(filter(None, (file, name)))}: {text}")


if __name__ == "__main__":
    if len(sys.argv) != 2 or not sys.argv[1].isdigit():
        sys.exit("usage: python tools/sample_text.py SEED (a whole number)")
    main(int(sys.argv[1]))
