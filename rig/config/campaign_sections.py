"""Schema of the sections of a campaign file: bench, gas generator, declared physics, recordings."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeGuard

from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    PositiveFloat,
    Tag,
    field_validator,
    model_validator,
)

from identification.effects import EFFECTS
from identification.model.gas_generator import PAPER, GasGenerator, ValveGeometry
from identification.model.parameters import (
    LADDER,
    LOAD_PARAMETERS,
    PAPER_FRICTION,
    SYSTEM_PARAMETERS,
)
from identification.recording import CHANNELS, Bench, Controller, Hoist, Model, Pendulum
from rig.common.text import stored_path
from rig.common.timing import iso_time
from rig.config.configuration import Schema, nearest

FITTED_EFFECTS = tuple(e.name for e in EFFECTS.values() if e.fitted_by_estimators)
FITTED_TERMS = ("offset", *FITTED_EFFECTS)
"""Effects that the estimators can fit in addition to the nominal model."""
_BEARING_LOAD = {"coulomb_viscous": "load_dependent", "stribeck": "stribeck_load_dependent"}
"""Rung that results from each rung if `load_dependent_friction` is added."""
PARAMETERS = (*SYSTEM_PARAMETERS, *LOAD_PARAMETERS, "offset")


def _known_term(name: str) -> str:
    if name in FITTED_TERMS:
        return name
    if name in EFFECTS:
        key = EFFECTS[name].declared_by
        remedy = f"; a known weight is declared by `{key}:` of a recording" if key else ""
        raise ValueError(
            f"the effect {name!r} cannot be fitted; terms may be {', '.join(FITTED_TERMS)}{remedy}"
        )
    raise ValueError(f"unknown effect; {nearest(name, [*FITTED_TERMS, *EFFECTS])}")


ANGLE_TIME = "angle_time"
"""Channel with the time stamps of the joint encoder, s, which the reader uses and then removes."""


def _one_of(names: Iterable[str], what: str) -> AfterValidator:
    """Return the check that a name is one of the given names."""
    known = list(names)

    def check(name: str) -> str:
        if name not in known:
            raise ValueError(f"unknown {what}; {nearest(name, known)}")
        return name

    check.__name__ = f"known_{what}"  # by which the reference describes the check
    return AfterValidator(check)


def _buildable(value: float) -> float:
    if not 1e-9 < value < 1e9:
        raise ValueError(
            "the value is outside the plausible range 1e-9 to 1e9; check its exponent and unit"
        )
    return value


Constant = Annotated[PositiveFloat, AfterValidator(_buildable)]  # a constant of a machine, SI


class Measured(float):
    """A number with its standard deviation; arithmetic treats it as a plain number."""

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
    """Return the standard deviations of the constants that were stated with one, by key."""
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

    def _known(exact, uncertain):
        """Return the type of a number that a file states alone or with its uncertainty."""
        forms = Annotated[exact, Tag("exact")] | Annotated[uncertain, Tag("uncertain")]
        return Annotated[forms, Discriminator(_form), AfterValidator(_measured)]

    Known = _known(Constant, UncertainConstant)
    KnownMass = _known(Annotated[float, Field(ge=0.0, lt=1e9)], UncertainConstant)
    KnownNumber = _known(float, UncertainNumber)


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


def _not_zero(value: float) -> float:
    if value == 0:
        raise ValueError("the scale is 0, which makes all samples 0")
    return value


class ReadSection(Schema):
    """How to read a delimited text file or CAN traffic; other formats need no options.

    Attributes:
        delimiter: Delimiter of the columns, one character; detected from the first lines if left
            out.
        skip_rows: Number of lines before the header, or before the first row of numbers if there is
            no header.
        decimal: Decimal separator.
        dbc: DBC file of recorded CAN traffic, or a list of them, relative to the campaign file.
        bus: Name in the file of the bus whose frames are used (`can0`, `1`); all buses if left
            out.
    """

    delimiter: str | None = Field(default=None, min_length=1, max_length=1)
    skip_rows: int = Field(default=0, ge=0)
    decimal: Literal[".", ","] = "."
    dbc: str | Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    bus: str | int | None = None

    @property
    def dbc_files(self) -> tuple[str, ...]:
        """The DBC files as written."""
        return (self.dbc,) if isinstance(self.dbc, str) else self.dbc or ()

    def beside(self, folder: Path) -> ReadSection:
        """Return a copy of the options in which file names are resolved from a folder."""
        named = tuple(str(folder / stored_path(name)) for name in self.dbc_files)
        return self.model_copy(update={"dbc": named or None})

    @model_validator(mode="after")
    def _told_apart(self) -> ReadSection:
        if self.delimiter == self.decimal == ",":
            raise ValueError("delimiter and decimal are both a comma; change one of the two")
        return self


class ChannelSection(Schema):
    """The column of a channel: SI value = scale * column + offset.

    Attributes:
        column: Name of the column, or its index from 0.
        scale: SI units per unit of the column; a negative scale reverses the sign.
        offset: Value that is added after the scale, SI.
        average: Whether each sample is the mean over the period that ends at its time.
        unsigned: Whether the column contains magnitudes; such a column is rejected, because the
            sign of the torque is needed.
        wraps_after: For `angle`, `motor_angle` and `command`: change, in units of the column, after
            which the column has its former value again, such as 360, 4000 counts, or 6.283 (which
            stands for 2 pi). The column is continued over these jumps; between two samples it must
            change by less than half of this value.
    """

    column: str | Annotated[int, Field(ge=0)]
    scale: Annotated[float, AfterValidator(_not_zero)] = 1.0
    offset: float = 0.0
    average: bool = False
    unsigned: bool = False
    wraps_after: Annotated[PositiveFloat, Field(allow_inf_nan=False)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _short_form(cls, data: object) -> object:
        return (
            {"column": data} if isinstance(data, str | int) and not isinstance(data, bool) else data
        )


class BenchSection(Schema):
    """Constants of the machine, SI; the meanings of the fields are those of
    :class:`identification.recording.Bench`.

    Attributes:
        motion: `rotary`: angles in rad, torques in N m. `linear`: positions in m, forces in N,
            masses in kg; in all descriptions N then replaces N m, and m replaces rad.
        torque_constant: Motor torque per ampere, N m/A. Without this constant and without a
            `torque` channel the fit is in amperes.
        back_emf_constant: Voltage per rad/s of the motor, V s/rad; needed if only the voltage was
            measured.
        resistance: Winding resistance, ohm; needed if only the voltage was measured.
        inductance: Winding inductance, H.
        supply_voltage: Voltage of the supply without load, V, if no `supply_voltage` was recorded.
        gear_ratio: Motor turns per turn of the joint; on a linear bench motor angle per travel,
            rad/m.
        moment_arm: Radius L1 at which the contact force acts, m; needed for the working load.
        lever_ratio: Ratio of the contact force to the weight on the lever, L3/L4; needed if a
            recording has a `weight_mass`.
        gravity: Local gravity, m/s^2.
        gas_generator: The gas generator; needed if pressure was recorded.
    """

    motion: Literal["rotary", "linear"] = "rotary"
    torque_constant: Known | None = None
    back_emf_constant: Known | None = None
    resistance: Known | None = None
    inductance: Known | None = None
    supply_voltage: Known | None = None
    gear_ratio: Known = 1.0
    moment_arm: Known | None = None
    lever_ratio: Known | None = None
    gravity: Known = 9.80665
    gas_generator: GasGeneratorSection | None = None

    def uncertainties(self) -> dict[str, float]:
        """Return the standard deviations of the constants, by their place in a recording."""
        return uncertain(self, "bench.", type(self).model_fields)

    def bench(self) -> Bench:
        """Return the record the numerics use."""
        keys = self.model_fields_set - {"gas_generator"}
        constants: dict[str, Any] = {
            key: value if key == "motion" else float(value)
            for key in keys
            if (value := getattr(self, key)) is not None
        }
        if self.gas_generator is None:
            return Bench(**constants)
        return Bench(
            **constants, gas_generator=self.gas_generator.generator(self.moment_arm or PAPER.L1)
        )


class ModelSection(Schema):
    """Declared physics beyond the nominal nine parameters, and values that are not fitted.

    Attributes:
        friction: Friction model, from the ladder of friction models.
        terms: Further physics that is fitted: `offset` (a constant torque) or
            `load_dependent_friction` (friction grows with the torque of a pendulum).
        fixed: Values of parameters that are not fitted; a value with an uncertainty is a prior,
            which is combined with the estimate from the recordings.
        shared: With units: parameters that are the same in all units.
        per_unit: With units: parameters that differ from unit to unit; stated alone, all others are
            shared. Without either key, no parameter is shared.
    """

    friction: Annotated[str, _one_of(LADDER, "friction")] = PAPER_FRICTION
    terms: tuple[Annotated[str, AfterValidator(_known_term)], ...] = ()
    fixed: dict[Annotated[str, _one_of(PARAMETERS, "parameter")], KnownNumber] = Field(
        default_factory=dict
    )

    shared: tuple[Annotated[str, _one_of(PARAMETERS, "parameter")], ...] = ()
    per_unit: tuple[Annotated[str, _one_of(PARAMETERS, "parameter")], ...] = ()

    @field_validator("terms")
    @classmethod
    def _once(cls, terms: tuple[str, ...]) -> tuple[str, ...]:
        repeated = sorted({name for name in terms if terms.count(name) > 1})
        if repeated:
            raise ValueError(f"{', '.join(repeated)} is listed twice or more; remove repetitions")
        return terms

    @field_validator("fixed")
    @classmethod
    def _physical(cls, fixed: dict[str, float]) -> dict[str, float]:
        negative = [
            f"{name} = {value:g}" for name, value in fixed.items() if value < 0 and name != "offset"
        ]
        if negative:
            raise ValueError(f"a fixed value must not be negative: {', '.join(negative)}")
        return fixed

    def model(self) -> Model:
        """Return the record the numerics use."""
        priors = {n: (float(v), v.uncertainty) for n, v in self.fixed.items() if measured(v)}
        return Model(terms=self.terms, fixed=self.held, friction=self.rung, priors=priors)

    @property
    def held(self) -> dict[str, float]:
        """Parameters that are known exactly and not fitted."""
        return {name: value for name, value in self.fixed.items() if not measured(value)}

    @property
    def rung(self) -> str:
        """The rung of the ladder that `friction` and `terms` select together."""
        if set(FITTED_EFFECTS) & set(self.terms):
            return _BEARING_LOAD.get(self.friction, self.friction)
        return self.friction


ChannelName = Annotated[str, _one_of((*CHANNELS, ANGLE_TIME), "channel")]


class GravitySection(Schema):
    """A known weight that turns with the joint: torque -m g l sin(angle - zero).

    Attributes:
        mass: Mass m, kg.
        length: Distance l of the weight's centre from the axis, m.
        zero: Angle at which the weight hangs straight down, rad.
    """

    mass: Known
    length: Known
    zero: KnownNumber = 0.0

    def pendulum(self) -> Pendulum:
        """Return the record the numerics use."""
        return Pendulum(float(self.mass), float(self.length), float(self.zero))


class HoistSection(Schema):
    """A known mass that hangs on the joint by a rope: torque -m g r at every angle, inertia m r^2.

    Attributes:
        mass: Mass m, kg.
        radius: Radius r of drum or pulley, m; negative if forward motion lowers the mass. A linear
            bench must have no radius, because the force is -m g.
    """

    mass: Known
    radius: KnownNumber | None = None

    @field_validator("radius")
    @classmethod
    def _turns(cls, radius: float | None) -> float | None:
        if radius is not None and not 1e-9 < abs(radius) < 1e9:
            raise ValueError(
                "the magnitude is outside the plausible range 1e-9 to 1e9; check its exponent and "
                "unit"
            )
        return radius

    def hoist(self) -> Hoist:
        """Return the record the numerics use."""
        return Hoist(float(self.mass), 1.0 if self.radius is None else float(self.radius))


class WindowSection(Schema):
    """The part of a file that is used, by the time of the file; short form: `[from, to]`.

    Attributes:
        from: Time at which the part begins, s.
        to: Time at which the part ends, s; a sample at this time is not used.
    """

    begin: float | None = Field(default=None, alias="from")
    to: float | None = None

    @model_validator(mode="before")
    @classmethod
    def _short_form(cls, data: object) -> object:
        if not isinstance(data, list | tuple):
            return data
        if len(data) != 2:
            raise ValueError("the short form of a window is [from, to]; null leaves an end open")
        return {"from": data[0], "to": data[1]}

    @model_validator(mode="after")
    def _in_order(self) -> WindowSection:
        if self.begin is not None and self.to is not None and not self.begin < self.to:
            raise ValueError(
                f"the window is empty, from {self.begin:g} to {self.to:g} s; `from` must be below "
                f"`to`"
            )
        return self

    def words(self) -> str:
        """Return the window as text."""
        begin = "the beginning" if self.begin is None else f"{self.begin:g} s"
        return f"{begin} to {'the end' if self.to is None else f'{self.to:g} s'}"


class ControllerSection(Schema):
    """The position loop: output = clip(position_gain (command - angle) - velocity_gain velocity,
    limit).

    Attributes:
        output: `duty`: share of the supply voltage; `voltage`: motor voltage, V; `torque`: torque
            at the joint, N m.
        position_gain: Output per rad.
        velocity_gain: Output per rad/s.
        limit: Greatest magnitude of the output.
    """

    output: Literal["duty", "voltage", "torque"]
    position_gain: PositiveFloat
    velocity_gain: Annotated[float, Field(ge=0.0)] = 0.0
    limit: PositiveFloat | None = None

    def controller(self) -> Controller:
        """Return the record the numerics use."""
        return Controller(**self.model_dump())


class RecordingSection(Schema):
    """One entry of `recordings`, for one file or several.

    Attributes:
        file: File name or glob relative to the campaign file, or a list of them, of any format of
            the reference of file formats; all may be gzipped.
        stage: The load condition.
        weight_mass: Mass on the lever, kg. The contact force is lever_ratio m g (Fig. 10).
        moment_arm: Radius L1 at which the contact force acts, m; `bench.moment_arm` if it is left
            out.
        gravity: A known weight that turns with the joint.
        hoisted: A known mass that hangs on the joint by a rope.
        constant_torque: Known torque on the joint that does not depend on the angle, N m; a
            positive torque drives the joint forward.
        unit: Name of the machine, if the recordings are of several of one kind; all recordings
            state it, or none.
        start: Start time of the file: an ISO time, or seconds since the machine was switched on
            cold. Either all recordings state a start time, or no recording does.
        window: The part of the file that is used.
        controller: The position loop during the recording, for simulations.
        role: `validate` excludes the recording from every fit; at the end the recording is scored,
            and a diagnosis uses it to decide which identified effects it keeps.
        rate: Sampling rate, Hz; only if there is no `time` channel.
        read: How to read a text file.
        channels: Column of each canonical channel. A name or index alone is the short form of
            `{column: ...}`.
    """

    file: str | Annotated[tuple[str, ...], Field(min_length=1)]
    stage: Literal["unloaded", "loaded"] = "unloaded"
    weight_mass: KnownMass = 0.0
    moment_arm: Known | None = None
    gravity: GravitySection | None = None
    hoisted: HoistSection | None = None
    constant_torque: KnownNumber = 0.0
    unit: Annotated[str, Field(pattern=r"^(\w[\w.-]*)?$")] = ""
    start: float | Annotated[str, AfterValidator(iso_time)] | None = None
    window: WindowSection | None = None
    controller: ControllerSection | None = None
    role: Literal["fit", "validate"] = "fit"
    rate: Constant | None = None
    read: ReadSection = ReadSection()
    channels: dict[ChannelName, ChannelSection]

    @field_validator("unit", mode="before")
    @classmethod
    def _named(cls, unit: object) -> object:
        return str(unit) if type(unit) is int else unit

    @property
    def known_load(self) -> bool:
        """Whether a known torque acts on the joint in addition to that of the drive."""
        return self.gravity is not None or self.hoisted is not None or self.constant_torque != 0.0

    def uncertainties(self) -> dict[str, float]:
        """Return the standard deviations of known loads, by their place in a recording."""
        return {
            **uncertain(self, "", ("weight_mass", "constant_torque")),
            **uncertain(self, "bench.", ("moment_arm",)),
            **uncertain(self.gravity, "pendulum.", ("mass", "length", "zero")),
            **uncertain(self.hoisted, "hoist.", ("mass", "radius")),
        }

    @property
    def patterns(self) -> tuple[str, ...]:
        """File names and patterns as written in the file."""
        return (self.file,) if isinstance(self.file, str) else self.file
