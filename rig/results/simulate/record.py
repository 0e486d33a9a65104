"""A simulation as the JSON of the contract."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from identification.simulate.score import Sums
from rig.results.simulate.predict import Prediction
from rig.results.simulate.simulate import Case, Simulation

SIMULATE_SCHEMA = "loadrig.simulate/1"


def simulation_record(found: Simulation) -> dict[str, Any]:
    """Return the record of ``rig simulate --json``."""
    return {
        **found.provenance.record(SIMULATE_SCHEMA),
        "unit": found.unit,
        "angle_unit": "rad" if found.rotary else "m",
        "bandwidth_Hz": found.bandwidth_Hz,
        "equations": error_record(found.predictions, found.unit),
        "cases": [_case_record(found, case) for case in found.cases],
    }


def error_record(found: Sequence[Prediction], unit: str) -> list[dict[str, object]]:
    """Return the same for the result file, SI units."""
    return [
        {
            "result": str(one.file),
            "effects": list(one.effects),
            "equation": equation,
            "unit": {"transmission": "rad", "voltage": "V"}.get(equation, unit),
            "rms": one.error(equation, "fit"),
            "validate_rms": one.error(equation, "validate"),
        }
        for one in found
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
