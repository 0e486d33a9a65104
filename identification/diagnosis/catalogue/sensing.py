"""Catalogue entries of effects of the sensors: sampling instants, zeros and mounting."""

from __future__ import annotations

from math import pi

from identification.diagnosis.catalogue.entry import Entry, Quantity

SENSING: tuple[Entry, ...] = (
    Entry(
        name="time_skew",
        group="sensing",
        equation=(
            "I_logged(t) = I(t - T), angles at t; where U was computed from angles by the "
            "controller's law: "
            "U_logged(t) = U of command(t), U = that of command(t + T)"
        ),
        assumption="the implied assumption that all channels are sampled at the same instant",
        shows_in="torque",
        coordinate="frequency: grows with the rate of change of the current, at any load and "
        "either way",
        parameters=(Quantity("time_s", "s", -0.05, 0.05),),
        look_alikes=("current_loop_lag", "friction_memory", "transport_delay"),
        experiment=(
            "Fast unloaded sines of two frequencies, command and current on one clock, beside "
            "slow loaded ramps: "
            "a lag rounds the torque and turns its phase less than in proportion to frequency, a "
            "skew shifts it "
            "whole."
        ),
        sentence=(
            "the {channel} is sampled {time_s:abs ms} {time_s:?before/after} the angles that carry "
            "its time stamp"
        ),
    ),
    Entry(
        name="transport_delay",
        group="sensing",
        equation="theta_logged(t) = theta(t - T), phi_logged(t) = phi(t)",
        assumption="the implied assumption that both angles are sampled at the same instant",
        shows_in="transmission",
        coordinate="speed: the angles of motor and joint differ in proportion to it, equal at rest",
        parameters=(Quantity("time_s", "s", 0.0, 0.1),),
        look_alikes=("backlash", "compliance", "time_skew"),
        experiment=(
            "Torque slowly through zero at two loads and two speeds: a gap has a width fixed in "
            "angle, a twist is "
            "proportional to torque, a delay to speed."
        ),
        sentence="the joint's encoder reports the angle of the joint {time_s:ms} ago",
    ),
    Entry(
        name="current_offset",
        group="sensing",
        equation="I_logged = I + I_0",
        assumption="the implied assumption that the current's zero is right",
        shows_in="torque",
        coordinate="direction: one constant torque in motion and at rest, at any speed, angle and "
        "load",
        parameters=(Quantity("current_A", "A", -5.0, 5.0),),
        look_alikes=("asymmetric_coulomb", "gravity_imbalance", "current_drift"),
        experiment=(
            "The logged current with the power stage off; holding at rest after approaches from "
            "either side; full "
            "turns: an offset stays in all of them."
        ),
        sentence="the current reads {current_A:abs mA} too {current_A:?high/low}",
    ),
    Entry(
        name="current_drift",
        group="sensing",
        equation="I_logged = I + r (t + t_0), t since the recording's start, t_0 since the zero "
        "was taken before it",
        assumption="the implied assumption that the current's zero does not change",
        shows_in="torque",
        coordinate="time: one torque that grows from a recording's start, the same both ways and "
        "at rest",
        parameters=(Quantity("rate_A_s", "A/s", -0.1, 0.1),),
        look_alikes=("coulomb_drift", "viscous_thermal_drift", "current_offset", "winding_heating"),
        experiment=(
            "The logged current with the power stage off before and after a long recording; slow "
            "motion both ways "
            "in between: a drift of the zero keeps its sign, one of friction turns with the "
            "direction."
        ),
        sentence="the current's zero {rate_A_s:?rises/falls} by {rate_A_s:abs mA/min} within a "
        "recording",
    ),
    Entry(
        name="encoder_eccentricity",
        group="sensing",
        equation="theta_logged = theta + A sin(theta + p)",
        assumption="the implied assumption that the joint's encoder is centred on its shaft",
        shows_in="transmission",
        coordinate="angle: once per joint turn, the same both ways and at any speed and load",
        parameters=(
            Quantity("amplitude_rad", "rad", 0.0, 0.1),
            Quantity("phase_rad", "rad", -pi, pi),
        ),
        look_alikes=("gear_mesh_ripple", "compliance", "gravity_imbalance"),
        experiment=(
            "The widest travel, slowly both ways, then again with the encoder turned on its "
            "shaft: an eccentric "
            "seat moves its phase, a gear or a load does not."
        ),
        sentence=(
            "the joint's encoder sits off centre and reads up to {amplitude_rad:deg} wrong, once "
            "per turn (phase "
            "{phase_rad:deg})"
        ),
    ),
    Entry(
        name="encoder_slip",
        group="sensing",
        equation="theta_logged = theta + a for t > t_0, in one recording and those after it",
        assumption="the implied assumption that the joint's encoder is fixed to its shaft",
        shows_in="transmission",
        coordinate="time: one step of the angle between motor and joint, which remains",
        parameters=(Quantity("angle_rad", "rad", -1.0, 1.0), Quantity("at_s", "s", 0.0, 1e5)),
        look_alikes=("backlash", "coupling_hysteresis"),
        experiment=(
            "The start position approached again from the same side after the recording: after "
            "a slip the reading differs, after the crossing of a gap it is the same."
        ),
        sentence=(
            "the joint's encoder slipped on its shaft by {angle_rad:deg}, {at_s:s} into "
            "{recordings}"
        ),
    ),
)
"""Effects of the sensors and of their sampling instants."""
