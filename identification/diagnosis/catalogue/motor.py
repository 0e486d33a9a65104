"""Catalogue entries of effects of the motor and its electronics: torque other than Km I, and
voltage other than R I + Ke omega (eq. 1).
"""

from __future__ import annotations

from math import pi

from identification.diagnosis.catalogue.entry import Entry, Quantity

MOTOR: tuple[Entry, ...] = (
    Entry(
        name="cogging",
        group="motor",
        equation="J domega/dt = i Km I + A sin(n phi + p) - M_f - M_L",
        assumption="the implied assumption that the motor's torque is Km I, and none without "
        "current (eq. 1)",
        shows_in="torque",
        coordinate="motor angle: periodic in the motor's angle, with the same amplitude at any "
        "current and load",
        parameters=(
            Quantity("torque_Nm", "N m", 0.0, 20.0),
            Quantity("per_motor_turn", "1/turn", 1.0, 200.0),
            Quantity("phase_rad", "rad", -pi, pi),
        ),
        look_alikes=("torque_ripple", "gear_mesh_ripple", "encoder_eccentricity"),
        experiment=(
            "One slow turn without load and under two weights: the torque of cogging is constant, "
            "that of ripple grows with the current."
        ),
        sentence=(
            "a torque of {torque_Nm:N m} swings {per_motor_turn:} times per motor turn whatever "
            "the current "
            "(phase {phase_rad:deg})"
        ),
    ),
    Entry(
        name="torque_ripple",
        group="motor",
        equation="J domega/dt = i Km I (1 + f sin(n phi + p)) - M_f - M_L",
        assumption="the implied assumption that the torque constant Km is constant over a turn "
        "(eq. 1)",
        shows_in="torque",
        coordinate="motor angle: periodic in the motor's angle, with an amplitude proportional to "
        "the current",
        parameters=(
            Quantity("fraction", "", 0.0, 0.5),
            Quantity("per_motor_turn", "1/turn", 1.0, 200.0),
            Quantity("phase_rad", "rad", -pi, pi),
        ),
        look_alikes=("cogging", "gear_mesh_ripple", "encoder_eccentricity"),
        experiment=(
            "One slow turn without load and under two weights: the torque of cogging is constant, "
            "that of ripple grows with the current."
        ),
        sentence=(
            "the motor's torque per ampere swings by {fraction:%} of itself, {per_motor_turn:} "
            "times per motor "
            "turn (phase {phase_rad:deg})"
        ),
    ),
    Entry(
        name="torque_saturation",
        group="motor",
        equation="J domega/dt = i Km I_k tanh(I / I_k) - M_f - M_L, or (rational = 1) "
        "i Km I / (1 + (I / I_k)^2) - M_f - M_L",
        assumption="the implied assumption that torque is proportional to current at any current "
        "(eq. 1)",
        shows_in="torque",
        coordinate="torque: grows as the cube of the current, zero at small currents",
        parameters=(Quantity("knee_A", "A", 2.0, 500.0), Quantity("rational", "", 0.0, 1.0)),
        look_alikes=("load_exponent", "transmission_efficiency", "winding_heating"),
        experiment=(
            "High currents without load, by the greatest accelerations that the limits allow, and "
            "high currents under load: saturation depends on the current, load friction on the "
            "weight."
        ),
        sentence="torque per ampere falls as the current rises, with a knee at {knee_A:A} "
        "(rational {rational:}; 0: I_k tanh(I / I_k), 1: I / (1 + (I / I_k)^2) in place of I)",
    ),
    Entry(
        name="current_loop_lag",
        group="motor",
        equation="J domega/dt = i Km I_true - M_f - M_L, T dI_true/dt = I - I_true",
        assumption="the implied assumption that the torque follows the measured current at once "
        "(eq. 1)",
        shows_in="torque",
        coordinate="torque rate: grows with the rate of change of the current, most at reversals "
        "of torque",
        parameters=(Quantity("time_s", "s", 0.0, 0.05),),
        look_alikes=("time_skew", "friction_memory", "transport_delay"),
        experiment=(
            "Fast sines of two frequencies without load, with command and current on one clock, "
            "and slow ramps under load: a lag attenuates the torque, and its phase grows less "
            "than in proportion to the frequency; a time skew is a pure delay."
        ),
        sentence="the motor's torque lags the measured {channel} by {time_s:ms}, first order",
    ),
    Entry(
        name="inverter_dead_time",
        group="motor",
        equation="R I + L dI/dt = U - U_d sgn(I) - Ke dphi/dt",
        assumption="the implied assumption that the voltage at the winding is the logged one (eq. "
        "1)",
        shows_in="voltage",
        coordinate="current direction: a sharp step with the sign of the current, at any speed, "
        "in proportion to the supply voltage",
        parameters=(Quantity("voltage_V", "V", 0.0, 5.0),),
        look_alikes=("brush_drop", "winding_heating", "supply_sag"),
        experiment=(
            "Small currents through zero, at rest and in motion, at two supply voltages: dead time "
            "causes a sharp step in proportion to the supply voltage; a brush drop is a "
            "rounded step that does not depend on the supply voltage."
        ),
        sentence="the voltage at the winding is {voltage_V:V} less than the logged one, a sharp "
        "step with the sign of the current",
    ),
    Entry(
        name="brush_drop",
        group="motor",
        equation="R I + L dI/dt = U - U_b tanh(I / I_b) - Ke dphi/dt",
        assumption="the implied assumption that voltage falls over R, L and Ke omega alone (eq. 1)",
        shows_in="voltage",
        coordinate="current direction: a rounded step with the sign of the current, at any speed "
        "and supply voltage",
        parameters=(Quantity("voltage_V", "V", 0.0, 5.0), Quantity("current_A", "A", 0.01, 10.0)),
        look_alikes=("inverter_dead_time", "winding_heating", "supply_sag"),
        experiment=(
            "Small currents through zero, at rest and in motion, at two supply voltages: dead time "
            "causes a sharp step in proportion to the supply voltage; a brush drop is a "
            "rounded step that does not depend on the supply voltage."
        ),
        sentence=(
            "{voltage_V:V} are lost between logged voltage and winding, reached over "
            "{current_A:A} around zero current"
        ),
    ),
    Entry(
        name="winding_heating",
        group="motor",
        equation=(
            "R(dT) = R (1 + 0.00393 dT), Km and Ke (dT) = those (1 - 0.001 dT) (if magnet = 1), T "
            "d(dT)/dt = r R(dT) I^2 - dT"
        ),
        assumption="the implied assumption that the motor's constants R and Km are constant (eq. "
        "1)",
        shows_in="voltage",
        coordinate="time: grows with the heat that the current has produced since the start, and "
        "falls at rest",
        parameters=(
            Quantity("rise_K_per_W", "K/W", 0.0, 20.0),
            Quantity("time_s", "s", 1.0, 5000.0),
            Quantity("magnet", "", 0.0, 1.0),
        ),
        look_alikes=("viscous_thermal_drift", "coulomb_drift", "current_drift", "supply_sag"),
        experiment=(
            "One sequence at two speeds, with the machine cold, after minutes at high current, and "
            "after a rest, with voltage and current logged: a hot winding changes U - Ke omega "
            "per ampere, hot grease changes the current only."
        ),
        sentence=(
            "the winding heats by {rise_K_per_W:K/W} of loss with a time constant of {time_s:s}, "
            "its resistance rises and, if the magnets heat with it ({magnet:}; 1: they do, 0: they "
            "do not), its torque per ampere falls"
        ),
    ),
    Entry(
        name="supply_sag",
        group="motor",
        equation="R I + L dI/dt = U (1 - Rs I_bus / U_nominal) - Ke dphi/dt",
        assumption="the implied assumption that the supply's voltage is constant",
        shows_in="voltage",
        coordinate="torque: grows with the power of the motor, the product of voltage and supply "
        "current",
        parameters=(Quantity("resistance_ohm", "ohm", 0.0, 3.0),),
        look_alikes=("winding_heating", "inverter_dead_time", "brush_drop"),
        experiment=(
            "One high current at rest, where the supply delivers little power, and in fast motion, "
            "where it delivers much power. A log of the supply voltage shows the effect "
            "directly."
        ),
        sentence="the supply voltage falls by {resistance_ohm:ohm} times the supply current, and "
        "the voltage at the winding with it",
    ),
)
"""Effects of the motor and its electronics."""
