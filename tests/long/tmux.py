"""A terminal as an operator has it: tmux with one pane and a shell in it, keys to press, and the
text on the screen.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

from .console import ROOT

HINT = "tmux is missing; install it, on Debian with `apt-get install tmux`"
_LOOK_S = 0.05
_RC = """\
PS1='$ '
renice -n -5 $$ >/dev/null 2>&1
export PYTHONPATH={root} OPENBLAS_NUM_THREADS=1
rig() {{ WITNESS=9 WITNESS_GATE="$GATE@8" {python} -m tests.long.witness "$@" 9>>notices 8<>gate; }}
slow() {{
  WITNESS=9 WITNESS_GATE="@8" {python} -m tests.long.slow_line \\
    {python} -m tests.long.witness "$@" 9>>notices 8<>gate
}}
go() {{ trap : INT; clear; "$@"; echo "status $?"; trap - INT; }}
"""


def available() -> bool:
    """Whether tmux is installed."""
    return shutil.which("tmux") is not None


class Tmux:
    """A server of its own with one session; a context manager.

    Args:
        folder: In which the shell is started; its file of settings and its witness's notices go
            there.
        env: Additions to the environment.
        columns: Of the terminal.
        lines: Of the terminal.
    """

    def __init__(
        self, folder: Path, env: Mapping[str, str], columns: int = 80, lines: int = 24
    ) -> None:
        self.folder = folder
        self.columns = columns
        self._name = f"loadrig-{uuid.uuid4().hex[:8]}"
        (folder / "rc").write_text(_RC.format(root=ROOT, python=sys.executable))
        if not (folder / "gate").exists():
            subprocess.run(["mkfifo", str(folder / "gate")], check=True)
        (folder / "notices").write_text("")
        size = ["-x", str(columns), "-y", str(lines)]
        words = [word for name, value in env.items() for word in ("-e", f"{name}={value}")]
        shell = ["bash", "--noprofile", "--rcfile", "rc", "-i"]
        self._tmux("-f", "/dev/null", "new-session", "-d", *size, "-c", str(folder), *words, *shell)
        self._tmux("set-option", "-g", "status", "off")
        self._tmux("set-option", "-g", "history-limit", "5000")
        self._tmux("set-option", "-g", "window-size", "manual")
        self.resize(columns, lines)
        self.until(lambda: "$" in self.screen(), 10.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the server and what runs in it."""
        subprocess.run(["tmux", "-L", self._name, "kill-server"], capture_output=True)

    def _tmux(self, *words: str) -> str:
        return subprocess.run(
            ["tmux", "-L", self._name, *words], check=True, capture_output=True, text=True
        ).stdout

    def type(self, text: str) -> None:
        """Type text, without Enter."""
        self._tmux("send-keys", "-l", text)

    def press(self, *keys: str) -> None:
        """Press keys by tmux's names: Enter, C-c..."""
        self._tmux("send-keys", *keys)

    def command(self, text: str) -> None:
        """Type a command line; it is gone from the screen as it begins."""
        self.type(f"go {text}")
        self.press("Enter")

    def resize(self, columns: int, lines: int = 24) -> None:
        """Change the size of the terminal."""
        self.columns = columns
        self._tmux("resize-window", "-x", str(columns), "-y", str(lines))

    def screen(self) -> str:
        """Return what is on the screen."""
        return self._tmux("capture-pane", "-p").rstrip("\n")

    def everything(self) -> str:
        """Return what is and was on the screen, lines that did not fit joined again."""
        return self._tmux("capture-pane", "-p", "-J", "-S", "-").rstrip("\n")

    def until(self, reached: Callable[[], object], timeout_s: float) -> bool:
        """Wait until something is so; False where it is not so in time."""
        limit = time.monotonic() + timeout_s
        while not reached():
            if time.monotonic() > limit:
                return False
            time.sleep(_LOOK_S)
        return True
