"""Schema of the bench file: machine constants, bus, devices, limits and the simulated machine.

The names of the keys contain the units (``angle_max_deg``); the properties of the records return SI
units.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from datetime import date
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from drivers.can.timing import ANSWER_SHARE, cycle_bits
from drivers.canopen import cia402_objects, cia404, cia406
from drivers.canopen.axis import Axis
from drivers.canopen.eds_file import read_eds
from drivers.canopen.sdo import described
from drivers.errors import ConfigurationError
from drivers.mock.plant.parts import constants
from rig.config.canopen import Bus, EncoderSection, ServoSection
from rig.config.configuration import (
    Document,
    Loc,
    NonNegative,
    Positive,
    Schema,
    load_located,
    located_text,
)
from rig.config.dbc import DbcServoSection, cycle_frames, wire
from rig.config.gas_section import GasGeneratorSection, PressureSection
from rig.config.limits_section import LimitsSection
from rig.config.packaged import resolve
from rig.config.serial_bus import MOCK, UNWATCHED_SHARE, Amt21Section, SerialBus, overload
from rig.config.simulated_machine import follow_bench, hidden_problems, require_buildable

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


def _servo_kind(section: object) -> object:
    """Return the kind of servo of a section; CANopen if the section states none."""
    return (
        section.get("kind", "canopen")
        if isinstance(section, dict)
        else getattr(section, "kind", None)
    )


def _bus_kind(section: object) -> object:
    """Return the kind of bus of a section: CAN (with many interface names) or serial."""
    name = (
        section.get("interface")
        if isinstance(section, dict)
        else getattr(section, "interface", None)
    )
    return "serial" if name == "epos_serial" else "can"


def _encoder_kind(section: object) -> object:
    """Return the kind of encoder of a section; CiA 406 if the section states none."""
    return (
        section.get("kind", "cia406")
        if isinstance(section, dict)
        else getattr(section, "kind", None)
    )


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
            _servo_kind, "servo_kind", "kind is unknown; known are canopen (the default) and dbc"
        ),
    ] = ServoSection()
    encoder: Annotated[
        Annotated[EncoderSection, Tag("cia406")] | Annotated[Amt21Section, Tag("amt21")],
        Discriminator(
            _encoder_kind,
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
    def _mock_is_described(self) -> Self:
        if self.simulated and self.mock is None:
            raise ValueError(
                "bus.interface is mock but there is no section `mock`; add this section with the "
                "constants of the simulated machine"
            )
        return self

    @model_validator(mode="after")
    def _devices_fit_the_bus(self) -> Self:
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
        if (
            isinstance(self.encoder, Amt21Section)
            and (self.encoder.port == MOCK) is not self.simulated
        ):
            raise ValueError(
                "bus and encoder must both be simulated (mock) or both real; change bus.interface "
                "or the encoder"
            )
        if (
            isinstance(self.encoder, Amt21Section)
            and isinstance(self.servo, DbcServoSection)
            and self.simulated
        ):
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
    """Read a bench by path, or by the bare name of a packaged bench (``practical``).

    For a drive without watchdog, the limits of torque, current and speed in the file are reduced.

    Raises:
        InputError: The file is missing or not valid; the message lists every problem with its place
            in the file.
    """
    return _in_use(load_located(resolve(name, "benches"), Bench, follow_bench))


def bench_from_text(text: str, path: Path) -> Document[Bench]:
    """Return the bench from a text that will be written to a file next to ``path``, or in place of
    ``path``.

    Raises:
        InputError: The text is not valid; the message has every problem with its place.
    """
    return _in_use(located_text(path, text, Bench, follow_bench))


def _in_use(document: Document[Bench]) -> Document[Bench]:
    """Check effects, signals and bus load of a bench; return it with the limits in force."""
    bench = document.value
    document.require((("mock", *path), text) for path, text in hidden_problems(bench.mock))
    frames: Sequence[tuple[int, int]] = cia402_objects.FRAMES
    if isinstance(bench.servo, DbcServoSection):
        document.require(_unreported(bench))
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
    """Determine from the EDS file whether the drive has a watchdog, if the bench file does not
    state this.

    An EDS file that cannot be read, or is not the EDS file of a drive, is rejected by a later
    check, which reports all errors of the file.
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


def _unreported(bench: Bench) -> Iterator[tuple[Loc, str]]:
    """Yield the limits that the file states for values which the drive does not report."""
    for name in sorted(bench.unreported & bench.limits.model_fields_set):
        yield ("limits", name), NOT_REPORTED


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
    bits = cycle_bits((*servo, *cia406.FRAMES, *(cia404.FRAMES if bench.pressure else ())))
    share = bits / (bitrate * cycle_s)
    if share > ANSWER_SHARE:
        shortest_ms = math.ceil(1e3 * bits / (bitrate * ANSWER_SHARE))
        yield (
            f"too slow: a cycle of {cycle_s * 1e3:g} ms takes up to {bits:.0f} bits, {share:.0%} "
            f"of the bus, limit {ANSWER_SHARE:.0%}; raise the bit rate, or lower cycle_Hz to "
            f"{1e3 / shortest_ms:g}"
        )
