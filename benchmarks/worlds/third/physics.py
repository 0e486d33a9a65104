"""A world of its own: the paper's equations as an ordinary differential equation with events.

Written from the paper and its list of effects alone; it shares no line with the project's plant or
with MuJoCo's. Friction is a set-valued law with two states of each body: stuck, exactly still until
the torque on it exceeds the static limit, and sliding in one direction, with friction a smooth
function of speed. A sliding body whose speed reaches zero is an event: the step is cut there.

Everything is at the joint; the motor's shaft turns ``GEAR`` times as far. A carriage on a linear
axis has the same equations in m, N and kg, with rad per m for the gear.
"""

from __future__ import annotations

import math

from identification.numerics.compiled import compiled

# Values of one recording, by their place in a vector.
(
    J_M, J_L, COULOMB, STATIC, W_S, VISCOUS, EXPONENT, SHARE,
    LEVER, MU_C, MU_S, W_L, MU_V, FORCE, HUNG, HANGS, K_T, K_E, GEAR, R, L,
    COG, COG_N, COG_P, RIP, RIP_N, RIP_P, KNEE, RATIONAL, TORQUE_LAG, ETA,
    EDDIES, PULL,
    DEAD, BRUSH, BRUSH_A, SAG, SUPPLY, HEAT, HEAT_S,
    GAP, STIFF, LOSSY, LOSSY_RAD, DAMP,
    SIDE, SIDE_V, DRAG, LAGS, AGES, AGES_S, DAHL, PATCH, PATCH_C, PATCH_W,
    THIN, THIN_S, DRIFT, DRIFT_S,
    LOPSIDED, LOPSIDED_P, SPRING, SPRING_0, STOP_K, STOP_HIGH, STOP_LOW,
    SLOPE, SWING, SWING_F, SWING_D, PIVOT, PER_LOAD,
    TIMED, TIMED_F, TIMED_P, FLIP, FLIP_S, BURST, BURST_T, BURST_L, ACC, BEGAN, STEADY, SIZE,
) = range(84)  # fmt: skip
# State of one recording.
(
    CURRENT, PHI, W_M, THETA, W, WORKING, SLOW, REST, Z, TEMPERATURE, SLIDES_M, SLIDES, E_1, E_2,
    STATE,
) = range(15)  # fmt: skip
COPPER = 0.00393


@compiled
def motor_torque(p, y):
    """Return what the motor gives at the joint, without the gear's loss."""
    i = y[WORKING] if p[TORQUE_LAG] > 0.0 else y[CURRENT]
    lost = p[EDDIES] * i * i * y[W_M]
    if p[KNEE] > 0.0:
        if p[RATIONAL] > 0.5:
            i = i / (1.0 + (i / p[KNEE]) ** 2)
        else:
            i = p[KNEE] * math.tanh(i / p[KNEE])
    shaft = y[PHI] * p[GEAR]
    torque = p[GEAR] * p[K_T] * i * (1.0 + p[RIP] * math.sin(p[RIP_N] * shaft + p[RIP_P]))
    return torque + p[COG] * math.sin(p[COG_N] * shaft + p[COG_P]) - lost


@compiled
def other_torques(p, y, since):
    """Return what acts on the joint beside motor and friction."""
    q = y[THETA]
    torque = (
        p[STEADY]
        + p[PULL]
        - p[HUNG] * math.sin(q - p[HANGS])
        - p[LOPSIDED] * math.sin(q - p[LOPSIDED_P])
    )
    torque -= p[SPRING] * (q - p[SPRING_0])
    if p[STOP_K] > 0.0:
        torque -= p[STOP_K] * (max(q - p[STOP_HIGH], 0.0) + min(q - p[STOP_LOW], 0.0))
    torque += p[TIMED] * math.sin(2.0 * math.pi * p[TIMED_F] * since + p[TIMED_P])
    if p[FLIP] > 0.0:
        torque += p[FLIP] if (since / p[FLIP_S]) % 1.0 < 0.5 else -p[FLIP]
    if p[BURST] > 0.0 and since % p[BURST_T] < p[BURST_L]:
        torque += p[BURST]
    return torque


@compiled
def contact(p, q, since):
    """Return the moment of the contact force, F_P L1."""
    force = p[FORCE] * (1.0 + p[SLOPE] * q)
    if p[SWING] > 0.0:
        swing = math.cos(2.0 * math.pi * p[SWING_F] * since) * math.exp(-since / p[SWING_D])
        force *= 1.0 + p[SWING] * swing
    return p[LEVER] * force


@compiled
def level(p, y, speed, way, since):
    """Return the dry friction of the joint when it slides at ``speed`` >= 0 in direction ``way``,
    without the share of the motor's side.
    """
    seen = abs(y[SLOW]) if p[LAGS] > 0.0 else speed
    aged = p[AGES] * (1.0 - math.exp(-y[REST] / p[AGES_S])) if p[AGES] > 0.0 else 0.0
    fall = math.exp(-((seen / p[W_S]) ** p[EXPONENT]))
    own = (1.0 - p[SHARE]) * (p[COULOMB] + (p[STATIC] + aged - p[COULOMB]) * fall)
    t = p[BEGAN] + since
    if p[DRIFT] != 0.0:
        own += p[DRIFT] * p[DRIFT_S] * (1.0 - math.exp(-t / p[DRIFT_S]))
    if p[PATCH] != 0.0:
        own += p[PATCH] * math.exp(-0.5 * ((y[THETA] - p[PATCH_C]) / p[PATCH_W]) ** 2)
    mu = p[MU_C] + (p[MU_S] - p[MU_C]) * math.exp(-((seen / p[W_L]) ** 2))
    own += contact(p, y[THETA], since) * mu + p[PIVOT]
    own += p[PER_LOAD] * abs(p[STEADY] - p[HUNG] * math.sin(y[THETA] - p[HANGS]))
    return max(own + way * p[SIDE], 0.0)


@compiled
def viscous(p, y, w, since):
    """Return the viscous friction of the joint, against its speed ``w``."""
    per = p[VISCOUS]
    if p[THIN] != 0.0:
        per *= 1.0 - p[THIN] * (1.0 - math.exp(-(p[BEGAN] + since) / p[THIN_S]))
    per = (1.0 - p[SHARE]) * per + contact(p, y[THETA], since) * p[MU_V]
    return per * w + p[SIDE_V] * abs(w) + p[DRAG] * w * abs(w)


@compiled
def motor_level(p, speed):
    """Return the dry friction of the motor's side."""
    fall = math.exp(-((speed / p[W_S]) ** p[EXPONENT]))
    return p[SHARE] * (p[COULOMB] + (p[STATIC] - p[COULOMB]) * fall)


@compiled
def coupling(p, y):
    """Return the torque that the motor's side passes to the joint."""
    twist, turns = y[PHI] - y[THETA], y[W_M] - y[W]
    if p[GAP] > 0.0:
        half = 0.5 * p[GAP]
        if twist > half:
            return max(p[STIFF] * (twist - half) + p[DAMP] * turns, 0.0)
        if twist < -half:
            return min(p[STIFF] * (twist + half) + p[DAMP] * turns, 0.0)
        return 0.0
    if p[LOSSY] > 0.0:
        # Two springs in a row with a slider each, beside one without: loops that do not depend on
        # speed.
        stiffness = p[LOSSY] / p[LOSSY_RAD]
        return stiffness * (twist + (twist - y[E_1]) + (twist - y[E_2])) + p[DAMP] * turns
    return p[STIFF] * twist + p[DAMP] * turns


@compiled
def two_bodies(p):
    """Return whether motor and joint turn apart."""
    return p[STIFF] > 0.0 or p[LOSSY] > 0.0


@compiled
def through_gear(p, torque, w):
    """Return a motor's torque after the gear's loss: taken from the side that drives."""
    if p[ETA] == 1.0:
        return torque
    return torque / p[ETA] if torque * w < 0.0 else torque * p[ETA]


@compiled
def pushes(p, y, since):
    """Return all torques but friction, on the motor's side and on the joint.

    Where both turn as one, all of it is on the joint.
    """
    torque = through_gear(p, motor_torque(p, y), y[W])
    rest = other_torques(p, y, since)
    if two_bodies(p):
        passed = coupling(p, y)
        return torque - passed, passed + rest
    return 0.0, torque + rest


@compiled
def rates(p, y, voltage, since, out):
    """Write the rates of current, angles and speeds into ``out``, with both bodies as they are:
    stuck (0) or sliding in the direction of their state.
    """
    resistance = p[R] * (1.0 + COPPER * y[TEMPERATURE])
    speed = y[W_M] if two_bodies(p) else y[W]
    drop = p[BRUSH] * math.tanh(y[CURRENT] / p[BRUSH_A]) if p[BRUSH] > 0.0 else 0.0
    out[CURRENT] = (voltage - drop - resistance * y[CURRENT] - p[K_E] * p[GEAR] * speed) / p[L]
    at_motor, at_joint = pushes(p, y, since)
    inertia = p[J_L] if two_bodies(p) else p[J_L] + p[J_M]
    way = y[SLIDES]
    if p[DAHL] > 0.0:
        net = at_joint - p[DAHL] * y[Z] - viscous(p, y, y[W], since)
    else:
        net = at_joint - way * level(p, y, abs(y[W]), way, since) - viscous(p, y, y[W], since)
    if p[ACC] != 0.0:
        way_now = 1.0 if y[W] > 0.0 else -1.0
        inertia += p[ACC] * way_now * (1.0 if net > 0.0 else -1.0)
    moves = way != 0.0 or p[DAHL] > 0.0
    out[THETA], out[W] = (y[W], net / inertia) if moves else (0.0, 0.0)
    if two_bodies(p):
        slides = y[SLIDES_M]
        net = at_motor - slides * motor_level(p, abs(y[W_M])) - p[SHARE] * p[VISCOUS] * y[W_M]
        out[PHI], out[W_M] = (y[W_M], net / p[J_M]) if slides != 0.0 else (0.0, 0.0)
    else:
        out[PHI], out[W_M] = out[THETA], out[W]
