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
        shows_in="voltage",
        coordinate="torque rate: proportional to the rate of change of the current, at any load "
        "and in both directions; without a measured voltage, in the torque equation",
        parameters=(Quantity("time_s", "s", -0.05, 0.05),),
        look_alikes=("current_loop_lag", "friction_memory", "transport_delay"),
        experiment=(
            "Fast sines of two frequencies without load, with command and current on one clock, "
            "and slow ramps under load: a lag attenuates the torque, and its phase grows less "
            "than in proportion to the frequency; a time skew is a pure delay."
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
        coordinate="speed: the difference of the angles of motor and joint is proportional to the "
        "speed, and zero at rest",
        parameters=(Quantity("time_s", "s", 0.0, 0.1),),
        look_alikes=("backlash", "compliance", "time_skew"),
        experiment=(
            "Torque that passes slowly through zero, at two loads and two speeds: a gap has a "
            "fixed width in angle; the effect of a twist is proportional to the torque, that "
            "of a delay to the speed."
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
            "The logged current with the power stage off, while holding at rest after approaches "
            "from either side, and during full turns: an offset is the same in all these "
            "cases."
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
        coordinate="time: a torque that grows from the start of each recording, the same in both "
        "directions and at rest",
        parameters=(Quantity("rate_A_s", "A/s", -0.1, 0.1),),
        look_alikes=("coulomb_drift", "viscous_thermal_drift", "current_offset", "winding_heating"),
        experiment=(
            "The logged current with the power stage off before and after a long recording, with "
            "slow motion in both directions between: a drift of the zero keeps its sign, a "
            "drift of friction changes its sign with the direction."
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
        coordinate="angle: one period per joint turn, the same in both directions and at any speed "
        "and load",
        parameters=(
            Quantity("amplitude_rad", "rad", 0.0, 0.1),
            Quantity("phase_rad", "rad", -pi, pi),
        ),
        look_alikes=("gear_mesh_ripple", "compliance", "gravity_imbalance"),
        experiment=(
            "Slow motion over the widest travel in both directions, repeated after the encoder was "
            "turned on its shaft: this changes the phase of an eccentricity of the encoder, "
            "but not the phase of an error of the gear or of a load."
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
        coordinate="time: one lasting step of the difference of motor and joint angle",
        parameters=(Quantity("angle_rad", "rad", -1.0, 1.0), Quantity("at_s", "s", 0.0, 1e5)),
        look_alikes=("backlash", "coupling_hysteresis"),
        experiment=(
            "The start position approached from the same side before and after the recording: "
            "after a slip the readings of the joint encoder differ, after the crossing of a "
            "gap they are equal."
        ),
        sentence=(
            "the joint's encoder slipped on its shaft by {angle_rad:deg}, {at_s:s} into "
            "{recordings}"
        ),
    ),
)
"""Effects of the sensors and of their sampling instants."""
