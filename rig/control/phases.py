"""The phases of a run and the permitted transitions between them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from rig.common.sample import Phase


class Event(Enum):
    """How a phase ended."""

    DONE = "done"
    FIRST_PASS = "first pass"
    NEXT_REPEAT = "next repeat"
    NEXT_STAGE = "next stage"
    REPEAT_STAGE = "repeat stage"


TRANSITIONS: Mapping[tuple[Phase, Event], Phase] = {
    (Phase.LOAD, Event.DONE): Phase.PREPARE,
    (Phase.LOAD, Event.REPEAT_STAGE): Phase.LOAD,
    (Phase.PREPARE, Event.DONE): Phase.ENABLE,
    (Phase.ENABLE, Event.DONE): Phase.APPROACH,
    (Phase.ENABLE, Event.FIRST_PASS): Phase.FIRST_PASS,
    (Phase.FIRST_PASS, Event.DONE): Phase.WEIGH,
    (Phase.WEIGH, Event.DONE): Phase.APPROACH,
    (Phase.WEIGH, Event.FIRST_PASS): Phase.FIRST_PASS,
    (Phase.APPROACH, Event.DONE): Phase.SETTLE,
    (Phase.SETTLE, Event.DONE): Phase.EXCITE,
    (Phase.EXCITE, Event.DONE): Phase.HOLD,
    (Phase.HOLD, Event.NEXT_REPEAT): Phase.APPROACH,
    (Phase.HOLD, Event.DONE): Phase.RELEASE,
    (Phase.RELEASE, Event.DONE): Phase.BOUNDARY,
    (Phase.BOUNDARY, Event.NEXT_STAGE): Phase.LOAD,
    (Phase.BOUNDARY, Event.REPEAT_STAGE): Phase.LOAD,
    (Phase.BOUNDARY, Event.DONE): Phase.FINISHED,
}


def next_phase(phase: Phase, event: Event) -> Phase:
    """Return the next phase by the transition table.

    Raises:
        ValueError: The table has no such transition; the message states phase and event.
    """
    try:
        return TRANSITIONS[phase, event]
    except KeyError:
        raise ValueError(
            f"no transition from phase {phase.value!r} on event {event.value!r}"
        ) from None
