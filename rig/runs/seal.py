"""Writes the SHA-256 of a run's files into ``SHA256SUMS`` in the run folder.

The file has the format of ``sha256sum``, so that ``sha256sum -c SHA256SUMS`` verifies the files
without this program. The digests show damage and edits, but not who made them: a person who can
write the folder can also write this file. A certificate that is kept elsewhere, for example on
paper, protects the digests against such a change.
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
    """Write the digests of the present files; digests of other files stay.

    Args:
        folder: The run folder.
        names: Paths relative to the folder; those that are missing are left out.

    Returns:
        Name to digest of everything that is sealed now.

    Raises:
        OSError: A file cannot be read, or the seal cannot be written.
    """
    try:
        sealed = dict(read_seal(folder))
    except InputError:
        # A damaged seal is replaced; the files that are sealed now are known.
        sealed = {}
    sealed |= {name: sha256_file(folder / name) for name in names if is_file(folder / name)}
    lines = (f"{digest}  {name}\n" for name, digest in sorted(sealed.items()))
    write_text(folder / SEAL_FILE, "".join(lines))
    return sealed


def seal_run(folder: Path, record: RunRecord) -> dict[str, str]:
    """Record the digests of a run's record and recordings at its end.

    Raises:
        OSError: As :func:`seal`.
    """
    return seal(folder, [RUN_FILE, *(part.file for part in record.parts)])


def read_seal(folder: Path) -> Mapping[str, str]:
    """Read the seal: return name to digest; empty if the folder has no seal.

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
            raise InputError(f"{path}:{number}: no line of the form `SHA-256  file`")
        found[match[2]] = match[1]
    return found
