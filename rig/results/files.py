"""Writes the output files of a command: result file, page with figures, other files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rig.common.errors import InputError
from rig.common.places import write_json, write_text
from rig.results.document import Document
from rig.results.html import page

PAGE_FILE = "report.html"


def write_record(record: Mapping[str, Any], file: Path, json_file: Path | None) -> None:
    """Write a result file into its folder, which is created, and a copy if requested.

    Raises:
        InputError: A path cannot be written.
    """
    with _writing(*filter(None, (file.parent, json_file))):
        file.parent.mkdir(parents=True, exist_ok=True)
        for path in filter(None, (file, json_file)):
            write_json(path, record)


def write_page(document: Document, file: Path) -> None:
    """Write a document as a page, with its pictures embedded and as files in ``figures``.

    Raises:
        InputError: The folder cannot be written.
    """
    with _writing(file.parent):
        (file.parent / "figures").mkdir(parents=True, exist_ok=True)
        for picture in document.pictures():
            (file.parent / picture.file).write_bytes(picture.data)
        write_text(file, page(document))


def write_texts(texts: Mapping[str, str], folder: Path) -> None:
    """Write text files into a folder, by their paths relative to the folder.

    Raises:
        InputError: The folder cannot be written.
    """
    with _writing(folder):
        for name, text in texts.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            write_text(folder / name, text)


@contextmanager
def _writing(*places: Path) -> Iterator[None]:
    """Turn a write error into an InputError that names the paths and the remedy."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{' or '.join(map(str, places))}: cannot be written: {error.strerror}; give --out or "
            f"--json another place"
        ) from error
