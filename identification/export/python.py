"""Writes the corrected model as a file of plain Python that needs only numpy."""

from __future__ import annotations

import dis
import inspect
import pprint
import re
import textwrap
from collections.abc import Iterator
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from identification.effects.model import COORDINATES, CorrectedModel, Response
from identification.effects.own import OwnEffect, Seen, sampled, samples_of
from identification.numerics.arrays import Array
from identification.numerics.series import delayed_series, sine_cosine
from identification.recording import Recording
from identification.views.nominal import NominalTorque, winding_voltage
from identification.views.view import DELAYED

_CACHED = re.compile(r"^ *@(compiled|recent)\n", re.MULTILINE)
"""Decorators of functions that the file has without compiler and cache."""
_DECORATORS = re.compile(r"\A(?:@(?:.|\n)*?\n)?(?=def )")
"""Decorators of a user's function."""
_TAKEN = frozenset(
    {"Array", "Any", "CURVE", "DRIVE", "EFFECTS", "M", "NOMINAL", "NamedTuple", "Nominal", "TORQUE"}
    | {"TRANSMISSION", "VOLTAGE", "drive", "signals", "torque", "twist", "voltage"}
)
"""Names that the file defines itself."""
_OWN = """\
def {name}(s: Any, nominal: Any, shape: Any) -> Array:
    found = []
    for one in {coefficients!r} or ("",):
        values = dict(zip({searched!r}, shape)) | {{n: float(n == one) for n in {coefficients!r}}}
        p = namedtuple("Parameters", {names!r})(**values)
        found.append(np.asarray({series}, dtype=float))
    return np.stack(found)
"""
"""Response of an effect of one's own to each of its coefficients."""
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
that turns with the joint, the zero of the current, the gear's efficiency, the presliding stiffness,
the torque ripple and the time by which the torque is late are those of the effects.
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
    for regressors, shape, coefficients, late in effects:
        seen = s.delayed(M["late_s"]) if late else s
        total = total + np.array(coefficients) @ regressors(seen, NOMINAL, shape)
    return total


def _curve(equation: str, s: Any) -> Array:
    if CURVE is None or CURVE[0] != equation:
        return np.zeros(len(s["time"]))
    value = np.interp(s[CURVE[1]], CURVE[2], CURVE[3])
    return s["sense"] * value if CURVE[4] else value
'''


class _Namespace:
    """Attributes by name."""

    def __init__(self, **given: Any) -> None:
        self.__dict__.update(given)


class Signals:
    """Signals of one recording with the names of :class:`identification.views.view.View`, SI, at
    the joint except those of the motor; arrays of shape (n,).
    """

    def __init__(
        self,
        m: Any,
        time: Array,
        angle: Array,
        velocity: Array,
        acceleration: Array,
        contact_force: Any = 0.0,
        weight_mass: float = 0.0,
        current: Any = 0.0,
        voltage: Any = 0.0,
        supply: Any = None,
        known: Any = 0.0,
        known_inertia: float = 0.0,
        run_start: float = 0.0,
        number: int = 1,
        before: Signals | None = None,
    ) -> None:
        """Compute the signals.

        Args:
            m: Nominal parameters and bench constants.
            time: s, evenly spaced.
            angle: rad.
            velocity: rad/s; zero at rest.
            acceleration: rad/s^2.
            contact_force: F_P, N.
            weight_mass: Mass on the lever, or of the weight that turns with the joint, kg.
            current: Logged current, A.
            voltage: Logged voltage, V.
            supply: Supply voltage, V; without it the greatest voltage is used.
            known: Torque of a weight that turns with the joint, less its inertia torque, N m.
            known_inertia: Inertia of the weight that turns with the joint, kg m^2.
            run_start: Time from the start of the first recording to the start of this recording, s.
            number: Number of the recording, from 1.
            before: Signals of the recording before this one, which heats the motor.

        Raises:
            ValueError: The times are not evenly spaced.
        """
        steps = np.diff(time)
        if np.max(steps) > 1.5 * np.median(steps):
            raise ValueError(
                f"time: samples must be evenly spaced, but the longest step is {np.max(steps):g} s "
                f"and the median step {np.median(steps):g} s; interpolate all signals to an even "
                "grid first"
            )
        one = np.ones(len(time))
        moving = np.maximum.accumulate(np.where(velocity != 0.0, np.arange(len(time)), 0))
        self.time, self.run_time = time, run_start + time - time[0]
        self.step = float(time[-1] - time[0]) / (len(time) - 1)
        self.angle, self.velocity, self.acceleration = angle, velocity, acceleration
        self.sense, self.still = np.sign(velocity)[moving], velocity == 0.0
        self.rest_time = rest_times(time, velocity)
        self.moment, self.known = contact_force * m["L1"] * one, known * one
        self.hanging = (known + known_inertia * acceleration) * one
        self.loaded = bool(np.any(self.moment != 0.0))
        self.burdened = bool(np.any(self.known))
        self.current, self.voltage = current * one, voltage * one
        self.supply = None if supply is None else supply * one
        self.transmitted = m["ampere_torque"] * self.current
        self.torque = self.transmitted + self.known
        self.motor, self.drive_angle, self.lag = m["i"] * angle, angle, None
        self.motor_speed = m["i"] * velocity
        self.twist = 0.0 * time
        self.rotor_acceleration = np.gradient(velocity, self.step)
        self.index, self.before, self.voltage_is_computed = number - 1, before, False
        bench = _Namespace(
            resistance=m["R"],
            inductance=m["L"],
            back_emf_constant=m["Ke"],
            moment_arm=m["L1"],
            gear_ratio=m["i"],
            ampere_torque=m["ampere_torque"],
        )
        self.recording = _Namespace(
            bench=bench,
            pendulum=None,
            weight_mass=weight_mass,
            time=time,
            period=self.step,
            channels={"current": self.current},
            averaged=(),
        )

    def with_velocity(self, velocity: Array) -> Signals:
        """Return the signals with another velocity of the joint."""
        other = Signals.__new__(Signals)
        other.__dict__.update({**self.__dict__, "velocity": velocity})
        return other

    def delayed(self, late_s: float) -> Signals:
        """Return the signals with the motion as late as the samples of the torque."""
        other = Signals.__new__(Signals)
        other.__dict__.update(self.__dict__)
        for name in (*DELAYED, "drive_angle", "rotor_acceleration"):
            setattr(other, name, delayed_series(getattr(self, name), self.step, late_s))
        other.sense = np.clip(other.sense, -1.0, 1.0)
        other.transmitted = other.torque - other.known
        return other

    def __getitem__(self, name: str) -> Any:
        """Return a signal by its name."""
        return getattr(self, name)


def rest_times(time: Array, velocity: Array) -> Array:
    """Return the duration of rest at each sample, s, shape (n,): at rest the time since the rest
    began, in motion the duration of the last rest.
    """
    out = np.zeros(len(time))
    began = -1
    for k in range(1, len(time)):
        if velocity[k] == 0.0 and began < 0:
            began = k
        out[k] = time[k] - time[began] if began >= 0 else out[k - 1]
        if velocity[k] != 0.0:
            began = -1
    return out


def python_text(model: CorrectedModel, recording: Recording, name: str) -> str:
    """Return the model as Python, with the source of the functions that compute it here."""
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
    """Return nonlinear parameters, coefficients and whether the signals are late as literals."""
    shape, coefficients = map(np.array, (response.shape, response.coefficients))
    return f"{tuple(shape.tolist())!r}, {tuple(coefficients.tolist())!r}, {response.late!r}"


class _Source:
    """Source of definitions with all of this program that they use, in the order of use."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self._known: dict[str, Any] = {}

    def response(self, response: Response, table: str) -> str:
        """Add the regressors of an effect; return the name of their function in the file."""
        function = response.columns
        if isinstance(response.effect, OwnEffect):
            return self._own(response.effect, table)
        if "." not in function.__qualname__:
            self.add(function)
            return function.__name__
        name = f"{response.effect.name}_{table.lower()}"
        self._use(function)
        text = textwrap.dedent(inspect.getsource(function)).removeprefix("@staticmethod\n")
        self.texts[name] = text.replace(f"def {function.__name__}(", f"def {name}(", 1)
        return name

    def _own(self, effect: OwnEffect, table: str) -> str:
        """Add an effect of one's own with the source of its function; return the name of its
        response.
        """
        equation = table.lower() if table != "DRIVE" else "torque"
        called = effect.functions[equation].call
        name = f"{effect.name}_{equation}"
        for definition in (Seen, *((sampled, samples_of) if effect.states else ())):
            self.add(definition)
        self._use(called)
        text = _DECORATORS.sub("", textwrap.dedent(inspect.getsource(called)))
        self._put(f"own_{name}", text.replace(f"def {called.__name__}(", f"def own_{name}(", 1))
        series = f"own_{name}(Seen(s, nominal), p)"
        if effect.states:
            rows = f"samples_of(Seen(s, nominal), {sorted(effect.used)!r})"
            series = f"sampled(own_{name}, {rows}, {effect.states}, s.step, p)"
        self._put("namedtuple", "from collections import namedtuple\n")
        text = _OWN.format(
            name=name,
            names=tuple(q.name for q in effect.parameters),
            searched=effect.nonlinear,
            coefficients=effect.coefficients,
            series=series,
        )
        self._put(name, text)
        return name

    def _put(self, name: str, text: str) -> None:
        """Add a text; ValueError if the file has another definition of this name."""
        if name in _TAKEN or self.texts.setdefault(name, text) != text:
            raise ValueError(f"two definitions of the corrected model have the name {name}")

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
            self._put(name, _PLAIN[definition])
            return
        self._use(definition)
        plain = getattr(definition, "py_func", definition)
        self._put(name, _CACHED.sub("", inspect.getsource(plain)))

    def _use(self, definition: Any) -> None:
        for function in _functions(definition):
            for name in sorted(_names(function.__code__)):
                used = function.__globals__.get(name)
                if getattr(used, "__module__", "").startswith("identification."):
                    self.add(used)
                elif isinstance(used, float | int | str | tuple):
                    self._put(name, f"{name} = {used!r}\n")
                elif used is not None and not function.__module__.startswith("identification."):
                    self._use_of_user(function, name, used)
                elif definition is Seen and isinstance(used, dict):
                    self._put(name, f"{name} = {used!r}\n")

    def _use_of_user(self, function: FunctionType, name: str, used: Any) -> None:
        """Add a definition of a user's file, or an import, under its name there."""
        plain = getattr(used, "py_func", used)
        module = getattr(plain, "__module__", None)
        if isinstance(plain, FunctionType) and module == function.__module__:
            if self._known.setdefault(name, plain) is not plain:
                raise ValueError(f"two definitions of the corrected model have the name {name}")
            if name not in self.texts:
                self._use(plain)
                self._put(name, _DECORATORS.sub("", inspect.getsource(plain)))
        elif isinstance(used, np.ndarray):
            self._put(name, f"{name} = np.array({used.tolist()!r})\n")
        elif isinstance(used, ModuleType):
            self._put(name, f"import {used.__name__} as {name}\n")
        elif callable(used) and module and module != function.__module__:
            self._put(name, f"from {module} import {used.__name__} as {name}\n")
        else:
            raise ValueError(
                f"{function.__code__.co_filename}: {function.__name__} uses {name}, which is a "
                f"{type(used).__name__}; the exported file can contain functions, numbers, texts, "
                "tuples and arrays"
            )


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
