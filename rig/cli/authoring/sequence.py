"""``rig new sequence``: stages of sines, on the empty lever and with weights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from rig.cli.authoring.questions import Answers, Number, Numbers, Question
from rig.cli.authoring.yaml_text import Block, render
from rig.config.bench import Bench
from rig.config.configuration import Document
from rig.config.sequence import Sequence, StageSection, Tone, load_sequence
from rig.planning.plan import make_plan

_PERIODS: Final = 4.0
_SHORTEST_S: Final = 20.0
_RAMP_S: Final = 1.0


def _duration_s(answers: Mapping[str, Any]) -> float:
    """Return the default duration: four periods, at least 20 s."""
    return max(_SHORTEST_S, float(math.ceil(_PERIODS / answers["frequency"] + 2 * _RAMP_S)))


QUESTIONS: Final = (
    Question(
        "weights",
        "Weights to hang in turn after the empty lever, or none",
        "kg",
        kind=Numbers(),
        default=(2.0, 5.0),
    ),
    Question("amplitude", "Amplitude of the sine at the joint", "deg", default=20.0),
    Question("frequency", "Frequency of the sine", "Hz", default=0.2),
    Question("duration", "Duration of each stage", "s", default=_duration_s),
    Question(
        "center", "Angle about which the joint swings", "deg", kind=Number(above=None), default=0.0
    ),
)
"""Questions in order."""


def sequence_text(name: str, answers: Answers) -> str:
    """Return the text of a sequence file without its first line.

    Args:
        name: Name of the sequence.
        answers: Answers to :data:`QUESTIONS`.
    """
    masses = [0.0, *answers["weights"]]
    stages = [
        _stage(mass, masses[:n].count(mass), answers, bare=n > 0) for n, mass in enumerate(masses)
    ]
    head = (
        f"# Sequence {name}, written by `rig new sequence`. The keys of the first stage are "
        f"explained.\n"
        f"# `rig run SEQUENCE --bench BENCH --dry-run` prints the plan of a run and moves "
        f"nothing.\n"
    )
    return head + render(Block(Sequence, {"sequence": 1, "name": name, "stages": stages}))


def _stage(mass: float, before: int, answers: Answers, bare: bool) -> Block:
    name = f"weight-{mass:g}kg" if mass else "unloaded"
    tone = Block(
        Tone,
        {
            "amplitude_deg": answers["amplitude"],
            "frequency_Hz": answers["frequency"],
            "phase_deg": 0.0,
        },
        bare=bare,
    )
    values: dict[str, Any] = {
        "name": f"{name}-{before + 1}" if before else name,
        "stage": "loaded" if mass else "unloaded",
        "weight_kg": mass,
        "tones": [tone],
        "duration_s": answers["duration"],
        "ramp_in_s": _RAMP_S,
        "ramp_out_s": _RAMP_S,
        "repeats": 1,
        "center_deg": answers["center"],
        "settle_s": 0.2,
        "role": "fit",
    }
    return Block(StageSection, values, bare=bare)


def load_for(bench: Document[Bench] | None, path: Path) -> None:
    """Read a written sequence file; with a bench, check the sequence against the bench's limits.

    Raises:
        InputError: The sequence is not valid, or exceeds a limit of the bench.
    """
    document = load_sequence(path)
    if bench is not None:
        make_plan(document, bench)
