"""Faults of an EPOS4 on a serial line with an AMT21 encoder, where they differ from CANopen."""

from collections.abc import Mapping
from dataclasses import replace

from .fault_cases import (
    BRAKE_S,
    CASES,
    FOUND_LATER,
    NO_POWER,
    NOT_RUNNING,
    REFUSED,
    RIDES,
    STALE,
    Case,
    Must,
    at,
    fault,
)

_IDLE = "prompt prepare enable disable"
_ANSWERS = {"frames": {"device": "drive"}}
_REQUESTS = {"frames": {"device": "host"}}
_BAD_LINE = Must(4, "no correct answer", 0.0)
_DEAF = Must(4, "no correct answer.*could NOT be verified", 0.0, verified=False)
_HEARD = Must(4, "no correct answer.*read back", 0.0)
_INSISTENT_S = 10.0
"""Five attempts to take the power off, on a line that returns after the first of them."""
_FOUND_AFTER_PROMPT = replace(FOUND_LATER, within_s=0.8)
"""The proof that the drive is off, before the prompt, takes longer over a serial line."""
_LATE = Must(4, "lateness of the control cycle", BRAKE_S)
_OTHERWISE: Mapping[str, Case] = {
    "drive fault": Case(
        (fault("drive", "fault"),),
        NOT_RUNNING,
        at("prompt prepare enable", Must(4, "7320h", 0.0))
        | at("disable", Must(0, "read back: fault", BRAKE_S)),
    ),
    "drive restarts": Case(
        (fault("drive", "restart"),),
        NOT_RUNNING,
        at("prompt prepare disable", RIDES) | at("enable", Must(4, "6061h still reads 0", 0.0)),
    ),
    "control loop hangs 0.5 s": Case(
        (fault("host", "hangs"),),
        replace(_LATE, within_s=0.6),
        at("prompt prepare enable disable", RIDES),
    ),
    "clock steps 1 s ahead": Case(
        (fault("host", "clock_step", value=1.0),), _LATE, at("prompt prepare enable disable", RIDES)
    ),
    "clock steps 1 s back": Case((fault("host", "clock_step", value=-1.0),), RIDES),
    "encoder frozen": Case(
        (fault("encoder", "frozen"),),
        FOUND_LATER,
        at("prompt", _FOUND_AFTER_PROMPT) | at("hold disable", RIDES),
    ),
    "60 kg instead of none": Case(
        (fault("operator", "wrong_weight", value=60.0),),
        Must(1, "beyond its limit", 0.7),
        at("approach excite ramp_out hold disable", RIDES),
    ),
}
"""Where a serial line differs: no watchdog, no emergency messages, no heartbeats, and lower
limits.
"""


_DOUBLED = at(NO_POWER, _BAD_LINE) | at("disable", replace(_BAD_LINE, within_s=BRAKE_S))
_LINE: Mapping[str, Case] = {
    "request lost": Case((fault("line", "lost", **_REQUESTS),), RIDES),
    "answer lost": Case((fault("line", "lost", **_ANSWERS),), RIDES),
    "answers lost, 40 of them": Case(
        (fault("line", "lost", **_ANSWERS, count=40),),
        STALE,
        at(NO_POWER, _HEARD) | at("disable", replace(_HEARD, within_s=BRAKE_S)),
    ),
    "a byte of a request lost": Case((fault("line", "byte_lost", **_REQUESTS),), RIDES),
    "a byte of an answer lost": Case((fault("line", "byte_lost", **_ANSWERS),), RIDES),
    "CRC error in a request": Case((fault("line", "corrupt", **_REQUESTS),), RIDES),
    "CRC error in an answer": Case((fault("line", "corrupt", **_ANSWERS),), RIDES),
    "stuffing error in a request": Case((fault("line", "stuffing", **_REQUESTS),), RIDES),
    "stuffing error in an answer": Case((fault("line", "stuffing", **_ANSWERS),), RIDES),
    "noise: CRC errors both ways, 100 of them": Case(
        (fault("line", "corrupt", count=100),),
        Must(4, "sample age.*read back", _INSISTENT_S),
        at("prompt", _DEAF)
        | at("prepare enable", _HEARD)
        | at("disable", replace(_HEARD, within_s=_INSISTENT_S)),
    ),
    "an answer 5 ms late": Case((fault("line", "late", **_ANSWERS),), RIDES),
    "40 answers 5 ms late": Case(
        (fault("line", "late", **_ANSWERS, count=40),), STALE, at(_IDLE, RIDES)
    ),
    "10 requests repeated": Case(
        (fault("line", "repeated", **_REQUESTS, count=10),), RIDES, _DOUBLED
    ),
    "10 answers repeated": Case(
        (fault("line", "repeated", **_ANSWERS, count=10),), RIDES, _DOUBLED
    ),
    "a request refused": Case((fault("line", "refused"),), RIDES, at("prepare disable", REFUSED)),
    "drive's line cut for 0.5 s": Case(
        (fault("line", "cut", value=0.5),), replace(STALE, within_s=0.6), at(_IDLE, RIDES)
    ),
    "drive's line cut": Case(
        (fault("line", "cut"),),
        Must(4, "sample age.*could NOT be verified", verified=False, stays_on=True),
        at(NO_POWER, _DEAF) | at("disable", replace(_DEAF, within_s=None, stays_on=True)),
    ),
}
_NO_ENCODER = Must(4, "simulated AMT21", 0.0)
_NO_ANGLE = at("prompt prepare", _NO_ENCODER) | at("disable", RIDES)
_ENCODER_LINE: Mapping[str, Case] = {
    "encoder's answer lost": Case((fault("encoder_line", "lost", **_ANSWERS),), RIDES),
    "a byte of the encoder's answer lost": Case(
        (fault("encoder_line", "byte_lost", **_ANSWERS),), RIDES
    ),
    "encoder's check bits wrong": Case((fault("encoder_line", "corrupt", **_ANSWERS),), RIDES),
    "encoder's check bits wrong, 40 times": Case(
        (fault("encoder_line", "corrupt", **_ANSWERS, count=40),), STALE, _NO_ANGLE
    ),
    "encoder's answer 5 ms late": Case((fault("encoder_line", "late", **_ANSWERS),), RIDES),
    "encoder's answers repeated, 10 of them": Case(
        (fault("encoder_line", "repeated", **_ANSWERS, count=10),), STALE, _NO_ANGLE
    ),
    "encoder's line cut": Case((fault("encoder_line", "cut"),), STALE, _NO_ANGLE),
    # What the joint can't have done is not believed, so that these show as answers without an
    # angle.
    "encoder bit": Case((fault("encoder", "bit"),), RIDES),
    "encoder jump": Case(
        (fault("encoder", "jump"),),
        STALE,
        at("prompt", _FOUND_AFTER_PROMPT) | at("prepare", FOUND_LATER) | at("disable", RIDES),
    ),
    "encoder reversed": Case(
        (fault("encoder", "reversed"),),
        FOUND_LATER,
        at("prompt", _FOUND_AFTER_PROMPT)
        | at("excite ramp_out hold", STALE)
        | at("disable", RIDES),
    ),
}

_DEAD: Mapping[str, Case] = {
    "controller killed, and no guardian (PC dead)": Case(
        (fault("host", "killed"),),
        Must(-9, verified=False, stays_on=True),
        at(NO_POWER, Must(-9, "", 0.0, verified=False)),
    )
}
"""The guardian is a process of its own, for real ports: see tests/long/moments.py.

Here is what is left without it.
"""
_NOT_HERE = ("controller killed", "EMCY", "SDO abort", "SDO time-out")
SERIAL: Mapping[str, Case] = {
    **{
        name: _OTHERWISE.get(name, case)
        for name, case in CASES.items()
        if case.rows[0]["target"] != "bus" and name not in _NOT_HERE
    },
    **_DEAD,
    **_LINE,
    **_ENCODER_LINE,
}
