"""The command line in a process of its own, as a shell starts it."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

ENTRY = "from rig.cli.entry import main; main()"


def rig(
    *arguments: str | os.PathLike[str] | bytes,
    folder: Path,
    shell: str = "",
    environment: Mapping[str, str] | None = None,
    entry: str = ENTRY,
) -> subprocess.CompletedProcess[str]:
    """Run ``rig`` in a folder.

    Args:
        arguments: Of the command line.
        folder: Where it runs.
        shell: Redirections and a pipe, in the words of the shell.
        environment: Added to that of the tests.
        entry: What runs in the interpreter.
    """
    added = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **(environment or {})}
    return subprocess.run(
        [
            "bash",
            "-c",
            f'set -o pipefail; "$@" {shell}',
            "bash",
            sys.executable,
            "-c",
            entry,
            *arguments,
        ],
        cwd=folder,
        env={**os.environ, **added},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        encoding="utf-8",
        errors="surrogateescape",
        check=False,
    )


def assert_in_words(ended: subprocess.CompletedProcess[str]) -> None:
    """Check that what is shown is no traceback, and nothing that the interpreter says on its
    own.
    """
    shown = ended.stdout + ended.stderr
    for unwanted in (
        "Traceback",
        "Exception ignored",
        "Error in sys.excepthook",
        "--- Logging error",
        'File "',
    ):
        assert unwanted not in shown, shown
