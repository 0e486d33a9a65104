"""Completes and checks the simulated machine (``mock``) of a bench file.

By default the simulated bench has the motor, gear, lever, encoders, supply and current limit of the
real bench. Friction and inertia are unknown before an identification; their defaults are the values
of the paper, scaled by the torque limit.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.amt21.encoder import COUNTS_PER_TURN
from drivers.errors import ConfigurationError
from drivers.mock.plant.effects.own import injected
from drivers.mock.plant.effects.pack import problems, too_light
from drivers.mock.plant.parts.constants import Joint, Loops, Machine, Motor, Sensing
from rig.common.yaml_tree import Mark, Node
from rig.config.configuration import nearest

PAPER_TORQUE_N_M: Final = 75.0
"""Torque limit, N m, of a bench whose default friction is the paper's, without scaling."""
_FALLBACK: Final[Mapping[str, Any]] = {"canopen": 4096, "cia406": 262144, "amt21": COUNTS_PER_TURN}
_ANY_SIGN: Final = frozenset({"temperature_C"})
_SMALLEST: Final = 1e-12
"""Smallest permitted constant of the simulated machine, SI units; the largest is its inverse."""
_LOOPS_HZ: Final = (100.0, 1e8)
"""Permitted rate of the simulated drive's loops, Hz; very fast loops represent continuous time."""
_MAY_BE_ZERO: Final = frozenset(
    {
        "inductance_H",
        "Mc_N_m",
        "Ms_N_m",
        "sigma_2_N_m_s_rad",
        "mu_c",
        "mu_s",
        "mu_2_s_rad",
        "velocity_integral_1_s",
        "velocity_feedforward",
        "current_integral_1_s",
        "motor_counts_per_turn",
        "joint_counts_per_turn",
        "current_noise_A",
        "rotor_inertia_kg_m2",
        "warming_K",
        "noise_Pa",
        "back_pressure_Pa",
    }
)
Section = dict[str, float]


def follow_bench(root: Node) -> Node:
    """Complete the ``mock`` section of a bench file; existing keys keep their values.

    A simulated bench without the section gets a complete section. A value that cannot be computed,
    because the file is incomplete or wrong, is left out; the checks of the file report the cause.
    """
    top = root.value
    if not isinstance(top, dict):
        return root
    plain = root.plain()
    given = top.get("mock")
    if given is None or given.value is None:
        if not _simulated(plain):
            return root
        given = Node({}, root.mark, {})
    if not isinstance(given.value, dict):
        return root
    mock = given.over(_nodes(derived(plain), root.keys.get("mock", given.mark)))
    return Node({**top, "mock": mock}, root.mark, {"mock": mock.mark, **root.keys})


def derived(bench: Mapping[str, Any]) -> dict[str, Section | float]:
    """Return the values of ``mock`` that follow from the other sections of a bench file."""
    motor = _of_machine(
        bench,
        "resistance_ohm",
        "inductance_H",
        "torque_constant_N_m_A",
        "back_emf_constant_V_s_rad",
        "gear_ratio",
    )
    torque = (_number(bench, "limits", "torque_N_m") or PAPER_TORQUE_N_M) / PAPER_TORQUE_N_M
    scaled = ("inertia_kg_m2", "Mc_N_m", "Ms_N_m", "sigma_2_N_m_s_rad")
    joint = {name: getattr(Joint, name) * torque for name in scaled}
    joint |= _of_machine(bench, "moment_arm_m", "lever_ratio", "gravity_m_s2")
    inertia = _number(bench, "mock", "joint", "inertia_kg_m2") or joint["inertia_kg_m2"]
    gear = _number(bench, "mock", "motor", "gear_ratio") or motor.get(
        "gear_ratio", Motor.gear_ratio
    )
    share = inertia / Joint.inertia_kg_m2
    motor["rotor_inertia_kg_m2"] = (
        Motor.rotor_inertia_kg_m2 * share * (Motor.gear_ratio / gear) ** 2
    )
    low, high = (_number(bench, "limits", f"supply_{end}_V") for end in ("min", "max"))
    supply = None if low is None or high is None else 0.5 * (low + high)
    limit_A, rate_Hz = _number(bench, "limits", "current_A"), _number(bench, "cycle_Hz")
    machine: dict[str, Section | float] = {
        "motor": motor,
        "joint": joint,
        "loops": _loops(bench, motor, share, supply),
        "sensing": _known(
            motor_counts_per_turn=_counts(bench, "servo", "counts_per_motor_turn", "canopen"),
            joint_counts_per_turn=_counts(bench, "encoder", "counts_per_turn", "cia406"),
            current_noise_A=limit_A and Sensing.current_noise_A * (limit_A / Loops.current_limit_A),
            cycle_s=rate_Hz and 1.0 / rate_Hz,
        ),
    }
    return machine if supply is None else {**machine, "supply_V": supply}


def _of_machine(bench: Mapping[str, Any], *names: str) -> Section:
    return _known(**{name: _number(bench, "machine", name) for name in names})


def _loops(
    bench: Mapping[str, Any], motor: Section, inertia_share: float, supply_V: float | None
) -> Section:
    """Return the gains with which any motor has the bandwidths of the practical bench."""

    def of_motor(name: str) -> float:
        return float(_number(bench, "mock", "motor", name) or motor.get(name, getattr(Motor, name)))

    resistance, inductance = of_motor("resistance_ohm"), of_motor("inductance_H")
    per_second = (resistance / inductance) / (Motor.resistance_ohm / Motor.inductance_H)
    gain = Loops.velocity_gain_N_m_s_rad
    assert gain is not None
    return _known(
        velocity_gain_N_m_s_rad=gain * inertia_share,
        current_gain_V_A=Loops.current_gain_V_A * (inductance / Motor.inductance_H),
        current_integral_1_s=Loops.current_integral_1_s * per_second,
        voltage_limit_V=_number(bench, "mock", "supply_V") or supply_V,
        current_limit_A=_number(bench, "limits", "current_A"),
    )


def _counts(bench: Mapping[str, Any], section: str, key: str, kind: str) -> float | None:
    """Return an encoder's counts per turn, from the file or from the kind of the encoder."""
    found = bench.get(section)
    stated = found.get("kind", kind) if isinstance(found, dict) else kind
    fixed = _FALLBACK.get(stated) if isinstance(stated, str) else None
    return _number(bench, section, key) or fixed


def _simulated(bench: Mapping[str, Any]) -> bool:
    bus = bench.get("bus", {})
    if bus is None:
        return True
    if not isinstance(bus, dict):
        return False
    name = bus.get("interface", "mock")
    return bool(name == "mock" or (name == "epos_serial" and bus.get("port") == "mock"))


def _number(tree: Mapping[str, Any], *path: str) -> Any:
    """Return the number at a path of keys, or None if the value is missing or not positive."""
    value: Any = tree
    for key in path:
        value = value.get(key) if isinstance(value, Mapping) else None
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    # Integers in a file may exceed the range of a float.
    return value if 0 < value < math.inf and value <= sys.float_info.max else None


def _known(**values: float | None) -> Section:
    return {name: value for name, value in values.items() if value is not None}


def _nodes(value: Any, mark: Mark) -> Node:
    """Return values that are not in the file as a tree, at one place and without places of keys."""
    if isinstance(value, dict):
        value = {name: _nodes(each, mark) for name, each in value.items()}
    return Node(value, mark, {})


def may_be(name: str) -> str:
    """Return the permitted range of a number: "> 0", "≥ 0", or an empty text for any number."""
    if name in _ANY_SIGN:
        return ""
    return "≥ 0" if name in _MAY_BE_ZERO else "> 0"


def require_buildable(machine: Machine) -> None:
    """Check the numbers of a simulated machine; ValueError for sign, size or an unsteady burn."""
    for path, value in _leaves(machine):
        name = path.rsplit(".", 1)[-1]
        if name in _ANY_SIGN:
            continue
        if not math.isfinite(value) or value < 0 or (value == 0 and name not in _MAY_BE_ZERO):
            bound = "zero or more" if name in _MAY_BE_ZERO else "more than zero"
            raise ValueError(f"{path} is {value:g}; it must be finite and {bound}")
        if value and not _SMALLEST <= value <= 1.0 / _SMALLEST:
            raise ValueError(
                f"{path} is {value:g}, outside the plausible range {_SMALLEST:g} to "
                f"{1.0 / _SMALLEST:g}; check its exponent and unit"
            )
    if not _LOOPS_HZ[0] <= machine.loops.rate_Hz <= _LOOPS_HZ[1]:
        raise ValueError(
            f"loops.rate_Hz is {machine.loops.rate_Hz:g}; it must be {_LOOPS_HZ[0]:g} to "
            f"{_LOOPS_HZ[1]:g} Hz"
        )
    generator = machine.gas
    if not generator.pressure_exponent < 1.0:
        raise ValueError(
            f"gas.pressure_exponent is {generator.pressure_exponent:g}; it must be below 1, "
            "because with an exponent of 1 or more no chamber pressure is stable"
        )
    if not generator.valve.hole_diameter_m < min(
        generator.valve.plate_width_m, generator.valve.opening_diameter_m
    ):
        raise ValueError(
            "gas.valve.hole_diameter_m must be below plate_width_m and opening_diameter_m"
        )


def _leaves(record: object, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Yield every number of nested dataclasses with its dotted path."""
    if not dataclasses.is_dataclass(record):
        return
    for item in dataclasses.fields(record):
        value = getattr(record, item.name)
        path = f"{prefix}{item.name}"
        if isinstance(value, int | float):
            try:
                yield path, float(value)
            except OverflowError:
                yield path, math.inf
        else:
            yield from _leaves(value, f"{path}.")


def hidden_problems(machine: Machine | None) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the problems of the effects that are injected into a simulated machine; the file with
    effects of the user is read, but not run.
    """
    if machine is None or not (machine.effects or machine.effects_file):
        return
    found, own = False, list[str]()
    if machine.effects_file:
        try:
            own = injected(Path(machine.effects_file))
        except ConfigurationError as error:
            yield ("effects_file",), str(error)
            return
    for path, text in problems(machine.effects, own=own):
        found = True
        yield ("effects", *path), text
    if not found and (light := too_light(machine)):
        yield ("motor", "rotor_inertia_kg_m2"), light


_OF_THE_OWN: Final = ("motor", "joint", "gas", "effects", "steps_per_loop")


def plant_problems(
    plant: Mapping[str, str], states: Callable[..., bool]
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield what is wrong with the section `mock.plant` of a bench file, of which ``states``
    returns whether it has a key, given as the names that lead to it.
    """
    if not plant:
        return
    known = ["fmu"] if "fmu" in plant else ["python", "class"]
    for name in plant:
        if name not in known:
            also = "; give either `python` and `class`, or `fmu`"
            yield ("plant", name), f"unknown key; {nearest(name, known)}{also}"
    for name in known:
        if not plant.get(name):
            yield (("plant", name), "missing; write {python: FILE, class: NAME} or {fmu: FILE}")
    for name in _OF_THE_OWN:
        if states("mock", name):
            yield (
                (name,),
                "describes the program's own machine, but `plant` puts another in its place; "
                "remove this key: what is believed of the other machine stands in `machine`",
            )


_BISECTIONS = 60
_ADVISED_SHARE = 0.5
"""Recommended gain as a share of the gain at the stability limit: a gain margin of 6 dB."""


def unstable_current_loop(machine: Machine) -> str | None:
    """Return a message with a stable gain if the current loop of a simulated drive is unstable.

    The loop is a PI controller with a zero-order hold on resistance and inductance of the motor
    (eq. 1). The loop is linear, so that its eigenvalues determine its stability; the supply voltage
    only limits the oscillation.
    """
    gain = machine.loops.current_gain_V_A
    radius = _radius(machine, gain)
    if radius < 1.0:
        return None
    motor, loops = machine.motor, machine.loops
    advised = _ADVISED_SHARE * _greatest_stable_gain(machine)
    return (
        f"with {motor.inductance_H:g} H and {motor.resistance_ohm:g} ohm at {loops.rate_Hz:g} Hz "
        "the current loop of the simulated drive is unstable (its error grows by a factor of "
        f"{radius:.3g} each period), and may stop a run by its limits of current or torque; lower "
        f"the gain to {advised:.2g} or less, or raise rate_Hz"
    )


def _radius(machine: Machine, gain: float) -> float:
    """Return the growth factor of the loop's error per period."""
    motor, loops = machine.motor, machine.loops
    period = 1.0 / loops.rate_Hz
    integral = gain * loops.current_integral_1_s * period
    constant_s = motor.inductance_H / motor.resistance_ohm
    kept = math.exp(-period / constant_s) if constant_s > 0.0 else 0.0
    rise = (1.0 - kept) / motor.resistance_ohm
    # State: current, and voltage of the integrator including the error of the present period.
    loop = np.array([[kept - rise * (gain + integral), rise], [-integral, 1.0]])
    return float(np.max(np.abs(np.linalg.eigvals(loop))))


def _greatest_stable_gain(machine: Machine) -> float:
    """Return the gain at the stability limit, V/A; all lower gains are stable."""
    low, high = 0.0, machine.loops.current_gain_V_A
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _radius(machine, middle) < 1.0 else (low, middle)
    return low
