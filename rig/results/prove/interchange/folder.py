"""Reads and writes a folder of sealed rigs: ``NAME/campaign.yaml`` with its recordings, and the
truth in ``sealed/NAME.yaml`` or ``sealed/NAME.json``.

The optional ``sealed/NAME.reference/campaign.yaml`` is the same rig without its effects. The
optional ``SHA256SUMS`` lists the digest of every file in the format of ``sha256sum``.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rig.common.errors import InputError
from rig.common.input_files import is_file, read_utf8
from rig.common.places import write_text
from rig.common.provenance import sha256_file
from rig.results.prove.folder import CAMPAIGN_FILE
from rig.results.prove.seal import seal
from rig.results.prove.truth import strangers

SEALED = "sealed"
REFERENCE = ".reference"
SUMS_FILE = "SHA256SUMS"
SUFFIXES = (".yaml", ".yml", ".json")
PREFIX = "rig-"
"""Name of the folder of a rig whose truth has only a number as its name, as written by ``rig
prove``.
"""


class SealedRig(NamedTuple):
    """One rig of a folder of sealed rigs.

    Attributes:
        name: Name of its folder.
        campaign: Its campaign file.
        truth: File of its truth.
        reference: Campaign file of the same rig without effects; it need not exist.
        digest: SHA-256 of the truth's file.
    """

    name: str
    campaign: Path
    truth: Path
    reference: Path
    digest: str = ""


def place(home: Path, name: str) -> SealedRig:
    """Return the paths to which the files of a rig with this name are written."""
    sealed = home / SEALED
    return SealedRig(
        name,
        home / name / CAMPAIGN_FILE,
        sealed / f"{name}.json",
        sealed / f"{name}{REFERENCE}" / CAMPAIGN_FILE,
    )


def sealed_rigs(home: Path) -> list[SealedRig]:
    """Return the rigs of a folder in order of their names, with the digests of their truths.

    Raises:
        InputError: There are none, or a truth cannot be read.
    """
    found = list(_found(home))
    if not found:
        raise InputError(
            f"{home}: no NAME/{CAMPAIGN_FILE} with a {SEALED}/NAME.yaml or .json beside it; give "
            f"--from a folder with such files (docs/guides/worlds.md)"
        )
    return found


def _found(home: Path) -> Iterator[SealedRig]:
    for truth in sorted((home / SEALED).glob("*")):
        if truth.suffix not in SUFFIXES or truth.name.startswith("."):
            continue
        for name in (truth.stem, PREFIX + truth.stem):
            rig = place(home, name)
            if is_file(rig.campaign):
                try:
                    yield rig._replace(truth=truth, digest=sha256_file(truth))
                except OSError as error:
                    raise InputError(f"{truth}: cannot be read: {error.strerror}") from error
                break


def write_truth(where: SealedRig, truth: Mapping[str, Any]) -> None:
    """Write the truth of a rig with a salt.

    Raises:
        OSError: It cannot be written.
    """
    where.truth.parent.mkdir(parents=True, exist_ok=True)
    content = {"truth": 1, "rig": where.name, "outside": strangers(truth["effects"]), **truth}
    seal(where.truth, content, secrets.token_hex(16))


def write_sums(home: Path) -> Path:
    """Write the digest of every file of the folder; return the path of the list.

    Raises:
        OSError: It cannot be written.
    """
    path = home / SUMS_FILE
    files = sorted(f for f in home.rglob("*") if is_file(f) and f != path)
    lines = [f"{sha256_file(file)}  {file.relative_to(home).as_posix()}" for file in files]
    write_text(path, "\n".join(lines) + "\n")
    return path


def check_sums(home: Path) -> None:
    """Compare the files of the folder with its list of digests; without a list nothing is checked.

    Raises:
        InputError: A file is missing, or differs from its listed digest; the message names all such
            files.
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
