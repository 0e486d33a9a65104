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
from rig.cli import entry as cli
from rig.cli.crash import note_drive, noting_folder
from rig.cli.entry import BAD_INPUT, CRASHED, DEVICE_FAILED, STOPPED, status
from rig.common.errors import InputError, StorageError

from .command import assert_in_words, rig

OFF = "the drive is de-energised (read back: switch on disabled)"
EFFECTS = """\
from rig.cli import entry as cli
from rig.results import effects
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

        monkeypatch.setattr("rig.results.effects.overview", overview)

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
    assert status(["effects"]) == CRASHED == 5
    said = capsys.readouterr().err
    assert said.startswith(f"rig effects: the program broke down: {type(error).__name__}")
    assert "test_crash.py, line" in said.splitlines()[0]
    assert "Traceback" not in said
    assert len(said.splitlines()) == 2
    file = next(tmp_path.glob("crash-*.txt"))
    assert str(file) in said
    kept = file.read_text(encoding="utf-8")
    assert "Traceback (most recent call last)" in kept
    assert "arguments: 'effects'" in kept
    assert "loadrig 0" in kept


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


def test_how_the_drive_was_left_travels_with_the_exception(
    effects_raise: Raise, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    error = ValueError("unforeseen")
    note_drive(error, OFF)
    effects_raise(error)
    assert status(["effects"]) == CRASHED
    assert OFF in capsys.readouterr().err.splitlines()
    assert f"drive: {OFF}\n" in next(tmp_path.glob("crash-*.txt")).read_text(encoding="utf-8")


def test_the_traceback_goes_to_the_run_folder(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    with pytest.raises(ValueError, match="unforeseen") as noted, noting_folder(run):
        raise ValueError("unforeseen")
    assert str(run) in crash.report(noted.value, ["run"], "run")
    assert len(list(run.glob("crash-*.txt"))) == 1


def test_where_the_folder_cannot_be_written_it_is_a_temporary_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    refuse_to_write_in(monkeypatch, Path())
    words = crash.report(ValueError("unforeseen"), ["effects"], "effects")
    assert str(place) in words
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
        "raise ValueError('unforeseen')",
        "return broken(shown)",
        "return 'x' * (1 << 62)",
        "import threading; thread = threading.Thread(target=lambda: 1 / 0); thread.start(); "
        "thread.join(); return ''",
        "raise BrokenPipeError(32, 'Broken pipe')",
    ],
    ids=["exception", "recursion", "memory", "thread", "pipe"],
)
def test_the_process_ends_with_its_own_status(tmp_path: Path, body: str) -> None:
    ended = rig("effects", folder=tmp_path, entry=EFFECTS.format(body=body))
    assert_in_words(ended)
    assert ended.returncode == CRASHED, ended.stderr
    assert "rig effects: the program broke down: " in ended.stderr
    kept = next(tmp_path.glob("crash-*.txt")).read_text(encoding="utf-8")
    assert "Traceback (most recent call last)" in kept


def refuse_to_write_in(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    touch = Path.touch

    def refuse(file: Path, mode: int = 0o666, exist_ok: bool = True) -> None:
        if file.parent == folder:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(file))
        touch(file, mode, exist_ok)

    monkeypatch.setattr(Path, "touch", refuse)


def test_the_documents_list_every_status() -> None:
    root = Path(cli.__file__).parents[2]
    page = (root / "docs" / "guides" / "command_line.md").read_text(encoding="utf-8")
    assert [
        line[2] for line in page.splitlines() if line.startswith("| ") and line[2].isdigit()
    ] == list("012345")
    readme = (root / "README.md").read_text(encoding="utf-8")
    assert "5 the\nprogram itself failed" in readme
