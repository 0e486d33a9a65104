"""Catalogue entries of effects of system friction that a Stribeck curve without memory and without
dependence on direction, angle and temperature (eq. 9) omits.
"""

from __future__ import annotations

from math import pi

from identification.diagnosis.catalogue.entry import Entry, Quantity

FRICTION: tuple[Entry, ...] = (
    Entry(
        name="asymmetric_coulomb",
        group="friction",
        equation="Mc, Ms -> Mc + d, Ms + d for omega > 0; Mc - d, Ms - d for omega < 0",
        assumption="the implied assumption that friction is the same both ways (eq. 9)",
        shows_in="torque",
        coordinate="direction: a constant torque in motion, the same at any speed, angle and "
        "load; none at rest",
        parameters=(Quantity("torque_Nm", "N m", -20.0, 20.0),),
        look_alikes=(
            "current_offset",
            "asymmetric_viscous",
            "gravity_imbalance",
            "transmission_efficiency",
        ),
        experiment=(
            "Holding at rest after approaches from either side, at two loads, and over the widest "
            "travel: at rest asymmetric friction is zero, an offset of the current remains, "
            "and gravity changes with the angle."
        ),
        sentence=(
            "friction is {torque_Nm:abs N m} {torque_Nm:?higher/lower} in the positive direction, "
            "and as much "
            "{torque_Nm:?lower/higher} in the negative, at any speed"
        ),
    ),
    Entry(
        name="asymmetric_viscous",
        group="friction",
        equation="sigma_2 -> sigma_2 + d for omega > 0; sigma_2 - d for omega < 0",
        assumption="the implied assumption that friction is the same both ways (eq. 9)",
        shows_in="torque",
        coordinate="speed: proportional to |omega|, with one sign in both directions",
        parameters=(Quantity("coefficient_Nms_rad", "N m s/rad", -40.0, 40.0),),
        look_alikes=("asymmetric_coulomb", "quadratic_drag", "current_offset"),
        experiment=(
            "Steady speeds in both directions, at least four between the Stribeck speed and the "
            "limit: an asymmetry that grows with speed is one of viscous friction, a constant "
            "asymmetry is one of Coulomb friction."
        ),
        sentence=(
            "viscous friction is {coefficient_Nms_rad:abs N m s/rad} "
            "{coefficient_Nms_rad:?higher/lower} in the "
            "positive direction, and as much {coefficient_Nms_rad:?lower/higher} in the negative"
        ),
    ),
    Entry(
        name="quadratic_drag",
        group="friction",
        equation="M_f -> M_f + c omega |omega|",
        assumption="the implied assumption that friction grows with speed as a line (eq. 9)",
        shows_in="torque",
        coordinate="speed: proportional to the square of the speed, greatest at the highest speed",
        parameters=(Quantity("coefficient_Nms2_rad2", "N m s^2/rad^2", -80.0, 80.0),),
        look_alikes=("asymmetric_viscous", "stribeck_shape", "viscous_thermal_drift"),
        experiment=(
            "Steady speeds in both directions up to the limit, at least four above three Stribeck "
            "speeds, in rising and in falling order: quadratic drag depends on the speed "
            "alone, the effect of warming also on time."
        ),
        sentence="drag of {coefficient_Nms2_rad2:N m s^2/rad^2} times the square of speed adds to "
        "viscous friction",
    ),
    Entry(
        name="stribeck_shape",
        group="friction",
        equation="M_f = Mc + (Ms - Mc) exp(-|omega / omega_sf|^alpha) + sigma_2 |omega|, alpha != "
        "2",
        assumption="the printed exponent alpha = 2 of the Stribeck curve (eq. 13)",
        shows_in="torque",
        coordinate="speed: between zero and three Stribeck speeds, the same in both directions",
        parameters=(Quantity("alpha", "", 0.3, 6.0),),
        look_alikes=("friction_memory", "presliding", "quadratic_drag"),
        experiment=(
            "Steady slow speeds, five between a fifth of the Stribeck speed and three Stribeck "
            "speeds, in both directions, each approached from higher and from lower speed: a "
            "Stribeck curve does not depend on this history, friction with memory does."
        ),
        sentence="friction falls from static to Coulomb with the exponent {alpha:}, where the "
        "nominal model has 2",
    ),
    Entry(
        name="friction_memory",
        group="friction",
        equation="T dx/dt = u - x; x is the level M_f(omega) of friction less its viscous part, or "
        "(of_speed = 1) the speed omega that this level follows",
        assumption="the implied assumption that Stribeck friction is static, without memory (eq. "
        "9)",
        shows_in="torque",
        coordinate="time since reversal: loops of friction over speed that widen with the "
        "acceleration",
        parameters=(Quantity("time_s", "s", 0.0, 0.2), Quantity("of_speed", "", 0.0, 1.0)),
        look_alikes=("current_loop_lag", "time_skew", "stribeck_shape", "presliding"),
        experiment=(
            "Slow sines of the speed around one Stribeck speed, without reversal, at three "
            "frequencies; and fast motion without load: friction with memory has loops only "
            "where the Stribeck curve falls, a lag of the current wherever the current "
            "changes."
        ),
        sentence="friction responds to a change of speed with a lag of {time_s:ms} (of_speed "
        "{of_speed:}; 1: friction follows a lagged speed, 0: the friction level lags)",
    ),
    Entry(
        name="dwell_static_friction",
        group="friction",
        equation="Ms(t_rest) = Ms + dM (1 - exp(-t_rest / T))",
        assumption="the implied assumption that static friction does not depend on the time at "
        "rest (eq. 9)",
        shows_in="breakaway",
        coordinate="rest time: breakaway torque rises with the preceding time at rest",
        parameters=(Quantity("growth_Nm", "N m", 0.0, 20.0), Quantity("time_s", "s", 0.02, 100.0)),
        look_alikes=("presliding", "backlash", "friction_memory"),
        experiment=(
            "Rests of several durations from 0.1 to 8 s, each followed by the same slow rise of "
            "torque until breakaway, repeated in mixed order."
        ),
        sentence="static friction grows by {growth_Nm:N m} at rest, with a time constant of "
        "{time_s:s}",
    ),
    Entry(
        name="presliding",
        group="friction",
        equation="dM_f/dtheta = k (1 - M_f sgn(omega) / M_ss(omega)), M_ss the Stribeck curve "
        "(Dahl)",
        assumption="the implied assumption that a stuck contact does not move at all (eq. 9)",
        shows_in="torque",
        coordinate="travel since reversal: friction changes its sign gradually over a small travel",
        parameters=(Quantity("stiffness_Nm_rad", "N m/rad", 50.0, 1e6),),
        look_alikes=("backlash", "dwell_static_friction", "coupling_hysteresis", "friction_memory"),
        experiment=(
            "Small loops of torque below breakaway, of two sizes, after short and after long "
            "rests: with presliding the joint moves like a spring with hysteresis after any "
            "rest, a gap is crossed without torque, and static friction that grows at rest "
            "allows no motion."
        ),
        sentence="the contact deforms like a spring of {stiffness_Nm_rad:N m/deg} before it slides",
    ),
    Entry(
        name="position_dependent_friction",
        group="friction",
        equation="Mc, Ms -> + d exp(-((theta - theta_0) / w)^2 / 2)",
        assumption="the implied assumption that friction is the same everywhere on the travel "
        "(eq. 9)",
        shows_in="torque",
        coordinate="angle: in one range of the travel, against the motion in both directions",
        parameters=(
            Quantity("torque_Nm", "N m", -10.0, 20.0),
            Quantity("center_rad", "rad", -pi, pi),
            Quantity("width_rad", "rad", 0.005, 1.0),
        ),
        look_alikes=("end_stop", "gravity_imbalance", "load_position_dependence", "cogging"),
        experiment=(
            "Slow passes over the whole travel in both directions, without and with load: friction "
            "changes its sign with the direction, the torque of a spring, a stop or gravity "
            "does not; the friction of a worn patch of the bearing remains without load."
        ),
        sentence=(
            "friction is {torque_Nm:abs N m} {torque_Nm:?higher/lower} around {center_rad:deg}, "
            "over a width of "
            "{width_rad:deg}"
        ),
    ),
    Entry(
        name="viscous_thermal_drift",
        group="friction",
        equation="sigma_2(t) = sigma_2 (1 - f (1 - exp(-t_run / T)))",
        assumption="the implied assumption that friction is the same at any temperature (eq. 9)",
        shows_in="torque",
        coordinate="temperature: viscous friction falls with rising temperature, or with running "
        "time; zero at low speed",
        parameters=(Quantity("fraction", "", 0.0, 0.9), Quantity("time_s", "s", 1.0, 5000.0)),
        look_alikes=("coulomb_drift", "winding_heating", "current_drift"),
        experiment=(
            "A slow and a fast speed, each cold and hot, with voltage and current logged: a drift "
            "of viscous friction shows at the fast speed only, a drift of Coulomb friction "
            "equally at both speeds, a hot winding in the voltage."
        ),
        sentence="viscous friction falls by {fraction:%} as the bench runs warm, with a time "
        "constant of {time_s:s}",
    ),
    Entry(
        name="coulomb_drift",
        group="friction",
        equation="Mc(t) = Mc + r T (1 - exp(-t_run / T)), Ms alike; r t_run where T is long",
        assumption="the implied assumption that friction does not change from one recording to "
        "the next (eq. 9)",
        shows_in="torque",
        coordinate="time: against the motion in both directions and at any speed, changing from "
        "recording to recording",
        parameters=(Quantity("rate_Nm_s", "N m/s", -1.0, 1.0), Quantity("time_s", "s", 1.0, 1e7)),
        look_alikes=("viscous_thermal_drift", "winding_heating", "current_drift"),
        experiment=(
            "One recording repeated at the start, in the middle and at the end of a session, at "
            "two speeds in both directions: a drift of Coulomb friction changes its sign with "
            "the direction, a drift of the current's zero does not."
        ),
        sentence="Coulomb friction {rate_Nm_s:?rises/falls} by {rate_Nm_s:abs N m/h} of running at "
        "first, levelling off with a time constant of {time_s:s}",
    ),
)
"""Effects of the system's friction."""
