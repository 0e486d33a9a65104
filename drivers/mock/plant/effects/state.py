"""Extra state of the machine while effects are injected."""

from __future__ import annotations

(
    JOINT,  # true joint angle, rad; the nominal state's angle is the rotor's, over the gear ratio
    ROTOR_SPEED,  # over the gear ratio, rad/s
    TIME,  # s since the power came on
    RUN,  # s since the machine was built, pauses included
    RECORDING,  # how often the power came on
    HEAT,  # K, winding above ambient
    TORQUE_CURRENT,  # A, the current that makes torque
    PLAY,  # N m, hysteresis of the coupling
    BRISTLES,  # rad
    FALLING,  # N m, remembered friction that falls with speed; or the remembered speed, rad/s
    GROWN,  # N m, what rest has added to the static limit
    TRAVEL,  # memory of long travel, -1 to 1
    ACCELERATION,  # rad/s^2, smoothed
    TRANSMITTED,  # N m, torque at the gear's output
    EXTERNAL,  # N m, torque of weight and springs on the joint
    SUPPLY,  # V
    SLIPPED,  # rad, of the joint encoder
    SEEN,  # joint angle as its encoder sees it, rad
    LOOP,  # drive-loop periods since the machine was built
    EXTRA_SIZE,
) = range(20)

# Behind the effects in the effect vector: constants that their formulas need.
(
    ROTOR_INERTIA,  # kg m^2 at the joint
    SHAFT_DAMPING,  # N m s/rad
    GEAR,
    NOMINAL_SUPPLY,  # V
    TWO_MASSES,  # 1: rotor and joint move apart
    OUTSIDE_TORQUE,  # 1: an effect that is in no catalogue acts on the joint
    CONSTANTS_SIZE,
) = range(7)

HISTORY = 4096
"""Number of stored past loop periods; a power of two."""
