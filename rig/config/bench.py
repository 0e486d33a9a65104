"""Schema of the bench file: machine constants, bus, devices, limits and the simulated machine.

The names of the keys contain the units (``angle_max_deg``); the properties of the records return SI
units.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import yaml
from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from drivers.can.port import ANSWER_SHARE, cycle_bits
from drivers.canopen import cia402_objects, sensors
from drivers.canopen.eds_file import read_eds
from drivers.canopen.sdo import Axis, described
from drivers.canopen.sensors import Cia404Transmitter
from drivers.errors import ConfigurationError
from drivers.mock.plant.parts import constants
from drivers.objects import ProcessChannel
from identification.model.gas_generator import GasGenerator, ValveGeometry
from rig.common.yaml_tree import parse
from rig.config.canopen import Bus, EncoderSection, ServoSection
from rig.config.configuration import (
    Document,
    NonNegative,
    Positive,
    Schema,
    load_located,
    located_text,
    resolve,
)
from rig.config.dbc import DbcServoSection, cycle_frames, wire
from rig.config.serial_bus import MOCK, UNWATCHED_SHARE, Amt21Section, SerialBus, overload
from rig.config.simulated_machine import (
    follow_bench,
    hidden_problems,
    plant_problems,
    require_buildable,
)


class LimitsSection(Schema):
    """Limits that the program checks on every sample; a limit for which the drive has an object is
    also checked by the drive.

    Attributes:
        angle_min_deg: Lowest joint angle, commanded or measured.
        angle_max_deg: Highest joint angle, commanded or measured.
        speed_deg_s: Highest joint speed.
        torque_N_m: Highest torque of the drive, at the joint after the gear.
        current_A: Highest motor current.
        following_error_deg: Largest difference between commanded and measured joint angle.
        encoder_disagreement_deg: Largest difference between joint encoder and motor encoder, at the
            joint.
        weight_kg: Heaviest weight that a sequence may hang.
        contact_force_N: Highest contact force, of a weight or of the gas generator's pressure.
        pressure_MPa: Highest chamber pressure; needed if there is a pressure transmitter.
        temperature_C: Highest temperature that the drive may report.
        supply_min_V: Lowest supply voltage.
        supply_max_V: Highest supply voltage.
        sample_age_ms: Greatest age of a sample with which a cycle may continue.
        lateness_ms: Greatest delay of the start of a cycle; at most half of the time after which
            the drive's watchdog acts.
    """

    angle_min_deg: float
    angle_max_deg: float
    speed_deg_s: Positive
    torque_N_m: Positive
    current_A: Positive
    following_error_deg: Positive
    encoder_disagreement_deg: Positive
    weight_kg: NonNegative
    contact_force_N: NonNegative
    pressure_MPa: Positive | None = None
    temperature_C: float = 80.0
    supply_min_V: NonNegative = 0.0
    supply_max_V: Positive = 1000.0
    sample_age_ms: Positive = 5.0
    lateness_ms: Annotated[float, Field(gt=0, le=50)] = 25.0

    @property
    def middle_rad(self) -> float:
        """Middle of the joint's travel, rad."""
        return math.radians(0.5 * (self.angle_min_deg + self.angle_max_deg))

    @model_validator(mode="after")
    def _range_is_open(self) -> Self:
        if not self.supply_min_V < self.supply_max_V:
            raise ValueError(
                f"supply_min_V {self.supply_min_V:g} must be below supply_max_V "
                f"{self.supply_max_V:g}; exchange the two values"
            )
        if not self.angle_min_deg < self.angle_max_deg:
            raise ValueError(
                f"angle_min_deg {self.angle_min_deg:g} must be below angle_max_deg "
                f"{self.angle_max_deg:g}; exchange the two values"
            )
        return self


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


NOT_REPORTED = (
    "servo.inputs has no signal of this quantity, so that this limit would never be checked; if "
    "the drive sends the quantity, add its signal to servo.inputs, otherwise remove the limit"
)


class Constants(Schema):
    """Nominal constants of the machine, which an identification uses.

    Attributes:
        torque_constant_N_m_A: Motor torque per ampere, at the motor shaft.
        back_emf_constant_V_s_rad: Voltage induced per rad/s of the motor shaft.
        resistance_ohm: Winding resistance.
        inductance_H: Winding inductance.
        gear_ratio: Motor turns per turn of the joint.
        moment_arm_m: Radius L1 at which the contact force acts on the joint (Fig. 3, 8).
        lever_ratio: Ratio of the contact force to the weight that hangs on the lever, L3/L4 (eq.
            17).
        gravity_m_s2: Local gravity.
    """

    torque_constant_N_m_A: Positive
    back_emf_constant_V_s_rad: Positive
    resistance_ohm: Positive
    inductance_H: NonNegative
    gear_ratio: Positive
    moment_arm_m: Positive
    lever_ratio: Positive
    gravity_m_s2: Positive = 9.80665


def _stated(section: object, key: str, default: str | None = None) -> object:
    """Return the value of a key of a section, which may be a mapping or a record."""
    if isinstance(section, dict):
        return section.get(key, default)
    return getattr(section, key, default)


def _bus_kind(section: object) -> str:
    return "serial" if _stated(section, "interface") == "epos_serial" else "can"


class Calibration(Schema):
    """A calibration on which the results of this bench depend.

    Attributes:
        device: Calibrated device.
        id: Number of the certificate.
        due: Last day on which the calibration is valid.
    """

    device: str
    id: str
    due: date


class Bench(Schema):
    """One bench, as written in its file.

    Attributes:
        bench: Version of the file format.
        name: Name of the bench in reports.
        machine: Nominal constants of the machine.
        bus: The bus of the drive; null for the literal bench, which has no bus.
        servo: The drive.
        encoder: The joint encoder.
        pressure: The pressure transmitter of hot firings.
        gas_generator: Nominal constants of the gas generator of hot firings.
        cycle_Hz: Control cycles per second. The period must be a whole number of milliseconds.
        limits: Limits of the bench.
        weights_kg: Masses that can be hung on the lever; planned experiments use only these masses.
        weight_tolerance: Greatest relative difference between the mass that the operator types and
            the planned mass.
        weights_hung_by: `hoist` states that a machine hangs the weights and that the hung mass is
            certain, so that `--yes` may answer the prompts of a real bench.
        calibrations: Calibrations on which the results depend.
        overdue_calibration: Reaction of a run to a calibration whose last day has passed.
        prompt_timeout_s: Longest wait for an answer of the operator; null for no time-out.
        mock: The simulated machine behind a simulated bus. Keys that are left out follow from the
            rest of the file (motor, lever, encoders, supply and limits); friction and inertia are
            those of the paper, scaled by `limits.torque_N_m`.
    """

    bench: Literal[1]
    name: str
    machine: Constants
    bus: (
        Annotated[
            Annotated[Bus, Tag("can")] | Annotated[SerialBus, Tag("serial")],
            Discriminator(_bus_kind),
        ]
        | None
    ) = Bus()
    servo: Annotated[
        Annotated[ServoSection, Tag("canopen")] | Annotated[DbcServoSection, Tag("dbc")],
        Discriminator(
            lambda section: _stated(section, "kind", "canopen"),
            "servo_kind",
            "kind is unknown; known are canopen (the default) and dbc",
        ),
    ] = ServoSection()
    encoder: Annotated[
        Annotated[EncoderSection, Tag("cia406")] | Annotated[Amt21Section, Tag("amt21")],
        Discriminator(
            lambda section: _stated(section, "kind", "cia406"),
            "encoder_kind",
            "kind is unknown; known are cia406 (the default) and amt21",
        ),
    ] = EncoderSection()
    pressure: PressureSection | None = None
    gas_generator: GasGeneratorSection | None = None
    cycle_Hz: Annotated[float, Field(ge=0.1, le=4000)] = 1000.0
    limits: LimitsSection
    weights_kg: tuple[Positive, ...] = ()
    weight_tolerance: Annotated[float, Field(gt=0, le=0.05)] = 0.005
    weights_hung_by: Literal["operator", "hoist"] = "operator"
    calibrations: tuple[Calibration, ...] = ()
    overdue_calibration: Literal["warn", "refuse"] = "warn"
    prompt_timeout_s: Positive | None = None
    mock: constants.Machine | None = None

    @field_validator("cycle_Hz")
    @classmethod
    def _whole_milliseconds(cls, rate: float) -> float:
        period_ms = 1e3 / rate
        if abs(period_ms - round(period_ms)) > 1e-9:
            raise ValueError(
                f"the period {period_ms:g} ms must be a whole number of milliseconds; try 1000, "
                f"500 or 250"
            )
        return rate

    @field_validator("mock")
    @classmethod
    def _can_be_built(cls, machine: constants.Machine | None) -> constants.Machine | None:
        if machine is not None:
            require_buildable(machine)
        return machine

    @model_validator(mode="after")
    def _pressure_is_watched(self) -> Self:
        if self.pressure is None:
            return self
        if isinstance(self.bus, SerialBus):
            raise ValueError(
                "a pressure transmitter of kind cia404 needs a CAN bus, but bus.interface is "
                "epos_serial; remove `pressure`"
            )
        if isinstance(self.servo, DbcServoSection) and self.simulated:
            raise ValueError(
                "a simulated bench with a servo of kind dbc has no pressure transmitter; remove "
                "`pressure`"
            )
        if self.simulated and self.mock is not None and self.mock.plant:
            raise ValueError(
                "a simulated bench with a machine of its own (`mock.plant`) has no gas generator; "
                "remove `pressure`"
            )
        if self.gas_generator is None:
            raise ValueError(
                "`pressure` needs `gas_generator`, because the contact force is computed from the "
                "pressure and the valve of the gas generator; add `gas_generator`"
            )
        limit = self.limits.pressure_MPa
        if limit is None or limit > self.pressure.range_MPa:
            raise ValueError(
                f"`pressure` needs limits.pressure_MPa, at most pressure.range_MPa "
                f"{self.pressure.range_MPa:g} "
                f"(got {'none' if limit is None else f'{limit:g}'}); set limits.pressure_MPa"
            )
        return self

    @model_validator(mode="after")
    def _devices_fit_the_bus(self) -> Self:
        if self.simulated and self.mock is None:
            raise ValueError(
                "bus.interface is mock but there is no section `mock`; add this section with the "
                "constants of the simulated machine"
            )
        if isinstance(self.bus, SerialBus):
            if isinstance(self.servo, DbcServoSection):
                raise ValueError(
                    "a servo of kind dbc needs a CAN bus, but bus.interface is epos_serial; "
                    "change bus.interface or servo.kind"
                )
            if isinstance(self.encoder, EncoderSection):
                raise ValueError(
                    "an encoder of kind cia406 needs a CAN bus, but bus.interface is epos_serial; "
                    "use amt21"
                )
            if self.servo.object_offset or self.servo.sub_index:
                raise ValueError(
                    "servo.object_offset and servo.sub_index need a CAN bus, but bus.interface is "
                    "epos_serial; remove these keys"
                )
            if self.servo.mode not in (None, "csp"):
                raise ValueError(
                    f"servo.mode {self.servo.mode} needs a CAN bus: over a serial line only "
                    f"positions are sent; use csp"
                )
        if isinstance(self.encoder, Amt21Section):
            if (self.encoder.port == MOCK) is not self.simulated:
                raise ValueError(
                    "bus and encoder must both be simulated (mock) or both real; change "
                    "bus.interface or the encoder"
                )
            if isinstance(self.servo, DbcServoSection) and self.simulated:
                raise ValueError(
                    "with a simulated servo of kind dbc the encoder must be of kind cia406; change "
                    "encoder.kind"
                )
        return self

    @property
    def simulated(self) -> bool:
        """Whether the devices are simulated."""
        if isinstance(self.bus, SerialBus):
            return self.bus.port == MOCK
        return self.bus is None or self.bus.interface == MOCK

    @property
    def watched(self) -> bool:
        """Whether a watchdog in the drive stops the drive when the control loop stops."""
        if isinstance(self.servo, DbcServoSection):
            return self.servo.watchdog_ms is not None
        if self.servo.stops_alone is False:
            return False
        return not isinstance(self.bus, SerialBus)

    @property
    def cycle_ns(self) -> int:
        """Control cycle, ns."""
        return round(1e3 / self.cycle_Hz) * 1_000_000

    @property
    def unreported(self) -> frozenset[str]:
        """Names of the limits that are not checked because the drive does not report the value."""
        servo = self.servo
        return servo.unreported if isinstance(servo, DbcServoSection) else frozenset()

    @property
    def cycle_s(self) -> float:
        """Control cycle, s."""
        return self.cycle_ns * 1e-9


def load_bench(name: str | Path) -> Document[Bench]:
    """Read a bench by path or packaged name; the InputError has every problem with its place.

    For a drive without watchdog, the limits of torque, current and speed in the file are reduced.
    """
    return _in_use(load_located(resolve(name, "benches"), Bench, follow_bench))


def bench_from_text(text: str, path: Path) -> Document[Bench]:
    """Return the bench from a text for a file at or next to ``path``, or an InputError."""
    return _in_use(located_text(path, text, Bench, follow_bench))


def _in_use(document: Document[Bench]) -> Document[Bench]:
    """Check effects, signals and bus load of a bench; return it with the limits in force."""
    bench = document.value
    if bench.mock is not None and bench.mock.effects_file:
        own = str(document.path.parent / bench.mock.effects_file)
        mock = dataclasses.replace(bench.mock, effects_file=own)
        bench = bench.model_copy(update={"mock": mock})
        document = dataclasses.replace(document, value=bench)
    document.require((("mock", *path), text) for path, text in hidden_problems(bench.mock))
    if bench.mock is not None:
        found = plant_problems(bench.mock.plant, document.states)
        document.require((("mock", *path), text) for path, text in found)
    frames: Sequence[tuple[int, int]] = cia402_objects.FRAMES
    if isinstance(bench.servo, DbcServoSection):
        stated = bench.unreported & bench.limits.model_fields_set
        document.require((("limits", name), NOT_REPORTED) for name in sorted(stated))
        frames = cycle_frames(
            wire(bench.servo, document.path, bench.simulated, document.problem), bench.cycle_s
        )
    if isinstance(bench.bus, SerialBus):
        document.require((("bus", "baud"), text) for text in overload(bench.bus, bench.cycle_s))
    elif bench.bus is not None:
        document.require(
            (("bus", "bitrate"), text) for text in bus_overload(frames, bench.bus, bench)
        )
    return in_force(_with_watch(document))


def _with_watch(document: Document[Bench]) -> Document[Bench]:
    """Read from the EDS file whether the drive has a watchdog, if the bench file does not say.

    Another check rejects a file that cannot be read, or is not that of a drive.
    """
    bench = document.value
    servo = bench.servo
    if not isinstance(servo, ServoSection) or servo.stops_alone is not None or servo.eds is None:
        return document
    try:
        eds = read_eds(document.path.parent / servo.eds, servo.node)
    except ConfigurationError:
        return document
    axis = Axis(servo.object_offset, servo.sub_index)

    def has(index: int, subindex: int) -> bool:
        return described(eds, *axis.at(eds, index, subindex), mappable=False)

    is_drive = all(has(*address) for address in cia402_objects.NEEDED)
    if not is_drive or cia402_objects.stops_alone(has):
        return document
    return without_watch(document)


def without_watch(document: Document[Bench]) -> Document[Bench]:
    """Return the bench with a drive without watchdog."""
    bench = document.value
    if not isinstance(bench.servo, ServoSection):
        return document
    servo = bench.servo.model_copy(update={"stops_alone": False})
    return dataclasses.replace(document, value=bench.model_copy(update={"servo": servo}))


def in_force(document: Document[Bench]) -> Document[Bench]:
    """Return a bench with the limits that apply: reduced limits if the drive has no watchdog."""
    bench = document.value
    if bench.watched:
        return document
    names = ("torque_N_m", "current_A", "speed_deg_s")
    cut = {name: UNWATCHED_SHARE * getattr(bench.limits, name) for name in names}
    limits = bench.limits.model_copy(update=cut)
    return dataclasses.replace(document, value=bench.model_copy(update={"limits": limits}))


def bus_overload(servo: Sequence[tuple[int, int]], bus: Bus, bench: Bench) -> Iterator[str]:
    """Yield a problem if the frames of a control cycle exceed the capacity of the bus."""
    bitrate, cycle_s = bus.bitrate, bench.cycle_s
    bits = cycle_bits(
        (*servo, *sensors.ENCODER_FRAMES, *(sensors.PRESSURE_FRAMES if bench.pressure else ()))
    )
    share = bits / (bitrate * cycle_s)
    if share > ANSWER_SHARE:
        shortest_ms = math.ceil(1e3 * bits / (bitrate * ANSWER_SHARE))
        yield (
            f"too slow: a cycle of {cycle_s * 1e3:g} ms takes up to {bits:.0f} bits, {share:.0%} "
            f"of the bus, limit {ANSWER_SHARE:.0%}; raise the bit rate, or lower cycle_Hz to "
            f"{1e3 / shortest_ms:g}"
        )


def calibration_records(bench: Bench, today: date) -> list[Mapping[str, Any]]:
    """Return the bench's calibrations for ``run.json``; a calibration is valid on its due day."""
    return [
        {"device": c.device, "id": c.id, "due": c.due.isoformat(), "overdue": c.due < today}
        for c in bench.calibrations
    ]


def overdue(records: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a message for each overdue calibration."""
    return [
        f"calibration {c['id']} of {c['device']} was due on {c['due']}"
        for c in records
        if c["overdue"]
    ]


def overdue_problems(document: Document[Bench], today: date) -> list[str]:
    """Return the overdue calibrations that prevent a run, each with its place in the file."""
    bench = document.value
    if bench.overdue_calibration != "refuse":
        return []
    return [
        document.problem(
            ("calibrations", index, "due"),
            f"calibration {item.id} of {item.device} is overdue, and overdue_calibration is "
            "`refuse`; have the device calibrated",
        )
        for index, item in enumerate(bench.calibrations)
        if item.due < today
    ]


_OF_THE_MACHINE = frozenset(Constants.model_fields)
_KNOWN: Mapping[str, frozenset[str] | None] = {
    "motor": _OF_THE_MACHINE,
    "joint": _OF_THE_MACHINE,
    "loops": None,
    "sensing": frozenset({"motor_counts_per_turn", "joint_counts_per_turn", "cycle_s"}),
    "steps_per_loop": None,
    "supply_V": None,
}
"""Keys of the ``mock`` section that are kept; None for all keys of a subsection.

Friction, inertia, noise, warming and effects are removed, because they are unknown on a real bench.
"""
# libyaml writes the text faster than PyYAML, but PyYAML may be built without libyaml.
_DUMPER = yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper
_HEAD = (
    "# The true constants of the simulated machine, which are unknown on a real "
    "bench, were removed here.\n"
)


def redacted(content: bytes) -> bytes:
    """Return a valid bench file without the true values of the simulated machine."""
    tree, _ = parse(content.decode("utf-8"))
    bench: Any = tree.plain()
    if not isinstance(bench.get("mock"), dict):
        return content
    bench["mock"] = {
        name: value
        if _KNOWN[name] is None
        else {key: value[key] for key in value if key in (_KNOWN[name] or ())}
        for name, value in bench["mock"].items()
        if name in _KNOWN
    }
    return (_HEAD + yaml.dump(bench, Dumper=_DUMPER, sort_keys=False)).encode("utf-8")
