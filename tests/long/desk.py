"""An operator's desk: a simulated bench, a shell in tmux, and what must be so on the screen."""

from __future__ import annotations

import json
import os
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .benches import Bench
from .console import unwrapped
from .process_cases import PHASES, SECOND_STAGE, SEQUENCE
from .process_checks import VERDICT
from .tmux import Tmux

ANSWERED = re.compile(r"^Mass on the lever[^:\n]*: ?[^\n]{0,12}$")
STARTS = (
    r"Stage one: the drive is off",
    r"Mass on the lever",
    r"this drive has no watchdog",
    r"stage one: the weight cannot be checked",
    r"(?:done|stopped|tripped|failed): ",
    r"status \d",
)
"""What begins a line of its own, where the screen is as it should be."""
STATUS_LINE = re.compile(r"\d ?/ ?\d+ s\b|\bdeg\b.*\bA\b|Mass on the lever")
START_S = 60.0
END_S = 25.0


class MissedError(Exception):
    """It did not come to what was to be tried."""


@dataclass
class Desk:
    """An operator's place: a bench, a folder, a terminal.

    Attributes:
        bench: The bench.
        folder: The shell's folder.
        tmux: The terminal.
        captures: Title to what was on the screen.
        problems: What is not as it must be.
        remarks: What is not as nice as it could be.
    """

    bench: Bench
    folder: Path
    tmux: Tmux
    captures: dict[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def notices(self) -> list[dict[str, Any]]:
        """Return what the witness has told."""
        lines = (self.folder / "notices").read_text().splitlines()
        return [json.loads(line) for line in lines if line.endswith("}")]

    def reached(self, phase: str) -> bool:
        """Whether a phase of :data:`~tests.long.process_cases.PHASES` has begun."""
        stage, name, _ = PHASES[phase]
        return any(n.get("stage") == stage and n["phase"] == name for n in self.notices())

    def answered(self, stage: str) -> bool:
        """Whether the prompt of a stage was answered, so that the drive is prepared."""
        return any(
            notice.get("stage") == stage and notice["phase"] == "prepare"
            for notice in self.notices()
        )

    def wait_for(self, phase: str) -> None:
        """Wait for a phase, then for the moment in it.

        Raises:
            MissedError: It never comes.
        """
        limit = time.monotonic() + START_S
        while not self.reached(phase):
            if time.monotonic() > limit or self.status() is not None:
                raise MissedError(
                    f"phase {phase} was never reached: {self.tmux.everything()[-400:]}"
                )
            time.sleep(0.005)
        time.sleep(PHASES[phase][2])

    def wait_for_prompt(self, count: int = 1, timeout_s: float = START_S) -> None:
        """Wait until the last line on the screen is a prompt for a mass, the ``count``-th.

        Raises:
            MissedError: It never is.
        """

        def asked() -> bool:
            lines = self.tmux.everything().splitlines() or [""]
            seen = sum("Mass on the lever" in line for line in lines)
            return seen >= count and re.search(r"Mass on the lever[^:]*: ?$", lines[-1]) is not None

        if not self.tmux.until(asked, timeout_s):
            raise MissedError(
                f"prompt {count} is not on the screen: {self.tmux.everything()[-400:]}"
            )

    def open_gate(self) -> None:
        """Let the command go on."""
        gate = os.open(self.folder / "gate", os.O_RDWR | os.O_NONBLOCK)
        os.write(gate, b"x")
        os.close(gate)

    def status(self) -> int | None:
        """Return the exit status, once it is on the screen."""
        found = re.findall(r"^(?:\^C)*status (\d+)$", self.tmux.everything(), re.MULTILINE)
        return int(found[-1]) if found else None

    def wait_for_end(self, timeout_s: float = END_S) -> int | None:
        """Wait for the end of the command; returns its status."""
        self.tmux.until(lambda: self.status() is not None, timeout_s)
        return self.status()

    def capture(self, title: str) -> None:
        """Keep what is on the screen."""
        self.captures[title] = self.tmux.screen()

    def expect(self, what: object, words: str) -> None:
        """Note a problem where something is not so."""
        if not what:
            self.problems.append(words)

    def power_since_s(self, ns: int) -> bool:
        """Whether the drive had power at any time since then."""
        return self.bench.account().ever_on(ns, time.monotonic_ns())


def check_screen(desk: Desk, status: int | None, *wanted: int, verdict: bool = True) -> None:
    """Hold the screen at the end against what must be there."""
    text = desk.tmux.everything()
    desk.expect(
        status in wanted,
        f"exit status {status}, must be {' or '.join(map(str, wanted))}: {text[-300:]}",
    )
    desk.expect("Traceback (most recent call last)" not in text, f"a traceback: {text[-300:]}")
    if verdict:
        desk.expect(re.search(VERDICT, unwrapped(text)), f"no verdict on the screen: {text[-300:]}")
    desk.expect(not desk.bench.account().on, "the drive is still energised")
    desk.problems += tidy(text, desk.tmux.columns)
    desk.remarks += wide(text, desk.tmux.columns)


def tidy(text: str, columns: int) -> Iterator[str]:
    """Yield what is garbled: a status line or prompt wider than the terminal, or what begins within
    another line.
    """
    for line in text.splitlines():
        if len(line) > columns and STATUS_LINE.search(line):
            yield f"a status line of {len(line)} characters on {columns} columns: {line[:100]!r}"
        # What the shell writes after the end stands behind the ^C that its terminal has echoed.
        line = re.sub(r"^(\^C)+(?=status \d)", "", line)
        line = line.replace("the guardian stopped the drive: ", "")
        for start in STARTS:
            for found in re.finditer(start, line):
                if line[: found.start()].strip() not in ("", "warning:", "^C"):
                    yield f"{found.group()!r} begins in the middle of a line: {line[:100]!r}"
        if "Mass on the lever" in line and not ANSWERED.match(line):
            yield f"a garbled prompt: {line[:100]!r}"


def wide(text: str, columns: int) -> Iterator[str]:
    """Yield the messages that the terminal itself has to break; those with paths aside."""
    for line in text.splitlines():
        if len(line) > columns and not re.search(r"\S*/\S{10,}", line):
            yield f"a message of {len(line)} characters, broken at {columns}: {line[:50]!r}"


def sit_down(
    bench: Bench, folder: Path, columns: int = 80, sequence: str = SEQUENCE + SECOND_STAGE
) -> Desk:
    """Make a place with a bench as new."""
    bench.renew()
    bench.write_file(folder)
    (folder / "sequence.yaml").write_text(sequence)
    return Desk(bench, folder, Tmux(folder, bench.env, columns))


def answer(desk: Desk, text: str = "0") -> None:
    """Answer the prompt that is on the screen."""
    time.sleep(0.1)
    desk.tmux.type(text)
    desk.tmux.press("Enter")
