"""Analysis and output of ``rig diagnose --observable``: effects that recordings can show, and
effects that they cannot distinguish.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from identification.diagnosis.diagnose import observable_effects
from identification.diagnosis.rules import RULES
from identification.diagnosis.score.observable import Observable
from identification.effects import EFFECTS
from identification.model.parameters import parameter_unit
from identification.prepare import torque_unit
from identification.recording import Dataset, RecordingError
from rig.common.errors import InputError
from rig.common.input_files import is_folder, source_name
from rig.common.result_files import Provenance, finite
from rig.results.document import Block, Document, Items, Paragraph, Section, Table
from rig.runs.run_record import RUN_FILE
from rig.sources import load_source

OBSERVABLE_SCHEMA = "loadrig.observable/1"
HIDDEN = 0.01
"""Share of a regressor beyond the nominal parameters below which the effect counts as collinear
with the nominal model.
"""


@dataclass(frozen=True)
class Seen:
    """Result of ``rig diagnose --observable``.

    Attributes:
        dataset: The recordings.
        effects: Observability of each effect in the recordings.
        provenance: Seed, inputs, time.
    """

    dataset: Dataset
    effects: tuple[Observable, ...]
    provenance: Provenance

    def unit(self, effect: str, parameter: str) -> str:
        """Return the unit of an effect's parameter on this bench."""
        first = self.dataset.recordings[0]
        known = next((q.unit for q in EFFECTS[effect].parameters if q.name == parameter), "")
        return parameter_unit(first.bench.motion, parameter, known, torque_unit(first) == "A")

    def record(self) -> dict[str, Any]:
        """Return the record of ``rig diagnose --observable --json``."""
        return {
            **self.provenance.record(OBSERVABLE_SCHEMA),
            "effects": [
                {
                    "name": e.name,
                    "shown": bool(e.sizes),
                    "left": finite(e.left),
                    "least": {
                        name: {"value": finite(value), "unit": self.unit(e.name, name)}
                        for name, value in e.sizes.items()
                    },
                    "alike": {name: finite(share) for name, share in e.alike.items()},
                    "separating_experiment": EFFECTS[e.name].experiment,
                }
                for e in self.effects
            ],
        }


def observe_source(source: Path, seed: int, bandwidth_Hz: float | None = None) -> Seen:
    """Return which effects the recordings of a run folder or campaign file can show.

    Raises:
        InputError: The source cannot be read, or its recordings do not determine the nominal model.
    """
    started = time.perf_counter()
    dataset = load_source(source)
    described_by = source / RUN_FILE if is_folder(source) else source
    try:
        effects = observable_effects(dataset, bandwidth_Hz)
    except RecordingError as error:
        raise InputError(f"{source}: {error}") from error
    seconds = time.perf_counter() - started
    provenance = Provenance.of(seed, dataset.recordings, seconds, described_by, dataset.tables)
    return Seen(dataset, effects, provenance)


def observable_document(source: Path, seen: Seen) -> Document:
    """Return the effects that recordings can show as a document."""
    shown = [e for e in seen.effects if e.sizes]
    alike = [e for e in shown if e.alike]
    text = (
        f"These recordings can show {len(shown)} of {len(seen.effects)} effects; "
        f"{len(alike)} of these effects cannot be distinguished from others."
    )
    blocks: list[Block] = [Paragraph(text), _table(seen, shown)]
    hidden = [e.name for e in seen.effects if not e.sizes]
    if hidden:
        blocks.append(Paragraph(", ".join(hidden) + ".", "Not shown by these recordings."))
    sections = [Section("What these recordings can show", tuple(blocks))]
    if alike:
        asked = tuple((e.name, EFFECTS[e.name].experiment) for e in alike)
        sections.append(Section("What would distinguish them", (Items(asked),)))
    return Document(f"Observable effects of {source_name(source)}", text, tuple(sections))


def _table(seen: Seen, shown: Sequence[Observable]) -> Table:
    rows = tuple(
        (
            e.name,
            _least(seen, e),
            f"{100.0 * e.left:.0f} %" if e.left >= HIDDEN else f"{100.0 * e.left:.2g} %",
            ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in e.alike.items()),
        )
        for e in shown
    )
    header = (
        "effect",
        "least size shown",
        "beyond the nominal model",
        f"explained to {100.0 * RULES.alike:.0f} % by",
    )
    return Table(header, rows, (1, 2))


def _least(seen: Seen, effect: Observable) -> str:
    name, value = next(iter(effect.sizes.items()))
    unit = seen.unit(effect.name, name)
    return f"{name} {value:.3g} {unit}".rstrip()
