"""Catalogue entries of effects that the paper's gas generator omits (Sec. 3.2, assumptions G1, G4,
G5, and the throat of eq. 3).
"""

from __future__ import annotations

from identification.diagnosis.catalogue.entry import Entry, Quantity

_ALIKE = (
    "Steps of the valve between its least and its greatest throat, early and late in the burn, "
    "and a second burn at another level: at rest area, temperature and burning area look alike; "
    "in the transients a wider throat is quicker and a colder gas slower; and the effect of a "
    "deposit follows time, that of the grain the burnt length."
)

GAS: tuple[Entry, ...] = (
    Entry(
        name="throat_deposition",
        group="gas generator",
        equation="m_g = p_g A_t(theta; d - 2 h, D - 2 h) / C_r, dh/dt = k",
        assumption="the implied assumption of eq. 3 and Fig. 3 that the throat keeps its diameters",
        shows_in="pressure",
        coordinate="time: the pressure climbs through the burn at every angle, most where the "
        "throat is least",
        parameters=(Quantity("rate_m_s", "m/s", 0.0, 2e-4),),
        look_alikes=("burning_area_change", "heat_loss", "leakage"),
        experiment=_ALIKE,
        sentence="a deposit grows on the rims of the throat at {rate_m_s:mm/min}",
    ),
    Entry(
        name="burning_area_change",
        group="gas generator",
        equation="A_b = (pi D_P^2/4) (1 + t w)^2, w = integral of r dt",
        assumption="assumption G1: end burning, the burning area constant (eq. 2)",
        shows_in="pressure",
        coordinate="web burnt: the pressure drifts with the burnt length, by the same share at "
        "every angle",
        parameters=(Quantity("taper_per_m", "1/m", -2.0, 2.0),),
        look_alikes=("throat_deposition", "heat_loss", "erosive_burning"),
        experiment=_ALIKE,
        sentence="the grain's diameter {taper_per_m:?grows/shrinks} by {taper_per_m:abs %/m} of "
        "burnt length",
    ),
    Entry(
        name="erosive_burning",
        group="gas generator",
        equation="r = a p_g^n (1 + k u), u = A_t R_g T_g / (C_r A_b), the speed at which the gas "
        "leaves the surface",
        assumption="assumption G5: the burning rate depends on pressure alone (eq. 2)",
        shows_in="pressure",
        coordinate="throat area: more pressure than eq. 2 gives at wide throats, at once as the "
        "valve opens",
        parameters=(Quantity("coefficient_s_m", "s/m", 0.0, 0.5),),
        look_alikes=("leakage", "heat_loss", "burning_area_change"),
        experiment=(
            "Steps over the whole range of throats, with pauses at five or more: erosion bends "
            "the steady pressure up "
            "toward wide throats, a leak bends it down toward narrow ones; a wrong exponent "
            "leaves it straight in "
            "logarithms."
        ),
        sentence="the burning rate grows by {coefficient_s_m:%/(m/s)} of gas speed along the "
        "surface",
    ),
    Entry(
        name="heat_loss",
        group="gas generator",
        equation="m ds/dt = m_r (1 - s) - s Q / h_g, T_g = s T, Q = Q_0 exp(-t / tau), h_g = "
        "gamma/(gamma - 1) R_g T_g",
        assumption="assumption G4: the gas temperature remains unchanged (eq. 5, 6)",
        shows_in="pressure",
        coordinate="time: too little pressure at first, less as the walls warm; most where little "
        "is burnt",
        parameters=(Quantity("heat_flow_W", "W", 0.0, 1e6), Quantity("time_s", "s", 0.2, 200.0)),
        look_alikes=("throat_deposition", "burning_area_change", "leakage"),
        experiment=(
            "A second burn soon after the first, its walls still warm: the heat loss to the "
            "walls has ended, effects of deposits and grain remain. In one burn, steps early "
            "and late."
        ),
        sentence="cold walls take {heat_flow_W:kW} from the gas at first, and warm in {time_s:s}",
    ),
    Entry(
        name="leakage",
        group="gas generator",
        equation="m_g = p_g (A_t + A_l) / C_r",
        assumption="the implied assumption of eq. 3 that all gas leaves through the valve's throat",
        shows_in="pressure",
        coordinate="throat area: too little pressure, which changes faster, where the throat is "
        "least",
        parameters=(Quantity("area_m2", "m^2", 0.0, 2e-4),),
        look_alikes=("erosive_burning", "throat_deposition", "heat_loss"),
        experiment=(
            "Pauses at five throats or more between the least and the greatest: a leak is the "
            "same area at each, so "
            "that its share is greatest at the least. A cold chamber under test pressure shows it "
            "too."
        ),
        sentence="gas leaks beside the throat through {area_m2:mm^2}",
    ),
)
"""Effects of the gas generator, which show in pressure and valve angle."""
