"""The machine as MJCF in two forms: damping and dry friction of the joint by least squares, and
MuJoCo's DC motor with its LuGre friction.

MuJoCo has neither the fall of friction with speed in the first form nor any effect that is not a
spring, a weight or cogging; both files state the torque that they leave out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from identification.export.machine import Machine
from identification.recording import Array

SPEED_RAD_S, TRAVEL_RAD = 0.5, 0.35
"""Greatest speed and half of the travel of the fit where the recordings' ranges are unknown."""
SPEEDS, ANGLES = 40, 9
"""Numbers of speeds in each direction and of angles of the fit."""
LEAST_GAIN = 0.05
"""Least share of the error that a spring or a weight must remove, so that the file has it."""
ROUNDING = 1e-9
"""Torque relative to the whole that counts as a rounding error."""
FLATTEST = 1e-6
"""Least change of a spring's torque over the travel, relative to the torque; a constant torque is
no spring.
"""
MUJOCO = "4.0"
"""Version whose `dcmotor` the second form is written for."""
BREAKAWAY_RAD = 1e-4
"""Deflection of the LuGre friction at which the joint breaks away."""
STANDARD_GRAVITY = 9.80665


class Grid(NamedTuple):
    """Speeds and angles of steady motion, rad/s and rad, shape (n,)."""

    speed: Array
    angle: Array


class Passive(NamedTuple):
    """Torque that MJCF's joint can have, N m: friction, damping, spring, weight; and the error.

    ``spring`` is stiffness, N m/rad, and rest angle, rad; ``weight`` is the greatest torque, N m,
    and the angle, rad, at which the weight hangs down; both are zeros where absent.
    """

    friction: float
    damping: float
    spring: tuple[float, float]
    weight: tuple[float, float]
    error: Array
    basis: Array


def grid_of(machine: Machine) -> Grid:
    """Return the grid of the fit: the range of the recordings."""
    low, high = machine.ranges.get("angle", (-TRAVEL_RAD, TRAVEL_RAD))
    fastest = max(map(abs, machine.ranges.get("velocity", (SPEED_RAD_S,))))
    speeds = (np.arange(SPEEDS) + 0.5) / SPEEDS * fastest
    angles = np.linspace(low, high, ANGLES)
    speed, angle = np.meshgrid(np.concatenate((-speeds[::-1], speeds)), angles)
    return Grid(speed.ravel(), angle.ravel())


def fitted(torque: Array, grid: Grid, linear: bool = False) -> Passive:
    """Return the passive joint that is nearest to a torque; least squares over the grid. The joint
    of a linear bench slides level, so that no weight acts along it.
    """
    one = np.ones(len(grid.speed))
    spring = np.stack((grid.angle, one))
    weight = np.stack((np.sin(grid.angle), np.cos(grid.angle)))
    # Spring and weight are chosen by the mean over both directions, which has no friction.
    place = np.repeat(np.mean(torque.reshape(ANGLES, -1), axis=1), 2 * SPEEDS)
    if _rms(place) <= ROUNDING * _rms(torque):
        place = np.zeros(len(torque))
    parts: tuple[Array, ...] = ()
    turning = (((weight,), LEAST_GAIN), ((spring, weight), 0.5))
    for tried, gain in (((spring,), LEAST_GAIN), *(() if linear else turning)):
        c, left = _least_squares(np.concatenate(tried), place)
        known = _least_squares(np.concatenate(parts), place)[1] if parts else place
        stiff = c[0] * np.ptp(grid.angle) > FLATTEST * _rms(place)
        if (tried[0] is weight or stiff) and _rms(left) < (1.0 - gain) * _rms(known):
            parts = tried
    friction = np.stack((np.sign(grid.speed), grid.speed))
    c, left = _least_squares(np.concatenate((friction, *parts)), torque)
    if min(c[:2]) < 0.0:  # a joint has no negative damping
        friction[int(np.argmin(c[:2]))] = 0.0
        c, left = _least_squares(np.concatenate((friction, *parts)), torque)
    rest, hanging = (0.0, 0.0), (0.0, 0.0)
    if parts and parts[0] is spring:
        rest = float(c[2]), float(-c[3] / c[2])
    if parts and parts[-1] is weight:
        hanging = float(math.hypot(c[-2], c[-1])), float(math.atan2(-c[-1], c[-2]))
    basis = np.concatenate((friction, *parts))
    return Passive(max(float(c[0]), 0.0), max(float(c[1]), 0.0), rest, hanging, left, basis)


def _least_squares(basis: Array, torque: Array) -> tuple[Array, Array]:
    """Return coefficients and the rest."""
    c: Array = np.asarray(np.linalg.lstsq(basis.T, torque, rcond=None)[0])
    return c, torque - c @ basis


def mjcf_texts(
    machine: Machine, without: Mapping[str, Machine], inertia: float, values: Mapping[str, float]
) -> dict[str, str]:
    """Return both files by their names.

    Args:
        machine: The machine.
        without: Name of each effect to the machine without it.
        inertia: Inertia at the joint, kg m^2.
        values: Nominal parameters and constants of the bench by the names of the machine's
            parameters.
    """
    grid, force_unit = grid_of(machine), machine.unit("N m")
    torque = machine.steady(*grid)
    linear = machine.motion == "linear"
    plain = fitted(torque, grid, linear)
    value = {q.name: q.value for q in machine.parameters} | dict(values)
    ampere_torque = value.get("torque_constant", 1.0) * value.get("gear_ratio", 1.0)
    dropped = _dropped(machine, without, grid, torque, plain)
    force = machine.ranges.get("contact_force", (0.0, 0.0))[1]
    loaded = ""
    if force > 0.0:
        other = fitted(machine.steady(*grid, force), grid, linear)
        loaded = (
            f"  With a contact force of {force:g} N: damping {other.damping:.6g}, frictionloss "
            f"{other.friction:.6g}, error {_rms(other.error):.4g} {force_unit} rms.\n"
        )
    head = (
        f"  {machine.source}\n  Fitted to steady motion from {np.min(grid.angle):.4g} to "
        f"{np.max(grid.angle):.4g} {machine.unit('rad')} at up to {np.max(grid.speed):.4g} "
        f"{machine.unit('rad/s')}, without contact force.\n"
    )
    # With MuJoCo's usual softness the joint creeps under dry friction up to 0.05 rad/s.
    kinetic = (
        f'damping="{plain.damping:.10g}" frictionloss="{plain.friction:.10g}" '
        f'solreffriction="{2.0 * machine.largest_step:g} 1" solimpfriction="0.99 0.99 0.001"'
    )
    motor = f'<motor name="current" joint="joint" gear="{ampere_torque:.10g}"/>'
    note = (
        f"{head}  Error of the torque: {_rms(plain.error):.4g} {force_unit} rms, greatest "
        f"{np.max(np.abs(plain.error)):.4g} {force_unit}, of {_rms(torque):.4g} {force_unit} rms.\n"
        f"{loaded}{dropped}"
        "  Control: motor current, A.\n"
    )
    texts = {"plain.xml": _document(machine, plain, inertia, kinetic, motor, note)}
    resistance = value.get("resistance", 0.0)
    if (
        resistance > 0.0
        and values.get("torque_constant", 0.0) > 0.0
        and value.get("back_emf_constant", 0.0) > 0.0
        and value.get("Mc", 0.0) > 0.0
    ):
        texts["dcmotor.xml"] = _dc_motor(
            machine, plain, inertia, value, grid, torque, head, dropped
        )
    return texts


def _dc_motor(
    machine: Machine,
    plain: Passive,
    inertia: float,
    value: Mapping[str, float],
    grid: Grid,
    torque: Array,
    head: str,
    dropped: str,
) -> str:
    gear = value["gear_ratio"]
    level, static = value["Mc"], max(value.get("Ms", 0.0), value["Mc"])
    speed = value.get("omega_sf", 0.0) or 1e-3
    stiffness = static / BREAKAWAY_RAD
    damping = 2.0 * math.sqrt(stiffness * inertia)
    viscous = value.get("sigma_2", 0.0)
    bristles = (stiffness / gear**2, damping / gear**2, level / gear, static / gear, speed * gear)
    motor = (
        f'<dcmotor name="voltage" joint="joint" gear="{gear:.10g}" input="voltage" '
        f'motorconst="{value["torque_constant"]:.10g} {value["back_emf_constant"]:.10g}" '
        f'resistance="{value["resistance"]:.10g}" '
        f'lugre="{" ".join(f"{b:.10g}" for b in bristles)}"/>'
    )
    fall = np.exp(-((grid.speed / speed) ** 2))
    own = np.sign(grid.speed) * (level + (static - level) * fall) + viscous * grid.speed
    position = plain.basis[2:]
    rest = torque - own
    if len(position):
        rest = _least_squares(position, rest)[1]
    constants = value["torque_constant"], value["back_emf_constant"]
    force_unit = machine.unit("N m")
    note = (
        f"{head}  For MuJoCo {MUJOCO} and later: actuator dcmotor with LuGre friction, which "
        f"deflects {BREAKAWAY_RAD:g} {machine.unit('rad')}\n  before breakaway. "
        "Error of the torque: "
        f"{_rms(rest):.4g} {force_unit} rms, greatest {np.max(np.abs(rest)):.4g} {force_unit}.\n"
        f"  The motor has one constant, {math.sqrt(constants[0] * constants[1]):.6g}, in place of "
        f"Km {constants[0]:.6g} N m/A and Ke {constants[1]:.6g} V s/rad;\n  no inductance.\n"
        f"{dropped}  Control: voltage, V.\n"
    )
    return _document(machine, plain, inertia, f'damping="{viscous:.10g}"', motor, note)


def _dropped(
    machine: Machine, without: Mapping[str, Machine], grid: Grid, torque: Array, plain: Passive
) -> str:
    """Return one line for each effect, with the torque that the passive joint lacks."""
    lines = []
    unit = machine.unit("N m")
    for name, other in without.items():
        own = torque - other.steady(*grid)
        left = _least_squares(plain.basis, own)[1]
        words = f"{_rms(left):.4g} {unit} rms of its {_rms(own):.4g} {unit} are left out"
        if not np.any(own):
            words = "left out; it has no torque in steady motion"
        elif _rms(left) <= 1e-6 * _rms(own):
            words = "in the joint"
        lines.append(f"  {name}: {words}.\n")
    for left_out in machine.left_out:
        if left_out.name not in without:
            lines.append(f"  {left_out.words}.\n")
    return "".join(lines)


def _document(
    machine: Machine, plain: Passive, inertia: float, kinetic: str, actuator: str, note: str
) -> str:
    (stiffness, rest), (moment, zero) = plain.spring, plain.weight
    spring = f' stiffness="{stiffness:.10g}" springref="{rest:.10g}"' if stiffness > 0.0 else ""
    # The weight hangs so near the axis that its inertia is a tenth of the joint's at most.
    length = min(0.1, 0.1 * inertia * STANDARD_GRAVITY / moment) if moment > 0.0 else 0.0
    mass = moment / (STANDARD_GRAVITY * length) if moment > 0.0 else 1e-9
    place = f"{length * math.sin(zero):.10g} 0 {-length * math.cos(zero):.10g}"
    least = 1e-6 * inertia
    armature = inertia - mass * length**2 - least
    kind = "slide" if machine.motion == "linear" else "hinge"
    axis = "1 0 0" if machine.motion == "linear" else "0 1 0"
    step, g = machine.largest_step, STANDARD_GRAVITY
    inner = " ".join([f"{least:.3g}"] * 3)
    return f"""\
<!--
{note.replace("--", "- -")}-->
<mujoco model="{machine.name}">
  <compiler angle="radian"/>
  <option timestep="{step:g}" integrator="implicitfast" gravity="0 0 -{g}"/>
  <worldbody>
    <body name="joint">
      <joint name="joint" type="{kind}" axis="{axis}" armature="{armature:.10g}"
        {kinetic}{spring}/>
      <inertial pos="{place}" mass="{mass:.10g}" diaginertia="{inner}"/>
    </body>
  </worldbody>
  <actuator>
    {actuator}
  </actuator>
</mujoco>
"""


def _rms(series: Array) -> float:
    return float(np.sqrt(np.mean(series**2)))
