"""Faults of drives of common makes over CANopen, where they differ from the simulated drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from drivers.mock.makes import MAKES

from .fault_cases import CASES, NO_POWER, RIDES, Case, Must, at, fault

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


MODES: Mapping[str, str] = {
    "csv": "mode: csv, ",
    "cst": "mode: cst, position_loop: {inertia_kg_m2: 0.204, drive_limits_speed: true}, ",
    "pp": "mode: pp, ",
}
"""Mode to its keys of the bench file; the simulated drive offers all."""


def cases(make: str) -> Mapping[str, Case]:
    """Return the faults of a drive of this make, or in this mode, and what must follow."""
    if make in MODES:
        return CASES
    if 0x6007 not in MAKES[make].lacks:
        return CASES
    found = dict(CASES) | _ALONE
    for name in _LEFT_ON:
        case = found[name]
        by_phase = {
            phase: case.must(phase)
            if phase in NO_POWER.split()
            else replace(case.must(phase), within_s=None, stays_on=True)
            for phase in (*NO_POWER.split(), "disable")
        }
        found[name] = Case(case.rows, replace(case.rest, within_s=None, stays_on=True), by_phase)
    hangs = found["control loop hangs 0.5 s"]
    found["control loop hangs 0.5 s"] = replace(hangs, rest=replace(hangs.rest, within_s=0.7))
    return found
