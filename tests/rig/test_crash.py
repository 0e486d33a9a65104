"""The program itself breaks down: words, a file with the traceback, how the drive was left, and
status 5.
"""

from __future__ import annotations

import errno
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from rig.cli import crash
from rig.cli.crash import drive_words, note_drive, noting_folder
from rig.cli.entry import BAD_INPUT, CRASHED, DEVICE_FAILED, STOPPED, status
from rig.common.errors import InputError, StorageError
from rig.runs.run_record import RUN_FILE
from rig.wiring.teardown import SafeState

from .command import assert_in_words, rig

OFF = "the drive is de-energised (read back: switch on disabled)"
EFFECTS = """\
from rig.cli import entry as cli
from rig.results.diagnose import document as effects
def broken(shown):
    {body}
effects.overview = broken
cli.main()
"""
"""The command line, with a part of `rig effects` replaced."""


class Broken(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no words")


class StrangeError(BaseException):
    pass


Raise = Callable[[BaseException], None]


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Keep what is written out of the sources."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def effects_raise(monkeypatch: pytest.MonkeyPatch) -> Raise:
    """Let `rig effects` raise."""

    def arrange(error: BaseException) -> None:
        def overview(shown: object) -> str:
            raise error

        monkeypatch.setattr("rig.results.diagnose.document.overview", overview)

    return arrange


@pytest.mark.parametrize(
    "error",
    [
        ValueError("operands\nof two lines"),
        AssertionError(),
        MemoryError(),
        RecursionError("maximum recursion depth exceeded"),
        EOFError("the file ends early"),
        BrokenPipeError(errno.EPIPE, "Broken pipe"),
        OSError("no number"),
        PermissionError(errno.EACCES, "Permission denied", "somewhere"),
        ExceptionGroup("two", [ValueError("one"), KeyError("other")]),
        GeneratorExit(),
        StrangeError("strange"),
        Broken(),
    ],
    ids=lambda error: type(error).__name__,
)
def test_what_is_not_foreseen_ends_in_words(
    effects_raise: Raise, tmp_path: Path, capsys: pytest.CaptureFixture[str], error: BaseException
) -> None:
    effects_raise(error)
    note_drive(error, OFF)
    assert status(["effects"]) == CRASHED == 5
    said = capsys.readouterr().err
    assert OFF in said.splitlines()
    assert said.startswith(f"rig effects: the program broke down: {type(error).__name__}")
    assert "test_crash.py, line" in said.splitlines()[0]
    assert "Traceback" not in said
    assert len(said.splitlines()) == 3
    file = next(tmp_path.glob("crash-*.txt"))
    assert str(file) in said
    kept = file.read_text(encoding="utf-8")
    assert "Traceback (most recent call last)" in kept
    assert "arguments: 'effects'" in kept
    assert "loadrig 0" in kept
    assert f"drive: {OFF}\n" in kept


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (InputError(["one: bad", "two: bad"]), BAD_INPUT, "one: bad\ntwo: bad\n"),
        (KeyboardInterrupt(), STOPPED, "stopped by the operator\n"),
        (StorageError("runs/demo: full"), DEVICE_FAILED, "storage error: runs/demo: full\n"),
        (
            OSError(errno.ENOSPC, "No space left on device", "runs/demo/run.json"),
            DEVICE_FAILED,
            "storage error: runs/demo/run.json: No space left on device; free disk space, or "
            "write to another place\n",
        ),
        (
            OSError(errno.EDQUOT, "Disk quota exceeded"),
            DEVICE_FAILED,
            "storage error: Disk quota exceeded; free disk space, or write to another place\n",
        ),
    ],
    ids=["input", "operator", "storage", "full", "quota"],
)
def test_what_is_foreseen_keeps_its_status_and_says_how_the_drive_was_left(
    effects_raise: Raise,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    code: int,
    words: str,
) -> None:
    effects_raise(error)
    assert status(["effects"]) == code
    assert capsys.readouterr().err.lstrip("\n") == words
    note_drive(error, OFF)
    assert status(["effects"]) == code
    assert capsys.readouterr().err.lstrip("\n") == f"{words}{OFF}\n"
    assert not list(tmp_path.glob("crash-*"))


def test_a_program_that_ends_itself_is_let_go(effects_raise: Raise) -> None:
    effects_raise(SystemExit(7))
    with pytest.raises(SystemExit) as ended:
        status(["effects"])
    assert ended.value.code == 7


def test_the_words_are_found_on_what_led_to_an_exception() -> None:
    first = KeyError("first")
    note_drive(first, "earlier")
    note_drive(first, OFF)
    assert drive_words(first) == OFF
    second = ValueError("second")
    second.__cause__ = first
    assert drive_words(second) == OFF
    assert drive_words(ExceptionGroup("both", [OSError(), second])) == OFF
    assert drive_words(ValueError("other")) is None


def test_an_exception_that_carries_the_state_of_the_drive_says_it() -> None:
    error = ValueError("unforeseen")
    error.safe = SafeState(verified=True, state="switch on disabled")  # type: ignore[attr-defined]
    assert drive_words(error) == OFF


@pytest.mark.parametrize("command", ["run", "resume", "jog"])
def test_a_command_that_moves_says_where_nothing_is_known(command: str) -> None:
    words = crash.report(ValueError("unforeseen"), [command], command)
    assert "switch the main supply of a real bench off" in words


def test_the_traceback_goes_to_the_run_folder(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    with pytest.raises(ValueError, match="unforeseen") as noted, noting_folder(run):
        raise ValueError("unforeseen")
    assert str(run) in crash.report(noted.value, ["run"], "run")
    assert len(list(run.glob("crash-*.txt"))) == 1


def test_a_run_folder_on_the_command_line_is_the_place_too(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    (run / RUN_FILE).write_text("{}", encoding="utf-8")
    crash.report(ValueError("unforeseen"), ["identify", "x" * 5000, "\0", "run"], "identify")
    assert len(list(run.glob("crash-*.txt"))) == 1
    assert crash.RUN_FILE == RUN_FILE


def test_files_of_one_second_are_kept_apart_and_a_folder_that_is_read_only_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(2):
        crash.report(ValueError("unforeseen"), ["effects"], "effects")
    assert len(list(tmp_path.glob("crash-*.txt"))) == 2
    place, touch = tmp_path / "temporary", Path.touch
    place.mkdir()

    def refuse(file: Path, mode: int = 0o666, exist_ok: bool = True) -> None:
        if file.parent == Path():
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(file))
        touch(file, mode, exist_ok)

    monkeypatch.setattr(tempfile, "tempdir", str(place))
    monkeypatch.setattr(Path, "touch", refuse)
    assert str(place) in crash.report(ValueError("unforeseen"), ["effects"], "effects")
    assert len(list(place.glob("crash-*.txt"))) == 1


def test_where_nothing_can_be_written_the_traceback_is_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(file: Path, content: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    words = crash.report(ValueError("unforeseen"), ["effects"], "effects")
    assert "could not be written to a file" in words
    assert "ValueError: unforeseen" in words.splitlines()[-1]
    assert not list(Path().glob("crash-*"))


@pytest.mark.parametrize(
    "body",
    [
        "return 'x' * (1 << 62)",
        "import threading; thread = threading.Thread(target=lambda: 1 / 0); thread.start(); "
        "thread.join(); return ''",
        "raise BrokenPipeError(32, 'Broken pipe')",
    ],
    ids=["memory", "thread", "pipe"],
)
def test_the_process_ends_with_its_own_status(tmp_path: Path, body: str) -> None:
    ended = rig("effects", folder=tmp_path, entry=EFFECTS.format(body=body))
    assert_in_words(ended)
    assert ended.returncode == CRASHED, ended.stderr
    assert "rig effects: the program broke down: " in ended.stderr
    kept = next(tmp_path.glob("crash-*.txt")).read_text(encoding="utf-8")
    assert "Traceback (most recent call last)" in kept


def test_an_object_that_fails_as_it_goes_is_not_shown(tmp_path: Path) -> None:
    body = "type('Owner', (), {'__del__': lambda self: 1 / 0})(); return 'all'"
    ended = rig("effects", folder=tmp_path, entry=EFFECTS.format(body=body))
    assert_in_words(ended)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "all\n", "")
