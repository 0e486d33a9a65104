"""Bench file sections of serial drives (EPOS4) and encoders (AMT21), with a cycle time check."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator
from typing import Annotated, Final, Literal

from pydantic import Field, field_validator

from drivers.amt21.encoder import DEFAULT_ADDRESS
from drivers.can.port import ANSWER_SHARE
from drivers.epos import frames as epos_serial
from drivers.epos import link as epos_serial_node
from rig.config.configuration import Positive, Schema, nearest

MOCK: Final = "mock"


def _not_nearly_mock(port: str) -> str:
    """Refuse a mistyped `mock`, which would be taken for the port of a real bench."""
    if port != MOCK and difflib.get_close_matches(port.casefold(), [MOCK]):
        raise ValueError(f"no port; {nearest(port, [MOCK])}")
    return port


UNWATCHED_SHARE: Final = 0.6
"""Factor by which the limits of torque, current and speed are reduced for a drive without watchdog.
"""
NO_WATCHDOG_AT_ALL: Final = "this drive has no watchdog"
"""Beginning of a warning of which the page of a run concludes that the limits are reduced."""
_ALONE: Final = (
    "the drive holds its last target with power on, and only the main switch or the emergency stop "
    "switches the power off. Stay beside the bench. Torque, current and speed limits are reduced "
    f"to {UNWATCHED_SHARE:.0%} of the bench file's"
)
NO_WATCHDOG: Final = (
    f"{NO_WATCHDOG_AT_ALL}: if this program or its computer fails or sleeps, or the cable fails, "
    f"{_ALONE}"
)
GUARDED: Final = (
    f"{NO_WATCHDOG_AT_ALL}: if this program ends or hangs, a second process, its guardian, brakes "
    "and switches the power off; if the guardian ends or hangs, this program does. If both are "
    "killed or frozen at once, if the computer fails or sleeps, and while the cable or its adapter "
    f"is out, nothing protects: {_ALONE}"
)


def sleep_words(reason: str) -> str:
    """Return the warning that nothing keeps this computer awake."""
    return (
        f"nothing keeps this computer awake ({reason}): switch its sleep off (lid, idle time, "
        "battery), because a drive without a watchdog stays under power while the computer sleeps"
    )


_Baud = Annotated[int, Field(ge=9_600, le=12_000_000)]


class SerialBus(Schema):
    """An EPOS4 on RS-232 or USB.

    Attributes:
        interface: The protocol of the line.
        port: `mock`, or a serial device of this computer such as `/dev/ttyUSB0`.
        baud: Bits per second.
        round_trip_ms: Time that adapter and drive add to every request and its answer, in addition
            to the time of the bytes; to be measured. FTDI adapters add 16 ms, in low-latency mode
            6 ms.
    """

    interface: Literal["epos_serial"]
    port: str
    baud: _Baud = 1_000_000
    round_trip_ms: Annotated[float, Field(ge=0, le=100)] = 0.0

    _typed = field_validator("port")(_not_nearly_mock)


class Amt21Section(Schema):
    """An AMT21 joint encoder on a separate RS-485 line.

    A position that implies more speed or acceleration than `gate_speed_deg_s` or
    `gate_acceleration_deg_s2` is discarded.

    Attributes:
        kind: The protocol of the encoder.
        port: `mock`, or a serial device of this computer.
        baud: Bits per second.
        address: Address of the encoder on its line, a multiple of 4.
        sign: 1 if the encoder counts up for a positive joint angle, else -1.
        offset_deg: Joint angle at which the encoder reads zero.
        gate_speed_deg_s: Highest joint speed between two positions.
        gate_acceleration_deg_s2: Highest joint acceleration between positions.
    """

    kind: Literal["amt21"]
    port: str
    baud: _Baud = 2_000_000
    address: Annotated[int, Field(ge=0, le=252, multiple_of=4)] = DEFAULT_ADDRESS
    sign: Literal[1, -1] = 1
    offset_deg: float = 0.0
    gate_speed_deg_s: Positive = 500.0
    gate_acceleration_deg_s2: Positive = 20_000.0

    _typed = field_validator("port")(_not_nearly_mock)


def overload(bus: SerialBus, cycle_s: float) -> Iterator[str]:
    """Yield a problem if the messages of a control cycle take more time than the line permits."""
    writes, reads = epos_serial_node.CYCLE_WRITES, epos_serial_node.CYCLE_READS
    bits = epos_serial.cycle_bits(writes, reads)
    needed_s = bits / bus.baud + (writes + reads) * bus.round_trip_ms * 1e-3
    if needed_s > ANSWER_SHARE * cycle_s:
        shortest_ms = math.ceil(1e3 * needed_s / ANSWER_SHARE - 1e-9)
        yield (
            f"too slow: {writes + reads} objects per cycle take up to {bits} bits and "
            f"{needed_s * 1e3:.2f} ms, {needed_s / cycle_s:.0%} of a cycle of {cycle_s * 1e3:g} "
            f"ms, limit {ANSWER_SHARE:.0%}; raise baud, lower round_trip_ms, or lower cycle_Hz to "
            f"{1e3 / shortest_ms:g}"
        )
