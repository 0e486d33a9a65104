"""Writes the corrected model for other tools: as YAML, and as a file of plain Python that needs
only numpy.
"""

from __future__ import annotations

import inspect
import pprint
from collections.abc import Callable, Mapping
from typing import Any

import yaml

from identification.corrected import arrays, motor, states, torque, transmission
from identification.corrected.model import COORDINATES, CorrectedModel
from identification.recording import Recording

YAML_FILE, PYTHON_FILE = "model.yaml", "model.py"
_TABLES: Mapping[str, Mapping[str, Callable[..., Any]]] = {
    "TORQUE": torque.TORQUE,
    "DRIVE": motor.DRIVE,
    "TRANSMISSION": transmission.TRANSMISSION,
    "VOLTAGE": motor.VOLTAGE,
}
_HEAD = '''\
"""Corrected model of {name}: torque that the motion requires of the drive, and
readings of its sensors.

Needs only numpy.

    s = signals(M, time, angle, velocity, acceleration, contact_force=3000.0, current=current)
    torque(s)        torque that the motion requires, N m at the joint
    drive(s)         torque of the logged current, N m at the joint; torque(s) plus noise
    twist(s)         motor_angle / i - angle, rad
    voltage(s)       voltage that the logged current requires, V

Effects: {effects}.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray
M = {numbers}
"""Nominal parameters and constants of the bench, SI, at the joint but for R, L and Ke."""
CURVE: Any = {curve}
"""Unmodelled torque without an effect: equation, signal, grid, values, and whether the values act
against the motion; None where there is none.
"""
'''
_TAIL = '''\
def torque(s: Any) -> Array:
    """Return the torque that the motion requires of the drive, N m at the joint, shape (n,)."""
    return _sum(nominal_torque(s, M), TORQUE, s) + _curve("torque", s)


def drive(s: Any) -> Array:
    """Return the torque of the logged current, N m at the joint, shape (n,)."""
    return _sum(s["drive"], DRIVE, s)


def twist(s: Any) -> Array:
    """Return motor_angle / i - angle but for a constant, rad, shape (n,)."""
    return _sum(np.zeros(len(s["time"])), TRANSMISSION, s) + _curve("transmission", s)


def voltage(s: Any) -> Array:
    """Return the voltage that the logged current requires, V, shape (n,)."""
    return _sum(nominal_voltage(s, M), VOLTAGE, s) + _curve("voltage", s)


def _sum(total: Array, effects: Any, s: Any) -> Array:
    for function, given in effects:
        total = total + function(s, M, **given)
    return total


def _curve(equation: str, s: Any) -> Array:
    if CURVE is None or CURVE[0] != equation:
        return np.zeros(len(s["time"]))
    value = np.interp(s[CURVE[1]], CURVE[2], CURVE[3])
    return s["sense"] * value if CURVE[4] else value
'''


def yaml_text(model: CorrectedModel, recording: Recording) -> str:
    """Return the model as YAML: parameters, constants of the bench, effects and curve, in SI
    units.
    """
    record: dict[str, Any] = {
        "model": 1,
        "parameters": {name: float(value) for name, value in model.parameters.items()},
        "alpha": float(model.alpha),
        "constants": {
            k: v
            for k, v in model.numbers(recording).items()
            if k not in model.parameters and k != "alpha"
        },
        "effects": {
            name: {k: float(v) for k, v in given.items()} for name, given in model.effects.items()
        },
    }
    if model.curve is not None:
        curve = model.curve
        record["curve"] = {
            "equation": curve.equation,
            "coordinate": curve.coordinate,
            "unit": curve.unit,
            "residual_unit": curve.residual_unit,
            "against_motion": curve.against_motion,
            "grid": curve.grid.tolist(),
            "value": curve.value.tolist(),
        }
    return "# Corrected model, SI units, at the joint after the gear.\n" + yaml.safe_dump(
        record, sort_keys=False
    )


def python_text(model: CorrectedModel, recording: Recording, name: str) -> str:
    """Return the model as a Python file that contains the source of the model functions of this
    program.

    Args:
        model: The corrected model.
        recording: Any recording of the bench, for its constants.
        name: Name of the source, for the docstring.
    """
    used: list[Callable[..., Any]] = [torque.nominal_torque, motor.nominal_voltage, arrays.signals]
    lists = []
    for table, functions in _TABLES.items():
        rows = [
            (functions[effect], dict(given))
            for effect, given in model.effects.items()
            if effect in functions
        ]
        used += [function for function, _ in rows]
        body = "".join(f"    ({function.__name__}, {given!r}),\n" for function, given in rows)
        lists.append(f"{table}: Any = [\n{body}]" if rows else f"{table}: Any = []")
    head = _HEAD.format(
        name=name,
        effects=", ".join(model.effects) or "none",
        numbers=pprint.pformat(model.numbers(recording), sort_dicts=False),
        curve=_curve_literal(model),
    )
    sources = [inspect.getsource(function) for function in _with_helpers(used)]
    return "\n\n".join([head, *sources, "\n".join(lists) + "\n", _TAIL])


def _with_helpers(used: list[Callable[..., Any]]) -> list[Callable[..., Any]]:
    """Return the functions and the functions that they call; called functions come first."""
    helpers = {
        name: function
        for module in (states, arrays, torque)
        for name, function in inspect.getmembers(module, inspect.isfunction)
        if function.__module__ == module.__name__
    }
    ordered: dict[str, Callable[..., Any]] = {}

    def add(function: Callable[..., Any]) -> None:
        body = inspect.getsource(function).partition("\n")[2]
        for name, helper in helpers.items():
            if f"{name}(" in body and name != function.__name__ and name not in ordered:
                add(helper)
        ordered.setdefault(function.__name__, function)

    for function in used:
        add(function)
    return list(ordered.values())


def _curve_literal(model: CorrectedModel) -> str:
    curve = model.curve
    if curve is None:
        return "None"
    along, grid, value = COORDINATES[curve.coordinate], curve.grid.tolist(), curve.value.tolist()
    return repr((curve.equation, along, grid, value, curve.against_motion))
