"""Text of `gas_generator.yaml`: corrected constants and effects of a gas generator diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import yaml

from identification.diagnosis.gas.rows import PRESSURE
from identification.diagnosis.result import Diagnosis
from identification.recording import Bench

GAS_FILE = "gas_generator.yaml"
_KEYS = {
    "a": "burning_coefficient",
    "n": "pressure_exponent",
    "C_r": "characteristic_velocity",
    "V_0": "free_volume",
}
"""Keys in a campaign file by the names of the fitted constants."""
_VALVE_KEYS = {"d": "hole_diameter", "D": "opening_diameter", "b": "plate_width"}


def of_gas(found: Diagnosis) -> bool:
    """Return whether a diagnosis is a diagnosis of the gas generator."""
    return found.fit.equation == PRESSURE


def gas_text(found: Diagnosis, bench: Bench) -> str:
    """Return the corrected gas generator as YAML (a block of a campaign file), and notes on what
    the YAML cannot state.

    Args:
        found: The diagnosis.
        bench: The bench with the nominal constants.
    """
    g = bench.gas_generator
    assert g is not None
    block = {
        "propellant_density": g.rho_b,
        "grain_diameter": g.D_P,
        **{key: float(found.parameters[name]) for name, key in _KEYS.items()},
        "heat_ratio": g.gamma,
        "back_pressure": g.p_c0,
        "valve": {key: float(found.parameters[name]) for name, key in _VALVE_KEYS.items()},
    }
    effects: Mapping[str, Any] = {
        e.name: {n: float(v.value) for n, v in e.parameters.items()} for e in found.effects
    }
    return (
        "# Corrected constants, for `bench:` of a campaign; free_volume is the mean over the "
        "recordings.\n"
        + yaml.safe_dump({"gas_generator": block}, sort_keys=False)
        + "# Effects that eq. 2 to 8 do not contain; `rig effects NAME` prints the equations "
        "of each.\n" + yaml.safe_dump({"effects": effects}, sort_keys=False)
    )
