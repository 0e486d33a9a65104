"""Reports a defect of this program: message to the operator, and file with the traceback.

Information for the operator is attached to the exception as notes: the code that made the drive
safe adds the final state of the drive, and the code that opened the run folder adds the path of
the folder.
"""

from __future__ import annotations

import errno
import os
import platform
import tempfile
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from rig.common.provenance import RUN_FILE, utc_now, versions

_DRIVE: Final = "the drive: "
_FOLDER: Final = "run folder: "
_MOVES: Final = frozenset({"run", "resume", "jog", "commission"})
_LONGEST: Final = 300
"""Most characters of an exception's message that are shown; the traceback has all."""
_STORAGE: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS})
_NOT_KNOWN: Final = (
    "the state of the drive is not known; switch the main supply of a real bench off "
    "before approaching the bench"
)


def note_drive(error: BaseException, words: str) -> None:
    """Attach the final state of the drive to an exception, as text."""
    error.add_note(f"{_DRIVE}{words}")


def drive_words(error: BaseException) -> str | None:
    """Return the latest noted final state of the drive, from an exception or from its causes.

    An attribute ``safe`` with a ``message`` (a :class:`rig.wiring.teardown.SafeState`) counts as a
    note.
    """
    for cause in _causes(error):
        for note in reversed(getattr(cause, "__notes__", ())):
            if isinstance(note, str) and note.startswith(_DRIVE):
                return note.removeprefix(_DRIVE)
        words = getattr(getattr(cause, "safe", None), "message", None)
        if isinstance(words, str):
            return words
    return None


@contextmanager
def noting_folder(folder: Path) -> Iterator[None]:
    """Attach a run folder to passing exceptions; their traceback is written there."""
    try:
        yield
    except BaseException as error:
        error.add_note(f"{_FOLDER}{folder}")
        raise


def storage_words(error: OSError) -> str | None:
    """Return a message for a full or read-only disk, or None for other operating system errors."""
    if error.errno not in _STORAGE:
        return None
    place = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
    return f"{place}{error.strerror}; free disk space, or write to another place"


def report(error: BaseException, arguments: Sequence[str], command: str) -> str:
    """Write the traceback to a file, and return the message for the operator."""
    drive = drive_words(error)
    if drive is None and command in _MOVES:
        drive = _NOT_KNOWN
    found = _quietly(lambda: "".join(traceback.format_exception(error)))
    kept = _keep(_page(found, drive, arguments), _folders(error, arguments))
    lines = [f"{' '.join(('rig', command)).strip()}: the program broke down: {_in_one_line(error)}"]
    if drive is not None:
        lines.append(drive)
    if kept is None:
        lines += ["the traceback, which could not be written to a file:", found.rstrip()]
    else:
        place = _quietly(lambda: os.path.abspath(kept)) or str(kept)
        lines.append(f"the traceback is in {place}; report the defect with that file")
    return "\n".join(lines)


def _causes(error: BaseException) -> Iterator[BaseException]:
    """Yield an exception, the members of its group, and its causes."""
    todo: list[BaseException] = [error]
    seen: set[int] = set()
    while todo:
        cause = todo.pop(0)
        if id(cause) in seen:
            continue
        seen.add(id(cause))
        yield cause
        if isinstance(cause, BaseExceptionGroup):
            todo += cause.exceptions
        todo += [other for other in (cause.__cause__, cause.__context__) if other is not None]


def _in_one_line(error: BaseException) -> str:
    """Return class, message and innermost source line of an exception."""
    words = type(error).__name__
    said = _quietly(lambda: str(error)).strip().splitlines()
    if said:
        words += f": {said[0][:_LONGEST]}"
    places = traceback.extract_tb(error.__traceback__)
    return (
        f"{words} ({Path(places[-1].filename).name}, line {places[-1].lineno})" if places else words
    )


def _page(found: str, drive: str | None, arguments: Sequence[str]) -> str:
    """Return the content of the traceback file."""
    head = {
        "time": utc_now().isoformat(timespec="seconds"),
        "arguments": " ".join(map(repr, arguments)),
        "folder": _quietly(os.getcwd),
        "system": _quietly(platform.platform),
        "versions": _quietly(
            lambda: ", ".join(f"{name} {number}" for name, number in versions().items())
        ),
        "drive": drive or "this command does not move the drive",
    }
    return "".join(f"{name}: {value}\n" for name, value in head.items()) + f"\n{found}"


def _quietly(ask: Callable[[], str]) -> str:
    """Return the result of a function; empty if it fails, because the report must not fail."""
    try:
        return ask()
    except Exception:  # noqa: BLE001 - the defect may affect this function as well
        return ""


def _folders(error: BaseException, arguments: Sequence[str]) -> Iterator[Path]:
    """Yield folders for the traceback: the run folder, the current folder, the temporary folder."""
    for cause in _causes(error):
        for note in getattr(cause, "__notes__", ()):
            if isinstance(note, str) and note.startswith(_FOLDER):
                yield Path(note.removeprefix(_FOLDER))
    for argument in arguments:
        with suppress(OSError, ValueError):
            if (Path(argument) / RUN_FILE).is_file():
                yield Path(argument)
    yield Path()
    with suppress(OSError):
        yield Path(tempfile.gettempdir())


def _keep(page: str, folders: Iterable[Path]) -> Path | None:
    """Write the file into the first writable folder; return its path, or None."""
    stamp = f"{utc_now():%Y%m%dT%H%M%SZ}"
    content = page.encode("utf-8", "backslashreplace")
    for folder in folders:
        for name in (f"crash-{stamp}.txt", f"crash-{stamp}-{os.getpid()}.txt"):
            file = folder / name
            try:
                # Never overwrites a file and never follows an existing link.
                file.touch(exist_ok=False)
            except FileExistsError:
                continue
            except OSError:
                break
            try:
                file.write_bytes(content)
            except OSError:
                with suppress(OSError):
                    file.unlink()
                break
            return file
    return None
