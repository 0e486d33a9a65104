"""Converts a simulation to the JSON record of ``rig simulate --json``."""

from __future__ import annotations

from typing import Any

from identification.simulate.closed_loop import Sums
from rig.results.simulate.simulate import Case, Simulation

SIMULATE_SCHEMA = "loadrig.simulate/1"


def simulation_record(found: Simulation) -> dict[str, Any]:
    """Return the record of ``rig simulate --json``."""
    return {
        **found.provenance.record(SIMULATE_SCHEMA),
        "unit": found.unit,
        "angle_unit": "rad" if found.rotary else "m",
        "bandwidth_Hz": found.bandwidth_Hz,
        "equations": _errors(found),
        "cases": [_case_record(found, case) for case in found.cases],
    }


def _errors(found: Simulation) -> list[dict[str, object]]:
    """Return the prediction errors of each result, one entry per equation, SI units."""
    units = {"transmission": "rad" if found.rotary else "m", "voltage": "V"}
    return [
        {
            "result": str(one.file),
            "effects": list(one.effects),
            "equation": equation,
            "unit": units.get(equation, found.unit),
            "rms": one.error(equation, "fit"),
            "validate_rms": one.error(equation, "validate"),
        }
        for one in found.predictions
        for equation in dict.fromkeys(p.equation for p in one.parts)
    ]


def _case_record(found: Simulation, case: Case) -> dict[str, Any]:
    roles = {role: names for role in ("fit", "validate") if (names := found.names(role))}
    return {
        "result": str(case.model.file),
        "friction_share": case.share,
        **{role: _sums_record(case.over(names)) for role, names in roles.items()},
        "recordings": {name: _sums_record(sums) for name, sums in case.sums.items()},
    }


def _sums_record(sums: Sums) -> dict[str, float]:
    return {
        "torque_rms": sums.torque_rms,
        "torque_relative": sums.torque_relative,
        "angle_rms": sums.angle_rms,
    }
