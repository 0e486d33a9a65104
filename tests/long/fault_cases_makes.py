"""Faults of drives of common makes over CANopen, where they differ from the simulated drive."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from drivers.mock.traits import MAKES

from .fault_cases import (
    BRAKE_S,
    CASES,
    NO_POWER,
    PHASES,
    RIDES,
    SILENCE_S,
    WATCH_S,
    Case,
    Must,
    at,
    fault,
)

MODES: Mapping[str, str] = {
    "csv": "mode: csv, ",
    "cst": "mode: cst, position_loop: {inertia_kg_m2: 0.204, drive_limits_speed: true}, ",
    "pp": "mode: pp, ",
}
"""Mode to its keys of the bench file; the simulated drive offers all."""
_DEAF_S = 1.6
"""A drive that hears nothing of the host, and has no watchdog, is on until an order passes."""
_SDO_S = 0.2
"""Time that the host waits for the answer of the drive before it takes the power off."""
_ALONE: Mapping[str, Case] = {
    "60 kg instead of none": Case(
        (fault("operator", "wrong_weight", value=60.0),),
        Must(1, "beyond its limit", 0.7),
        at("approach excite ramp_out hold disable", RIDES),
    ),
    "controller killed": Case(
        (fault("host", "killed"),),
        Must(-9, verified=False, stays_on=True),
        at(NO_POWER, Must(-9, "", 0.0, verified=False)),
    ),
}
"""Where a drive has no reaction to a lost master (6007h): it goes on, and its limits are cut."""
_LEFT_ON = ("cable pulled", "bus-off")
"""Faults after which nothing reaches such a drive."""


def _changed(case: Case, change: Callable[[str, Must], Must]) -> Case:
    """Change what must follow in each phase."""
    return replace(case, by_phase={phase: change(phase, case.must(phase)) for phase in PHASES})


def _unwatched(name: str, phase: str, must: Must) -> Must:
    """What must follow where the drive has no watchdog."""
    powered = phase not in NO_POWER.split()
    if name in _LEFT_ON and powered:
        return replace(must, within_s=None, stays_on=True)
    if name == "one frame lost" and phase == "disable":
        return replace(must, within_s=SILENCE_S)
    if name.startswith("the drive's frames lost") and powered:
        return replace(must, within_s=_DEAF_S)
    if name == "control loop hangs 0.5 s" and must.within_s is not None:
        return replace(must, within_s=0.7)
    if name == "clock steps 1 s back" and must.within_s is not None:
        return replace(must, within_s=1.0 + BRAKE_S)  # the control loop pauses for that time
    if name == "SDO time-out" and must.within_s:
        return replace(must, within_s=must.within_s + _SDO_S)  # on while the host waits for it
    if name == "host's heartbeat lost" and phase == "hold":
        return Must(4, "8130h", WATCH_S)  # the drive tells it, and does nothing
    return must


def cases(make: str) -> Mapping[str, Case]:
    """Return the faults of a drive of this make, or in this mode, and what must follow."""
    found = dict(CASES)
    lacks = MAKES[make].lacks if make in MAKES else frozenset()
    if 0x603F in lacks:
        told = found["drive fault"]
        nameless = Must(4, "fault code .603Fh. cannot be read", 0.0)
        found["drive fault"] = replace(
            told, by_phase={**told.by_phase, **at("prompt prepare", nameless)}
        )
    if 0x607F in lacks:
        # Nothing limits the step of a target that is wrong for one cycle.
        found["target with a bit wrong"] = replace(
            found["target with a bit wrong"],
            by_phase=at("approach excite ramp_out hold", Must(4, "8611h", BRAKE_S)),
        )
    elif {0x6007, 0x6072, 0x6073} <= lacks:
        # The limit is cut, and the drive does not hold it.
        found["target with a bit wrong"] = replace(
            found["target with a bit wrong"],
            by_phase=at("approach excite ramp_out hold", Must(1, "motor current", BRAKE_S)),
        )
    if make == "EPOS2":
        # The first frame of that phase is no answer there, but process data.
        lost = found["one frame lost"]
        found["one frame lost"] = replace(lost, by_phase={**lost.by_phase, "disable": RIDES})
    if 0x6007 in lacks:
        found |= _ALONE
        found = {name: _changed(case, partial(_unwatched, name)) for name, case in found.items()}
    return found
