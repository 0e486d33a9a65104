"""Standard streams that are full, gone or closed: the work is done, its files are written."""

import errno
import io
import os
import pty
import sys
from pathlib import Path

import pytest

from rig.terminal.output import Inlet, Outlet, complain, reader_gone
from tests.rig.command import assert_in_words, rig

from .benches import sine, stages

ROWS = """\
import click
import sys
from pathlib import Path
from rig.cli import entry as cli

@click.command("rows")
@click.argument("code", type=int)
def rows(code):
    made = open("made.txt", "w")
    print("\\n".join(f"row {number} \\xb5 \\xb0 \\u2603" for number in range(20000)))
    made.write("made")
    made.close()
    return code

sys.modules["rig.cli.commands.rows"] = sys.modules["__main__"]
cli.COMMANDS["rows"] = ("rows", "")
cli.main()
"""
"""A command that prints more than a pipe holds, makes a file, and ends with the status it is
given.
"""

SHORT = "short.yaml"
SEQUENCE = stages(
    sine("empty", 1, 1, 2, more=", ramp_in_s: 0.5, ramp_out_s: 0.5, settle_s: 0"),
    head="limits: {speed_deg_s: 20}\n",
)


@pytest.mark.parametrize(("code", "reader"), [(0, "head -1"), (3, "head -c 100000 | tail -1")])
def test_a_reader_that_goes_away_changes_nothing(tmp_path: Path, code: int, reader: str) -> None:
    ended = rig("rows", str(code), folder=tmp_path, shell=f"| {reader}", entry=ROWS)
    assert_in_words(ended)
    assert ended.returncode == code
    assert ended.stderr == ""
    assert (tmp_path / "made.txt").exists()


@pytest.mark.parametrize(("code", "status"), [(0, 4), (1, 1)])
def test_a_full_disk_behind_the_output_is_said(tmp_path: Path, code: int, status: int) -> None:
    ended = rig("rows", str(code), folder=tmp_path, shell="> /dev/full", entry=ROWS)
    assert_in_words(ended)
    assert ended.returncode == status
    assert ended.stderr == (
        "storage error: the output cannot be written: No space left on device; "
        f"the command itself ended with status {code}\n"
    )
    assert (tmp_path / "made.txt").exists()


@pytest.mark.parametrize(("code", "shell"), [(1, "<&- >&- 2>&-"), (0, "2> /dev/full")])
def test_a_stream_that_is_closed_changes_nothing(tmp_path: Path, code: int, shell: str) -> None:
    ended = rig("rows", str(code), folder=tmp_path, shell=shell, entry=ROWS)
    assert_in_words(ended)
    assert ended.returncode == code
    assert ended.stderr == ""
    assert (tmp_path / "made.txt").read_text(encoding="utf-8") == "made", (
        "nothing of the output is in the file"
    )


@pytest.mark.parametrize("shell", ["> /dev/full", "<&- >&- 2>&-"])
def test_a_run_is_recorded_whatever_becomes_of_its_output(tmp_path: Path, shell: str) -> None:
    ended = rig("run", SHORT, "--yes", "--out", "made", folder=sequence_in(tmp_path), shell=shell)
    assert_in_words(ended)
    assert ended.returncode == (4 if "full" in shell else 0), ended.stderr
    assert {file.name for file in (tmp_path / "made").iterdir()} >= {
        "run.json",
        "recording.mcap",
        "run.html",
    }


def test_what_an_encoding_lacks_is_escaped(tmp_path: Path) -> None:
    environment = {"PYTHONIOENCODING": "cp437", "LC_ALL": "C", "PYTHONUTF8": "0"}
    ended = rig("rows", "0", folder=tmp_path, entry=ROWS, environment=environment)
    assert_in_words(ended)
    assert ended.returncode == 0
    assert ended.stdout.startswith("row 0 \udce6 \udcf8 \\u2603\n")


def test_an_outlet_whose_reader_went_away_takes_everything_and_does_not_fail() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    outlet = Outlet(writer)
    assert outlet.write(b"words") == 5
    assert outlet.write(memoryview(b"more")) == 4
    assert outlet.failure is None
    os.close(writer)


def test_a_terminal_that_went_away_is_a_reader_that_did() -> None:
    ours, theirs = pty.openpty()
    outlet, inlet = Outlet(theirs), Inlet(theirs)
    os.close(ours)
    assert outlet.write(b"words") == 5
    assert outlet.failure is None
    assert inlet.readinto(bytearray(8)) == 0
    os.close(theirs)


@pytest.mark.parametrize(
    ("number", "terminal", "gone"),
    [
        (errno.EPIPE, False, True),
        (errno.EIO, True, True),
        (errno.EIO, False, False),
        (errno.ENOSPC, True, False),
    ],
)
def test_a_broken_disk_is_no_reader_that_went_away(number: int, terminal: bool, gone: bool) -> None:
    assert reader_gone(OSError(number, os.strerror(number)), terminal=terminal) is gone


@pytest.mark.parametrize("closed", [False, True])
def test_complaining_without_stderr_is_no_error(monkeypatch, closed):
    stream = io.StringIO()
    stream.close()
    monkeypatch.setattr(sys, "stderr", stream if closed else None)
    complain("words")


def sequence_in(folder: Path) -> Path:
    (folder / SHORT).write_text(SEQUENCE, encoding="utf-8")
    return folder
