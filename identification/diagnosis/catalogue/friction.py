"""Catalogue entries of effects of the system's friction beyond a static, symmetric, uniform, cold
Stribeck curve (eq. 9).
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
        parameters=(Quantity("torque_Nm", "N m", -10.0, 10.0),),
        look_alikes=(
            "current_offset",
            "asymmetric_viscous",
            "gravity_imbalance",
            "transmission_efficiency",
        ),
        experiment=(
            "Holding at rest after approaches from either side, at two loads, and over the "
            "widest travel: asymmetric friction vanishes at rest, an offset of the current "
            "remains, gravity changes with the angle."
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
        coordinate="speed: grows with |omega|, with the same sign both ways",
        parameters=(Quantity("coefficient_Nms_rad", "N m s/rad", -10.0, 10.0),),
        look_alikes=("asymmetric_coulomb", "quadratic_drag", "current_offset"),
        experiment=(
            "Steady speeds both ways, at least four between the Stribeck speed and the limit: "
            "an asymmetry that grows with speed is viscous, a constant one is Coulomb."
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
        coordinate="speed: grows with its square, most at the highest speed",
        parameters=(Quantity("coefficient_Nms2_rad2", "N m s^2/rad^2", -10.0, 10.0),),
        look_alikes=("asymmetric_viscous", "stribeck_shape", "viscous_thermal_drift"),
        experiment=(
            "Steady speeds both ways up to the limit, at least four above three Stribeck speeds, "
            "in rising and "
            "falling order: drag bends up with speed alone, warming also with time."
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
        coordinate="speed: between nothing and three Stribeck speeds, the same both ways",
        parameters=(Quantity("alpha", "", 0.3, 6.0),),
        look_alikes=("friction_memory", "presliding", "quadratic_drag"),
        experiment=(
            "Steady slow speeds, five between a fifth of and three Stribeck speeds, both ways "
            "and approached from above and below: a Stribeck curve is the same from either "
            "side, friction with memory differs."
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
            "Slow sines around a bias speed of one Stribeck speed, never reversing, at three "
            "frequencies, beside "
            "fast unloaded motion: memory loops where the Stribeck curve falls, a lag wherever "
            "the current "
            "changes."
        ),
        sentence="friction responds to a change of speed with a lag of {time_s:ms} (of_speed "
        "{of_speed:}; 1: it follows a lagged speed, 0: its level lags)",
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
            "A ladder of rests of 0.1 to 8 s, each followed by the same slow rise of torque until "
            "breakaway, "
            "several times over in mixed order."
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
        coordinate="travel since reversal: friction changes its sign over a small travel and not "
        "at once",
        parameters=(Quantity("stiffness_Nm_rad", "N m/rad", 50.0, 1e6),),
        look_alikes=("backlash", "dwell_static_friction", "coupling_hysteresis", "friction_memory"),
        experiment=(
            "Small loops of torque below breakaway, at two sizes, after short and long rests: "
            "presliding moves "
            "the joint as a spring with hysteresis at any rest, a gap is crossed at no torque, "
            "ageing moves "
            "nothing."
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
        coordinate="angle: one range of the travel, against the motion both ways",
        parameters=(
            Quantity("torque_Nm", "N m", -10.0, 20.0),
            Quantity("center_rad", "rad", -pi, pi),
            Quantity("width_rad", "rad", 0.005, 1.0),
        ),
        look_alikes=("end_stop", "gravity_imbalance", "load_position_dependence", "cogging"),
        experiment=(
            "Slow passes over the whole travel both ways, unloaded and loaded: friction changes "
            "sign with the "
            "direction, a spring, a stop or gravity does not; a worn patch of the bearing stays "
            "without load."
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
        coordinate="temperature: viscous friction falls with it, or with running time; nothing at "
        "low speed",
        parameters=(Quantity("fraction", "", 0.0, 0.9), Quantity("time_s", "s", 1.0, 5000.0)),
        look_alikes=("coulomb_drift", "winding_heating", "current_drift"),
        experiment=(
            "The same two speeds, slow and fast, cold and hot, with voltage and current logged: a "
            "viscous drift "
            "shows at the fast one only, a Coulomb drift at both alike, a hot winding in the "
            "voltage."
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
        coordinate="time: against the motion both ways and at any speed, growing from recording "
        "to recording",
        parameters=(Quantity("rate_Nm_s", "N m/s", -1.0, 1.0), Quantity("time_s", "s", 1.0, 1e7)),
        look_alikes=("viscous_thermal_drift", "winding_heating", "current_drift"),
        experiment=(
            "One recording repeated at the start, in the middle and at the end of a session, at "
            "two speeds both "
            "ways: a Coulomb drift turns with the direction, a drift of the current's zero does "
            "not."
        ),
        sentence="Coulomb friction {rate_Nm_s:?rises/falls} by {rate_Nm_s:abs N m/h} of running at "
        "first, levelling off with a time constant of {time_s:s}",
    ),
)
"""Effects of the system's friction."""
