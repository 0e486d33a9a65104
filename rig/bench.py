"""The bench file: machine constants, bus, devices, limits and, for the mock, the true machine behind the bus.

Units are in the names, at the edge of the program (``angle_max_deg``); everything past the properties here is SI.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from drivers import cia402_servo, cia406
from drivers.can_timing import ANSWER_SHARE, cycle_bits
from drivers.mock.plant import constants
from rig.configuration import Document, Schema, load_located
from rig.packaged import resolve

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
NodeId = Annotated[int, Field(ge=1, le=127)]
Sign = Literal[1, -1]
ObjectAddress = tuple[Annotated[int, Field(ge=0, le=0xFFFF)], Annotated[int, Field(ge=0, le=0xFF)]]

_ANY_SIGN = frozenset({"temperature_C"})
_MAY_BE_ZERO = frozenset(
    {
        "inductance_H",
        "Mc_N_m",
        "Ms_N_m",
        "sigma_2_N_m_s_rad",
        "mu_c",
        "mu_s",
        "mu_2_s_rad",
        "velocity_integral_1_s",
        "velocity_feedforward",
        "current_integral_1_s",
        "motor_counts_per_turn",
        "joint_counts_per_turn",
        "current_noise_A",
    }
)


class Constants(Schema):
    """What is believed of the machine: the constants an identification works with."""

    torque_constant_N_m_A: Positive
    back_emf_constant_V_s_rad: Positive
    resistance_ohm: Positive
    inductance_H: NonNegative
    gear_ratio: Positive
    moment_arm_m: Positive
    lever_ratio: Positive = 10.0
    gravity_m_s2: Positive = 9.80665


class Bus(Schema):
    """Where the devices are. ``mock`` is the simulated bus; any other name is a python-can interface."""

    interface: str = "mock"
    channel: str | None = None
    bitrate: Annotated[int, Field(ge=10_000, le=1_000_000)] = 1_000_000


class ServoSection(Schema):
    """The drive: node, and the scales that turn its units into SI, checked against the device before a run.

    ``velocity_unit_rad_s`` is the motor speed of one unit of 606Ch, null for one count per second. ``eds`` is the
    device's own EDS file, relative to the bench file; the simulated drive needs none.
    """

    node: NodeId = 1
    counts_per_motor_turn: Annotated[int, Field(gt=0)] = 4096
    sign: Sign = 1
    offset_deg: float = 0.0
    rated_current_A: Positive = 15.0
    rated_torque_N_m: Positive = 0.45
    velocity_unit_rad_s: Positive | None = None
    voltage_object: ObjectAddress = (0x2100, 0)
    voltage_unit_V: Positive = 0.01
    temperature_object: ObjectAddress = (0x2101, 0)
    temperature_unit_C: Positive = 0.1
    eds: str | None = None
    quick_stop_option: Literal[2, 6] = 2
    quick_stop_deceleration_deg_s2: Positive = 2000.0


class EncoderSection(Schema):
    """The joint encoder; ``eds`` as for the drive."""

    node: NodeId = 2
    counts_per_turn: Annotated[int, Field(gt=0)] = 262144
    sign: Sign = 1
    offset_deg: float = 0.0
    eds: str | None = None


class LimitsSection(Schema):
    """Limits checked on every sample, and held by the drive as well where it has an object for them."""

    angle_min_deg: float
    angle_max_deg: float
    speed_deg_s: Positive
    torque_N_m: Positive
    current_A: Positive
    following_error_deg: Positive
    encoder_disagreement_deg: Positive
    weight_kg: NonNegative
    contact_force_N: NonNegative
    temperature_C: float = 80.0
    sample_age_ms: Positive = 5.0

    @model_validator(mode="after")
    def _range_is_open(self) -> Self:
        if not self.angle_min_deg < self.angle_max_deg:
            raise ValueError(
                f"angle_min_deg {self.angle_min_deg:g} must be below angle_max_deg {self.angle_max_deg:g}; swap them"
            )
        return self


class Bench(Schema):
    """One bench, as written in its file."""

    bench: Literal[1]
    name: str
    machine: Constants
    bus: Bus | None = Bus()
    servo: ServoSection = ServoSection()
    encoder: EncoderSection = EncoderSection()
    cycle_Hz: Annotated[float, Field(gt=0, le=4000)] = 1000.0
    limits: LimitsSection
    mock: constants.Machine | None = None

    @field_validator("cycle_Hz")
    @classmethod
    def _whole_milliseconds(cls, rate: float) -> float:
        period_ms = 1e3 / rate
        if abs(period_ms - round(period_ms)) > 1e-9:
            raise ValueError(
                f"the period {period_ms:g} ms must be a whole number of milliseconds; try 1000, 500 or 250"
            )
        return rate

    @field_validator("mock")
    @classmethod
    def _physical(cls, machine: constants.Machine | None) -> constants.Machine | None:
        for path, value in () if machine is None else _leaves(machine):
            name = path.rsplit(".", 1)[-1]
            if name in _ANY_SIGN:
                continue
            if not math.isfinite(value) or value < 0 or (value == 0 and name not in _MAY_BE_ZERO):
                bound = "zero or more" if name in _MAY_BE_ZERO else "more than zero"
                raise ValueError(f"{path} is {value:g}; it must be finite and {bound}")
        return machine

    @model_validator(mode="after")
    def _mock_is_described(self) -> Self:
        if self.simulated and self.mock is None:
            raise ValueError(
                "bus.interface is mock but there is no 'mock' section; add the simulated machine's constants"
            )
        return self

    @property
    def simulated(self) -> bool:
        """Whether the devices are simulated."""
        return self.bus is None or self.bus.interface == "mock"

    @property
    def cycle_ns(self) -> int:
        """Control cycle, ns."""
        return round(1e3 / self.cycle_Hz) * 1_000_000

    @property
    def cycle_s(self) -> float:
        """Control cycle, s."""
        return self.cycle_ns * 1e-9


def _leaves(record: object, prefix: str = "") -> Iterator[tuple[str, float]]:
    """Yield every number of nested dataclasses with its dotted path."""
    if not dataclasses.is_dataclass(record):
        return
    for item in dataclasses.fields(record):
        value = getattr(record, item.name)
        path = f"{prefix}{item.name}"
        if isinstance(value, int | float):
            yield path, float(value)
        else:
            yield from _leaves(value, f"{path}.")


def load_bench(name: str | Path) -> Document[Bench]:
    """Read a bench by path, or by the bare name of a packaged one (``practical``).

    Raises:
        InputError: It is not there, or not valid; every problem with its place in the file.
    """
    document = load_located(resolve(name, "benches"), Bench)
    bench = document.value
    if bench.bus is not None:
        document.require((("bus", "bitrate"), text) for text in _overload(bench.bus.bitrate, bench.cycle_s))
    return document


def _overload(bitrate: int, cycle_s: float) -> Iterator[str]:
    """Yield what is wrong where a control cycle does not fit the bus."""
    bits = cycle_bits((*cia402_servo.FRAMES, *cia406.FRAMES))
    share = bits / (bitrate * cycle_s)
    if share > ANSWER_SHARE:
        shortest_ms = math.ceil(1e3 * bits / (bitrate * ANSWER_SHARE))
        yield (
            f"too slow: a cycle of {cycle_s * 1e3:g} ms takes up to {bits:.0f} bits, {share:.0%} of the bus, limit "
            f"{ANSWER_SHARE:.0%}; raise it, or lower cycle_Hz to {1e3 / shortest_ms:g}"
        )
