"""Writes the corrected model for other tools: as YAML, and as a file of plain Python that needs
only numpy.
"""

from __future__ import annotations

import dis
import inspect
import pprint
import re
import textwrap
from collections.abc import Iterator
from types import CodeType, FunctionType
from typing import Any

import numpy as np
import yaml

from identification.effects.model import COORDINATES, CorrectedModel, Response
from identification.export.model import Signals
from identification.numerics.series import sine_cosine
from identification.recording import Recording
from identification.views.nominal import NominalTorque, winding_voltage
from rig.common.provenance import plain

YAML_FILE, PYTHON_FILE = "model.yaml", "model.py"
_CACHED = re.compile(r"^ *@(compiled|recent)\n", re.MULTILINE)
"""Decorators of functions that the file has without compiler and cache."""
_PLAIN = {
    sine_cosine: '''\
def sine_cosine(frequency: float, angle: Array) -> Array:
    """Return sin and cos of ``frequency * angle``, shape (2, m)."""
    return np.stack((np.sin(frequency * angle), np.cos(frequency * angle)))
'''
}
"""Functions whose source in this program needs its compiler, to their source in the file."""
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

from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray
M = {numbers}
"""Nominal parameters and constants of the bench, SI, at the joint but for R, L and Ke; the load
that turns with the joint, the zero of the current, the gear's efficiency, the presliding stiffness
and the torque ripple are those of the effects.
"""
EFFECTS = {values}
"""Parameters of the effects, SI."""
CURVE: Any = {curve}
"""Unmodelled torque without an effect: equation, signal, grid, values, and whether the values act
against the motion; None where there is none.
"""
'''
_TAIL = '''\
class Nominal(NominalTorque):
    """The nominal model at the values of ``M``."""

    def __init__(self, m: Any) -> None:
        self.values, self.alpha = m, m["alpha"]
        self.undeclared = tuple(m["load_" + n] for n in ("sine", "cosine", "slope", "constant"))
        self.zero_A, self.efficiency = m["zero_A"], m["efficiency"]
        self.presliding_stiffness = m["presliding_stiffness"]
        self.ripple = (m["ripple"][:-2], m["ripple"][-2:]) if m["ripple"] else ()


NOMINAL = Nominal(M)
signals = Signals


def torque(s: Any) -> Array:
    """Return the torque that the motion requires of the drive, N m at the joint, shape (n,)."""
    return NOMINAL.torque(s) + _sum(TORQUE, s) + _curve("torque", s)


def drive(s: Any) -> Array:
    """Return the torque of the logged current, N m at the joint, shape (n,)."""
    return s["transmitted"] - _sum(DRIVE, s)


def twist(s: Any) -> Array:
    """Return motor_angle / i - angle but for a constant, rad, shape (n,)."""
    return _sum(TRANSMISSION, s) + _curve("transmission", s)


def voltage(s: Any) -> Array:
    """Return the voltage that the logged current requires, V, shape (n,)."""
    return winding_voltage(s) + _sum(VOLTAGE, s) + _curve("voltage", s)


def _sum(effects: Any, s: Any) -> Array:
    total = np.zeros(len(s["time"]))
    for regressors, shape, coefficients in effects:
        total = total + np.array(coefficients) @ regressors(s, NOMINAL, shape)
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
        record["curve"] = plain(model.curve)
    return "# Corrected model, SI units, at the joint after the gear.\n" + yaml.safe_dump(
        record, sort_keys=False
    )


def python_text(model: CorrectedModel, recording: Recording, name: str) -> str:
    """Return the model as a Python file that contains the source of the functions with which this
    program computes it.

    Args:
        model: The corrected model.
        recording: Any recording of the bench, for its constants.
        name: Name of the source, for the docstring.
    """
    torque = list(model.responses("torque"))
    tables = {
        "TORQUE": [r for r in torque if not r.effect.on_drive],
        "DRIVE": [r for r in torque if r.effect.on_drive],
        "TRANSMISSION": list(model.responses("transmission")),
        "VOLTAGE": list(model.responses("voltage")),
    }
    source = _Source()
    for definition in (Signals, NominalTorque, winding_voltage):
        source.add(definition)
    lists = []
    for table, responses in tables.items():
        rows = [f"    ({source.response(r, table)}, {_plain(r)}),\n" for r in responses]
        lists.append(f"{table}: Any = [\n{''.join(rows)}]" if rows else f"{table}: Any = []")
    curve: Any = None
    if (c := model.curve) is not None:
        grid, value = c.grid.tolist(), c.value.tolist()
        curve = c.equation, COORDINATES[c.coordinate], grid, value, c.against_motion
    head = _HEAD.format(
        name=name,
        effects=", ".join(model.effects) or "none",
        numbers=pprint.pformat(model.numbers(recording), sort_dicts=False),
        values=pprint.pformat({n: dict(v) for n, v in model.effects.items()}, sort_dicts=False),
        curve=repr(curve),
    )
    return "\n\n".join([head, *source.texts.values(), "\n".join(lists) + "\n", _TAIL])


def _plain(response: Response) -> str:
    """Return nonlinear parameters and coefficients as literals."""
    shape, coefficients = map(np.array, (response.shape, response.coefficients))
    return f"{tuple(shape.tolist())!r}, {tuple(coefficients.tolist())!r}"


class _Source:
    """Source of definitions with all of this program that they use, in the order of use."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self._known: dict[str, Any] = {}

    def response(self, response: Response, table: str) -> str:
        """Add the regressors of an effect; return the name of their function in the file."""
        function = response.columns
        if "." not in function.__qualname__:
            self.add(function)
            return function.__name__
        name = f"{response.effect.name}_{table.lower()}"
        self._use(function)
        text = textwrap.dedent(inspect.getsource(function)).removeprefix("@staticmethod\n")
        self.texts[name] = text.replace(f"def {function.__name__}(", f"def {name}(", 1)
        return name

    def add(self, definition: Any) -> None:
        """Add a function, a class or a constant, after everything that it uses.

        Raises:
            ValueError: Another definition has the same name.
        """
        name = definition.__name__
        if name in self._known:
            if self._known[name] is not definition:
                raise ValueError(f"two definitions of the corrected model have the name {name}")
            return
        self._known[name] = definition
        if definition in _PLAIN:
            self.texts[name] = _PLAIN[definition]
            return
        self._use(definition)
        plain = getattr(definition, "py_func", definition)
        self.texts[name] = _CACHED.sub("", inspect.getsource(plain))

    def _use(self, definition: Any) -> None:
        for function in _functions(definition):
            for name in sorted(_names(function.__code__)):
                used = function.__globals__.get(name)
                if getattr(used, "__module__", "").startswith("identification."):
                    self.add(used)
                elif isinstance(used, float | int | str | tuple):
                    self.texts[name] = f"{name} = {used!r}\n"


def _functions(definition: Any) -> Iterator[FunctionType]:
    """Yield the functions of a definition: its own, or those of a class."""
    if not inspect.isclass(definition):
        yield inspect.unwrap(getattr(definition, "py_func", definition))
        return
    for member in vars(definition).values():
        function = getattr(member, "fget", member)
        if hasattr(function, "cache_info"):
            function = inspect.unwrap(function)
        if inspect.isfunction(function):
            yield function


def _names(code: CodeType) -> set[str]:
    """Return the global names that code uses, with those of the functions inside it."""
    own = {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}
    inner = (c for c in code.co_consts if isinstance(c, CodeType))
    return own.union(*(_names(c) for c in inner))
