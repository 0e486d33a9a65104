"""Keeps an index of run folders in SQLite; the index can be deleted at any time.

Each row holds the entry of one folder as JSON, the signature of the files from which the entry was
made, and a checksum. A row is used only if its signature agrees with the present files and its
checksum is right; all other folders are read again. Therefore a deleted, damaged or older index
does not change the answers.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import sqlite3
import zlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from rig.common.errors import InputError
from rig.runs.catalogue.entry import Details, Entry, Head
from rig.runs.catalogue.walk import Found, find_runs, signature_of

INDEX_FILE = ".runs.sqlite"
"""Name of the index in the searched folder."""
_FORMAT = 2
"""Format number of the entries, which is increased when the content of entries changes, so that
older rows are not used.
"""
_TABLE = (
    "CREATE TABLE IF NOT EXISTS runs (folder TEXT PRIMARY KEY, signature TEXT NOT NULL, "
    "head TEXT NOT NULL, checksum INTEGER NOT NULL, details TEXT NOT NULL, "
    "details_checksum INTEGER NOT NULL)"
)
_WAIT_S = 5.0
"""Time to wait for another program that writes the index, s."""


_NOT_DAMAGED = frozenset(
    {
        sqlite3.SQLITE_BUSY,
        sqlite3.SQLITE_LOCKED,
        sqlite3.SQLITE_READONLY,
        sqlite3.SQLITE_CANTOPEN,
        sqlite3.SQLITE_FULL,
        sqlite3.SQLITE_IOERR,
    }
)
"""Errors after which the index is kept, because it is intact but cannot be written now; after other
errors the index is created again.
"""


class _Row(NamedTuple):
    """A row of the index, in the order of its columns."""

    folder: str
    signature: str
    head: str
    checksum: int
    details: str = ""
    details_checksum: int = 0

    @property
    def sound(self) -> bool:
        """Whether the row is unchanged since it was written, by the checksums of the columns that
        were read.
        """
        return self.checksum == _checksum(self.folder, self.signature, self.head) and (
            self.details_checksum == _checksum(self.details) if self.details else True
        )


class Listing(NamedTuple):
    """Result of a search for the runs below a folder.

    Attributes:
        entries: Runs, the earliest first; folders without a date come first.
        read: Number of folders that had to be read.
        note: Message if the index could not be written; empty otherwise.
    """

    entries: list[Entry]
    read: int
    note: str


def list_runs(
    root: Path,
    progress: Callable[[int, int], None] | None = None,
    *,
    details: bool = True,
) -> Listing:
    """Return the runs in and below a folder, from the index if the index is current.

    Args:
        root: The folder.
        details: Whether the entries need their details; if not, entries from the index have no
            details.
        progress: Called with the number of folders that were read, and the number of folders to
            read.

    Raises:
        InputError: The folder cannot be searched.
    """
    try:
        found = list(find_runs(root))
    except OSError as error:
        raise InputError(f"{root}: cannot be searched: {error.strerror}") from error
    file = root / INDEX_FILE
    rows = _load(file, details)
    entries, fresh = [], []
    for each in found:
        row = rows.get(each.folder)
        if row is not None and row.signature == each.signature and row.sound:
            entries.append(Entry(each.folder, Head.of(json.loads(row.head)), row.details))
        else:
            fresh.append(each)
    made = _read(root, fresh, progress)
    gone = rows.keys() - {each.folder for each in found}
    entries += [Entry(row.folder, Head.of(json.loads(row.head)), row.details) for row in made]
    entries.sort(key=lambda entry: (entry.head.created, entry.folder))
    is_run = any(each.folder == "." for each in found)
    note = "" if is_run or not (made or gone) else _store(root, file, made, gone)
    return Listing(entries, len(made), note)


def detailed(root: Path, entries: Iterable[Entry]) -> list[Entry]:
    """Return runs of a list with their details, which are read for these runs only.

    Args:
        root: The folder that was searched.
        entries: The runs. Entries that already have details are kept; entries whose folder is
            gone are left out.
    """
    entries = list(entries)
    wanted = [entry.folder for entry in entries if not entry.details]
    rows = _load(root / INDEX_FILE, True, wanted) if wanted else {}
    made = []
    for entry in entries:
        if entry.details:
            made.append(entry)
            continue
        signature = signature_of(str(root / entry.folder))
        row = rows.get(entry.folder)
        if row is not None and row.signature == signature and row.sound:
            made.append(Entry(entry.folder, Head.of(json.loads(row.head)), row.details))
        elif signature:
            (read,) = _read(root, [Found(entry.folder, signature)], None)
            made.append(Entry(read.folder, Head.of(json.loads(read.head)), read.details))
    return made


def _read(
    root: Path, fresh: Iterable[Found], progress: Callable[[int, int], None] | None
) -> list[_Row]:
    """Read folders, and return their rows."""
    waiting = list(fresh)
    if not waiting:
        return []
    # Imported late: a list from the index does not need the readers.
    from rig.runs.catalogue.read import read_entry

    benches: dict[str, str] = {}
    rows = []
    for number, each in enumerate(waiting, start=1):
        if each.signature.startswith("unreadable"):
            problem = f"{root / each.folder}: no permission to read"
            head, details = Head("unreadable", problem), Details()
        else:
            head, details = read_entry(root / each.folder, benches)
        texts = (json.dumps(dataclasses.asdict(part)) for part in (head, details))
        first, second = texts
        check = _checksum(each.folder, each.signature, first)
        rows.append(_Row(each.folder, each.signature, first, check, second, _checksum(second)))
        if progress is not None:
            progress(number, len(waiting))
    return rows


def _checksum(*fields: str) -> int:
    return zlib.crc32("\0".join(fields).encode("utf-8", "surrogateescape"))


def _load(file: Path, details: bool, only: list[str] | None = None) -> Mapping[str, _Row]:
    """Return the rows of an index, or only the rows of some folders; empty if the index is missing,
    damaged or of another format.
    """
    if not os.path.isfile(file):
        return {}
    try:
        with contextlib.closing(_open(file)) as database:
            if database.execute("PRAGMA user_version").fetchone()[0] != _FORMAT:
                return {}
            columns = "folder, signature, head, checksum"
            columns += ", details, details_checksum" if details else ""
            query = f"SELECT {columns} FROM runs"
            if only is None:
                return {row[0]: _Row(*row) for row in database.execute(query)}
            query += " WHERE folder = ?"
            each = (database.execute(query, (folder,)).fetchone() for folder in only)
            return {row[0]: _Row(*row) for row in each if row is not None}
    except (sqlite3.Error, UnicodeError, TypeError):
        return {}


def _open(file: Path) -> sqlite3.Connection:
    return sqlite3.connect(file, timeout=_WAIT_S, isolation_level=None)


def _store(root: Path, file: Path, made: list[_Row], gone: Iterable[str]) -> str:
    """Write rows, and remove the rows of deleted folders; return a message if the index cannot be
    written.

    Rows whose files changed while they were read are not written.
    """
    kept = [row for row in made if signature_of(str(root / row.folder)) == row.signature]
    for again in (False, True):
        try:
            with contextlib.closing(_open(file)) as database:
                _write(database, kept, gone)
            return ""
        except (sqlite3.Error, UnicodeError) as error:
            code = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) & 0xFF
            if again or code in _NOT_DAMAGED:
                return (
                    f"{file}: the index cannot be written ({error}); each list therefore "
                    "reads all runs again"
                )
        with contextlib.suppress(OSError):
            file.unlink()
    return ""


def _write(database: sqlite3.Connection, made: Iterable[_Row], gone: Iterable[str]) -> None:
    database.execute("BEGIN IMMEDIATE")
    if database.execute("PRAGMA user_version").fetchone()[0] != _FORMAT:
        database.execute("DROP TABLE IF EXISTS runs")
        database.execute(f"PRAGMA user_version = {_FORMAT}")
    database.execute(_TABLE)
    database.executemany("INSERT OR REPLACE INTO runs VALUES (?, ?, ?, ?, ?, ?)", made)
    database.executemany("DELETE FROM runs WHERE folder = ?", [(folder,) for folder in gone])
    database.execute("COMMIT")
