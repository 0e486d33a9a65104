"""Faults of a drive with CAN frames of its own, where they differ from CANopen."""

from collections.abc import Mapping
from dataclasses import replace

from .fault_cases import (
    BRAKE_S,
    CASES,
    FOUND_LATER,
    MOTION,
    NO_POWER,
    NOT_RUNNING,
    RIDES,
    SIGNS,
    SILENCE_S,
    STALE,
    WATCH_S,
    Case,
    Must,
    at,
    fault,
)

_MUTE = Must(4, "sent no valid", 0.0)
_LOST = replace(_MUTE, within_s=WATCH_S, verified=False)
_NO_ENABLE = Must(4, "still in state", 0.0)
_WATCHDOG = Must(4, "0011h", WATCH_S)
_LATER = replace(FOUND_LATER, within_s=1.2)


def _but(name: str, phases: dict[str, Must], rest: Must | None = None) -> Case:
    """Return a case of CANopen with another reaction in some phases."""
    case = CASES[name]
    return Case(case.rows, rest or case.rest, {**case.by_phase, **phases})


DBC: Mapping[str, Case] = {
    **SIGNS,
    "one frame lost": _but("one frame lost", at("prompt prepare disable", RIDES)),
    "the drive's frames lost, 40 of them": _but(
        "the drive's frames lost, 40 of them",
        at("prepare enable disable", replace(_LOST, verified=True)) | at("prompt", RIDES),
    ),
    "cable pulled": _but(
        "cable pulled",
        at("prompt prepare disable", _LOST)
        | at("enable", replace(_LOST, words="sent no heartbeat")),
    ),
    "10 frames repeated": CASES["10 frames repeated"],
    "a frame 3 ms late": CASES["a frame 3 ms late"],
    "the drive's positions 20 ms late, 60 of them": CASES[
        "the drive's positions 20 ms late, 60 of them"
    ],
    "target with a bit wrong": CASES["target with a bit wrong"],
    "checksum wrong: position with a bit wrong": Case(
        CASES["position with a bit wrong"].rows, RIDES
    ),
    "checksum wrong, 40 times": Case(
        (fault("bus", "flipped", frames=MOTION, value=29, count=40),),
        STALE,
        at("prepare enable", _MUTE)
        | at("prompt", RIDES)
        | at("disable", replace(_MUTE, within_s=BRAKE_S)),
    ),
    "speed with a bit wrong (no checksum)": Case(
        (fault("bus", "flipped", frames={"device": "drive", "function": "speed"}, value=6),), RIDES
    ),
    "process data cut short": CASES["process data cut short"],
    "bus-off": _but("bus-off", at("prompt prepare enable", _LOST)),
    "error frames": CASES["error frames"],
    "host silent": Case(
        (fault("bus", "lost", frames={"device": "host"}, count=0),),
        replace(STALE, within_s=WATCH_S),
        at("prompt prepare", _MUTE)
        | at("enable", _NO_ENABLE)
        | at("disable", Must(0, "read back: fault", WATCH_S)),
    ),
    "host's commands lost": Case(
        (fault("bus", "lost", frames={"device": "host", "function": "output"}, count=0),),
        STALE,
        at("prompt prepare", _MUTE) | at("enable", _NO_ENABLE) | at("disable", RIDES),
    ),
    "drive silent": Case(
        (fault("bus", "lost", frames={"device": "drive"}, count=0),),
        replace(STALE, within_s=WATCH_S, verified=False),
        at("prompt prepare enable disable", _LOST),
    ),
    "drive's status frame silent": Case(
        (fault("bus", "lost", frames={"device": "drive", "function": "heartbeat"}, count=0),),
        replace(STALE, within_s=SILENCE_S),
        at("prompt prepare", _MUTE) | at("hold disable", RIDES),
    ),
    "encoder's heartbeat lost": Case(
        (fault("bus", "lost", frames={"device": "encoder", "function": "heartbeat"}, count=0),),
        Must(4, "sent no heartbeat", SILENCE_S),
        at("prompt prepare", Must(4, "did not report the NMT state OPERATIONAL", 0.0))
        | at("hold disable", RIDES),
    ),
    "life counter stuck": Case(
        (fault("drive", "counter_stuck"),),
        replace(STALE, verified=False),
        at("prompt prepare disable", replace(_LOST, within_s=BRAKE_S))
        | at("enable", replace(_NO_ENABLE, verified=False)),
    ),
    "drive fault": Case(
        (fault("drive", "fault", value=0x31),),
        Must(4, "0031h", BRAKE_S),
        at("disable", Must(0, "read back: fault", BRAKE_S)),
    ),
    "drive restarts": Case(
        (fault("drive", "restart"),),
        NOT_RUNNING,
        at("prompt prepare disable", RIDES)
        | at("enable", Must(4, "no longer reports the limits", SILENCE_S)),
    ),
    **{name: case for name, case in CASES.items() if "stuck" in name},
    "order to run refused": Case(
        (fault("drive", "mode_refused"),), RIDES, at(NO_POWER, _NO_ENABLE)
    ),
    "limits refused": Case(
        (fault("drive", "limits_refused"),),
        RIDES,
        at("prompt prepare", Must(4, "does not accept these limits", 0.0)),
    ),
    **{
        name: case
        for name, case in CASES.items()
        if case.rows[0]["target"] in ("encoder", "host", "disk", "operator")
    },
    "encoder jump": _but("encoder jump", at("prompt prepare", _LATER)),
    "encoder frozen": _but("encoder frozen", at("prompt prepare", _LATER)),
    "encoder reversed": _but("encoder reversed", at("prompt prepare", _LATER)),
    "control loop hangs 0.5 s": _but("control loop hangs 0.5 s", at("enable", RIDES), _WATCHDOG),
    "clock steps 1 s back": _but("clock steps 1 s back", {}, _WATCHDOG),
    "300 kg instead of none": _but(
        "300 kg instead of none", at("prompt prepare", Must(1, "beyond its limit", 1.2))
    ),
}
"""Where a drive with frames of its own differs: no SDO, a watchdog on its commands, checksums and
life counters.
"""
