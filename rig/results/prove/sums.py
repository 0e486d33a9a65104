"""Lists digests of files in the format of ``sha256sum``, and checks files against such a list."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rig.common.errors import InputError
from rig.common.input_files import is_file, read_utf8
from rig.common.places import write_text
from rig.common.provenance import sha256_file

SUMS_FILE = "SHA256SUMS"


def write_sums(home: Path, parts: Sequence[str] = (".",)) -> Path:
    """Write the digest of every file of the folder; return the path of the list.

    Args:
        home: The folder.
        parts: Files and folders to list, relative to ``home``.

    Raises:
        OSError: The list cannot be written.
    """
    path = home / SUMS_FILE
    found = {f for part in parts for f in (home / part, *(home / part).rglob("*"))}
    files = sorted(f for f in found if is_file(f) and f != path)
    lines = [f"{sha256_file(file)}  {file.relative_to(home).as_posix()}" for file in files]
    write_text(path, "\n".join(lines) + "\n")
    return path


def check_sums(home: Path) -> None:
    """Compare the files of the folder with its list of digests; without a list nothing is checked.

    Raises:
        InputError: A file is missing, or its digest differs from the listed digest; the message
            names all files with an error.
    """
    path = home / SUMS_FILE
    if not is_file(path):
        return
    problems = []
    for number, line in enumerate(read_utf8(path).splitlines(), start=1):
        digest, _, name = line.partition(" ")
        file = home / name.strip().removeprefix("*")
        try:
            found = sha256_file(file)
        except OSError as error:
            problems.append(f"{path}:{number}: {name.strip()}: cannot be read: {error.strerror}")
            continue
        if found != digest:
            problems.append(
                f"{path}:{number}: {name.strip()}: SHA-256 is {found}, listed is {digest}; the "
                f"file was changed"
            )
    if problems:
        raise InputError(problems)
