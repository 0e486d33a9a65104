"""Tables of the process matrix, and each message once, written to out/process_matrix.md."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from .benches import TITLES, TRANSPORTS
from .process_cases import COLUMNS, LIMITS, PHASES, START, STARTS

PAGE = Path("out/process_matrix.md")
SHOWN = "The list has every message that a cell showed on the terminal, once each."


@dataclass(frozen=True)
class Cell:
    """Outcome of one failure in one phase on one transport.

    Attributes:
        text: Entry of the table.
        problems: Requirements that were not met.
        messages: Messages on the terminal after the failure.
        busy: Number of repeats because the machine was too busy.
        seconds: Time until the power was off, s.
    """

    text: str
    problems: tuple[str, ...]
    messages: tuple[str, ...] = ()
    busy: int = 0
    seconds: float | None = None


Cells = dict[tuple[str, str, str], Cell]
"""Outcome by column, transport and phase."""


def tables(cells: Cells) -> list[str]:
    """Return the tables of the page."""
    lines: list[str] = []
    for transport in TRANSPORTS:
        lines += [
            f"## {TITLES[transport]}",
            "",
            f"| | {' | '.join(PHASES)} |",
            "|---" * (len(PHASES) + 1) + "|",
        ]
        for column in COLUMNS:
            row = [cells.get((column, transport, phase), Cell("", ())).text for phase in PHASES]
            if any(row):
                lines.append(f"| {column} | {' | '.join(row)} |")
        lines.append("")
    lines += ["## From the start", "", f"| | {' | '.join(TITLES[t] for t in TRANSPORTS)} |"]
    lines.append("|---" * (len(TRANSPORTS) + 1) + "|")
    for start in STARTS:
        row = [cells.get((start, transport, START), Cell("", ())).text for transport in TRANSPORTS]
        lines.append(f"| `rig run ... {start}` | {' | '.join(row)} |")
    return [*lines, ""]


def said(cells: Cells) -> list[str]:
    """Return every message once, with the cell that showed it first and the number of cells.

    Lines of a message that the terminal wrapped are listed together.
    """
    seen: dict[str, tuple[str, tuple[str, str, str], int]] = {}
    for place, made in cells.items():
        for message in made.messages:
            key = re.sub(
                r"[-+]?\d+(\.\d+)?", "#", re.sub(r"stage \w+, phase [\w ]+:|/\S+", "@", message)
            )
            first = seen.get(key)
            seen[key] = (message, place, 1) if first is None else (first[0], first[1], first[2] + 1)
    blocks: dict[tuple[tuple[str, str, str], int], list[str]] = {}
    for message, place, count in seen.values():
        blocks.setdefault((place, count), []).append(message)
    lines = []
    for ((column, transport, phase), count), messages in blocks.items():
        lines += [
            f"- {count} cell{' shows' if count == 1 else 's show'} this message; "
            f"{'it' if count == 1 else 'the first of them'} is *{column}* in phase *{phase}*, "
            f"on the {transport} transport:",
            "",
            "  ```text",
            *(f"  {message}" for message in messages),
            "  ```",
        ]
    return lines


def write(lines: Sequence[str], messages: Sequence[str], cells: Cells) -> None:
    """Write failures, limits, tables and messages."""
    bad = sum(bool(made.problems) for made in cells.values())
    again = sum(made.busy for made in cells.values())
    count = (
        f"{len(cells)} cells, {bad} of them bad; {again} repeats because the machine was too busy."
    )
    head = [
        "# Failures of the process, adapter, terminal and disk of a run",
        "",
        *(f"- **{name}**: {column.words}" for name, column in COLUMNS.items()),
        "",
        f"**Limits.** {LIMITS}",
        "",
        count,
        "",
    ]
    PAGE.parent.mkdir(exist_ok=True)
    PAGE.write_text(
        "\n".join([*head, *lines, "## What the operator sees", "", SHOWN, "", *messages, ""]),
        encoding="utf-8",
    )
