"""``--json`` and ``--seed`` of commands on a bench: judged before anything is done."""

from __future__ import annotations

import json
import os
import shutil
import stat
from pathlib import Path
from typing import Any

import pytest

from rig.cli.entry import status

RUN = ("run", "short.yaml", "--yes", "--out", "out")
CHECK = ("check", "practical")
JOG = ("jog", "practical", "--to", "1")
RECOVER = ("recover", "done")
RESUME = ("resume", "done")


@pytest.fixture(autouse=True)
def _elsewhere(short_sequence: Path, monkeypatch: pytest.MonkeyPatch, finished_run: Path) -> None:
    monkeypatch.chdir(short_sequence.parent)
    shutil.copytree(finished_run, "done")


@pytest.mark.parametrize("command", [RUN, CHECK, JOG, RECOVER, RESUME], ids=lambda c: c[0])
def test_a_missing_folder_is_bad_input_before_anything_is_done(
    command: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def connected(*arguments: Any) -> None:
        raise AssertionError("a bench was connected to")

    for name in ("rig.control.attendance", "rig.cli.commands.bench"):
        monkeypatch.setattr(f"{name}.connect", connected)
    assert status([*command, "--json", "missing/x.json"]) == 2
    assert "missing/x.json: the folder missing does not exist" in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.parametrize("command", [RUN, CHECK, JOG], ids=lambda c: c[0])
def test_a_negative_seed_is_bad_input(
    command: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert status([*command, "--seed", "-1"]) == 2
    assert "-1 is not in the range x>=0" in capsys.readouterr().err
    assert not Path("out").exists()


@pytest.mark.parametrize("command", [RUN, CHECK, JOG, RECOVER], ids=lambda c: c[0])
def test_what_is_no_plain_file_is_written_through(command: tuple[str, ...]) -> None:
    """A pipe stands for every device node: one that is replaced is gone for the whole machine."""
    os.mkfifo("pipe")
    reader = os.open("pipe", os.O_RDONLY | os.O_NONBLOCK)
    try:
        assert status([*command, "--json", "pipe"]) == 0
        assert json.loads(os.read(reader, 1 << 16))["schema"].startswith("loadrig.")
    finally:
        os.close(reader)
    assert stat.S_ISFIFO(Path("pipe").stat().st_mode)
