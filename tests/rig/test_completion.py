"""Shell completion of the command line, as docs/completion.md sets it up."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rig.cli.entry import COMMANDS

CODE = "import sys; from rig.cli.entry import main; main()"
PAGE = Path(__file__).parents[2] / "docs" / "completion.md"


def shell(**environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", CODE],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
    )
    assert done.returncode in (0, 1), done.stderr
    return done.stdout


def completed(*words: str) -> list[str]:
    text = shell(
        _RIG_COMPLETE="bash_complete", COMP_WORDS=" ".join(words), COMP_CWORD=str(len(words) - 1)
    )
    return [line.partition(",")[2] for line in text.splitlines()]


@pytest.mark.parametrize("name", ["bash", "zsh", "fish"])
def test_the_script_for_a_shell_is_what_the_page_asks_for(name: str) -> None:
    line = f"_RIG_COMPLETE={name}_source"
    assert line in PAGE.read_text()
    if name != "bash":  # click asks for the version of bash, which a test does not need.
        assert "_RIG_COMPLETE" in shell(_RIG_COMPLETE=f"{name}_source")


def test_commands_and_options_are_completed() -> None:
    assert completed("rig", "ru") == ["run", "runs"]
    assert completed("rig", "new", "") == ["bench", "campaign", "sequence"]
    assert "--torque-constant" in completed("rig", "new", "bench", "--to")
    assert completed("rig", "new", "bench", "b.yaml", "--drive", "epos") == ["epos4-serial"]
    assert completed("rig", "schema", "") == ["bench", "sequence", "campaign", "faults"]


def test_the_names_of_commands_are_completed_without_importing_them() -> None:
    code = (
        "import sys, click\nfrom rig.cli.entry import cli\n"
        "found = cli.shell_complete(click.Context(cli), '')\n"
        "print(*[item.value for item in found])\n"
        "assert not [name for name in sys.modules if name.startswith('rig.cli.commands.')]\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr == ""
    assert done.stdout.split() == list(COMMANDS)
