"""The machine as a self-contained model in Modelica: one clocked function with the state."""

from __future__ import annotations

import math

from identification.export.c import EVERY, filled, notes
from identification.export.machine import INPUTS, Machine
from identification.export.printed import Language, number, roots_of, statements
from identification.export.symbols import Node

_MODELICA = Language(
    forms={
        "power": "({0} ^ {1})",
        "and": "({0} and {1})",
        "or": "({0} or {1})",
        "not": "(not {0})",
        "choose": "(if {0} then {1} else {2})",
        "expm1": "(exp({0}) - 1.0)",
        "atanh": "(0.5 * log((1.0 + {0}) / (1.0 - {0})))",
    },
    declared="Real {0} := {1};",
    logical="Boolean {0} := {1};",
    truth=("false", "true"),
)
_WORDS = """
    abs acos algorithm and annotation asin assert atan atan2 block boolean break cardinality ceil
    change class clock connect connector constant constrainedby cos cosh cross delay der diagonal
    discrete div each edge else elseif elsewhen encapsulated end enumeration equation exp expandable
    extends external false fill final flow floor for function homotopy identity if import impure in
    initial inner input integer interval linspace log log10 loop machine matrix max min mod model
    ndims noevent not operator or outer output outerproduct package parameter partial pre product
    protected public pure real record redeclare reinit rem replaceable return sample scalar sign sin
    sinh size skew smooth spatialdistribution sqrt stream string sum symmetric tan tanh terminal
    terminate test then time transpose true type vector when while within zeros ones
"""
NAMES = frozenset(_WORDS.split())
"""Words of Modelica and of the texts here, in small letters, which cannot be the name of a model.
"""
_TEXT = """\
// Simulation of @SOURCE@.
// The model advances at every `interval`; set-valued friction holds the joint exactly still.
@NOTES@model @NAME@
@PARAMETERS@  parameter Real interval(unit = "s") = @STEP@
    "time between two steps; a longer one than @STEP@ is divided";
  parameter Real start_angle(unit = "@ANGLE@") = 0.0 "angle at the start";
  parameter Real start_velocity(unit = "@SPEED@") = 0.0 "speed at the start";
@INPUTS@@OUTPUTS@protected
  parameter Real step = interval / max(ceil(interval / @STEP@ - 1e-9), 1.0);
  discrete Real z[@SIZE@](each start = 0.0, each fixed = true);
  Real y[@SIZE@] = if z[9] > 0.5 then z
    else begun({@NAMES@}, {@INPUT_NAMES@}, {start_angle, start_velocity});

  // Required torque less the torque of drive and loads. p: parameters; z: outputs of the previous
  // sample, whether it exists, memories; x: inputs, angle, velocity, acceleration, sense, step.
  function residual
    input Real p[@COUNT@];
    input Real z[@SIZE@];
    input Real x[9];
    output Real missing;
@RESIDUAL@  end residual;

  // Outputs and memories after this sample.
  function keep
    input Real p[@COUNT@];
    input Real z[@SIZE@];
    input Real x[9];
    input Boolean first;
    output Real y[@SIZE@];
@EVALUATE@  end keep;

  function sampled
    input Real z[@SIZE@];
    input Real u[4];
    input Real h;
    input Real speed;
    input Real sense;
    output Real x[9];
  algorithm
    x := {u[1], u[2], u[3], u[4], z[1] + 0.5 * h * (speed + z[2]), speed, (speed - z[2]) / h,
          sense, h};
  end sampled;

  // One step, in which friction holds the joint or the speed has one sign.
  function advance
    input Real p[@COUNT@];
    input Real z[@SIZE@];
    input Real u[4];
    input Real h;
    output Real y[@SIZE@];
  protected
    Real up;
    Real down;
    Real side;
    Real low;
    Real high;
    Real last;
    Real before;
    Real start;
    Real speed;
    Real value;
    Real next;
    Boolean done;
    Integer k;
  algorithm
    up := residual(p, z, sampled(z, u, h, 0.0, 1.0));
    down := if up < 0.0 then up else residual(p, z, sampled(z, u, h, 0.0, -1.0));
    side := if up < 0.0 then 1.0 else -1.0;
    speed := if abs(z[2]) > 0.0 then abs(z[2]) else 1e-6;
    low := 0.0;
    high := 1e300;
    last := 0.0;
    start := if up < 0.0 then abs(up) else abs(down);
    before := -start;
    done := false;
    k := 0;
    if up >= 0.0 and down <= 0.0 then
      done := true;
      speed := 0.0;
      side := if up > down then -(up + down) / (up - down) else 0.0;
    end if;
    while k < 200 and not done loop
      value := side * residual(p, z, sampled(z, u, h, side * speed, side));
      if value < 0.0 then
        low := speed;
      else
        high := speed;
      end if;
      next := if value == before then high else speed - value * (speed - last) / (value - before);
      done := value == 0.0 or abs(next - speed) <= 1e-12 * speed + 1e-18;
      if not done and (not (low < next and next < high) or (mod(k, 10) == 9 and high < 1e300)) then
        next := if high < 1e300 then 0.5 * (low + high) else 2.0 * speed;
      end if;
      done := done or high - low <= 1e-13 * speed;
      if done and abs(value) > 1e-6 * start then
        next := low;
      end if;
      last := speed;
      before := value;
      speed := if value == 0.0 then speed else next;
      k := k + 1;
    end while;
    y := keep(p, z, sampled(z, u, h, if speed > 0.0 then side * speed else 0.0, side), false);
  end advance;

  // The first sample.
  function begun
    input Real p[@COUNT@];
    input Real u[4];
    input Real start[2];
    output Real y[@SIZE@];
  algorithm
    y := keep(p, fill(0.0, @SIZE@), {u[1], u[2], u[3], u[4], start[1], start[2], 0.0,
              sign(start[2]), @STEP@}, true);
  end begun;

  function stepped
    input Real p[@COUNT@];
    input Real z[@SIZE@];
    input Real u[4];
    input Real h;
    input Real start[2];
    output Real y[@SIZE@];
  algorithm
    y := if z[9] > 0.5 then z else begun(p, u, start);
    y := advance(p, y, u, h);
  end stepped;
equation
  when sample(step, step) then
    z = stepped({@NAMES@}, pre(z), {@INPUT_NAMES@}, step,
                {start_angle, start_velocity});
  end when;
@COPIES@end @NAME@;
"""


def modelica_text(machine: Machine) -> str:
    """Return the machine as a Modelica model."""
    places = {q.name: k for k, q in enumerate(machine.parameters, 1)}
    members = {n: k for k, n in enumerate(machine.memories.values(), len(EVERY) + 2)}
    signals = (*INPUTS, "angle", "velocity", "acceleration", "sense", "step")

    def known(each: Node) -> str | None:
        if each.operation == "parameter":
            return f"p[{places[each.name]}]"
        if each.operation == "input":
            return "first" if each.name == "first" else f"x[{signals.index(each.name) + 1}]"
        return f"z[{members[each]}]" if each.operation == "memory" else None

    lines, (missing,) = statements([machine.residual], known, _MODELICA)
    outputs, updates = roots_of(machine)
    more, found = statements([*outputs, *updates], known, _MODELICA)
    motion = [f"x[{k}]" for k in range(5, 9)]
    kept = [*motion, *found[: len(outputs)], "1.0", *found[len(outputs) :]]
    assigned = [f"y[{k}] := {text};" for k, text in enumerate(kept, 1)]

    def declared(kind: str, name: str, unit: str, value: float, words: str) -> str:
        unit = f'unit = "{_unit(unit)}"'
        start = f"start = {number(value)}, " if kind == "input" else ""
        given = f" = {number(value)}" if kind == "parameter" else ""
        return f'  {kind} Real {name}({start}{unit}){given} "{words}";\n'

    return filled(
        _TEXT,
        machine,
        SOURCE=machine.source,
        NOTES=notes(machine, "// "),
        PARAMETERS="".join(
            declared("parameter", q.name, q.unit, q.value, q.unit + q.interval)
            for q in machine.parameters
        ),
        STEP=number(machine.largest_step),
        ANGLE=_unit(machine.unit_of("angle")),
        SPEED=_unit(machine.unit_of("velocity")),
        INPUTS="".join(
            declared("input", n, machine.unit_of(n), 0.0, w) for n, (_, w) in INPUTS.items()
        ),
        OUTPUTS="".join(
            declared("output", n, machine.unit_of(n), 0.0, w) for n, (_, w) in EVERY.items()
        ),
        SIZE=str(len(EVERY) + 1 + len(members)),
        COUNT=str(len(places)),
        RESIDUAL=_body(lines, [f"missing := {missing};"]),
        EVALUATE=_body(more, assigned),
        NAMES=", ".join(places),
        INPUT_NAMES=", ".join(INPUTS),
        COPIES="".join(f"  {n} = y[{k}];\n" for k, n in enumerate(EVERY, 1)),
    )


def _unit(unit: str) -> str:
    """Return a unit as Modelica writes units."""
    return unit.replace(" ", ".").replace("^", "")


def _body(lines: list[str], last: list[str]) -> str:
    """Return declarations and statements of a function."""
    split = [line.split(" ", 2) for line in lines]
    declarations = "".join(f"    {kind} {name};\n" for kind, name, _ in split)
    protected = f"  protected\n{declarations}" if lines else ""
    texts = "".join(f"    {text}\n" for text in [*(f"{n} {t}" for _, n, t in split), *last])
    return f"{protected}  algorithm\n{texts}"


def modelica_test(
    machine: Machine, peak: float, frequency: float, load: tuple[float, float], start: float
) -> str:
    """Return a model whose outputs are those of the test file of a simulation.

    Args:
        machine: The machine.
        peak: Amplitude of the current, A.
        frequency: Its frequency, Hz.
        load: Contact force, N, and mass on the lever, kg.
        start: Time from which the load acts, s.
    """
    outputs = "".join(f"  output Real {n};\n" for n in EVERY)
    equations = "".join(f"  {n} = machine.{n};\n" for n in EVERY)
    return f"""\
model test
  {machine.name} machine;
{outputs}equation
  machine.current = {number(peak)} * sin(2.0 * {number(math.pi)} * {number(frequency)} * time);
  machine.contact_force = if time > {number(start)} then {number(load[0])} else 0.0;
  machine.load_torque = 0.0;
  machine.weight_mass = if time > {number(start)} then {number(load[1])} else 0.0;
{equations}end test;
"""
