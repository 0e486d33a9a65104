"""Fig. 3: impacted area and effective throat area against the valve angle."""

from __future__ import annotations

import math

import numpy as np

from drivers.mock.plant.gas import impacted_area, throat_area
from drivers.mock.plant.parts.constants import Machine
from identification.plots import regulator
from rig.results.document import Picture
from rig.results.paper.exhibit import Exhibit, columns, true_machine

GREATEST_DEG = 30.0
_STEP_DEG = 0.1


def clear_deg(machine: Machine) -> float:
    """Return the angle at which the plate has left the opening, L1 sin(theta) = (b + D)/2, deg."""
    valve = machine.gas.valve
    beside = 0.5 * (valve.plate_width_m + valve.opening_diameter_m)
    return math.degrees(math.asin(beside / machine.joint.moment_arm_m))


def exhibit() -> Exhibit:
    """Return Fig. 3 from the closed form of the plant's valve."""
    machine = true_machine("practical_hot")
    angle_deg = np.arange(0.0, GREATEST_DEG + 0.5 * _STEP_DEG, _STEP_DEG)
    angle = np.deg2rad(angle_deg)
    throat, impacted = throat_area(machine, angle), impacted_area(machine, angle)
    total = 0.25 * math.pi * machine.gas.valve.opening_diameter_m**2
    clear = clear_deg(machine)
    return Exhibit(
        "fig_3",
        "Fig. 3: impacted and effective throat area",
        "The platform, and the schematic of the impacted area: d = 25 mm, D = 40 mm, b = 54 mm; "
        "the greatest throat is the sum of both areas; the valve turns from 0 to 30 deg. The "
        "paper announces the curve of the throat area, but does not print this curve.",
        (
            f"A_s = {impacted[0]:.4g} m^2 and A_t = {throat[0]:.4g} m^2 at 0 deg; the plate has "
            f"left the opening at {clear:.2f} deg, by the paper at 30 deg; A_s + A_t = "
            f"{total:.5g} m^2 at every angle.",
        ),
        (
            Picture.of(
                "fig_3",
                "Fig. 3: areas against the valve angle",
                regulator.areas(angle_deg, impacted, throat, clear),
            ),
        ),
        {"fig_3": columns(angle_deg=angle_deg, impacted_area_m2=impacted, throat_area_m2=throat)},
    )
