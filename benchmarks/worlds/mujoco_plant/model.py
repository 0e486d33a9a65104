"""Writes the machine as a MuJoCo model: bodies, joints, tendons and ``dcmotor``; one model for each
recording.

MuJoCo itself simulates dry friction of the joint (``frictionloss``, which a constraint solves),
linear and quadratic damping, armature, gravity of bodies, springs, tendons with a dead band or
limits, and elasto-plastic tendons; and of the ``dcmotor`` resistance, inductance, back-EMF,
cogging, heating and LuGre friction. The level of dry friction is set before each step, because
MuJoCo has no Stribeck curve and no load friction.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from benchmarks.worlds.world import World

ELASTIC = frozenset({"backlash", "compliance", "coupling_hysteresis"})
"""Effects for which motor and joint are two bodies."""
STIFFNESS_OVER_LOOP = 0.02
"""Damping of a tendon between motor and joint, as a share of the critical damping."""
ECCENTRIC_M = 1e-3
"""Distance of an unbalanced mass from the axis, m; it is so short that the inertia of the mass is
negligible.
"""
COPPER_PER_K = 0.00393
AMBIENT_C = 25.0
TINY = 1e-9
FAR_RAD = 50.0
IMPEDANCE = 0.9999
"""Greatest constraint impedance that MuJoCo accepts; a test measures the creep of a stuck joint at
this impedance.
"""


def two_bodies(world: World) -> bool:
    """Return whether motor and joint are two bodies."""
    return bool(ELASTIC & world.effects.keys())


def xml(world: World, k: int, step_s: float) -> str:
    """Return the model of recording ``k`` in MuJoCo's format.

    Args:
        world: The world.
        k: Number of the recording, from 0.
        step_s: Time step.
    """
    two = two_bodies(world)
    rotor = world.motor.rotor_share * world.constants.J
    body = _body if world.motion == "rotary" else _carriage
    motor = body("motor", rotor, "", _joint("m", world, k, step_s)) if two else ""
    load = world.constants.J - (rotor if two else 0.0) + _hung_inertia(world, k)
    joint = body("joint", load, _masses(world, k), _joint("q", world, k, step_s))
    return f"""<mujoco>
<compiler angle="radian" inertiafromgeom="false"/>
<option timestep="{step_s!r}" integrator="implicitfast" solver="Newton" iterations="50"
 tolerance="1e-12" gravity="0 0 {-world.gravity_m_s2!r}"><flag contact="disable"/></option>
<worldbody>{motor}{joint}</worldbody>
<tendon>{_tendons(world, step_s)}</tendon>
<actuator>{_motor(world, "m" if two else "q")}{_lugre(world)}</actuator>
</mujoco>"""


def _body(name: str, inertia: float, inside: str, joint: str) -> str:
    return (
        f'<body name="{name}">{joint}<inertial pos="0 0 0" mass="{TINY}" '
        f'diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>{inside}</body>'
    )


def _carriage(name: str, mass: float, inside: str, joint: str) -> str:
    """Return a body on a vertical slide, whose own weight is balanced."""
    return (
        f'<body name="{name}" gravcomp="1">{joint}<inertial pos="0 0 0" mass="{mass!r}" '
        f'diaginertia="{TINY} {TINY} {TINY}"/>{inside}</body>'
    )


def _joint(name: str, world: World, k: int, step_s: float) -> str:
    """Return a hinge or a slide; its dry friction and viscous load friction are set before each
    step.
    """
    constants, effects = world.constants, world.effects
    share = world.motor.friction_share if two_bodies(world) else 0.0
    viscous = constants.sigma_2 * (share if name == "m" else 1.0 - share)
    drag = spring = ""
    if name == "q":
        drag = f" {_of(effects, 'quadratic_drag', 'coefficient_Nms2_rad2')!r} 0"
        linear = _of(effects, "return_spring", "stiffness_Nm_rad")
        cubic = _of(effects, "x_cubic_spring", "stiffness_Nm_rad3")
        rest = _of(effects, "return_spring", "rest_rad")
        spring = f'stiffness="{linear!r} 0 {cubic!r}" springref="{rest!r}"'
    kind = 'hinge" axis="0 1 0' if world.motion == "rotary" else 'slide" axis="0 0 1'
    return (
        f'<joint name="{name}" type="{kind}" damping="{viscous!r}{drag}" {spring} '
        f'frictionloss="{constants.Mc!r}" solreffriction="{2.0 * step_s!r} 1" '
        f'solimpfriction="{IMPEDANCE} {IMPEDANCE} 0.001 0.5 2"/>'
    )


def _masses(world: World, k: int) -> str:
    """Return those of weight on the joint, lifted mass and unbalanced mass that recording ``k``
    has, as point masses.
    """
    points = []
    lifted = world.recordings[k].hoisted_kg
    if lifted:
        points.append((lifted, 0.0, 0.0))
    hung = world.recordings[k].pendulum
    if hung is not None:
        points.append((hung.mass_kg, hung.length_m, hung.zero_rad))
    lopsided = world.effects.get("gravity_imbalance")
    if lopsided is not None:
        mass = lopsided["torque_Nm"] / (world.gravity_m_s2 * ECCENTRIC_M)
        points.append((mass, ECCENTRIC_M, lopsided["zero_rad"]))
    out = ""
    for mass, length, zero in points:
        x, z = length * math.sin(zero), -length * math.cos(zero)
        out += (
            f'<body><inertial pos="{x!r} 0 {z!r}" mass="{mass!r}" '
            f'diaginertia="{TINY} {TINY} {TINY}"/></body>'
        )
    return out


def _hung_inertia(world: World, k: int) -> float:
    per_mass = _of(world.effects, "load_inertia", "inertia_kgm2") / 30.6
    return per_mass * world.recordings[k].weight_kg


def _tendons(world: World, step_s: float) -> str:
    """Return the coupling of motor and joint, and the stops, as fixed tendons."""
    effects, out = world.effects, ""
    both = '<joint joint="m" coef="1"/><joint joint="q" coef="-1"/>'
    inertia = world.constants.J * world.motor.rotor_share * (1.0 - world.motor.rotor_share)
    if "backlash" in effects:
        half = 0.5 * effects["backlash"]["gap_rad"]
        out += (
            f'<fixed name="c" limited="true" range="{-half!r} {half!r}" '
            f'solreflimit="{4.0 * step_s!r} 1" solimplimit="0.99 0.9999 0.001 0.5 2">{both}</fixed>'
        )
    for name in ("compliance", "coupling_hysteresis"):
        if name not in effects:
            continue
        given = effects[name]
        stiffness = given.get("stiffness_Nm_rad") or given["torque_Nm"] / given["deflection_rad"]
        damping = 2.0 * STIFFNESS_OVER_LOOP * math.sqrt(stiffness * inertia)
        out += (
            f'<fixed name="c" stiffness="{stiffness!r}" springlength="0 0" '
            f'damping="{damping!r}">{both}</fixed>'
        )
        if name == "coupling_hysteresis":
            out += (
                f'<fixed name="h" stiffness="{4.0 * stiffness!r}" springlength="0 0" '
                f'springyield="{0.25 * given["deflection_rad"]!r}">{both}</fixed>'
            )
    stop = effects.get("end_stop")
    if stop is not None:
        ends = sorted(
            (stop["angle_rad"], stop.get("other_rad", -math.copysign(FAR_RAD, stop["angle_rad"])))
        )
        out += (
            f'<fixed name="s" stiffness="{stop["stiffness_Nm_rad"]!r}" '
            f'springlength="{ends[0]!r} {ends[1]!r}"><joint joint="q" coef="1"/></fixed>'
        )
    return out


def _motor(world: World, joint: str) -> str:
    motor, effects = world.motor, world.effects
    further = ""
    if "cogging" in effects:
        wave = effects["cogging"]
        size = wave["torque_Nm"] / motor.gear_ratio
        order, phase = int(wave["per_motor_turn"]), wave["phase_rad"]
        further += f' cogging="{size!r} {order} {phase!r}"'
    if "winding_heating" in effects:
        heat = effects["winding_heating"]
        further += (
            f' thermal="{heat["rise_K_per_W"]!r} 0 {heat["time_s"]!r} {COPPER_PER_K} '
            f'{AMBIENT_C} {AMBIENT_C}"'
        )
    return (
        f'<dcmotor name="drive" joint="{joint}" gear="{motor.gear_ratio!r}" '
        f'motorconst="{motor.constant!r} {motor.constant!r}" '
        f'resistance="{motor.resistance_ohm!r}" inductance="{motor.inductance_H!r} 0"{further}/>'
    )


def _lugre(world: World) -> str:
    """Return the joint's friction as the bristles of the LuGre model, which replace MuJoCo's
    friction constraint.
    """
    if "presliding" not in world.effects:
        return ""
    constants, stiffness = world.constants, world.effects["presliding"]["stiffness_Nm_rad"]
    return (
        f'<dcmotor name="bristles" joint="q" input="none" motorconst="0 0" resistance="1" '
        f'lugre="{stiffness!r} 0 {constants.Mc!r} {constants.Ms!r} {constants.omega_sf!r}"/>'
    )


def _of(effects: Mapping[str, Mapping[str, float]], name: str, key: str) -> float:
    return effects.get(name, {}).get(key, 0.0)
