"""Prints the equations of a machine as statements of a language, and as plain Python."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

from identification.export.machine import INPUTS, OUTPUTS, Machine
from identification.export.symbols import LOGICAL, Node, ordered

LONGEST = 60
"""Length of an expression from which it becomes a variable of its own."""


@dataclass(frozen=True)
class Language:
    """How a language writes operations.

    Attributes:
        forms: Operation to its format, with ``{0}`` for the first operand; other operations are
            functions of their name.
        declared: Format of a statement that gives a name to a value.
        logical: The same for a value that is true or false.
        truth: Words for false and true.
    """

    forms: Mapping[str, str]
    declared: str
    logical: str
    truth: tuple[str, str]

    def write(self, each: Node, operands: Sequence[str]) -> str:
        """Return one operation of the graph of equations as source text of this language."""
        operation = each.operation
        form = self.forms.get(operation)
        if form is None:
            form = "({0} %s {1})" % operation if len(operation) < 3 else operation + "({0}, {1})"  # noqa: UP031
            form = form if len(operands) > 1 else operation + "({0})"
        return form.format(*operands)


def number(value: float) -> str:
    """Return a constant as text that every language reads as the same number."""
    text = repr(float(value))
    return f"({text})" if text.startswith("-") else text


def statements(
    roots: Sequence[Node], known: Callable[[Node], str | None], language: Language
) -> tuple[list[str], list[str]]:
    """Return statements and the expressions of the roots.

    Args:
        roots: Nodes to write.
        known: Function that returns the text of a node that the program has already, else None.
        language: The language.
    """
    given = {n: t for n in ordered(list(roots)) if (t := known(n)) is not None}
    every = ordered(list(roots), given)
    uses = Counter(a for n in every if n not in given for a in n.arguments)
    texts: dict[Node, str] = dict(given)
    lines: list[str] = []
    for each in every:
        if each in given:
            continue
        if each.operation == "constant":
            truth = language.truth[int(each.value)] if each.logical else number(each.value)
            texts[each] = truth
            continue
        text = language.write(each, [texts[a] for a in each.arguments])
        if uses[each] > 1 or len(text) > LONGEST:
            form = language.logical if each.logical else language.declared
            name = f"v{len(lines) + 1}"
            lines.append(form.format(name, _bare(text)))
            text = name
        texts[each] = text
    return lines, [texts[r] for r in roots]


def _bare(text: str) -> str:
    """Return an expression without parentheses around the whole."""
    depth = 0
    for k, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return text[1:-1] if text.startswith("(") and k == len(text) - 1 else text
    return text


def derived(roots: Collection[Node]) -> list[Node]:
    """Return the values that depend on parameters alone and that the roots use."""
    every = ordered(list(roots))
    used = {a for n in every if not n.fixed for a in n.arguments} | set(roots)
    return [
        n
        for n in every
        if n in used and n.fixed and n.arguments and n.operation not in LOGICAL and not n.logical
    ]


def roots_of(machine: Machine) -> tuple[list[Node], list[Node]]:
    """Return the nodes of all outputs and of all memories at the present sample."""
    return list(machine.outputs.values()), [m.update for m in machine.memories.values()]


_PYTHON = Language(
    forms={
        "/": "quotient({0}, {1})",
        "and": "({0} and {1})",
        "or": "({0} or {1})",
        "not": "(not {0})",
        "choose": "({1} if {0} else {2})",
        "==": "({0} == {1})",
        **{n: f"math.{n}({{0}})" for n in ("sin", "cos", "tanh", "expm1")},
    },
    declared="{0} = {1}",
    logical="{0} = {1}",
    truth=("False", "True"),
)
_PYTHON_TEXT = '''\
"""Simulation of {source}; needs Python alone.

    model = Model(J=0.3)                    parameters other than those of the file
    model.start(angle=0.1, velocity=0.0)
    out = model.step(0.001, current=2.0)    one step: time in s, then the inputs
    out["angle"], out["velocity"]

Inputs, held over the step: {inputs}.
Outputs: angle, velocity, acceleration, sense, {outputs}.
{notes}"""

from __future__ import annotations

import math

PARAMETERS = {{
{parameters}}}
LARGEST_STEP_S = {largest_step!r}
"""A longer step is divided."""


class Model:
    """The model with its state. Set-valued friction holds the joint exactly still."""

    def __init__(self, **parameters: float) -> None:
        """Take other values of parameters."""
        for name in parameters:
            if name not in PARAMETERS:
                raise ValueError(f"no parameter {{name}}; there are {{', '.join(PARAMETERS)}}")
        self.p = {{**PARAMETERS, **parameters}}
        self.start()

    def start(self, angle: float = 0.0, velocity: float = 0.0) -> None:
        """Start a simulation."""
        self.angle, self.velocity, self.first = angle, velocity, True
        self.m = {{}}

    def step(self, dt: float, current: float = 0.0, contact_force: float = 0.0,
             load_torque: float = 0.0, weight_mass: float = 0.0) -> dict[str, float]:
        """Advance by ``dt`` seconds."""
        x = dict(current=current, contact_force=contact_force, load_torque=load_torque,
                 weight_mass=weight_mass)
        if self.first:
            self.keep(dict(x, angle=self.angle, velocity=self.velocity, acceleration=0.0,
                           sense=sign(self.velocity), step=LARGEST_STEP_S), True)
        count = max(math.ceil(dt / LARGEST_STEP_S - 1e-9), 1)
        x["step"] = dt / count
        for _ in range(count):
            out = self.advance(x)
        return out

    def inverse(self, dt: float, angle: float, velocity: float, acceleration: float,
                **inputs: float) -> dict[str, float]:
        """Return the outputs for a motion that is given sample by sample."""
        moved = sign(velocity)
        self.sense = moved if moved or self.first else self.sense
        x = dict(current=0.0, contact_force=0.0, load_torque=0.0, weight_mass=0.0, step=dt,
                 angle=angle, velocity=velocity, acceleration=acceleration, sense=self.sense)
        return self.keep({{**x, **inputs}}, self.first)

    def keep(self, x: dict[str, float], first: bool) -> dict[str, float]:
        """Take a sample into the memory."""
        out, self.m = evaluate(self.p, self.m, x, first)
        self.angle, self.velocity, self.first = x["angle"], x["velocity"], False
        motion = {{n: x[n] for n in ("angle", "velocity", "acceleration", "sense")}}
        return {{**motion, **out}}

    def move(self, x: dict[str, float], speed: float, sense: float) -> None:
        """Set the motion at the end of the step."""
        h = x["step"]
        x["velocity"], x["acceleration"] = speed, (speed - self.velocity) / h
        x["angle"], x["sense"] = self.angle + 0.5 * h * (speed + self.velocity), sense

    def trial(self, x: dict[str, float], speed: float, sense: float) -> float:
        """Return the torque that is missing for a speed at the end of the step."""
        self.move(x, speed, sense)
        return residual(self.p, self.m, x)

    def advance(self, x: dict[str, float]) -> dict[str, float]:
        """Advance by one step, in which friction holds the joint or the speed has one sign."""
        up = self.trial(x, 0.0, 1.0)
        down = up if up < 0.0 else self.trial(x, 0.0, -1.0)
        if up >= 0.0 >= down:
            self.move(x, 0.0, -(up + down) / (up - down) if up > down else 0.0)
            return self.keep(x, False)
        side = 1.0 if up < 0.0 else -1.0
        low, high, last, before = 0.0, math.inf, 0.0, -abs(up if up < 0.0 else down)
        speed = abs(self.velocity) or 1e-6
        for k in range(200):
            value = side * self.trial(x, side * speed, side)
            low, high = (speed, high) if value < 0.0 else (low, speed)
            new = speed - quotient(value * (speed - last), value - before)
            if value == 0.0 or abs(new - speed) <= 1e-12 * speed + 1e-18:
                break
            if not low < new < high or (k % 10 == 9 and high < math.inf):
                new = 0.5 * (low + high) if high < math.inf else 2.0 * speed
            if high - low <= 1e-13 * speed:
                break
            last, before, speed = speed, value, new
        if not math.isfinite(value):
            raise ValueError("no speed solves the equations; are the inputs finite?")
        if value == 0.0:
            new = speed
        elif abs(value) > 1e-6 * abs(up if up < 0.0 else down):
            new = low  # the torque jumps, as where a gap closes
        self.move(x, side * new, side)
        return self.keep(x, False)


def sign(a: float) -> float:
    return 1.0 * (a > 0.0) - 1.0 * (a < 0.0)


def quotient(a: float, b: float) -> float:
    return a / b if b else math.copysign(math.inf, a) if a else math.nan


def power(a: float, b: float) -> float:
    return a * a if b == 2.0 else a**b


def exp(a: float) -> float:
    return math.exp(min(a, 709.0))


def sqrt(a: float) -> float:
    return math.sqrt(a) if a >= 0.0 else math.nan


def atanh(a: float) -> float:
    return math.atanh(a) if abs(a) < 1.0 else math.nan


def residual(p: dict[str, float], m: dict[str, float], x: dict[str, float]) -> float:
    """Return required torque less the torque of drive and loads."""
{residual}


def evaluate(p: dict[str, float], m: dict[str, float], x: dict[str, float], first: bool):
    """Return the outputs, and the memory after this sample."""
{evaluate}
'''


def simulation_text(machine: Machine) -> str:
    """Return the machine as a Python module that needs nothing else."""
    names = {n: k for k, n in machine.memories.items()}

    def known(each: Node) -> str | None:
        if each.operation == "parameter":
            return f"p[{each.name!r}]"
        if each.operation == "input":
            return "first" if each.name == "first" else f"x[{each.name!r}]"
        return f"m.get({names[each]!r}, 0.0)" if each.operation == "memory" else None

    lines, (rest,) = statements([machine.residual], known, _PYTHON)
    outputs, updates = roots_of(machine)
    more, texts = statements([*outputs, *updates], known, _PYTHON)
    out = ", ".join(f"{n!r}: {t}" for n, t in zip(machine.outputs, texts, strict=False))
    new = ", ".join(
        f"{n!r}: {t}" for n, t in zip(machine.memories, texts[len(outputs) :], strict=True)
    )
    notes = "".join(f"Not in the simulation: {left.words}.\n" for left in machine.left_out)
    return _PYTHON_TEXT.format(
        source=machine.source,
        inputs=", ".join(f"{n} ({machine.unit_of(n)})" for n in INPUTS),
        outputs=", ".join(f"{n} ({machine.unit_of(n)})" for n in OUTPUTS),
        notes=notes,
        parameters="".join(
            f"    {q.name!r}: {q.value!r},  # {q.unit}{q.interval}\n" for q in machine.parameters
        ),
        largest_step=machine.largest_step,
        residual="\n".join(f"    {line}" for line in [*lines, f"return {rest}"]),
        evaluate="\n".join(f"    {line}" for line in [*more, f"return {{{out}}}, {{{new}}}"]),
    )
