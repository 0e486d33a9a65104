"""The program itself breaks down: words, a traceback file, status 5."""

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
from rig.wiring.teardown import SafeState

from .command import assert_in_words, rig

pytestmark = pytest.mark.usefixtures("elsewhere")

OFF = "the drive is de-energised (read back: switch on disabled)"
BROKEN = """\
import sys
import click
from rig.cli import entry as cli

@click.command("broken")
def broken():
    {body}

sys.modules["rig.cli.commands.broken"] = sys.modules["__main__"]
cli.COMMANDS["broken"] = ("broken", "")
cli.main()
"""
"""The command line with a command of its own, which loads no numerics."""


class Broken(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no words")


class StrangeError(BaseException):
    pass


Raise = Callable[[BaseException], None]


@pytest.fixture
def effects_raise(monkeypatch: pytest.MonkeyPatch) -> Raise:
    def arrange(error: BaseException) -> None:
        def overview(shown: object) -> str:
            raise error

        monkeypatch.setattr("rig.results.diagnose.document.overview", overview)

    return arrange


@pytest.mark.parametrize(
    "error",
    [
        ValueError("operands\nof two lines"),
        MemoryError(),
        BrokenPipeError(errno.EPIPE, "Broken pipe"),
        OSError("no number"),
        ExceptionGroup("two", [ValueError("one"), KeyError("other")]),
        GeneratorExit(),
        StrangeError("strange"),
        Broken(),
    ],
    ids=lambda error: type(error).__name__,
)
def test_what_is_not_foreseen_ends_in_words(effects_raise, tmp_path, capsys, error):
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
    ],
    ids=["input", "operator", "storage", "full"],
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


def test_where_the_folder_takes_no_file_another_place_does(tmp_path, monkeypatch):
    place, touch = tmp_path / "temporary", Path.touch
    place.mkdir()

    def refuse(file: Path, mode: int = 0o666, exist_ok: bool = True) -> None:
        if file.parent == Path():
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(file))
        touch(file, mode, exist_ok)

    monkeypatch.setattr(tempfile, "tempdir", str(place))
    monkeypatch.setattr(Path, "touch", refuse)
    for _ in range(2):
        assert str(place) in crash.report(ValueError("unforeseen"), ["effects"], "effects")
    assert len(list(place.glob("crash-*.txt"))) == 2


@pytest.mark.parametrize(
    "body",
    [
        "import threading; thread = threading.Thread(target=lambda: 1 / 0); thread.start(); "
        "thread.join()",
        "raise BrokenPipeError(32, 'Broken pipe')",
    ],
    ids=["thread", "pipe"],
)
def test_the_process_ends_with_its_own_status(tmp_path: Path, body: str) -> None:
    ended = rig("broken", folder=tmp_path, entry=BROKEN.format(body=body))
    assert_in_words(ended)
    assert ended.returncode == CRASHED, ended.stderr
    assert "rig broken: the program broke down: " in ended.stderr
    assert list(tmp_path.glob("crash-*.txt"))


def test_an_object_that_fails_as_it_goes_is_not_shown(tmp_path: Path) -> None:
    body = "type('Owner', (), {'__del__': lambda self: 1 / 0})(); print('all')"
    ended = rig("broken", folder=tmp_path, entry=BROKEN.format(body=body))
    assert_in_words(ended)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "all\n", "")
