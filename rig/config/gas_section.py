"""Bench file sections of the gas generator and its pressure transmitter."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from drivers.canopen.cia404 import Cia404Transmitter
from drivers.objects import ProcessChannel
from identification.model.gas_generator import GasGenerator
from identification.model.valve import ValveGeometry
from rig.config.configuration import Positive, Schema


class PressureSection(Schema):
    """A CANopen pressure transmitter (CiA 404) on the chamber.

    Attributes:
        kind: The protocol of the transmitter.
        node: CANopen node number.
        unit_Pa: Pressure of one unit of the process value 9130h; checked against 6131h and 6132h
            before a run.
        range_MPa: Highest pressure that the transmitter measures.
        eds: The device's own EDS file, relative to the bench file; the simulated transmitter needs
            none.
    """

    kind: Literal["cia404"] = "cia404"
    node: Annotated[int, Field(ge=1, le=127)] = 4
    unit_Pa: Positive = 100.0
    range_MPa: Positive
    eds: str | None = None

    def transmitter(self, channel: ProcessChannel) -> Cia404Transmitter:
        """Return the device."""
        return Cia404Transmitter(channel, self.unit_Pa)


class GasGeneratorSection(Schema):
    """Nominal constants of gas generator and valve (Fig. 3, eq. 2, 3, 10).

    Contact force and limits need the valve and the back pressure; a flow command needs the
    propellant, the burning law and the chamber; the other constants are for the diagnosis.

    Attributes:
        hole_diameter_m: Diameter of the hole in the valve's plate.
        opening_diameter_m: Diameter of the opening that the plate covers.
        plate_width_m: Width of the plate.
        back_pressure_MPa: Pressure p_c0 downstream of the valve.
        propellant_density_kg_m3: Density rho_b of the propellant.
        burning_rate_mm_s: Burning rate a at 1 MPa.
        pressure_exponent: Exponent n of the burning law.
        chamber_diameter_m: Diameter D_P of the end-burning grain.
        characteristic_velocity_m_s: Characteristic velocity C_r of the gas.
        heat_ratio: Specific-heat ratio of the gas.
        free_volume_m3: Volume of the chamber without the grain, at ignition.
    """

    hole_diameter_m: Positive
    opening_diameter_m: Positive
    plate_width_m: Positive
    back_pressure_MPa: Annotated[float, Field(ge=0)]
    propellant_density_kg_m3: Positive
    burning_rate_mm_s: Positive
    pressure_exponent: Annotated[float, Field(gt=0, lt=1)]
    chamber_diameter_m: Positive
    characteristic_velocity_m_s: Positive
    heat_ratio: Annotated[float, Field(gt=1, lt=2)]
    free_volume_m3: Positive

    def valve(self, arm_m: float) -> ValveGeometry:
        """Return the geometry of the valve, whose plate turns at the radius L1, ``arm_m``."""
        return ValveGeometry(
            self.hole_diameter_m, self.opening_diameter_m, self.plate_width_m, arm_m
        )

    def generator(self, arm_m: float) -> GasGenerator:
        """Return the record that the numerics use."""
        return GasGenerator(
            rho_b=self.propellant_density_kg_m3,
            D_P=self.chamber_diameter_m,
            a=self.burning_rate_mm_s * 1e-3,
            n=self.pressure_exponent,
            C_r=self.characteristic_velocity_m_s,
            gamma=self.heat_ratio,
            V_0=self.free_volume_m3,
            p_c0=self.back_pressure_MPa * 1e6,
            valve=self.valve(arm_m),
        )
