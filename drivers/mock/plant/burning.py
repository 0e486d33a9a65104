"""Integrates the simulated machine over time, with the load of a weight or of a gas generator.

The machine may have injected effects. While the gas generator burns (Fig. 5, 11), valve angle and
pressure determine the contact force (eq. 10), and the contact force determines the friction at the
valve. The valve angle also affects the pressure.
"""

from __future__ import annotations

from drivers.mock.plant.effects import table
from drivers.mock.plant.effects.kernel import advance_hiding
from drivers.mock.plant.effects.sensing import Histories
from drivers.mock.plant.effects.state import JOINT, RUN, SEEN
from drivers.mock.plant.gas import ARM, FORCE, LOOPS_PER_STEP, MASS, PENDING, step_gas
from drivers.mock.plant.parts.compiled import Vector, compiled
from drivers.mock.plant.parts.friction import MOMENT
from drivers.mock.plant.parts.loops import LOOP_S, THETA, advance

REFERENCE_FORCE_N = 3000.0
"""Contact force at which the injected effect ``load_exponent`` has no effect."""


@compiled
def felt_force(force: float, e: Vector) -> float:
    """Return the effective contact force, to which friction is proportional, N.

    With the injected effect ``load_exponent``, the effective force is a power of the contact force
    ``force``, equal to ``force`` at the reference force. Without this effect it is equal to
    ``force``.
    """
    if len(e) > 0 and e[table.LOAD_EXPONENT] > 0.0 and force > 0.0:
        return float(REFERENCE_FORCE_N * (force / REFERENCE_FORCE_N) ** e[table.LOAD_EXPONENT])
    return force


@compiled
def advance_loaded(
    loops: int,
    s: Vector,
    x: Vector,
    histories: Histories,
    d: Vector,
    p: Vector,
    e: Vector,
    y: Vector,
    g: Vector,
    noise: Vector,
    path: Vector,
) -> None:
    """Advance ``loops`` drive-loop periods; the arguments are those of the kernels of machine and
    gas generator, of which ``y`` and ``g`` belong to the gas generator.

    In each gas step the contact force is that at the start of the step; at 50 deg/s the force
    changes by 0.5 N in 100 microseconds. Steps are counted from ignition, so that the result does
    not depend on how the time is divided among calls.
    """
    burns = y[MASS] > 0.0
    done = 0
    while done < loops:
        n = min(int(g[LOOPS_PER_STEP] - y[PENDING]), loops - done) if burns else loops
        if burns:
            p[MOMENT] = felt_force(y[FORCE], e) * g[ARM]
        part = path[done : done + n]
        if len(e) > 0:
            advance_hiding(n, s, x, histories, d, p, e, noise[done : done + n], part)
        else:
            advance(n, s, d, p, noise[done : done + n], part)
            x[RUN] += n * d[LOOP_S]
            x[SEEN] = s[THETA]
        done += n
        if burns:
            y[PENDING] += n
            if y[PENDING] >= g[LOOPS_PER_STEP]:
                step_gas(y, g, x[JOINT] if len(e) > 0 else s[THETA], y[PENDING] * d[LOOP_S])
                y[PENDING] = 0.0
