"""Shell completion of the command line, as docs/guides/command_line.md sets it up."""

from __future__ import annotations

import subprocess
import sys

import pytest
from click.shell_completion import BashComplete

from rig.cli.entry import COMMANDS, cli, status


def variables(*words: str) -> dict[str, str]:
    return {"COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}


def answered(text: str) -> list[str]:
    """Return the words that are offered in an answer to bash."""
    return [line.partition(",")[2] for line in text.splitlines()]


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("rig", "ru"), ["run", "runs"]),
        (("rig", "new", "bench", "--torque-c"), ["--torque-constant"]),
        (("rig", "new", "bench", "b.yaml", "--drive", "epos"), ["epos4-serial"]),
    ],
)
def test_commands_and_options_are_completed(
    words: tuple[str, ...], found: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in variables(*words).items():
        monkeypatch.setenv(name, value)
    completion = BashComplete(cli, {}, "rig", "_RIG_COMPLETE")
    assert answered(completion.complete()) == found


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


@pytest.mark.parametrize(
    ("typed", "nearest"), [("chekc", "'check'"), ("Identify", "'identify'"), ("zzz", "diagnose")]
)
def test_a_mistyped_command_gets_the_nearest_name(
    typed: str, nearest: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a near name, all names are listed."""
    assert status([typed]) == 2
    assert nearest in capsys.readouterr().err
