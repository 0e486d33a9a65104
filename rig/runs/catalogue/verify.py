"""Compares the files of a run with the digests that were recorded of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from rig.common.errors import InputError
from rig.common.places import is_file, read_json
from rig.common.provenance import sha256_file
from rig.runs.catalogue.index import RESULTS
from rig.runs.mcap.reader import DamageError, run_items
from rig.runs.run_file import SEAL_FILE, read_record, read_seal
from rig.runs.run_record import RUN_FILE, RunRecord


class Finding(Enum):
    """Result of the comparison of one file."""

    UNCHANGED = "unchanged"
    WHOLE = "whole, not sealed"
    OPEN = "not sealed"
    CHANGED = "CHANGED"
    DAMAGED = "DAMAGED"
    MISSING = "MISSING"

    @property
    def good(self) -> bool:
        """Whether the file is unchanged, as far as this can be determined."""
        return self in (Finding.UNCHANGED, Finding.WHOLE, Finding.OPEN)


@dataclass(frozen=True)
class Verified:
    """One file and the result of its comparison."""

    file: str
    finding: Finding
    sha256: str = ""  # present digest; empty for a missing file
    recorded: str = ""  # recorded digest; empty if no digest was recorded
    by: str = ""  # file with the recorded digest; empty if no digest was recorded
    words: str = ""


@dataclass(frozen=True)
class Verification:
    """All files of a run."""

    folder: Path
    files: tuple[Verified, ...]
    problems: tuple[str, ...] = ()

    @property
    def good(self) -> bool:
        """Whether no file is changed, damaged or missing."""
        return not self.problems and all(each.finding.good for each in self.files)


def verify(folder: Path) -> Verification:
    """Verify the files of a run; without a digest, a recording by its own checksums."""
    problems: list[str] = []
    try:
        record = read_record(folder)
    except InputError as error:
        record = None
        problems += error.problems
    try:
        sealed = read_seal(folder)
    except InputError as error:
        sealed = {}
        problems += error.problems
    recordings = [part.file for part in record.parts] if record else []
    references = {name: (digest, SEAL_FILE) for name, digest in sealed.items()}
    for name, digest, by in _inputs(folder, recordings):
        references.setdefault(name, (digest, by))
    names = [RUN_FILE, *recordings, *(name for name in RESULTS if is_file(folder / name))]
    every = dict.fromkeys([*names, *references])
    return Verification(
        folder,
        tuple(_verified(folder, name, references, record, recordings) for name in every),
        tuple(problems),
    )


def _inputs(folder: Path, recordings: list[str]) -> Iterator[tuple[str, str, str]]:
    """Yield the digests that results state of their inputs: recording, digest and result file."""
    for name in RESULTS:
        try:
            found = read_json(folder / name) if is_file(folder / name) else {}
        except InputError:
            continue  # the digest of this result itself is verified
        inputs = found.get("inputs") if isinstance(found, dict) else None
        for each in inputs if isinstance(inputs, list) else ():
            if isinstance(each, dict) and Path(str(each.get("file"))).name in recordings:
                yield Path(str(each["file"])).name, str(each.get("sha256")), name


def _verified(
    folder: Path,
    name: str,
    references: Mapping[str, tuple[str, str]],
    record: RunRecord | None,
    recordings: list[str],
) -> Verified:
    path, (recorded, by) = folder / name, references.get(name, ("", ""))
    try:
        digest = sha256_file(path)
    except FileNotFoundError:
        return Verified(name, Finding.MISSING, "", recorded, by)
    except OSError as error:
        return Verified(name, Finding.DAMAGED, "", recorded, by, error.strerror or str(error))
    found = Verified(name, Finding.UNCHANGED, digest, recorded, by)
    if digest == recorded:
        return found
    if record is not None and record.state == "running":
        words = "the run is in progress, or has died and can be completed with `rig recover`"
        return dataclasses.replace(found, finding=Finding.OPEN, words=words)
    if recorded:
        words = _damage(path) if name in recordings else ""
        return dataclasses.replace(found, finding=Finding.CHANGED, words=words)
    if name not in recordings:
        return dataclasses.replace(found, finding=Finding.OPEN)
    damage = _damage(path)
    if damage:
        return dataclasses.replace(found, finding=Finding.DAMAGED, words=damage)
    return dataclasses.replace(found, finding=Finding.WHOLE, words="its own checksums hold")


def _damage(path: Path) -> str:
    """Return a message on damage that the checksums inside a recording show; empty if intact."""
    try:
        for _ in run_items(path, ("time",)):
            pass
    except (DamageError, OSError) as error:
        return str(error)
    return ""
