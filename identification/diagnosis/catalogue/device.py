"""Catalogue entries of springs, stops and unbalance on the joint, and of effects of the lever with
its weights (eq. 12 to 17, Fig. 10).
"""

from __future__ import annotations

from math import pi

from identification.diagnosis.catalogue.entry import Entry, Quantity

DEVICE: tuple[Entry, ...] = (
    Entry(
        name="gravity_imbalance",
        group="device",
        equation="J domega/dt = i Km I - M_f - M_L - M sin(theta - theta_0)",
        assumption="the implied assumption that the joint is balanced and nothing but friction "
        "loads it (eq. 1)",
        shows_in="torque",
        coordinate="angle: a sine with one period per joint turn, the same in motion, at rest and "
        "in both directions",
        parameters=(Quantity("torque_Nm", "N m", 0.0, 50.0), Quantity("zero_rad", "rad", -pi, pi)),
        look_alikes=(
            "return_spring",
            "current_offset",
            "asymmetric_coulomb",
            "encoder_eccentricity",
        ),
        experiment=(
            "Slow motion over the widest travel that the stops allow, in both directions: over the "
            "angle, the torque of gravity is a sine, that of a spring a straight line, and "
            "that of an offset constant."
        ),
        sentence=(
            "a weight out of balance pulls with up to {torque_Nm:N m}, and hangs straight down at "
            "{zero_rad:deg}"
        ),
    ),
    Entry(
        name="return_spring",
        group="device",
        equation="J domega/dt = i Km I - M_f - M_L - k (theta - theta_0)",
        assumption="the implied assumption that nothing but friction loads the joint (eq. 1)",
        shows_in="torque",
        coordinate="angle: a straight line over the travel, the same in motion, at rest and in "
        "both directions",
        parameters=(
            Quantity("stiffness_Nm_rad", "N m/rad", 0.0, 200.0),
            Quantity("rest_rad", "rad", -pi, pi),
        ),
        look_alikes=("gravity_imbalance", "end_stop", "current_offset", "asymmetric_coulomb"),
        experiment=(
            "Slow motion over the widest travel that the stops allow, in both directions: over the "
            "angle, the torque of gravity is a sine, that of a spring a straight line, and "
            "that of an offset constant."
        ),
        sentence="a spring of {stiffness_Nm_rad:N m/deg} pulls the joint toward {rest_rad:deg}",
    ),
    Entry(
        name="end_stop",
        group="device",
        equation="J domega/dt = i Km I - M_f - M_L - k (theta - a) beyond the angle a, zero "
        "before it",
        assumption="the implied assumption that the travel is free",
        shows_in="torque",
        coordinate="angle: zero up to one angle, then a steep torque toward the free travel, in "
        "both directions of motion",
        parameters=(
            Quantity("angle_rad", "rad", -pi, pi),
            Quantity("stiffness_Nm_rad", "N m/rad", 1.0, 1e5),
            Quantity("other_rad", "rad", -pi, pi),
        ),
        look_alikes=("return_spring", "position_dependent_friction", "gravity_imbalance"),
        experiment=(
            "Slow approaches to the suspected angle from the free travel, in steps of a degree, in "
            "both directions: a stop pushes back at rest too, friction does not."
        ),
        sentence=(
            "an elastic stop of {stiffness_Nm_rad:N m/deg} begins at {angle_rad:deg}"
            "{other_rad:?/, and another one at the other end of the travel}"
        ),
    ),
    Entry(
        name="load_exponent",
        group="device",
        equation="M_L = L1 F_ref (F_P / F_ref)^p mu(omega), F_ref = 3000 N, p != 1",
        assumption="assumption A2, and eq. 12: load friction is proportional to the contact force",
        shows_in="torque",
        coordinate="load: a curve over the weight that is not a straight line, zero without load",
        parameters=(Quantity("exponent", "", 0.3, 2.0),),
        look_alikes=(
            "torque_saturation",
            "wrong_weight",
            "load_position_dependence",
            "lever_pivot_friction",
        ),
        experiment=(
            "At least three weights, the heaviest at least four times the lightest, at one speed "
            "in both directions; and accelerations without load that need the same current."
        ),
        sentence="load friction grows with the contact force to the power {exponent:}, where the "
        "nominal model has 1",
    ),
    Entry(
        name="load_position_dependence",
        group="device",
        equation="F_P -> F_P (1 + s theta)",
        assumption="assumptions A1 and A3: impact at one point, one touch spot",
        shows_in="torque",
        coordinate="angle: load friction changes over the travel, zero without load",
        parameters=(Quantity("slope_per_rad", "1/rad", -2.0, 2.0),),
        look_alikes=("position_dependent_friction", "load_exponent", "gravity_imbalance"),
        experiment=(
            "Slow passes over the whole travel in both directions, without load and under two "
            "weights: friction of the load grows with the weight, friction of the bearing does "
            "not."
        ),
        sentence="the contact force changes by {slope_per_rad:%/deg} of travel",
    ),
    Entry(
        name="wrong_weight",
        group="device",
        equation="F'_P = (L3/L4) m g with m other than the recording's label (eq. 17)",
        assumption="the implied assumption that the weight has the mass on its label",
        shows_in="torque",
        coordinate="load: in one recording the load friction is wrong by a constant factor; all "
        "other recordings fit",
        parameters=(Quantity("mass_kg", "kg", 0.0, 200.0),),
        look_alikes=("load_exponent", "load_swing", "coulomb_drift"),
        experiment="Weigh the load on the lever and repeat this recording; all other recordings "
        "remain valid.",
        sentence="the weight in {recordings} is {mass_kg:kg}, which differs from its label",
    ),
    Entry(
        name="load_swing",
        group="device",
        equation="F_P -> F_P (1 + f cos(2 pi nu t) exp(-t / T)), t since the recording's start",
        assumption="the implied assumption that the weight hangs still",
        shows_in="torque",
        coordinate="time: load friction oscillates at one frequency, with an amplitude that decays "
        "from the start of the recording",
        parameters=(
            Quantity("fraction", "", 0.0, 0.9),
            Quantity("frequency_Hz", "Hz", 0.1, 10.0),
            Quantity("decay_s", "s", 0.2, 1000.0),
        ),
        look_alikes=("wrong_weight", "load_position_dependence", "torque_ripple"),
        experiment=(
            "One constant slow speed under load, started immediately after the weight was hung, "
            "and again after a minute: in the second recording the swing has decayed."
        ),
        sentence=(
            "the hung weight swings: the contact force by {fraction:%} at {frequency_Hz:Hz}, "
            "dying away over "
            "{decay_s:s}"
        ),
    ),
    Entry(
        name="load_inertia",
        group="device",
        equation="J -> J + J_L m_w / (30.6 kg) where loaded",
        assumption="the implied assumption that the lever's weight adds friction and no inertia "
        "(eq. 15)",
        shows_in="torque",
        coordinate="acceleration: in phase with the acceleration, and proportional to the weight",
        parameters=(Quantity("inertia_kgm2", "kg m^2", 0.0, 5.0),),
        look_alikes=("compliance", "current_loop_lag", "load_exponent"),
        experiment=(
            "Sines of one amplitude and two frequencies under two weights: a torque that grows "
            "with the square of the frequency and with the weight is due to inertia."
        ),
        sentence="each 30.6 kg hung on the lever adds {inertia_kgm2:kg m^2} of inertia",
    ),
    Entry(
        name="lever_pivot_friction",
        group="device",
        equation="M_L -> M_L + d sgn(omega) where the lever is hung, whatever the mass",
        assumption="assumption A3: load friction arises at one touch spot alone (eq. 12)",
        shows_in="torque",
        coordinate="load: a step between no weight and any weight, against the motion in both "
        "directions",
        parameters=(Quantity("torque_Nm", "N m", 0.0, 20.0),),
        look_alikes=("load_exponent", "wrong_weight", "coulomb_drift"),
        experiment=(
            "Two very different weights, and the lever without weight: the straight line of "
            "friction over mass, extended to zero mass, gives the friction of the pivot."
        ),
        sentence="the lever's own pivot adds {torque_Nm:N m} of friction, the same for every "
        "weight",
    ),
    Entry(
        name="load_dependent_friction",
        group="device",
        equation="M_f -> M_f + c |M_load| sgn(omega)",
        assumption="the implied assumption that system friction does not depend on the load "
        "torque (eq. 9)",
        shows_in="torque",
        coordinate="load: proportional to the torque of the load, against the motion in both "
        "directions",
        parameters=(Quantity("coefficient", "", 0.0, 1.0),),
        look_alikes=("transmission_efficiency", "torque_saturation", "position_dependent_friction"),
        experiment=(
            "One slow motion under two loads and without load, raising and lowering: friction that "
            "grows with the load is the same in both directions, the loss of a gear is not."
        ),
        sentence="friction grows by {coefficient:%} of the load's torque",
    ),
)
"""Effects of the load device and of other loads on the joint."""
