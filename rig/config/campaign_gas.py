"""Constants of a machine in a campaign file, and the gas generator made of them."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field, PositiveFloat, model_validator

from identification.model.gas_generator import GasGenerator
from identification.model.valve import PAPER, ValveGeometry
from rig.config.configuration import Schema


def _buildable(value: float) -> float:
    if not 1e-9 < value < 1e9:
        raise ValueError("outside of 1e-9 to 1e9; no machine is built so, check exponent and unit")
    return value


Constant = Annotated[PositiveFloat, AfterValidator(_buildable)]
"""A constant of a machine, SI."""


class ValveSection(Schema):
    """Dimensions of Fig. 3; the paper's where not given. The hole swings on the bench's moment arm,
    L1.

    Attributes:
        hole_diameter: Diameter of the hole in the plate, m.
        opening_diameter: Diameter of the opening behind the plate, m.
        plate_width: Width of the plate, m.
    """

    hole_diameter: Constant = 0.025
    opening_diameter: Constant = 0.040
    plate_width: Constant = 0.054

    @model_validator(mode="after")
    def _fits(self) -> ValveSection:
        self.geometry(PAPER.L1)
        return self

    def geometry(self, arm: float) -> ValveGeometry:
        """Return the record the numerics use."""
        return ValveGeometry(self.hole_diameter, self.opening_diameter, self.plate_width, arm)


class GasGeneratorSection(Schema):
    """Constants of eq. 2 to 8, SI; those of the paper, or chosen, where not given.

    Attributes:
        propellant_density: Density rho_b, kg/m^3.
        grain_diameter: Diameter D_P of the end-burning grain, m.
        burning_coefficient: Burning rate a at 1 MPa, m/s.
        pressure_exponent: Exponent n of the burning law.
        characteristic_velocity: Characteristic velocity C_r, m/s.
        heat_ratio: Specific-heat ratio; it ties R_g T_g to C_r.
        free_volume: Volume of the chamber without the grain, at ignition, m^3.
        back_pressure: Pressure p_c0 behind the valve, Pa.
        valve: Dimensions of the gate.
    """

    propellant_density: Constant = 1630.0
    grain_diameter: Constant = 0.350
    burning_coefficient: Constant = 6.3e-3
    pressure_exponent: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.53
    characteristic_velocity: Constant = 1000.0
    heat_ratio: Annotated[float, Field(gt=1.0, lt=2.0)] = 1.25
    free_volume: Constant = 0.010
    back_pressure: Annotated[float, Field(ge=0.0, lt=1e9)] = 0.5e6
    valve: ValveSection = ValveSection()

    def generator(self, arm: float) -> GasGenerator:
        """Return the record the numerics use."""
        return GasGenerator(
            rho_b=self.propellant_density,
            D_P=self.grain_diameter,
            a=self.burning_coefficient,
            n=self.pressure_exponent,
            C_r=self.characteristic_velocity,
            gamma=self.heat_ratio,
            V_0=self.free_volume,
            p_c0=self.back_pressure,
            valve=self.valve.geometry(arm),
        )
