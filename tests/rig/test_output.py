"""Standard streams that are full, gone or closed: the work is done, its files are written, nothing
is hidden.
"""

from __future__ import annotations

import errno
import io
import os
import pty
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from rig.terminal.output import Inlet, Outlet, ShareBar, complain, reader_gone
from tests.rig.command import assert_in_words, rig

ROWS = """\
import click
from pathlib import Path
from rig.cli import entry as cli

@click.command("rows")
@click.argument("code", type=int)
def command(code):
    made = open("made.txt", "w")
    print("\\n".join(f"row {number} \\xb5 \\xb0 \\u2603" for number in range(20000)))
    made.write("made")
    made.close()
    return code

cli.COMMANDS["rows"] = ("__main__:command", "")
cli.main()
"""
"""A command that prints more than a pipe holds, makes a file, and ends with the status it is
given.
"""

SHORT = "short.yaml"
SEQUENCE = """\
sequence: 1
name: short
limits: {speed_deg_s: 20}
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 1, frequency_Hz: 1}], duration_s: 2,
     ramp_in_s: 0.5, ramp_out_s: 0.5, settle_s: 0}
"""


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
    assert "No space left on device" in ended.stderr
    assert f"status {code}" in ended.stderr
    assert (tmp_path / "made.txt").exists()


@pytest.mark.parametrize(
    ("code", "shell"),
    [(0, ">&-"), (0, "<&-"), (1, "<&- >&- 2>&-"), (0, "2> /dev/full")],
)
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


def test_a_prompt_without_input_ends_the_run_in_words(tmp_path: Path) -> None:
    ended = rig("run", SHORT, "--out", "made", folder=sequence_in(tmp_path), shell="<&-")
    assert_in_words(ended)
    assert ended.returncode == 3
    assert "the input has ended; the drive is de-energised" in ended.stderr


@pytest.mark.parametrize(
    ("encoding", "shown"),
    [
        ("ascii", "µ ° ☃"),
        ("cp437", "\udce6 \udcf8 \\u2603"),
    ],
)
def test_what_an_encoding_lacks_is_escaped(tmp_path: Path, encoding: str, shown: str) -> None:
    environment = {"PYTHONIOENCODING": encoding, "LC_ALL": "C", "PYTHONUTF8": "0"}
    ended = rig("rows", "0", folder=tmp_path, entry=ROWS, environment=environment)
    assert_in_words(ended)
    assert ended.returncode == 0
    assert ended.stdout.startswith(f"row 0 {shown}\n")


def test_an_outlet_waits_for_a_reader_that_is_slow() -> None:
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    with ThreadPoolExecutor(1) as pool:
        taken = pool.submit(Path(f"/dev/fd/{reader}").read_bytes)
        with io.BufferedWriter(Outlet(writer)) as stream:
            stream.write(bytes(1_000_000))
        os.close(writer)
        assert len(taken.result()) == 1_000_000
    os.close(reader)


def test_an_outlet_whose_reader_went_away_takes_everything_and_does_not_fail() -> None:
    reader, writer = os.pipe()
    master, slave = pty.openpty()
    outlets = [Outlet(writer), Outlet(slave)]
    os.close(reader)
    os.close(master)
    for outlet in outlets:
        assert outlet.write(b"words") == 5
        assert outlet.write(memoryview(b"more")) == 4
        assert outlet.failure is None
    assert Inlet(slave).readinto(bytearray(8)) == 0
    os.close(writer)
    os.close(slave)


@pytest.mark.parametrize(
    ("number", "terminal", "gone"),
    [
        (errno.EPIPE, False, True),
        (errno.ECONNRESET, False, True),
        (errno.EIO, True, True),
        (errno.EIO, False, False),
        (errno.ENOSPC, True, False),
        (errno.EFBIG, False, False),
    ],
)
def test_a_broken_disk_is_no_reader_that_went_away(number: int, terminal: bool, gone: bool) -> None:
    assert reader_gone(OSError(number, os.strerror(number)), terminal=terminal) is gone


def test_a_complaint_that_cannot_be_shown_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = io.BytesIO()
    monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(kept, encoding="ascii", write_through=True))
    complain("25 °C")
    assert kept.getvalue() == b"25 \\xb0C\n"
    # Unbuffered, as what a buffer cannot write it keeps, and tries again when it is closed.
    full = io.TextIOWrapper(open("/dev/full", "wb", buffering=0), write_through=True)  # noqa: SIM115
    closed = io.StringIO()
    closed.close()
    for stream in (None, closed, full):
        monkeypatch.setattr(sys, "stderr", stream)
        complain("words")
    full.detach().close()


def sequence_in(folder: Path) -> Path:
    """Write a short sequence; returns the folder."""
    (folder / SHORT).write_text(SEQUENCE, encoding="utf-8")
    return folder


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_each_kind_of_work_is_shown_as_it_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = io.StringIO()
    monkeypatch.setattr(sys, "stderr", pipe)
    with ShareBar() as bar:
        bar("reading", 0.5)
    assert pipe.getvalue() == ""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with ShareBar() as bar:
        bar("reading", 0.0)
        assert "reading" in terminal.getvalue()
        bar("joint fit, 2 recordings", 0.0)
        assert "joint fit, 2 recordings" in terminal.getvalue()
        bar("joint fit, 2 recordings", 1.0)
        assert "100 %" in terminal.getvalue()
        bar("simulated replicates, round 1", 0.5)
        assert "50 %" in terminal.getvalue()
    assert "\n" not in terminal.getvalue().rstrip("\n")
