"""Campaign file: constants with their uncertainty, and the section of the gas generator."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, ClassVar, TypeGuard

from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    PositiveFloat,
    Tag,
    model_validator,
)

from identification.model.gas_generator import PAPER, GasGenerator, ValveGeometry
from rig.config.configuration import Schema


def _buildable(value: float) -> float:
    if not 1e-9 < value < 1e9:
        raise ValueError(
            "the value is outside the plausible range 1e-9 to 1e9; check its exponent and unit"
        )
    return value


Constant = Annotated[PositiveFloat, AfterValidator(_buildable)]
"""A constant of a machine, SI."""


class Measured(float):
    """A number with its standard deviation; arithmetic treats it as a plain number.

    Attributes:
        uncertainty: Standard deviation, in the unit of the number.
    """

    uncertainty: float

    def __new__(cls, value: float, uncertainty: float) -> Measured:
        """Create a number from its value and standard deviation."""
        made = super().__new__(cls, value)
        made.uncertainty = uncertainty
        return made


class UncertainConstant(Schema):
    """A positive constant with its uncertainty; a number alone counts as exact.

    Attributes:
        value: The constant, in the unit of its key.
        std: Standard deviation of the value, in the unit of the key.
    """

    heading: ClassVar[str] = "uncertain constant"
    value: Constant
    std: Constant

    @model_validator(mode="after")
    def _above_nothing(self) -> UncertainConstant:
        if self.std >= self.value:
            raise ValueError(
                f"a standard deviation of {self.std:g} is not below the value {self.value:g}; "
                "state a smaller standard deviation"
            )
        return self


class UncertainNumber(Schema):
    """A number of either sign with its uncertainty; a number alone counts as exact.

    Attributes:
        value: The number, in the unit of its key.
        std: Standard deviation of the value, in the unit of the key.
    """

    heading: ClassVar[str] = "uncertain number"
    value: float
    std: Constant


def measured(value: object) -> TypeGuard[Measured]:
    """Return whether a number was stated with an uncertainty."""
    return isinstance(value, Measured)


def _form(value: object) -> str:
    return "uncertain" if isinstance(value, dict | Schema) else "exact"


def _measured(value: float | UncertainConstant | UncertainNumber) -> float:
    if isinstance(value, float | int):
        return value
    return Measured(value.value, value.std)


def uncertain(section: Schema | None, place: str, keys: Iterable[str]) -> dict[str, float]:
    """Return the standard deviation of each constant that was stated with a standard deviation, by
    key.
    """
    values = {} if section is None else {key: getattr(section, key) for key in keys}
    return {
        place + key: value.uncertainty
        for key, value in values.items()
        if isinstance(value, Measured)
    }


if TYPE_CHECKING:
    Known = float
    KnownMass = float
    KnownNumber = float
else:
    _Uncertain = Annotated[UncertainConstant, Tag("uncertain")]
    Known = Annotated[
        Annotated[Constant, Tag("exact")] | _Uncertain,
        Discriminator(_form),
        AfterValidator(_measured),
    ]
    KnownMass = Annotated[
        Annotated[float, Field(ge=0.0, lt=1e9), Tag("exact")] | _Uncertain,
        Discriminator(_form),
        AfterValidator(_measured),
    ]
    KnownNumber = Annotated[
        Annotated[float, Tag("exact")] | Annotated[UncertainNumber, Tag("uncertain")],
        Discriminator(_form),
        AfterValidator(_measured),
    ]


class ValveSection(Schema):
    """Dimensions of the valve (Fig. 3); the defaults are those of the paper. The hole in the plate
    turns at the radius L1, the bench's `moment_arm`.

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
        """Return the record that the numerics use."""
        return ValveGeometry(self.hole_diameter, self.opening_diameter, self.plate_width, arm)


class GasGeneratorSection(Schema):
    """Constants of eq. 2 to 8, SI; the defaults are those of the paper, or assumptions where the
    paper gives no value.

    Attributes:
        propellant_density: Density rho_b, kg/m^3.
        grain_diameter: Diameter D_P of the end-burning grain, m.
        burning_coefficient: Burning rate a at 1 MPa, m/s.
        pressure_exponent: Exponent n of the burning law.
        characteristic_velocity: Characteristic velocity C_r, m/s.
        heat_ratio: Specific-heat ratio; it determines R_g T_g from C_r.
        free_volume: Volume of the chamber without the grain, at ignition, m^3.
        back_pressure: Pressure p_c0 downstream of the valve, Pa.
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
        """Return the record that the numerics use."""
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
