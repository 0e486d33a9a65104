"""The corrected model as equations of one sample, which every format prints.

The torque that the motion requires and the torque of the logged current are those of the
identification: the functions of :mod:`identification.views.nominal` and of the effects compute them
with symbols (:mod:`identification.export.symbols`). A simulation solves their difference for the
speed at the end of each step (backward Euler). At rest friction has any value between the static
limits, so that the joint rests if the difference has opposite signs at either limit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, Self

import numpy as np

from identification.effects.effect import Effect
from identification.effects.friction import initial_friction
from identification.effects.model import COORDINATES, CorrectedModel, Curve
from identification.effects.motor import mean_over_sample
from identification.effects.own import MEASURED, MODELLED, OwnEffect
from identification.export.symbols import (
    OF_ARRAYS,
    Node,
    NotCausalError,
    Symbols,
    Written,
    apply,
    computed,
    explored,
    memory,
    node,
    ordered,
    substituted,
    total,
)
from identification.model.parameters import UNITS_ROTARY, parameter_unit, unit_on
from identification.recording import Array, Bench
from identification.views.nominal import Nominal, NominalTorque, winding_voltage

LARGEST_STEP_S = 2.5e-4
"""Greatest step of a simulation, s, if friction allows it."""
STEP_SHARE = 0.25
"""Greatest step relative to the inertia over the steepest fall of friction, at which each step has
one solution.
"""
OF_ONE_SAMPLE = "its function uses what has no form in other languages, or more than one sample"
"""Why an effect of one's own is left out."""
STEADY_TRAVEL_RAD, STEADY_TIME_S, STEADY_STEPS = 0.2, 2.0, 200
"""Least travel and time, and number of steps, after which memories of a steady motion are used."""
SIGNALS: Mapping[str, tuple[str, str]] = {
    "angle": ("rad", "angle of the joint"),
    "velocity": ("rad/s", "speed of the joint"),
    "acceleration": ("rad/s^2", "acceleration of the joint"),
    "sense": ("1", "direction of motion, -1 or 1; at rest the share of static friction in use"),
}
INPUTS: Mapping[str, tuple[str, str]] = {
    "current": ("A", "motor current as the drive measures it"),
    "contact_force": ("N", "contact force F_P of the load"),
    "load_torque": (
        "N m",
        "torque of other known loads, positive if it turns the joint forward",
    ),
    "weight_mass": ("kg", "mass on the lever"),
}
OUTPUTS: Mapping[str, tuple[str, str]] = {
    "required": ("N m", "torque that the motion requires of drive and known loads"),
    "drive": ("N m", "torque of the motor current at the joint"),
    "motor_angle": ("rad", "angle of the motor"),
    "voltage": ("V", "voltage that the motor current requires"),
}


@dataclass(frozen=True)
class Quantity:
    """A parameter of the exported model, SI, with its 90 % interval where it is known."""

    name: str
    value: float
    unit: str
    words: str
    low: float | None = None
    high: float | None = None

    @property
    def interval(self) -> str:
        """The interval as words for a comment; empty where it is unknown."""
        if self.low is None or self.high is None:
            return ""
        return f", 90 % interval {self.low:.6g} to {self.high:.6g}"


@dataclass(frozen=True)
class LeftOut:
    """An effect, ``whole`` or in part, that a simulation lacks, with its size and the reason."""

    name: str
    parameters: Mapping[str, float]
    reason: str
    whole: bool

    @property
    def words(self) -> str:
        """Name, size and reason."""
        size = ", ".join(f"{n} {v:.6g}" for n, v in self.parameters.items())
        return f"{self.name} ({size}): {self.reason}"


@dataclass(frozen=True)
class Machine:
    """The model of a machine as equations.

    Attributes:
        name: Name, a C identifier.
        motion: ``rotary`` or ``linear``.
        parameters: Parameters in order.
        outputs: Name from :data:`OUTPUTS` to its node.
        residual: Required torque less the drive's and the known loads', N m, after the first
            sample.
        memories: Memories of the model: name to node.
        largest_step: Greatest step of a simulation, s.
        ranges: Signal to least and greatest value in the recordings.
        left_out: What the simulation lacks.
        source: Where the model is from, for comments.
        amperes: Whether torques are in amperes.
    """

    name: str
    motion: str
    parameters: tuple[Quantity, ...]
    outputs: Mapping[str, Node]
    residual: Node
    memories: Mapping[str, Node]
    largest_step: float
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    left_out: tuple[LeftOut, ...] = ()
    source: str = ""
    amperes: bool = False

    def unit(self, rotary: str) -> str:
        """Return a unit on this bench."""
        return unit_on(self.motion, rotary, self.amperes)

    def unit_of(self, signal: str) -> str:
        """Return the unit of an input or output; the motor's angle is in rad on any bench."""
        unit, _ = {**SIGNALS, **INPUTS, **OUTPUTS}[signal]
        return unit if signal == "motor_angle" else self.unit(unit)

    def steady(self, speed: Array, angle: Array, contact_force: float = 0.0) -> Array:
        """Return the motor torque that steady motion requires, N m at the joint, shape (n,).

        Args:
            speed: Speeds, rad/s, shape (n,), not zero.
            angle: Angles at which each motion is after a long travel, rad, shape (n,).
            contact_force: F_P, N.
        """
        step = np.maximum(STEADY_TRAVEL_RAD / np.abs(speed), STEADY_TIME_S) / STEADY_STEPS
        zero = np.zeros(len(speed))
        known = {node(0.0, "input", (), n): zero for n in (*SIGNALS, *INPUTS)}
        of = {n.name: n for n in known}
        known |= {of["velocity"]: speed, of["sense"]: np.sign(speed), STEP: step}
        known[of["contact_force"]] = np.full(len(speed), contact_force)
        known |= dict.fromkeys(self.memories.values(), zero)
        updates = [m.update for m in self.memories.values()]
        torque = zero
        with np.errstate(all="ignore"):  # values that a choice does not take
            for k in range(STEADY_STEPS):
                known[of["angle"]] = angle + speed * step * (k + 1 - STEADY_STEPS)
                known[FIRST] = np.full(len(speed), k == 0)
                torque, *new = computed([self.residual, *updates], known, OF_ARRAYS)
                known |= dict(zip(self.memories.values(), new, strict=True))
        return np.asarray(torque + zero)


FIRST = node(False, "input", (), "first")
STEP = node(0.0, "input", (), "step")


class _Signals(SimpleNamespace):
    """Symbols in place of the signals of a :class:`identification.views.view.View`."""

    def with_velocity(self, velocity: Node) -> Self:
        """Return the signals with another velocity of the joint."""
        return type(self)(**{**vars(self), "velocity": velocity})

    def __hash__(self) -> int:  # type: ignore[override]
        return id(self)


def _signals(symbols: Symbols, bench: SimpleNamespace) -> _Signals:
    given = {n: node(0.0, "input", (), n) for n in (*SIGNALS, *INPUTS)}
    s = _Signals(**{n: given[n] for n in (*SIGNALS, "current", "weight_mass")})
    s.step, s.still = STEP, s.velocity == 0.0
    time = memory("time", node(0.0, "key", (), "time"))
    time.update = symbols.started(node(0.0), time + STEP)
    s.time = s.run_time = node(0.0, "time", (time.update,), "time")
    # A rest counts from its first sample to the first sample of the motion after it.
    rest = memory("rest_time", node(0.0, "key", (), "rest_time"))
    was_still = apply("and", apply("not", FIRST), s.still)[slice(None, -1)]
    s.rest_time = rest.update = symbols.started(
        node(0.0), apply("choose", was_still, rest + STEP, apply("choose", s.still, 0.0, rest))
    )
    s.moment = given["contact_force"] * bench.moment_arm
    s.known = s.hanging = given["load_torque"]
    s.loaded, s.burdened = (apply("not", load == 0.0) for load in (s.moment, s.known))
    s.transmitted = bench.ampere_torque * s.current
    s.torque = s.transmitted + s.known
    s.motor, s.drive_angle, s.lag = bench.gear_ratio * s.angle, s.angle, None
    s.motor_speed, s.twist = bench.gear_ratio * s.velocity, node(0.0)
    s.rotor_acceleration, s.supply = s.acceleration, None
    s.index, s.before, s.voltage_is_computed = 0, None, False
    s.recording = SimpleNamespace(
        bench=bench, pendulum=None, weight_mass=s.weight_mass, channels={"current": s.current}
    )
    s.voltage = symbols.function(winding_voltage)(s)
    return s


def machine(
    name: str,
    model: CorrectedModel,
    bench: Bench,
    intervals: Mapping[str, tuple[float | None, float | None]],
    ranges: Mapping[str, tuple[float, float]],
    source: str = "",
    own: bool = True,
    amperes: bool = False,
) -> Machine:
    """Return the equations of a corrected model.

    Args:
        name: Name of the model, a C identifier.
        model: The model.
        bench: Constants of the bench.
        intervals: Name of a parameter, or ``effect.parameter``, to the ends of its interval.
        ranges: Signal to its least and greatest value in the recordings.
        source: Where the model is from, for comments.
        own: Whether to contain effects of one's own as far as their functions allow it.
        amperes: Whether the torques of the model are in amperes.
    """
    motion, quantities = bench.motion, _Quantities(intervals)
    values = {
        n: quantities(n, v, unit_on(motion, UNITS_ROTARY.get(n, "1"), amperes), "nominal model")
        for n, v in model.parameters.items()
        if n in UNITS_ROTARY
    }
    alpha = quantities("alpha", model.alpha, "1", "exponent of the Stribeck curve")
    constant = {
        n: quantities(n, model.parameters.get(symbol, known), unit, "constant of the bench")
        for n, symbol, known, unit in (
            ("resistance", "R", bench.resistance, "ohm"),
            ("inductance", "L", bench.inductance, "H"),
            ("back_emf_constant", "Ke", bench.back_emf_constant, "V s/rad"),
            ("moment_arm", "L1", bench.moment_arm, "m"),
            ("gear_ratio", "i", bench.gear_ratio, "1" if motion == "rotary" else "rad/m"),
            (
                *("torque_constant", "Km", bench.torque_constant or 1.0 / bench.gear_ratio),
                "1" if amperes else "N m/A",
            ),
        )
    }
    known = SimpleNamespace(
        **constant, ampere_torque=constant["torque_constant"] * constant["gear_ratio"]
    )
    symbols = Symbols(
        STEP,
        FIRST,
        {
            initial_friction: lambda *_: node(0.0),
            mean_over_sample: lambda view, zero, _, law: law(view.current - zero),
        },
    )
    s = _signals(symbols, known)
    methods = {
        n: symbols.function(f)
        for c in (NominalTorque, Nominal)
        for n, f in vars(c).items()
        if callable(f) and not n.startswith("__") and n != "get"
    }
    methods["get"] = lambda self, name: self.values.get(name, node(0.0))
    symbolic = type("Symbolic", (Nominal,), methods)
    plain = nominal = symbolic(values, (), alpha)
    placed, left_out, values_of = [], [], {}
    for each, given in model.effects.items():
        effect = model.catalogue[each]
        if effect.place is not None:
            left_out.append(LeftOut(each, given, effect.not_simulated, whole=True))
            continue
        inner = {
            q.name: quantities(
                f"{each}.{q.name}",
                given[q.name],
                parameter_unit(motion, q.name, q.unit, amperes) or "1",
                effect.equation,
            )
            for q in effect.parameters
        }
        shape, coefficients = symbols.function(type(effect).at)(effect, inner, plain)
        placed.append((effect, shape, coefficients))
        values_of[each] = inner
    for effect, shape, coefficients in placed:
        feeds_back = symbols.function(type(effect).feeds_back)
        nominal = feeds_back(effect, nominal, shape, coefficients)
    for k, (effect, shape, coefficients) in enumerate(placed):
        nominal, shape = symbols.function(type(effect).begin)(effect, nominal, shape)
        placed[k] = effect, shape, coefficients
    responses: dict[str, list[Node]] = {}
    for effect, shape, coefficients in placed:
        added: Mapping[str, Node] = {}
        reason = effect.not_simulated
        try:
            if not isinstance(effect, OwnEffect):
                added = _added(symbols, effect, s, nominal, shape, coefficients)
            elif own:
                added = _own(symbols, effect, s, nominal, values_of[effect.name])
            else:
                reason = OF_ONE_SAMPLE
        except NotCausalError:
            pass
        except Exception as error:
            if not isinstance(effect, OwnEffect):
                raise
            reason = f"{OF_ONE_SAMPLE} ({type(error).__name__}: {error})"
        if reason or not added:
            given = model.effects[effect.name]
            left_out.append(LeftOut(effect.name, given, reason, whole=not added))
        for equation, value in added.items():
            responses.setdefault(equation, []).append(value)

    def of(equation: str) -> Any:
        return total([*responses.get(equation, ()), *_carried(model.curve, equation, s)])

    required = explored(lambda: nominal.torque(s)) + of("torque")
    drive = s.transmitted - of("drive")
    outputs = {
        "required": required,
        "drive": drive,
        "motor_angle": constant["gear_ratio"] * (s.angle + of("transmission")),
        "voltage": s.voltage + of("voltage"),
    }
    outputs = dict(zip(outputs, _timed(list(outputs.values())), strict=True))
    (residual,) = substituted(
        [outputs["required"] - outputs["drive"] - s.known], {FIRST: node(False)}
    )
    memories = _memories([*outputs.values(), residual])
    used = set(ordered([*outputs.values(), *(m.update for m in memories.values())]))
    kept = tuple(q for n, q in quantities.found.items() if n in used)
    step = _largest_step(model, bench.moment_arm, ranges)
    return Machine(
        *(name, motion, kept, outputs, residual, memories, step, ranges, tuple(left_out), source),
        amperes=amperes,
    )


class _Quantities:
    """Makes nodes of parameters, and lists them."""

    def __init__(self, intervals: Mapping[str, tuple[float | None, float | None]]) -> None:
        self.intervals = intervals
        self.found: dict[Node, Quantity] = {}

    def __call__(self, key: str, value: float | None, unit: str, words: str) -> Node:
        name = key.replace(".", "_")
        ends = self.intervals.get(key, (None, None))
        made = node(float(value or 0.0), "parameter", (), name)
        self.found[made] = Quantity(name, made.value, unit, words, *ends)
        return made


def _added(
    symbols: Symbols, effect: Effect, s: _Signals, nominal: Any, shape: Any, coefficients: Any
) -> Mapping[str, Node]:
    """Return what an effect adds to each equation."""
    out = {}
    for equation, regressors in effect.corrected.items():
        if equation == "breakaway":
            continue
        function = symbols.function(regressors)
        rows = explored(lambda f=function: list(f(s, nominal, shape)))  # type: ignore[misc]
        added = total(c * r for c, r in zip(map(node, coefficients), rows, strict=True))
        out["drive" if equation == "torque" and effect.on_drive else equation] = added
    return out


def _own(
    symbols: Symbols, effect: OwnEffect, s: _Signals, nominal: Any, values: Mapping[str, Node]
) -> Mapping[str, Node]:
    """Return what an effect of one's own adds to each equation: its function, called with symbols;
    its states are memories.
    """
    seen, p, out = _Seen(s, nominal), SimpleNamespace(**values), {}
    used = explored(lambda: [node(getattr(seen, name)) for name in sorted(effect.used)])
    for equation, call, _ in effect.functions.values():
        function = symbols.function(call)
        own = node(0.0, "key", (*values.values(), *used), f"{effect.name}_{equation}")
        names = [f"{effect.name}_{k}" for k in range(effect.states)]
        kept = [memory(name, node(0.0, "key", (own,), name)) for name in names]

        def sample(states: list[Any], f: Any = function) -> list[Node]:
            x = Written(states)
            found = f(seen, x, STEP, p) if states else f(seen, p)
            return [node(found), *map(node, x)]

        (at_first, *starts), (later, *updates) = (
            explored(lambda x=x: sample(x))  # type: ignore[misc]
            for x in ([0.0] * effect.states, kept)
        )
        for each, start, update in zip(kept, starts, updates, strict=True):
            each.update = symbols.started(start, update)
        out[equation] = symbols.started(at_first, later)
    if "breakaway" in out:
        out.setdefault("torque", out.pop("breakaway"))
    return out


class _Seen:
    """Symbols by the names that a function of one's own uses."""

    def __init__(self, view: _Signals, nominal: Any) -> None:
        self.view, self.nominal = view, nominal

    def __getattr__(self, name: str) -> Any:
        if name in MODELLED:
            return getattr(self.nominal, MODELLED[name])(self.view)
        if getattr(self.view, MEASURED[name]) is None:
            raise AttributeError(f"a simulation has no signal {name}")
        return getattr(self.view, MEASURED[name])


def _carried(curve: Curve | None, equation: str, s: _Signals) -> Sequence[Node]:
    """Return the empirical curve, as a sum of slopes between its points."""
    if curve is None or curve.equation != equation or curve.coordinate not in COORDINATES:
        return ()
    x = getattr(s, COORDINATES[curve.coordinate])
    value: Any = node(float(curve.value[0]))
    slopes = np.diff(curve.value) / np.diff(curve.grid)
    for left, width, slope in zip(curve.grid, np.diff(curve.grid), slopes, strict=False):
        value = value + float(slope) * apply("min", apply("max", x - left, 0.0), float(width))
    return (s.sense * value if curve.against_motion else value,)


def _timed(roots: list[Node]) -> list[Node]:
    """Return the roots without the marks of times, which serve to give their first value."""
    marks = {n: n.arguments[0] for n in ordered(roots) if n.operation == "time"}
    return substituted(roots, marks)


def _memories(roots: list[Node]) -> Mapping[str, Node]:
    """Return all memories that the roots depend on, by unique names."""
    found: dict[str, Node] = {}
    seen: set[Node] = set()
    pending = list(roots)
    while pending:
        for each in ordered([pending.pop()]):
            if each.operation == "memory" and each not in seen:
                seen.add(each)
                (each.update,) = _timed([each.update])
                name, k = each.name, 1
                while name in found:
                    k += 1
                    name = f"{each.name}_{k}"
                found[name] = each
                pending.append(each.update)
    return found


def _largest_step(
    model: CorrectedModel, arm: float | None, ranges: Mapping[str, tuple[float, float]]
) -> float:
    """Return the greatest step at which friction that falls with speed leaves one solution, s."""
    value = model.parameters.get
    moment = ranges.get("contact_force", (0.0, 0.0))[1] * (arm or 0.0)
    steepest = sum(
        share * (value(static, 0.0) - value(coulomb, 0.0)) / speed
        for coulomb, static, name, share in (
            ("Mc", "Ms", "omega_sf", 1.0),
            ("mu_c", "mu_s", "omega_sL", moment),
        )
        if (speed := value(name, 0.0)) > 0.0
    )
    inertia = value("J", 0.0)
    step = min(LARGEST_STEP_S, STEP_SHARE * inertia / steepest if steepest else LARGEST_STEP_S)
    digit = 10.0 ** math.floor(math.log10(step)) if step > 0.0 else 1.0
    return float(f"{math.floor(step / digit) * digit:.0e}")
