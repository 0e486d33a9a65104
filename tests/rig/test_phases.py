"""The transition table of a run, word by word: the words are in the recording, in messages and on
the screen.
"""

from __future__ import annotations

import itertools

import pytest

from rig.common.sample import Phase
from rig.control.phase_handlers import TRANSITIONS, Event, next_phase

TABLE = {
    ("load", "done"): "prepare",
    ("load", "repeat stage"): "load",
    ("prepare", "done"): "enable",
    ("enable", "done"): "approach",
    ("enable", "first pass"): "first pass",
    ("first pass", "done"): "weight check",
    ("weight check", "done"): "approach",
    ("weight check", "first pass"): "first pass",
    ("approach", "done"): "settle",
    ("settle", "done"): "excite",
    ("excite", "done"): "hold",
    ("hold", "next repeat"): "approach",
    ("hold", "done"): "release",
    ("release", "done"): "between stages",
    ("between stages", "next stage"): "load",
    ("between stages", "repeat stage"): "load",
    ("between stages", "done"): "finished",
}


def test_every_pair_of_phase_and_event() -> None:
    for phase, event in itertools.product(Phase, Event):
        following = TABLE.get((phase.value, event.value))
        if following is not None:
            assert next_phase(phase, event) is TRANSITIONS[phase, event] is Phase(following)
            continue
        with pytest.raises(ValueError, match="no transition") as caught:
            next_phase(phase, event)
        assert (
            str(caught.value)
            == f"no transition from phase {phase.value!r} on event {event.value!r}"
        )


def test_every_way_to_the_end_passes_through_release() -> None:
    """The drive has power from ENABLE to RELEASE: no way from one to the end, or to a prompt,
    leaves RELEASE out.
    """
    seen, waiting = set(), [Phase.ENABLE]
    while waiting:
        phase = waiting.pop()
        if phase in seen or phase is Phase.RELEASE:
            continue
        seen.add(phase)
        waiting += [after for (before, _), after in TRANSITIONS.items() if before is phase]
    assert not seen & {Phase.LOAD, Phase.PREPARE, Phase.BOUNDARY, Phase.FINISHED}
