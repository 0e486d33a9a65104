"""Effects of one's own: a function with parameters becomes an effect that a diagnosis searches
beside those of the catalogue.
"""

from __future__ import annotations

import itertools
import keyword
import logging
import math
import re
import traceback
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from functools import cache, cached_property, partial
from typing import Any, NamedTuple

import numba
import numpy as np

from identification.effects.effect import Coefficients, Columns, Context, Effect, Quantity, Shape
from identification.recording import Array
from identification.views.nominal import Nominal
from identification.views.view import View

_LOG = logging.getLogger(__name__)
Response = Callable[..., Any]
"""Function of signals and parameters, ``f(s, p)``, that returns an array of shape (n,); with
states, function ``f(s, x, dt, p)`` of one sample that changes the states ``x`` and returns a
number.
"""
MEASURED = {
    "time": "time",
    "run_time": "run_time",
    "rest_time": "rest_time",
    "angle": "angle",
    "velocity": "velocity",
    "acceleration": "acceleration",
    "direction": "sense",
    "load": "moment",
    "motor_angle": "motor",
    "motor_velocity": "motor_speed",
    "current": "current",
    "voltage": "voltage",
    "supply": "supply",
}
MODELLED = {"motor_torque": "drive", "friction": "friction"}
"""Names of the signals, and attributes of a recording's view and of the nominal model that have the
signals. Torques of the nominal model stand for the measured torque, which is to be explained.
"""
SIGNAL_UNITS = {
    **dict.fromkeys(("time", "run_time", "rest_time"), "s"),
    **{"angle": "rad", "velocity": "rad/s", "acceleration": "rad/s^2", "direction": ""},
    **{"motor_angle": "1", "motor_velocity": "1/s", "current": "A", "voltage": "V", "supply": "V"},
    **dict.fromkeys(("load", "motor_torque", "friction"), "N m"),
}
EQUATION_UNITS = {"torque": "N m", "breakaway": "N m", "transmission": "rad", "voltage": "V"}
MOST_TRIALS = 48
"""Greatest number of trial values of the nonlinear parameters together."""
WIDE = 8.0
"""Ratio of the ends of a range from which a parameter is searched by factors."""
BEYOND = 0.05
"""Share of a range by which a search may leave the range: a parameter found outside its range is
implausible.
"""
_BASE: Mapping[str, Mapping[str, float]] = {
    "": {},
    "1": {},
    "rad": {},
    "turn": {},
    **{unit: {unit: 1.0} for unit in ("m", "kg", "s", "A", "K")},
    "Hz": {"s": -1.0},
    "N": {"kg": 1.0, "m": 1.0, "s": -2.0},
    "Pa": {"kg": 1.0, "m": -1.0, "s": -2.0},
    "J": {"kg": 1.0, "m": 2.0, "s": -2.0},
    "W": {"kg": 1.0, "m": 2.0, "s": -3.0},
    "V": {"kg": 1.0, "m": 2.0, "s": -3.0, "A": -1.0},
    "ohm": {"kg": 1.0, "m": 2.0, "s": -3.0, "A": -2.0},
}
_FACTOR = re.compile(r"([A-Za-z1]+)(?:\^(-?\d+(?:\.\d+)?))?")
_PROBES = 160
PROBE_STEP_S = 0.01


class EffectError(ValueError):
    """An effect that cannot be used; the message has file and line of the user's code."""


def dimensions(unit: str) -> dict[str, float]:
    """Return the exponents of m, kg, s, A and K in a unit such as ``N m s^2/rad^2``.

    Raises:
        ValueError: The unit is not one of SI.
    """
    found: dict[str, float] = {}
    above, *below = unit.split("/")
    if len(below) > 1:
        raise ValueError(f"{unit!r} has more than one '/'; write N m/(rad s), not N m/rad/s")
    for sign, part in ((1.0, above), (-1.0, "".join(below).strip().strip("()"))):
        for factor in part.split():
            match = _FACTOR.fullmatch(factor)
            if match is None or match[1] not in _BASE:
                raise ValueError(
                    f"{factor!r} is not a unit; write units of SI with spaces between factors and "
                    f"^ before exponents, such as N m s^1.5/rad^1.5, from {', '.join(_BASE)[2:]}"
                )
            for base, power in _BASE[match[1]].items():
                found[base] = found.get(base, 0.0) + sign * power * float(match[2] or 1.0)
    return {base: power for base, power in found.items() if power}


class Seen:
    """Signals of one recording for the function of an effect: SI, at the joint, shape (n,)."""

    def __init__(self, view: Any, nominal: Any) -> None:
        self.view, self.nominal = view, nominal

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.view.time)

    def __getattr__(self, name: str) -> Any:
        """Return a signal by its name, which cannot be written to."""
        if name in MODELLED:
            series = getattr(self.nominal, MODELLED[name])(self.view)
        elif name in MEASURED:
            series = getattr(self.view, MEASURED[name])
        else:
            known = ", ".join((*MEASURED, *MODELLED))
            raise AttributeError(f"there is no signal {name}; there are {known}")
        if series is None:
            raise AttributeError(f"{self.view.recording.name} has no signal {name}")
        series = np.nan_to_num(series) if name == "voltage" else series.view()
        series.flags.writeable = False
        return series


def sampled(step: Any, samples: Any, states: int, dt: float, p: Any, first: float = 0.0) -> Array:
    """Return the values of a function of one sample with states, which are zero before the first
    sample, shape (n,); ``first`` is the period before the first sample if it is not ``dt``.
    """
    x = np.zeros(states)
    out = np.empty(len(samples))
    for k in range(len(samples)):
        out[k] = step(samples[k], x, dt if k or first == 0.0 else first, p)
    return out


def samples_of(seen: Any, names: Any) -> Any:
    """Return signals as one record for each sample, shape (n,)."""
    rows = np.empty(len(seen), dtype=[(name, "f8") for name in names])
    for name in names:
        rows[name] = getattr(seen, name)
    return rows.view(np.recarray)


class _Probe:
    """Made-up signals, or one sample of them, that record which of them a function uses."""

    def __init__(self, series: Mapping[str, Any], used: set[str]) -> None:
        self._series, self.asked = series, used

    def __len__(self) -> int:
        return _PROBES

    def __getattr__(self, name: str) -> Any:
        if name not in self._series:
            raise AttributeError(f"there is no signal {name}; there are {', '.join(self._series)}")
        self.asked.add(name)
        if isinstance(series := self._series[name], np.ndarray):
            series.flags.writeable = False
        return series

    def __getitem__(self, at: int) -> _Probe:
        return _Probe({name: float(s[at]) for name, s in self._series.items()}, self.asked)


@cache
def made_up() -> Mapping[str, Array]:
    """Return signals of a plausible motion, for tests of a function without a recording."""
    t = PROBE_STEP_S * np.arange(_PROBES)
    w = 2.0 * math.pi
    angle = 0.4 * np.sin(w * t) + 0.1 * np.sin(3.7 * w * t + 0.6)
    velocity = 0.4 * w * np.cos(w * t) + 0.37 * w * np.cos(3.7 * w * t + 0.6)
    acceleration = -0.4 * w**2 * np.sin(w * t) - 0.1 * (3.7 * w) ** 2 * np.sin(3.7 * w * t + 0.6)
    sense = np.sign(velocity)
    torque = 0.2 * acceleration + sense * (8.0 + 3.0 * np.abs(velocity))
    motion = {"time": t, "run_time": 60.0 + t, "rest_time": 0.5 + 0.0 * t, "angle": angle}
    motion |= {"velocity": velocity, "acceleration": acceleration, "direction": sense}
    motor = {"motor_angle": 100.0 * angle, "motor_velocity": 100.0 * velocity}
    motor |= {"current": torque / 3.0, "voltage": 0.5 * torque + 2.6 * velocity}
    loads = {"load": 20.0 + 0.0 * t, "supply": 60.0 + 0.0 * t}
    return {**motion, **motor, **loads, "motor_torque": torque, "friction": torque}


class _Function(NamedTuple):
    """A function of an effect, with its equation and its place, ``file:line: ``."""

    equation: str
    call: Response
    place: str


class OwnEffect(Effect):
    """An effect that a user defines, as a subclass or with :func:`effect`.

    A subclass has a static method ``torque``, ``transmission``, ``voltage`` or ``breakaway`` for
    each equation that the effect enters: without states ``f(s, p)`` of the signals ``s``, which
    returns an array of shape (n,); with states ``f(s, x, dt, p)`` of one sample, which changes the
    states ``x``, shape (states,), and returns a number. What the function returns is added to the
    nominal side of its equation: the torque that the drive must supply beside the nominal torque,
    N m at the joint, so that friction is positive in motion in the positive direction;
    motor_angle / i - angle, rad; the voltage, V; or the torque at a breakaway, N m.

    Parameters in which the functions are linear are found by evaluations, and become coefficients;
    all others are searched within their ranges. Words that a subclass does not state are generic.

    Attributes:
        parameters: Name of each parameter to unit, least and greatest plausible value; a range
            without values below zero states the sign.
        states: Number of states.
        coefficients: Parameters in which the effect is linear; found if they are not stated.
        used: Signals that the functions use.

    Raises:
        EffectError: The definition cannot be used; raised where the class is defined.
    """

    states = 0
    implied = "the nominal model is complete"
    coordinate = "speed"
    look_alikes = ()
    experiment = """Vary speed, load, direction and time at rest separately; no experiment is stated
        for this effect."""
    coefficients: tuple[str, ...] = ()
    used: frozenset[str] = frozenset()
    functions: Mapping[str, _Function] = {}

    def __init_subclass__(cls) -> None:
        """Check the definition, and complete it."""
        own = vars(cls)
        made = {e: f for e in EQUATION_UNITS if (f := getattr(cls, e, None)) is not None}
        place = f"{_place(*made.values())}{cls.__name__}"
        if not made:
            raise EffectError(f"{place}: has no function; define {', '.join(EQUATION_UNITS)}")
        cls.functions = {e: _Function(e, f, _place(f)) for e, f in made.items()}
        cls.parameters = _quantities(own.get("parameters"), place)
        once = "torque" in made and "breakaway" not in made
        cls.enters = (*made, *(("breakaway",) if once else ()))
        cls.shows_in = cls.enters[0]
        words = " ".join((cls.__doc__ or cls.__name__).split()).partition(". ")[0].rstrip(".")
        if "equation" not in own:
            cls.equation = words
        if "sentence" not in own:
            listed = ", ".join(f"{q.name} = {{{q.name}:}}" for q in cls.parameters)
            cls.sentence = f"{words.replace('{', '{{').replace('}', '}}')}: {listed}"
        super().__init_subclass__()
        cls._complete()

    @classmethod
    def _complete(cls) -> None:
        """Find the signals and the coefficients of the functions by evaluations."""
        tried, used = cls(), set[str]()
        draws = [{q.name: _within(q, share) for q in cls.parameters} for share in (0.35, 0.7)]
        first = [tried.probed(draw, e, used) for e in cls.functions for draw in draws]
        if not cls.coefficients:
            if not any(np.any(series) for series in first):
                raise EffectError(
                    f"{tried.placed}{cls.name}: returns zero on a sine "
                    "of 0.4 rad at 1 Hz under load; state in a class which parameters it is linear "
                    "in, such as coefficients = ('c',)"
                )
            for q in cls.parameters:
                trial = (*cls.coefficients, q.name)
                if all(tried.is_linear(e, trial, d) for e in cls.functions for d in draws):
                    cls.coefficients = trial
            absent = dict.fromkeys(cls.coefficients, 0.0)
            both = [{**draw, **absent} for draw in draws]
            if any(np.any(tried.probed(b, e)) for e in cls.functions for b in both):
                cls.coefficients = ()
        rest = [q for q in cls.parameters if q.name not in cls.coefficients]
        cls.nonlinear = tuple(q.name for q in rest)
        cls.used, cls.at_angle = frozenset(used), bool(used & {"angle", "motor_angle"})
        cls.follows = bool(used & MODELLED.keys())
        cls.varies = cls.enters if cls.follows else ()
        cls.size = None if cls.coefficients else 1.0
        low = {q.name: q.low for q in cls.parameters}
        signs = [k for k, n in enumerate(cls.coefficients) if low[n] >= 0.0]
        cls.positive = tuple(signs) if cls.coefficients else (0,)
        count = min(12, max(3, math.floor(MOST_TRIALS ** (1.0 / max(len(rest), 1)))))
        middles = [(k + 0.5) / count for k in range(count)]
        cls.trials = tuple(itertools.product(*([_within(q, m) for m in middles] for q in rest)))
        width = [q.high - q.low for q in rest]
        cls.refine = {k: 0.0 if _by_factors(q) else width[k] / count for k, q in enumerate(rest)}
        cls.limits = {k: _limits(q) for k, q in enumerate(rest)}

    @property
    def placed(self) -> str:
        """File and line of the first function, ``file:line: ``."""
        return next(iter(self.functions.values())).place

    @property
    def group(self) -> str:
        """The word for effects that are not of the catalogue."""
        return "own"

    @cached_property
    def columns(self) -> Mapping[str, Columns]:
        """Name of each equation that the effect enters to its regressors there."""
        made = {e: partial(self._rows, f) for e, f in self.functions.items()}
        return {e: made[e] if e in made else made["torque"] for e in self.enters}

    def shapes(self, context: Context) -> Sequence[Shape]:
        """Return the trial values of the nonlinear parameters; empty if a recording lacks a signal
        that the effect uses.
        """
        needed = [MEASURED[n] for n in self.used if n in MEASURED]
        lacking = any(getattr(v, n) is None for v in context.views for n in needed)
        return () if lacking else self.trials

    def read(self, c: Array, shape: Shape, _context: Context) -> Mapping[str, float]:
        """Return the parameters at fitted coefficients ``c``."""
        found = {**_named(self.nonlinear, shape), **_named(self.coefficients, c)}
        return {q.name: float(found[q.name]) for q in self.parameters}

    def at(self, values: Mapping[str, float], _nominal: Nominal) -> tuple[Shape, Coefficients]:
        """Return nonlinear parameters and coefficients; the inverse of :meth:`read`."""
        shape = tuple(float(values[str(n)]) for n in self.nonlinear)
        return shape, tuple(float(values[n]) for n in self.coefficients) or (1.0,)

    def _rows(self, function: _Function, view: View, nominal: Nominal, shape: Shape) -> Array:
        """Return the response to each coefficient of one, the others zero, shape (k, m)."""
        searched = _named(self.nonlinear, shape)
        return np.stack(
            [
                self.response(
                    function, Seen(view, nominal), view.step, {**searched, **_named(names, ones)}
                )
                for names, ones in _units(self.coefficients)
            ]
        )

    def response(
        self, function: _Function, seen: Any, dt: float, values: Mapping[str, float]
    ) -> Array:
        """Return what a function returns, shape (n,).

        Args:
            function: A function of the effect.
            seen: Signals.
            dt: Sample period, s.
            values: Values of all parameters.

        Raises:
            EffectError: The function fails, or does not return n finite numbers.
        """
        p = _record_of(tuple(q.name for q in self.parameters))(**values)
        try:
            with np.errstate(all="ignore"):
                found = self._called(function, seen, dt, p)
        except Exception as error:
            calls = traceback.extract_tb(error.__traceback__)
            own = [
                f"{c.filename}:{c.lineno}: " for c in calls if f"{c.filename}:" in function.place
            ]
            form = "" if own else "; a function is f(s, p), with states f(s, x, dt, p)"
            if getattr(error, "obj", None) is p:
                form = f"; the parameters are {', '.join(values)}"
            said = f"{type(error).__name__}: {error}{form}"
            raise EffectError(f"{[function.place, *own][-1]}{self.name}: {said}") from error
        if found.shape != (len(seen),):
            one = "" if found.shape else "; a function of one sample states its number of states"
            raise EffectError(
                f"{function.place}{self.name}: {function.equation} must return one number for each "
                f"sample, shape ({len(seen)},) (got shape {found.shape}){one}"
            )
        if not np.all(np.isfinite(found)):
            k = int(np.argmin(np.isfinite(found)))
            used = seen.asked if isinstance(seen, _Probe) else self.used
            here = {n: float(getattr(seen, n)[k]) for n in sorted(used)} | dict(values)
            at = ", ".join(f"{n} = {v:.4g}" for n, v in here.items())
            raise EffectError(
                f"{function.place}{self.name}: {function.equation} returns {found[k]} at {at}; it "
                "must be finite in every sample, at all values within the ranges of the parameters"
            )
        return found

    def _called(self, function: _Function, seen: Any, dt: float, p: Any) -> Array:
        if not self.states:
            return np.asarray(function.call(seen, p), dtype=np.float64)
        if isinstance(seen, _Probe):
            return sampled(function.call, seen, self.states, dt, p)
        rows = samples_of(seen, sorted(self.used))
        return np.asarray(self._loops[function.equation](rows, self.states, dt, p))

    @cached_property
    def _loops(self) -> Mapping[str, Callable[..., Array]]:
        """Loops over samples, by equation; compiled if the functions can be compiled."""
        found: dict[str, Callable[..., Array]] = {}
        one = samples_of(_Probe(made_up(), set()), sorted(self.used))[:1]
        p = _record_of(tuple(q.name for q in self.parameters))
        for equation, call, place in self.functions.values():
            found[equation] = partial(_LOOP, numba.njit(error_model="numpy")(call))
            try:
                middle = p(*(_within(q, 0.5) for q in self.parameters))
                found[equation](one, self.states, 1.0, middle)
            except Exception as error:  # noqa: BLE001 - numba fails in many ways; Python is the remedy
                said = str(error).partition("\n")[0]
                _LOG.warning("%s%s: is not compiled, and is slow: %s", place, self.name, said)
                found[equation] = partial(sampled, call)
        return found

    def probed(
        self,
        values: Mapping[str, float],
        equation: str,
        used: set[str] | None = None,
        scale: Mapping[str, float] = {},
        linear: bool = False,
    ) -> Array:
        """Return the response to made-up signals, shape (n,).

        Args:
            values: Values of all parameters.
            equation: Equation of the function.
            used: Set to which the names of the signals are added that the function uses.
            scale: Name of a base unit to the factor by which its numbers grow in other units.
            linear: Whether the motion is one in m, not in rad.

        Raises:
            EffectError: The function fails, or does not return finite numbers.
        """
        series = {n: s * factor(SIGNAL_UNITS[n], scale, linear) for n, s in made_up().items()}
        probe = _Probe(series, set() if used is None else used)
        known = {q.name: values[q.name] * factor(q.unit, scale) for q in self.parameters}
        dt = PROBE_STEP_S * factor("s", scale)
        return self.response(self.functions[equation], probe, dt, known)

    def is_linear(self, equation: str, names: tuple[str, ...], values: Mapping[str, float]) -> bool:
        """Whether the response to made-up signals, less that without these parameters, is linear in
        them together.
        """

        def at(*factors: float) -> Array:
            changed = {n: k * values[n] for n, k in zip(names, factors, strict=True)}
            return self.probed({**values, **changed}, equation)

        try:
            units = [ones for _, ones in _units(names)]
            none = at(*(0.0 for _ in names))
            whole = at(*(1.0 for _ in names)) - none
            parts = [at(*ones) - none for ones in units]
            doubled = [at(*(-2.0 * one for one in ones)) - none for ones in units]
        except EffectError:  # beyond its range, a nonlinear parameter may have no value
            return False
        small = 1e-9 * max(float(np.max(np.abs(whole))), 1e-300)
        gaps = [sum(parts) - whole, *(d + 2.0 * p for d, p in zip(doubled, parts, strict=True))]
        return all(bool(np.max(np.abs(gap)) <= small) for gap in gaps)

    @property
    def middle(self) -> dict[str, float]:
        """A value of each parameter within its range."""
        return {q.name: _within(q, 0.45) for q in self.parameters}

    def problems(self) -> list[str]:
        """Return what is wrong with the functions by evaluations on made-up signals: units, and a
        size that no parameter determines.
        """
        found, middle = [], self.middle
        for equation, unit in ((e, EQUATION_UNITS[e]) for e in self.functions):
            plain = self.probed(middle, equation)
            wrong = min(
                (
                    [
                        base
                        for base in ("m", "kg", "s", "A", "K")
                        if not alike(
                            self.probed(middle, equation, None, {base: 3.7}, linear),
                            plain * factor(unit, {base: 3.7}, linear),
                        )
                    ]
                    for linear in (False, True)
                ),
                key=len,
            )
            if wrong:
                found.append(
                    f"units: {equation} is not in {unit} if the signals and parameters have their "
                    f"units: the powers of {', '.join(wrong)} differ; correct the unit of a "
                    "parameter, or make a number in the function that has a unit a parameter"
                )
            holds = [q.name for q in self.parameters if q.low <= 0.0 <= q.high]
            if holds and not any(self._vanishes(equation, {**middle, n: 0.0}) for n in holds):
                found.append(
                    f"zero: {equation} is not zero where {' or '.join(holds)} is zero, so that no "
                    "size means that the effect is absent"
                )
        return found

    def problems_of(self, function: Callable[..., float], size: int) -> list[str]:
        """Return what is wrong with the function that injects the effect into a simulated machine,
        by evaluations on a made-up motion: numbers that are not finite, units, sign.

        Args:
            function: ``f(angle, speed, motor_torque, load, state, dt, p)``, the torque that resists
                the motion, N m.
            size: Number of values of ``state``.
        """
        names = ("angle", "velocity", "motor_torque", "load")

        def torque(scale: Mapping[str, float] = {}) -> Array:
            rows = zip(*(made_up()[n] * factor(SIGNAL_UNITS[n], scale) for n in names), strict=True)
            known = {q.name: self.middle[q.name] * factor(q.unit, scale) for q in self.parameters}
            p = _record_of(tuple(known))(**known)
            state, dt = np.zeros(size), PROBE_STEP_S * factor("s", scale)
            return np.array([float(function(*map(float, row), state, dt, p)) for row in rows])

        where = f"{_place(function)}{getattr(function, '__name__', function)}: "
        try:
            with np.errstate(all="ignore"):
                plain = torque()
                scaled = {b: torque({b: 3.7}) for b in ("m", "kg", "s", "A", "K")}
        except Exception as error:  # noqa: BLE001 - whatever a user's function raises
            fields = getattr(getattr(error, "obj", None), "_fields", ())
            more = f"; the parameters are {', '.join(fields)}" if fields else ""
            form = "f(angle, speed, motor_torque, load, state, dt, p)"
            more = more or (f"; it is called as {form}" if isinstance(error, TypeError) else "")
            return [f"{where}{type(error).__name__}: {error}{more}"]
        if not np.all(np.isfinite(plain)):
            return [f"{where}returns {plain[np.argmin(np.isfinite(plain))]} in a plausible motion"]
        found = []
        wrong = [b for b, t in scaled.items() if not alike(t, plain * factor("N m", {b: 3.7}))]
        if wrong:
            found.append(
                f"{where}units: it is not in N m if its arguments are in SI units: the powers of "
                f"{', '.join(wrong)} differ; make a number that has a unit a parameter"
            )
        if "torque" in self.functions and self.probed(self.middle, "torque") @ plain < 0.0:
            found.append(
                f"{where}sign: it returns the opposite of torque; both are positive where they "
                "resist motion in the positive direction"
            )
        return found

    def _vanishes(self, equation: str, values: Mapping[str, float]) -> bool:
        try:
            return not np.any(self.probed(values, equation))
        except EffectError:
            return False


_LOOP = numba.njit(sampled)


def effect(
    *, states: int = 0, enters: str = "torque", **parameters: tuple[str, float, float]
) -> Callable[[Response], OwnEffect]:
    """Return a decorator that makes a function an effect with the function's name and docstring.

    Args:
        states: Number of states; with states, the function is one of single samples.
        enters: Equation: ``torque``, ``transmission``, ``voltage`` or ``breakaway``.
        **parameters: Unit, least and greatest plausible value of each parameter.

    Raises:
        EffectError: The definition cannot be used; raised by the decorator.

    Example:
        >>> import numpy as np
        >>> @effect(c=("N m s^1.5/rad^1.5", 0.0, 20.0))
        ... def root_drag(s, p):
        ...     return p.c * s.velocity * np.abs(s.velocity) ** 0.5
        >>> root_drag.name, root_drag.coefficients
        ('root_drag', ('c',))
    """

    def made(function: Response) -> OwnEffect:
        if enters not in EQUATION_UNITS:
            raise EffectError(
                f"{_place(function)}{function.__name__}: enters: must be one of "
                f"{', '.join(EQUATION_UNITS)} (got {enters!r})"
            )
        own = {"parameters": parameters, "states": states, enters: staticmethod(function)}
        own |= {"__doc__": function.__doc__, "__module__": function.__module__}
        made: type[OwnEffect] = type(function.__name__, (OwnEffect,), own)
        return made()

    return made


def factor(unit: str, scale: Mapping[str, float], linear: bool = False) -> float:
    """Return the factor by which numbers grow in other units; on a linear bench rad is m, and N m
    is N.
    """
    if linear and unit in ("N m", "rad", "rad/s", "rad/s^2"):
        unit = unit.replace("N m", "N").replace("rad", "m")
    return float(
        math.prod(scale.get(base, 1.0) ** power for base, power in dimensions(unit).items())
    )


def alike(one: Array, other: Array) -> bool:
    """Whether two series are equal but for rounding."""
    return float(np.linalg.norm(one - other)) <= 1e-3 * float(np.linalg.norm(other))


def _place(*functions: Response) -> str:
    """Return ``file:line: `` of the first function; empty without one."""
    code = getattr(functions[0], "__code__", None) if functions else None
    return "" if code is None else f"{code.co_filename}:{code.co_firstlineno}: "


@cache
def _record_of(names: tuple[str, ...]) -> Any:
    return namedtuple("Parameters", names)


def _named(names: Sequence[Any], values: Sequence[float] | Array) -> dict[str, float]:
    return {str(n): float(v) for n, v in zip(names, values, strict=False)}


def _units(names: tuple[str, ...]) -> list[tuple[tuple[str, ...], tuple[float, ...]]]:
    """Return the unit vectors of coefficients; one empty vector without coefficients."""
    return [(names, tuple(float(n == name) for n in names)) for name in names] or [((), ())]


def _quantities(given: Any, place: str) -> tuple[Quantity, ...]:
    """Return the parameters of a definition after checks."""
    example = 'c=("N m s/rad", 0.0, 5.0)'
    if not isinstance(given, Mapping) or not given:
        raise EffectError(
            f"{place}: parameters: state at least one with unit, least and greatest plausible "
            f"value, such as {example}"
        )
    found = []
    for name, entry in given.items():
        where = f"{place}: parameters: {name}"
        if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
            raise EffectError(f"{where}: is not a name; use letters, digits and _")
        if not isinstance(entry, tuple | list) or len(entry) != 3 or not isinstance(entry[0], str):
            raise EffectError(
                f"{where}: must be unit, least and greatest plausible value, such as {example} "
                f"(got {entry!r})"
            )
        unit, low, high = entry
        try:
            dimensions(unit)
        except ValueError as error:
            raise EffectError(f"{where}: {error} (got {unit!r})") from None
        numbers = all(isinstance(v, int | float) and math.isfinite(v) for v in (low, high))
        if not numbers or not low < high:
            raise EffectError(
                f"{where}: the least plausible value must be below the greatest, both finite "
                f"(got {low!r} to {high!r})"
            )
        found.append(Quantity(name, "" if unit == "1" else unit, float(low), float(high)))
    return tuple(found)


def _by_factors(q: Quantity) -> bool:
    return q.low > 0.0 and q.high > WIDE * q.low


def _within(q: Quantity, share: float) -> float:
    """Return the value at a share of a range."""
    if _by_factors(q):
        return q.low * float((q.high / q.low) ** share)
    return q.low + share * (q.high - q.low)


def _limits(q: Quantity) -> tuple[float, float]:
    """Return the limits of a search: a little beyond the range, so that a value at the end of the
    range is seen to be implausible, but not beyond zero, which a range may exclude.
    """
    if _by_factors(q):
        return q.low / (1.0 + BEYOND), q.high * (1.0 + BEYOND)
    width = q.high - q.low
    low, high = q.low - BEYOND * width, q.high + BEYOND * width
    return (
        max(low, 1e-3 * width) if q.low >= 0.0 else low,
        min(high, -1e-3 * width) if q.high <= 0.0 else high,
    )
