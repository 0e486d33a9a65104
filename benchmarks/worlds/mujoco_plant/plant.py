"""Simulates worlds with a machine in MuJoCo and the loops of a drive, and returns the signals.

MuJoCo's friction is a constraint that its solver keeps approximately. With the impedance and the
time constant chosen in :mod:`benchmarks.worlds.mujoco_plant.model` a stuck joint creeps by less
than 2e-6 of its speed scale, and breaks away within 0.5 % of the set level of friction; this level
is computed one step late. A step of MuJoCo accelerates the joint with the current at the end of the
step, and moves the joint with the speed at the end of the step. The angle before a step is logged
one time stamp later, so that the angle agrees with the current that caused the motion.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np

from benchmarks.worlds.loops import (
    CASCADE,
    COUNT,
    LAST,
    PERIOD,
    STATES,
    SUM,
    asked,
    settings,
)
from benchmarks.worlds.mujoco_plant.friction import (
    ALPHA,
    GEAR,
    KEPT,
    MC,
    MS,
    PER_A,
    PULL,
    SHARE,
    STEADY,
    W_SF,
    damping,
    dry,
    further,
    values,
)
from benchmarks.worlds.mujoco_plant.model import xml
from benchmarks.worlds.sizes import SIZES
from benchmarks.worlds.world import COMMAND_S, Array, Signals, World
from identification.numerics.compiled import compiled
from rig.common.errors import InputError

try:
    import mujoco
except ImportError:
    mujoco = None

MISSING = (
    "the plant mujoco needs the package mujoco; install it with: pip install 'loadrig[mujoco]'"
)
(CURRENT, VOLTAGE, TERMINAL, SUPPLY, SHAFT, ANGLE, COLUMNS) = range(7)


class Views(NamedTuple):
    """Views of MuJoCo's state and settings, which change in place.

    Attributes:
        angle: Angles of the joints, rad; that of the motor is first if it is a separate body.
        speed: Speeds of the joints, rad/s.
        states: States of the motor; the current is last.
        voltage: Voltage at the motor, V, shape (1,).
        applied: Further torques on the joints, N m.
        friction: Level of dry friction of the joints, N m.
        viscous: Linear damping of the joints, N m s/rad.
    """

    angle: Array
    speed: Array
    states: Array
    voltage: Array
    applied: Array
    friction: Array
    viscous: Array


class Given(NamedTuple):
    """Data with which one recording is simulated.

    Attributes:
        loop: Settings of the drive.
        law: Values of friction and further torques.
        stage: Values of the power stage and the mesh, in the order of the names in this module.
        loop_state: States of the drive.
        law_state: States of friction.
    """

    loop: Array
    law: Array
    stage: Array
    loop_state: Array
    law_state: Array


(DEAD, BRUSH, BRUSH_A, SAG, NOMINAL, MESH, MESH_N, MESH_AT, AT_MOTOR, START, STAGES) = range(11)


class MujocoPlant:
    """Plant that MuJoCo simulates; see :class:`benchmarks.worlds.seal.Plant`."""

    effects: Collection[str] = frozenset(n for n in SIZES if not n.startswith("x_"))
    outside: Collection[str] = frozenset({"x_timed_torque", "x_switching_torque", "x_cubic_spring"})
    not_scored: Collection[str] = frozenset(
        {
            "winding_heating.rise_K_per_W",
            "coupling_hysteresis.torque_Nm",
            "coupling_hysteresis.deflection_rad",
        }
    )

    def play(self, world: World) -> Iterator[Signals]:
        """Yield the signals of the machine in each recording.

        Raises:
            InputError: MuJoCo is not installed.
        """
        require_mujoco()
        session_s, heat = 0.0, 0.0
        for k, planned in enumerate(world.recordings):
            session_s = session_s + planned.pause_s if world.log.clock else 0.0
            cooling = world.effects.get("winding_heating", {}).get("time_s", 1.0)
            heat = heat * float(np.exp(-planned.pause_s / cooling)) if world.log.clock else 0.0
            signals, heat = _played(world, k, session_s, heat)
            yield signals
            session_s += len(planned.command) * COMMAND_S


def require_mujoco() -> None:
    """Check that MuJoCo is installed.

    Raises:
        InputError: MuJoCo is not installed; the message says how to install it.
    """
    if mujoco is None:
        raise InputError(MISSING)


def _played(world: World, k: int, session_s: float, heat: float) -> tuple[Signals, float]:
    """Return the signals of recording ``k``, and the temperature rise of the winding at its
    end, K.
    """
    planned, rate = world.recordings[k], world.drive.rate_Hz
    model = mujoco.MjModel.from_xml_string(xml(world, k, 1.0 / rate))
    data = mujoco.MjData(model)
    # States of MuJoCo's motor: temperature rise of the winding over ambient, then its current.
    heated = "winding_heating" in world.effects
    states = data.act[model.actuator_actadr[0] :][: model.actuator_actnum[0]]
    if heated:
        states[0] = heat
    given = Given(
        settings(world),
        values(world, k, session_s),
        _stage(world, session_s),
        np.zeros(STATES),
        np.zeros(KEPT),
    )
    views = Views(
        data.qpos,
        data.qvel,
        states,
        data.ctrl,
        data.qfrc_applied,
        model.dof_frictionloss,
        model.dof_damping if model.dof_damping.ndim == 1 else model.dof_damping[:, 0],
    )
    n = round(len(planned.command) * COMMAND_S * rate)
    at = np.arange(n) / rate
    command, torque = planned.sent(at)
    rng = np.random.default_rng([*world.seed, 7, k])
    noise = rng.standard_normal((2, n))
    noise[0] *= world.sensing.current_noise_A
    noise[1] *= world.sensing.flicker * given.loop[COUNT]
    out, inputs = (
        np.zeros((COLUMNS, n)),
        np.vstack(
            (command, np.gradient(command, 1.0 / rate), torque, world.host_sends(k, n), noise)
        ),
    )
    _hold(given, states)
    step = mujoco.mj_step
    for row in range(n):
        tick(row, views, given, inputs, out)
        step(model, data)
    first = round(planned.lead_s * rate)
    signals = Signals(
        current=out[CURRENT, first:],
        voltage=out[VOLTAGE, first:],
        terminal=out[TERMINAL, first:],
        supply=out[SUPPLY, first:],
        motor_angle=_a_step_later(out[SHAFT])[first:],
        angle=_a_step_later(out[ANGLE])[first:],
        command=command[first:],
        start_s=session_s + planned.lead_s,
    )
    return signals, float(states[0]) if heated else 0.0


def _hold(given: Given, states: Array) -> None:
    """Set the initial current to the value that holds the known steady load."""
    needed = -given.law[STEADY]
    states[-1] = needed / given.law[PER_A]
    if given.loop[CASCADE] > 0.0:
        given.loop_state[SUM] = needed


def _a_step_later(angle: Array) -> Array:
    return np.concatenate((angle[:1], angle[:-1]))


def _stage(world: World, session_s: float) -> Array:
    out, given = np.zeros(STAGES), world.effects
    out[DEAD] = given.get("inverter_dead_time", {}).get("voltage_V", 0.0)
    brush = given.get("brush_drop", {})
    out[BRUSH], out[BRUSH_A] = brush.get("voltage_V", 0.0), brush.get("current_A", 1.0)
    out[SAG], out[NOMINAL] = (
        given.get("supply_sag", {}).get("resistance_ohm", 0.0),
        world.motor.supply_V,
    )
    mesh = given.get("gear_mesh_ripple", {})
    out[[MESH, MESH_N, MESH_AT]] = [
        mesh.get(key, 0.0) for key in ("amplitude_rad", "per_turn", "phase_rad")
    ]
    out[AT_MOTOR], out[START] = float(world.sensing.motor_bits is not None), session_s
    return out


@compiled
def tick(row: int, views: Views, given: Given, inputs: Array, out: Array) -> None:
    """Compute the drive and the effects that MuJoCo does not have, before one step of MuJoCo.

    Args:
        row: Number of the step.
        views: MuJoCo's state, in which voltage, friction, damping and further torques are set.
        given: Settings and states.
        inputs: Angle sent, speed of this angle, torque sent, whether the host sends, noise of
            current and encoder, shape (6, n).
        out: Signals of every step, shape (COLUMNS, n).
    """
    p, f, stage = given.loop, given.law, given.stage
    dt, last = p[PERIOD], len(views.angle) - 1
    since = row * dt
    t = stage[START] + since
    q, w, current = views.angle[last], views.speed[last], views.states[-1]
    mesh = stage[MESH] * math.sin(stage[MESH_N] * q + stage[MESH_AT])
    shaft = views.angle[0] + mesh
    seen = shaft if stage[AT_MOTOR] > 0.0 else q
    if row == 0:
        given.loop_state[LAST] = round(seen / p[COUNT]) * p[COUNT]
    voltage = asked(
        p, given.loop_state, inputs[:4, row], seen + inputs[5, row], current + inputs[4, row]
    )
    sag = 1.0 - stage[SAG] * voltage * current / stage[NOMINAL] ** 2
    terminal = voltage * sag - stage[DEAD] * np.sign(current)
    push = f[PER_A] * current
    views.voltage[0] = terminal - stage[BRUSH] * math.tanh(current / stage[BRUSH_A])
    views.applied[:] = 0.0
    views.applied[0] = further(f, given.law_state, since, shaft * f[GEAR], w, current, dt)
    views.friction[last] = dry(f, given.law_state, t, q, w, push, dt)
    views.viscous[last] = damping(f, t, q)
    views.applied[last] += f[PULL]
    if last > 0:
        v = views.speed[0]
        views.friction[0] = f[SHARE] * (
            f[MC] + (f[MS] - f[MC]) * math.exp(-((abs(v) / f[W_SF]) ** f[ALPHA]))
        )
    out[CURRENT, row], out[VOLTAGE, row], out[TERMINAL, row] = current, voltage, terminal
    out[SUPPLY, row], out[SHAFT, row], out[ANGLE, row] = stage[NOMINAL] * sag, shaft * f[GEAR], q
