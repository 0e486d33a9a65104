"""Catalogue entries of effects between motor and joint: a joint angle theta other than phi / i, and
a joint torque other than i times the motor torque.
"""

from __future__ import annotations

from math import pi

from identification.diagnosis.catalogue.entry import Entry, Quantity

TRANSMISSION: tuple[Entry, ...] = (
    Entry(
        name="backlash",
        group="transmission",
        equation="theta stands while |phi / i - theta| < gap / 2, else phi / i - theta = gap / 2 "
        "sgn(M)",
        assumption="assumption A5: no mechanical clearance, theta = i theta_r",
        shows_in="transmission",
        coordinate="travel since reversal: a step of fixed size of the angle difference at each "
        "reversal of torque",
        parameters=(Quantity("gap_rad", "rad", 0.0, 0.1),),
        look_alikes=("compliance", "coupling_hysteresis", "transport_delay", "presliding"),
        experiment=(
            "Torque that passes slowly through zero, at two loads and two speeds: a gap has a "
            "fixed width in angle; the effect of a twist is proportional to the torque, that "
            "of a delay to the speed."
        ),
        sentence="the shaft turns {gap_rad:deg} before the valve follows each reversal of torque",
    ),
    Entry(
        name="compliance",
        group="transmission",
        equation="phi / i - theta = M / k",
        assumption="assumption A4: no deformation",
        shows_in="transmission",
        coordinate="torque: the difference of the angles of motor and joint is proportional to the "
        "torque between them",
        parameters=(Quantity("stiffness_Nm_rad", "N m/rad", 50.0, 1e6),),
        look_alikes=("backlash", "coupling_hysteresis", "transport_delay"),
        experiment=(
            "Torque that passes slowly through zero, at two loads and two speeds: a gap has a "
            "fixed width in angle; the effect of a twist is proportional to the torque, that "
            "of a delay to the speed."
        ),
        sentence="the shaft twists in proportion to its torque, with a stiffness of "
        "{stiffness_Nm_rad:N m/deg}",
    ),
    Entry(
        name="gear_mesh_ripple",
        group="transmission",
        equation="phi / i - theta = A sin(n theta + p); M = i Km I (1 + A n cos(n theta + p)) (if "
        "with_torque = 1)",
        assumption="assumption A5: theta = i theta_r with one constant ratio i",
        shows_in="transmission",
        coordinate="angle: periodic in the joint's angle, the same in both directions and at any "
        "speed and load",
        parameters=(
            Quantity("amplitude_rad", "rad", 0.0, 0.05),
            Quantity("per_turn", "1/turn", 5.0, 2000.0),
            Quantity("phase_rad", "rad", -pi, pi),
            Quantity("with_torque", "", 0.0, 1.0),
        ),
        look_alikes=("encoder_eccentricity", "cogging", "torque_ripple"),
        experiment=(
            "Slow turns over the whole travel: an error with more than one period per joint turn "
            "is due to the gear, an error with one period to the seat of the encoder. Turning "
            "the encoder on its shaft changes the phase of the latter only."
        ),
        sentence=(
            "the gear's ratio varies: the angles of motor and joint differ by up to "
            "{amplitude_rad:deg}, {per_turn:} times per joint turn (phase {phase_rad:deg}), and "
            "the torque varies with the ratio ({with_torque:}; 1: it does, 0: it does not)"
        ),
    ),
    Entry(
        name="transmission_efficiency",
        group="transmission",
        equation="M_joint = eta i Km I where the motor drives (M omega > 0), i Km I / eta where "
        "it is driven",
        assumption="the implied assumption that the gear transmits torque without loss in either "
        "direction of power",
        shows_in="torque",
        coordinate="torque: proportional to the torque, with the sign of the power through the "
        "gear",
        parameters=(Quantity("efficiency", "", 0.4, 1.0),),
        look_alikes=("asymmetric_coulomb", "load_dependent_friction", "torque_saturation"),
        experiment=(
            "A load that pulls both ways, in one recording at least: a declared weight fixed to "
            "the joint, level and heavier than its friction. The loss follows the direction of "
            "power, an asymmetry that of motion. If friction is the only load, power flows in "
            "one direction only, and the nominal parameters explain the loss."
        ),
        sentence="the gear transmits {efficiency:%} of the torque, both when it drives and when it "
        "is driven back",
    ),
    Entry(
        name="coupling_hysteresis",
        group="transmission",
        equation="phi / i - theta = x sat(P / M_h), P the play of half width M_h that the torque "
        "M drags along",
        assumption="assumption A4: no deformation; and a deformed part springs back without loss",
        shows_in="transmission",
        coordinate="travel since reversal: loops of the deflection over the torque, the same at "
        "any speed",
        parameters=(
            Quantity("torque_Nm", "N m", 0.01, 100.0),
            Quantity("deflection_rad", "rad", 0.0, 0.05),
        ),
        look_alikes=("backlash", "compliance", "presliding"),
        experiment=(
            "Loops of torque of growing size around zero and around a constant torque, without "
            "motion of the joint: with hysteresis, loops of deflection over torque appear at "
            "any constant torque, with a gap at zero torque only, with a spring never."
        ),
        sentence=(
            "the coupling lags behind its torque by a loop of {deflection_rad:deg} that closes "
            "over {torque_Nm:N m}"
        ),
    ),
)
"""Effects of gear, shaft and coupling."""
