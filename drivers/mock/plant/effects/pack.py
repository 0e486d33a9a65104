"""Checks the requested injected effects and packs them into a vector for compiled code."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plant.effects import table
from drivers.mock.plant.effects.gas import GAS_CATALOGUE, GAS_OUTSIDE
from drivers.mock.plant.effects.kernel import CONSTANTS_AT, DAMPING_RATIO, stiffness_of
from drivers.mock.plant.effects.outside import OUTSIDE
from drivers.mock.plant.effects.table import CATALOGUE, Parameter
from drivers.mock.plant.parts import constants

Effects = Mapping[str, Mapping[str, float]]
KNOWN: Mapping[str, Mapping[str, Parameter]] = {**CATALOGUE, **OUTSIDE}
GAS_KNOWN: Mapping[str, Mapping[str, Parameter]] = {**GAS_CATALOGUE, **GAS_OUTSIDE}
"""Effects of the gas generator; their parameters are in the vector of the gas generator."""
_EVERY = {**KNOWN, **GAS_KNOWN}
_TWO_MASS = frozenset({"backlash", "compliance", "coupling_hysteresis"})


def problems(
    effects: Effects, any_size: bool = False, own: Collection[str] = ()
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the problems of the requested effects, each as a path of names and a message; none of
    the effects ``own``, which a file of the user injects.
    """
    for name, given in effects.items():
        if name in own:
            continue
        parameters = _EVERY.get(name)
        if parameters is None:
            known = ", ".join((*_EVERY, *own))
            yield (name,), f"there is no such effect; known effects are {known}"
            continue
        needed = [key for key, parameter in parameters.items() if parameter.default is None]
        for missing in needed:
            if missing not in given:
                yield (name,), f"parameter {missing} is missing; {name} needs {', '.join(needed)}"
        for key, value in given.items():
            if key not in parameters:
                yield (name, key), f"{name} has no such parameter; it has {', '.join(parameters)}"
            elif not (any_size or parameters[key].low <= value <= parameters[key].high):
                yield (
                    (name, key),
                    f"must be within {parameters[key].low:g} to {parameters[key].high:g}",
                )


def effect_vector(
    machine: constants.Machine, any_size: bool = False, own: Collection[str] = ()
) -> NDArray[np.float64]:
    """Pack the effects of a machine, except those of its gas generator.

    Args:
        machine: The machine.
        any_size: Whether values may be outside their ranges, which are stated for a machine of the
            size of the paper's valve.
        own: Names of effects that a file of the user injects.

    Raises:
        ValueError: An effect or a parameter is unknown, a value is out of range, or the rotor's
            inertia is not less than the total inertia.
    """
    wrong = [f"{'.'.join(path)}: {text}" for path, text in problems(machine.effects, any_size, own)]
    if wrong or (text := too_light(machine)):
        raise ValueError("; ".join(wrong) or text)
    effects = {name: given for name, given in machine.effects.items() if name in KNOWN}
    e = np.zeros(CONSTANTS_AT + table.CONSTANTS_SIZE)
    e[CONSTANTS_AT + table.ROTOR_INERTIA] = _rotor(machine)
    e[CONSTANTS_AT + table.GEAR] = machine.motor.gear_ratio
    e[CONSTANTS_AT + table.NOMINAL_SUPPLY] = machine.supply_V
    for name, given in effects.items():
        for key, parameter in KNOWN[name].items():
            value = given.get(key, parameter.default)
            assert value is not None
            e[parameter.slot] = value
    if _TWO_MASS & effects.keys():
        rotor = _rotor(machine)
        total = machine.joint.inertia_kg_m2
        e[CONSTANTS_AT + table.TWO_MASSES] = 1.0
        reduced = rotor * (total - rotor) / total
        e[CONSTANTS_AT + table.SHAFT_DAMPING] = (
            2.0 * DAMPING_RATIO * math.sqrt(stiffness_of(e) * reduced)
        )
    e[CONSTANTS_AT + table.OUTSIDE_TORQUE] = 1.0 if OUTSIDE.keys() & effects.keys() else 0.0
    return e


def too_light(machine: constants.Machine) -> str | None:
    """Return a text if an elastic transmission has no inertia on one of its sides."""
    rotor, total = _rotor(machine), machine.joint.inertia_kg_m2
    if not _TWO_MASS & machine.effects.keys() or 0.0 < rotor < total:
        return None
    return (
        f"the inertia of the rotor is {rotor:g} kg m^2 at the joint, of {total:g} kg m^2 in total, "
        "but an elastic transmission needs inertia on both sides; set the rotor's inertia between "
        f"0 and {total / machine.motor.gear_ratio**2:g} kg m^2 at the motor"
    )


def _rotor(machine: constants.Machine) -> float:
    """Return the rotor's inertia at the joint, kg m^2."""
    return machine.motor.rotor_inertia_kg_m2 * machine.motor.gear_ratio**2
