"""Indices of the state variables that a machine with injected effects has in addition."""

from __future__ import annotations

(
    JOINT,  # true joint angle, rad; the nominal state has the rotor's angle over the gear ratio
    ROTOR_SPEED,  # rotor speed over the gear ratio, rad/s
    TIME,  # s since the power was switched on
    RUN,  # s since the machine was built, pauses included
    RECORDING,  # number of times that the power was switched on
    HEAT,  # K, temperature of the winding above ambient
    TORQUE_CURRENT,  # A, the current that determines the torque
    PLAY,  # N m, hysteresis of the coupling
    BRISTLES,  # rad
    FALLING,  # N m, delayed part of friction that falls with speed; or the delayed speed, rad/s
    GROWN,  # N m, increase of the static limit by time at rest
    TRAVEL,  # state of the friction with long presliding travel, -1 to 1
    ACCELERATION,  # rad/s^2, smoothed
    TRANSMITTED,  # N m, torque at the gear's output
    EXTERNAL,  # N m, torque of weight, springs and steady load on the joint
    SUPPLY,  # V
    SLIPPED,  # rad, of the joint encoder
    SEEN,  # joint angle as its encoder measures it, rad
    LOOP,  # drive-loop periods since the machine was built
    EXTRA_SIZE,
) = range(20)

# Indices after the effects in the effect vector: constants that the formulas of the effects need.
(
    ROTOR_INERTIA,  # kg m^2 at the joint
    SHAFT_DAMPING,  # N m s/rad
    GEAR,
    NOMINAL_SUPPLY,  # V
    TWO_MASSES,  # 1: rotor and joint are two masses
    OUTSIDE_TORQUE,  # 1: an effect that is in no catalogue acts on the joint
    STEADY_LOAD,  # N m, known torque on the joint, the same at every angle
    CONSTANTS_SIZE,
) = range(8)

HISTORY = 4096
"""Number of stored past loop periods; a power of two."""
