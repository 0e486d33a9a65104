"""What is said when this program itself breaks down, and where the traceback goes.

What an operator has to know then travels with the exception as notes: how the drive was left, noted
by whoever made it safe, and the folder of the run, noted by whoever opened it.
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

from rig.common.provenance import utc_now, versions

RUN_FILE: Final = "run.json"
"""As in :mod:`rig.runs.run_record`, whose import takes a tenth of a second that ``rig --help`` does
not have.
"""
_DRIVE: Final = "the drive: "
_FOLDER: Final = "run folder: "
_MOVES: Final = frozenset({"run", "resume", "jog"})
_LONGEST: Final = 300
"""Characters of an exception's message that are shown; all of it is in the traceback."""
_STORAGE: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS})
_NOT_KNOWN: Final = (
    "how the drive was left is not known; switch the main supply of a real bench "
    "off before approaching it"
)


def note_drive(error: BaseException, words: str) -> None:
    """Attach to an exception how the drive was left, e.g. "the drive is de-energised (read back:
    ...)".
    """
    error.add_note(f"{_DRIVE}{words}")


def drive_words(error: BaseException) -> str | None:
    """Return how the drive was left, as noted on an exception or on one that led to it; the latest
    note counts.

    So does an exception with an attribute ``safe`` that has a ``message``
    (a :class:`rig.wiring.teardown.SafeState`).
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
    """Attach a run folder to every exception that passes, so that its traceback is written
    there.
    """
    try:
        yield
    except BaseException as error:
        error.add_note(f"{_FOLDER}{folder}")
        raise


def storage_words(error: OSError) -> str | None:
    """Return what a full or read-only disk says, or None for every other error of the operating
    system.
    """
    if error.errno not in _STORAGE:
        return None
    place = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
    return f"{place}{error.strerror}; free disk space, or write to another place"


def report(error: BaseException, arguments: Sequence[str], command: str) -> str:
    """Write the traceback to a file, and return what to tell the operator.

    Args:
        error: What was not foreseen.
        arguments: Of the command line.
        command: The subcommand, or nothing where none was reached.
    """
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
        lines.append(f"its traceback is in {place}; report the defect with that file")
    return "\n".join(lines)


def _causes(error: BaseException) -> Iterator[BaseException]:
    """Yield an exception, those it groups, and those that led to it."""
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
    """Return class, message and innermost place of an exception."""
    words = type(error).__name__
    said = _quietly(lambda: str(error)).strip().splitlines()
    if said:
        words += f": {said[0][:_LONGEST]}"
    places = traceback.extract_tb(error.__traceback__)
    return (
        f"{words} ({Path(places[-1].filename).name}, line {places[-1].lineno})" if places else words
    )


def _page(found: str, drive: str | None, arguments: Sequence[str]) -> str:
    """Return what is written to the file."""
    head = {
        "time": utc_now().isoformat(timespec="seconds"),
        "arguments": " ".join(map(repr, arguments)),
        "folder": _quietly(os.getcwd),
        "system": _quietly(platform.platform),
        "versions": _quietly(
            lambda: ", ".join(f"{name} {number}" for name, number in versions().items())
        ),
        "drive": drive or "this command does not move it",
    }
    return "".join(f"{name}: {value}\n" for name, value in head.items()) + f"\n{found}"


def _quietly(ask: Callable[[], str]) -> str:
    """Return an answer, or nothing where it cannot be had: the report must not break down
    itself.
    """
    try:
        return ask()
    except Exception:  # noqa: BLE001 - whatever broke the program may break this as well
        return ""


def _folders(error: BaseException, arguments: Sequence[str]) -> Iterator[Path]:
    """Yield where the traceback may go: to the run, else here, else among the temporary files."""
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
    """Write the page into the first folder that takes it; return where it is, or None."""
    stamp = f"{utc_now():%Y%m%dT%H%M%SZ}"
    content = page.encode("utf-8", "backslashreplace")
    for folder in folders:
        for name in (f"crash-{stamp}.txt", f"crash-{stamp}-{os.getpid()}.txt"):
            file = folder / name
            try:
                # Never over a file or through a link that is there.
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
