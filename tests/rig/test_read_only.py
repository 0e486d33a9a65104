"""A program that belongs to root, used by somebody whose home cannot be written, or is full."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import rig
from rig.runs.run import read_record

from .command import assert_in_words
from .test_bad_inputs import SEQUENCE

ENTRY = """\
import os, sys
sys.path[:0] = [{program!r}, {tests!r}]
from ordinary import ordinary_user
with ordinary_user():
    {body}
"""
RUN = "from rig.cli.entry import main; main()"

KERNEL = """\
import numpy
    from rig.cli.entry import find_kernel_folder
    find_kernel_folder()
    from identification.numerics.series import sine_cosine
    print(sine_cosine(1.0, numpy.zeros(1)).sum())"""


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Path]:
    """Return a copy of the program that cannot be written, nor the home beside it."""
    copy = tmp_path / "program"
    for package in ("rig", "drivers", "identification"):
        source = Path(rig.__file__).parent.with_name(package)
        shutil.copytree(source, copy / package, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "home").mkdir()
    (tmp_path / "temporary").mkdir()
    folders = [copy, tmp_path / "home", *(path for path in copy.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o500)
    yield copy
    for folder in folders:
        folder.chmod(0o700)


def start(program: Path, *arguments: str, body: str = RUN) -> subprocess.CompletedProcess[str]:
    place = program.parent
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("XDG_", "NUMBA", "MPL"))
    }
    environment |= {"HOME": str(place / "home"), "TMPDIR": str(place / "temporary")}
    entry = ENTRY.format(program=str(program), tests=str(Path(__file__).parent), body=body)
    return subprocess.run(
        [sys.executable, "-c", entry, *arguments],
        cwd=place,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.proof
def test_a_run_is_simulated_and_its_kernels_are_kept_among_the_temporary_files(
    program: Path,
) -> None:
    place = program.parent
    (place / "sequence.yaml").write_text(SEQUENCE, encoding="utf-8")
    for out in ("first", "second"):
        ended = start(program, "run", "sequence.yaml", "--yes", "--out", out)
        assert_in_words(ended)
        assert ended.returncode == 0, ended.stderr
        assert ended.stderr == ""
        assert read_record(place / out).state == "done"
    kept = list((place / "temporary").glob("loadrig-kernels-*/*/*.nbc"))
    assert kept
    assert not list(program.rglob("*.nb[ci]"))


def test_a_kernel_is_kept_among_the_temporary_files(program: Path) -> None:
    for _ in range(2):
        ended = start(program, body=KERNEL)
        assert (ended.returncode, ended.stdout, ended.stderr) == (0, "1.0\n", "")
    kept = list((program.parent / "temporary").glob("loadrig-kernels-*/*/*.nbc"))
    assert len(kept) == 1
    assert not list(program.rglob("*.nb[ci]"))


def test_numbers_are_not_loaded_before_the_command_line_sets_one_thread() -> None:
    """Sums in several threads differ in their last digits from sums in one."""
    script = "import sys, rig.cli.entry; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
