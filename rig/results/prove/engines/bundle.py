"""Packs files into tasks and results, for workers that share no disk with the calling process."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import rig
from rig.common.errors import InputError
from rig.common.input_files import is_file, read_bytes
from rig.common.places import replacing
from rig.config.campaign import load_campaign

Files = Mapping[str, bytes]
"""Contents of files by their paths relative to a folder, with slashes."""


class Bundle(NamedTuple):
    """A campaign with the files of its folder.

    Attributes:
        folder: Name of the folder.
        campaign: Name of the campaign file in the folder.
        files: All files in the folder.
    """

    folder: str
    campaign: str
    files: Files


def read_folder(folder: Path) -> dict[str, bytes]:
    """Return all files of a folder and of the folders in it, in order of their names.

    Raises:
        OSError: A file cannot be read.
    """
    found = sorted(f for f in folder.rglob("*") if is_file(f))
    return {f.relative_to(folder).as_posix(): read_bytes(f) for f in found}


def write_folder(folder: Path, files: Files) -> None:
    """Write files into a folder, in their order, each by one rename.

    Raises:
        OSError: A file cannot be written.
    """
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as draft:
            draft.write_bytes(content)


def bundle(campaign: Path) -> Bundle:
    """Return a campaign in the form in which it is sent to a worker on another machine.

    Raises:
        InputError: The campaign names files outside its folder, or a file cannot be read.
    """
    folder = campaign.parent
    try:
        named = [name for r in load_campaign(campaign).value.recordings for name in r.patterns]
    except InputError:
        named = []  # The worker reports the error as the result of this rig.
    astray = [n for n in named if Path(n).is_absolute() or ".." in Path(n).parts]
    if astray:
        raise InputError(
            f"{campaign}: {', '.join(astray)}: outside the campaign's folder, so that a worker "
            f"on another machine cannot read the files; move these files into {folder}, or use "
            f"--jobs"
        )
    try:
        return Bundle(folder.name, campaign.name, read_folder(folder))
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}") from error


@contextmanager
def unpacked(given: Path | Bundle) -> Iterator[Path]:
    """Yield the path of a campaign file; the files of a bundle are first written into a temporary
    folder.

    Raises:
        OSError: A file cannot be written.
    """
    if isinstance(given, Path):
        yield given
        return
    with TemporaryDirectory(prefix="loadrig-") as scratch:
        folder = Path(scratch) / given.folder
        write_folder(folder, given.files)
        yield folder / given.campaign


def without_place(record: Any, folder: Path) -> Any:
    """Return a record in which paths begin with the name of the folder, so that the bytes of the
    record depend neither on the place of the folder nor on the place of this program.

    Args:
        record: Record of plain values.
        folder: The folder.
    """
    places = {folder.parent, folder.parent.absolute(), folder.parent.resolve()} - {Path(".")}
    homes = [str(p) for p in sorted(places, key=lambda p: -len(str(p)))]
    homes.append(str(Path(rig.__file__).parents[1]))
    pattern = re.compile("|".join(re.escape(home) + r"[/\\]" for home in homes))
    return _changed(record, lambda text: pattern.sub("", text))


def _changed(record: Any, change: Callable[[str], str]) -> Any:
    if isinstance(record, str):
        return change(record)
    if isinstance(record, Mapping):
        return {key: _changed(value, change) for key, value in record.items()}
    if isinstance(record, list | tuple):
        return [_changed(value, change) for value in record]
    return record
