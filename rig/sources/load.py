"""Loads the recordings of a run folder or of a campaign file into a dataset."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from glob import glob, has_magic
from itertools import islice
from math import inf
from pathlib import Path

from identification.recording import Dataset, Recording
from rig.common.errors import InputError
from rig.common.places import is_file, is_folder
from rig.common.provenance import sha256_file
from rig.common.text import stored_path
from rig.config.campaign import Campaign, load_campaign
from rig.config.campaign_sections import RecordingSection, WindowSection
from rig.config.configuration import Document, Loc
from rig.runs.exported import read_back, sidecar
from rig.sources.build import Read, build, on_session_clock
from rig.sources.formats import FORMATS, unknown_format
from rig.sources.table import format_of


def load_source(path: Path, *, partial: bool = False) -> Dataset:
    """Load a run folder or a campaign file.

    Raises:
        InputError: The path is neither a run folder nor a campaign file, or a part of the source
            cannot be used; the message lists all problems.
    """
    _require_visible(path)
    if is_file(path / "run.json"):
        # Imported here, because recordings of a campaign do not need the reader of run folders.
        from rig.runs.run import load_run

        return load_run(path, partial=partial)
    if is_folder(path):
        raise InputError(
            f"{path}: the folder has no run.json; give a run folder or a campaign file (.yaml)"
        )
    if path.suffix.lower() not in (".yaml", ".yml"):
        remedy = (
            "; describe recordings made elsewhere in a campaign file (.yaml)"
            if is_file(path)
            else ""
        )
        missing = "" if os.path.exists(path) else "no such file; "
        raise InputError(f"{path}: {missing}a source is a run folder or a campaign file{remedy}")
    if partial:
        raise InputError(
            f"{path}: --partial is allowed for a run folder only; a campaign file names the "
            "recordings to load"
        )
    return _load_campaign(load_campaign(path))


def _require_visible(path: Path) -> None:
    """Reject a source that cannot be read, for example a folder without permission."""
    try:
        (path / "run.json").stat()
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path}: cannot be read: {reason}") from error


def _load_campaign(document: Document[Campaign]) -> Dataset:
    campaign = document.value
    bench = campaign.bench.bench()
    problems: list[str] = []
    read: list[Read] = []
    for file, index, section in _expand(document, problems):
        try:
            read.append(
                _exported(file, section, document, index)
                if section.exported
                else build(file, section, bench, document, index)
            )
        except InputError as error:
            problems.extend(error.problems)
    if problems:
        raise InputError(dict.fromkeys(problems))
    named = iter(_distinct_names([r for one in read for r in one.recordings]))
    files = [replace(one, recordings=tuple(islice(named, len(one.recordings)))) for one in read]
    recordings = tuple(on_session_clock(files, document))
    others = dict.fromkeys(document.other_files())
    for section in campaign.recordings:
        others |= dict.fromkeys(section.read.beside(document.path.parent).other_files)
    tables = {str(file): sha256_file(file) for file in others}
    return Dataset(recordings, campaign.model.model(), tables)


def _exported(
    file: Path, section: RecordingSection, document: Document[Campaign], index: int
) -> Read:
    """Read a file of ``rig export``; what the campaign states replaces its constants and role."""
    given = document.value.bench
    bench = {name: getattr(given.bench(), name) for name in given.model_fields_set}
    try:
        found = read_back(file, format_of(file), bench)
    except OSError as error:
        raise InputError(f"{file}: cannot be read: {error.strerror or error}") from error
    if found is None:
        raise InputError(
            document.problem(
                ("recordings", index),
                "`channels` is missing; only a file of `rig export` needs no channels, and "
                f"{file.name} is not such a file (an exported CSV file needs "
                f"{sidecar(file).name} beside it)",
            )
        )
    unsure = given.uncertainties()
    for k, one in enumerate(found):
        kept = {n: v for n, v in one.uncertainties.items() if n.partition(".")[2] not in bench}
        role = section.role if "role" in section.model_fields_set else one.role
        found[k] = replace(one, role=role, uncertainties={**kept, **unsure})
    first, last = (min(r.time[0] for r in found), max(r.time[-1] for r in found))
    return Read(tuple(found), float(first), float(last), section, index)


def _expand(
    document: Document[Campaign], problems: list[str]
) -> list[tuple[Path, int, RecordingSection]]:
    """Expand file names and patterns, and report missing files, unknown formats and duplicates."""
    files: list[tuple[Path, int, RecordingSection]] = []
    fitted: dict[tuple[str, str], list[RecordingSection]] = {}
    for index, section in enumerate(document.value.recordings):
        seen: set[Path] = set()
        for loc, file in _files(document, index, section, problems):
            if file in seen:
                continue
            seen.add(file)
            key = (os.path.realpath(file), repr(sorted(section.channels.items())))
            for other in fitted.setdefault(key, []):
                if not _apart(section.window, other.window):
                    again = "twice" if other.role == section.role else "both to fit and to validate"
                    problems.append(
                        document.problem(
                            loc,
                            f"{file} is used {again}; keep one entry for the file, or give each "
                            "entry its own `window`",
                        )
                    )
                    break
            fitted[key].append(section)
            files.append((file, index, section))
    return files


def _apart(one: WindowSection | None, other: WindowSection | None) -> bool:
    """Return whether two windows of a file have no sample in common."""
    if one is None or other is None:
        return False
    (a, b), (c, d) = (
        (-inf if w.begin is None else w.begin, inf if w.to is None else w.to) for w in (one, other)
    )
    return b <= c or d <= a


def _files(
    document: Document[Campaign], index: int, section: RecordingSection, problems: list[str]
) -> Iterator[tuple[Loc, Path]]:
    folder = document.path.parent
    for position, pattern in enumerate(section.patterns):
        loc: Loc = ("recordings", index, "file")
        if not isinstance(section.file, str):
            loc = (*loc, position)
        exact = folder / stored_path(pattern)
        # An existing name is used literally, because file names may contain brackets.
        matches = (
            [exact]
            if os.path.exists(exact)
            else [Path(m) for m in sorted(glob(str(exact), recursive=True))]
        )
        if not matches:
            what = "no file matches this pattern" if has_magic(pattern) else "no such file"
            problems.append(document.problem(loc, f"{what} in {folder}"))
        for file in matches:
            if is_folder(file):
                problems.append(
                    document.problem(
                        loc, f"{file} is a folder; give files, or add /* to the pattern"
                    )
                )
            elif format_of(file) not in FORMATS:
                problems.append(document.problem(loc, f"{file.name}: {unknown_format(file)}"))
            else:
                yield loc, file


def _distinct_names(recordings: list[Recording]) -> Iterator[Recording]:
    """Add the folder to duplicate names, then number the names that are still equal."""
    count = Counter(recording.name for recording in recordings)
    used: Counter[str] = Counter()
    for recording in recordings:
        name = recording.name
        if count[name] > 1:
            name = f"{Path(recording.source).parent.name}/{name}"
        used[name] += 1
        if used[name] > 1:
            name = f"{name} ({used[name]})"
        yield recording if name == recording.name else replace(recording, name=name)
