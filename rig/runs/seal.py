"""Writes the SHA-256 of a run's files into ``SHA256SUMS`` in the run folder.

The file has the format of ``sha256sum``, so that ``sha256sum -c SHA256SUMS`` verifies the files
without this program. The digests show accidental damage and edits. The digests do not protect
against a person who can write into the run folder, and who can therefore also change
``SHA256SUMS``; a certificate with the digests that is kept elsewhere, for example on paper, shows
such a change.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from rig.common.errors import InputError
from rig.common.input_files import is_file, read_utf8
from rig.common.places import write_text
from rig.common.provenance import sha256_file
from rig.runs.run_record import RUN_FILE, RunRecord

SEAL_FILE = "SHA256SUMS"
_LINE = re.compile(r"([0-9a-f]{64}) [ *](.+)")


def seal(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """Write the digests of these files; digests of other files in ``SHA256SUMS`` are kept.

        Args:
            folder: The run folder.
            names: Paths relative to the folder; missing files are left out.

        Returns:
            Digests of all sealed files, by name.

    Raises:
        OSError: A file cannot be read, or the seal cannot be written.
    """
    try:
        sealed = dict(read_seal(folder))
    except InputError:
        # A damaged seal is replaced by the digests of the given files.
        sealed = {}
    sealed |= {name: sha256_file(folder / name) for name in names if is_file(folder / name)}
    lines = (f"{digest}  {name}\n" for name, digest in sorted(sealed.items()))
    write_text(folder / SEAL_FILE, "".join(lines))
    return sealed


def seal_run(folder: Path, record: RunRecord) -> dict[str, str]:
    """Record the digests of a run's record and recordings at its end.

    Raises:
        OSError: See :func:`seal`.
    """
    return seal(folder, [RUN_FILE, *(part.file for part in record.parts)])


def read_seal(folder: Path) -> Mapping[str, str]:
    """Return the digests in the seal, by name; empty if the folder has no seal.

    Raises:
        InputError: The seal is damaged.
    """
    path = folder / SEAL_FILE
    if not is_file(path):
        return {}
    found = {}
    for number, line in enumerate(read_utf8(path).splitlines(), start=1):
        match = _LINE.fullmatch(line)
        if match is None:
            raise InputError(f"{path}:{number}: the line must have the form `SHA-256  file`")
        found[match[2]] = match[1]
    return found
