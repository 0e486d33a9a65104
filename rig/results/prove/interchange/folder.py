"""Reads and writes a folder of sealed rigs: ``NAME/campaign.yaml`` with its recordings, and the
truth in ``sealed/NAME.yaml`` or ``sealed/NAME.json``.

The optional ``sealed/NAME.reference/campaign.yaml`` is the rig ``NAME`` without its effects. The
optional ``SHA256SUMS`` lists the digest of every file in the format of ``sha256sum``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from rig.common.errors import InputError
from rig.common.input_files import is_file
from rig.common.provenance import sha256_file
from rig.results.prove.folder import CAMPAIGN_FILE
from rig.results.prove.seal import seal
from rig.results.prove.truth import strangers

SEALED = "sealed"
REFERENCE = ".reference"
SUFFIXES = (".yaml", ".yml", ".json")
PREFIX = "rig-"
"""Name of a rig's folder if the file of its truth is named by a number, as ``rig prove`` writes
it.
"""


class SealedRig(NamedTuple):
    """One rig of a folder of sealed rigs.

    Attributes:
        name: Name of the rig's folder.
        campaign: Campaign file.
        truth: File of the truth.
        reference: Campaign file of the rig without its effects; this file need not exist.
        digest: SHA-256 of the truth's file.
    """

    name: str
    campaign: Path
    truth: Path
    reference: Path
    digest: str = ""


def place(home: Path, name: str) -> SealedRig:
    """Return the paths of the files of the sealed rig with this name."""
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
        InputError: The folder has no rigs, or a truth cannot be read.
    """
    found = list(_found(home))
    if not found:
        raise InputError(
            f"{home}: no NAME/{CAMPAIGN_FILE} with a {SEALED}/NAME.yaml or {SEALED}/NAME.json; "
            f"give --from a folder of sealed rigs (docs/guides/worlds.md)"
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


def write_truth(where: SealedRig, truth: Mapping[str, Any], salt: str) -> None:
    """Write the truth of a rig with a salt.

    Raises:
        OSError: The truth cannot be written.
    """
    where.truth.parent.mkdir(parents=True, exist_ok=True)
    content = {"truth": 1, "rig": where.name, "outside": strangers(truth["effects"]), **truth}
    seal(where.truth, content, salt)
