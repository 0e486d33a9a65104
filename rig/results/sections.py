"""Makes sections that several documents have, on provenance and on corrections on reading, and
chooses the plotted recordings.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import TypeVar

from identification.recording import Recording
from rig.common.result_files import Provenance
from rig.results.document import Section, Table

Drawn = TypeVar("Drawn")
_NUMBER = re.compile(r"\d[\d.e+-]*")


def provenance_section(provenance: Provenance) -> Section:
    """Return the last section of every page: program, time and input files."""
    facts = (
        (
            "versions",
            ", ".join(f"{name} {release}" for name, release in provenance.versions.items()),
        ),
        ("created", provenance.created),
        ("seed", str(provenance.seed)),
        ("time spent", f"{provenance.seconds:.3g} s"),
    )
    files = tuple(provenance.inputs.items())
    inputs = (Table(("input file", "SHA-256"), files, ()),) if files else ()
    return Section("Provenance", (Table(("fact", "value"), facts, ()), *inputs))


def reading_notes(recordings: Sequence[Recording]) -> list[str]:
    """Return notes on corrections and implausible values; only the first of several notes that
    differ only in numbers is returned.
    """
    alike: dict[str, list[str]] = {}
    for recording in recordings:
        for note in recording.notes:
            alike.setdefault(_NUMBER.sub("#", note), []).append(
                f"reading: {recording.name}: {note}"
            )
    return [
        lines[0] + (f" ({len(lines) - 1} similar notes: see the report)" if len(lines) > 1 else "")
        for lines in alike.values()
    ]


def few_of_each_role(
    drawn: Sequence[Drawn],
    role: Callable[[Drawn], str],
    most: int,
    roles: Sequence[str] = ("fit", "validate"),
) -> list[Drawn]:
    """Return the first recordings of each role, in the order of the roles."""
    return [one for each in roles for one in [one for one in drawn if role(one) == each][:most]]
