"""Injects CAN bus faults: lost, repeated, late and corrupted frames, bus-off, device restarts."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

from drivers.clock import SimulatedClock
from drivers.epos.frames import DLE, ERROR, Opcode, encode
from drivers.mock.bench import SimulatedBench, SimulatedDbcBench
from drivers.mock.canopen.dictionary import key
from drivers.mock.drive import SimulatedDrive
from drivers.mock.plant.machine import DrivenMachine, Loop
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.power_state import Command
from drivers.mock.wires.bus import SimulatedBus
from drivers.mock.wires.serial_line import SimulatedLine

FOR_GOOD: Final = 0  # value of `count` for a permanent fault

GENERAL_ERROR: Final = 0x08000000
_SDO_REQUEST: Final = 0x600
_SDO_ANSWER: Final = 0x580
_SDO_ABORT: Final = 0x80

Frame = tuple[int, bytes]
Match = Callable[[int, bool], bool]
"""Function that selects frames by identifier and by whether the host sent them."""


@dataclass
class _Rule:
    match: Callable[..., bool]
    left: int | None
    change: Callable[..., Any]


def _change(rules: list[_Rule], *what: object) -> Callable[..., Any] | None:
    """Return the change by the first rule that matches, and count it; None if no rule matches."""
    for rule in rules:
        if rule.match(*what):
            if rule.left is not None:
                rule.left -= 1
                if not rule.left:
                    rules.remove(rule)
            return rule.change
    return None


class WireFaults:
    """Loses, repeats, delays and corrupts frames on a simulated bus.

    Several faults may be active at the same time.

    ``count`` is the number of affected frames, :data:`FOR_GOOD` for all frames from now on. A CAN
    controller repeats frames with a wrong CRC, so that a receiver never receives them; the injected
    corruption is one that the CRC does not detect.
    """

    def __init__(self, bus: SimulatedBus, clock: SimulatedClock) -> None:
        self._bus = bus
        self._clock = clock
        self._ghost = bus.attach()
        self._rules: list[_Rule] = []
        self._let_pass: Counter[Frame] = Counter()
        bus.frame_filters.append(self._filter)

    def lose(self, match: Match, count: int) -> None:
        """Lose frames."""
        self._add(match, count, lambda _identifier, _data, _host: None)

    def repeat(self, match: Match, count: int) -> None:
        """Deliver frames twice, the second time as soon as the bus is free."""

        def change(identifier: int, data: bytes, host: bool) -> Frame:
            self._send_again(identifier, data, host)
            return identifier, data

        self._add(match, count, change)

    def delay(self, match: Match, count: int, by_s: float) -> None:
        """Deliver frames with a delay of ``by_s``."""

        def change(identifier: int, data: bytes, host: bool) -> None:
            due = self._clock.now_ns() + round(by_s * 1e9)
            self._clock.call_at(due, lambda: self._send_again(identifier, data, host))

        self._add(match, count, change)

    def flip(self, match: Match, count: int, bit: int) -> None:
        """Invert one data bit; shorter frames are unchanged."""

        def change(identifier: int, data: bytes, _host: bool) -> Frame:
            spoiled = bytearray(data)
            if bit >> 3 < len(spoiled):
                spoiled[bit >> 3] ^= 1 << (bit & 7)
            return identifier, bytes(spoiled)

        self._add(match, count, change)

    def shorten(self, match: Match, count: int) -> None:
        """Remove the last byte of frames."""
        self._add(match, count, lambda identifier, data, _host: (identifier, data[:-1]))

    def refuse_sdo(self, node_id: int, count: int, code: int = GENERAL_ERROR) -> None:
        """Answer SDO requests to a node with an abort as if from the node."""

        def change(_identifier: int, data: bytes, _host: bool) -> None:
            answer = bytes([_SDO_ABORT]) + data[1:4] + struct.pack("<I", code)
            self._ghost.send(_SDO_ANSWER + node_id, answer)

        self._add(
            lambda identifier, host: host and identifier == _SDO_REQUEST + node_id, count, change
        )

    def bus_off(self, for_s: float | None) -> None:
        """Put the host's controller into bus-off, for a time (s) or for good (None)."""
        self._bus.down = True
        if for_s is not None:
            self._clock.call_at(self._clock.now_ns() + round(for_s * 1e9), self._recover)

    def error_frames(self, count: int) -> None:
        """Deliver this number of error frames to the host."""
        for _ in range(count):
            self._bus.disturb()

    def restart(self, node_id: int) -> None:
        """Restart a node, as after a short failure of its supply."""
        self._ghost.send(0x000, bytes([129, node_id]))

    def _add(
        self, match: Match, count: int, change: Callable[[int, bytes, bool], Frame | None]
    ) -> None:
        self._rules.append(_Rule(match, count or None, change))

    def _recover(self) -> None:
        self._bus.down = False

    def _send_again(self, identifier: int, data: bytes, host: bool) -> None:
        if host:
            if self._bus.down:
                return
            self._let_pass[identifier, data] += 1
            self._bus.transmit(identifier, data)
        else:
            self._let_pass[identifier, data] += 1
            self._ghost.send(identifier, data)

    def _filter(self, _now: int, identifier: int, data: bytes, host: bool) -> Frame | None:
        if self._let_pass[identifier, data]:
            self._let_pass[identifier, data] -= 1
            return identifier, data
        change = _change(self._rules, identifier, host)
        return (identifier, data) if change is None else change(identifier, data, host)


_BROKEN_STUFFING: Final = bytes([DLE, 0x01])
_HEAD: Final = 4


class LineFaults:
    """Loses, corrupts, delays and repeats messages on a simulated serial line.

    Several faults may be active at the same time.

    ``from_host`` selects requests (True), answers (False) or both (None); ``count`` is the number
    of affected messages, 0 for all messages from now on.
    """

    def __init__(self, line: SimulatedLine, clock: SimulatedClock) -> None:
        self._line = line
        self._clock = clock
        self._rules: list[_Rule] = []
        self._free_ns = {True: 0, False: 0}
        line.filters.append(self._filter)

    def lose(self, from_host: bool | None, count: int) -> None:
        """Lose messages."""
        self._add(from_host, count, lambda _data, _host: b"")

    def drop_byte(self, from_host: bool | None, count: int, at: int) -> None:
        """Lose byte number ``at``, counted from 0; in a shorter message, lose the last byte."""

        def change(data: bytes, _host: bool) -> bytes:
            place = min(at, len(data) - 1)
            return data[:place] + data[place + 1 :]

        self._add(from_host, count, change)

    def flip(self, from_host: bool | None, count: int, bit: int) -> None:
        """Invert bit ``bit``, from the lowest of the first byte; at most one of the last byte."""

        def change(data: bytes, _host: bool) -> bytes:
            spoiled = bytearray(data)
            spoiled[min(bit >> 3, len(spoiled) - 1)] ^= 1 << (bit & 7)
            return bytes(spoiled)

        self._add(from_host, count, change)

    def break_stuffing(self, from_host: bool | None, count: int) -> None:
        """Insert a single byte 90h after opcode and length; the byte stuffing requires two."""
        self._add(
            from_host, count, lambda data, _host: data[:_HEAD] + _BROKEN_STUFFING + data[_HEAD:]
        )

    def delay(self, from_host: bool | None, count: int, by_s: float) -> None:
        """Deliver messages later by ``by_s``; those that follow wait."""
        self._add(
            from_host,
            count,
            lambda data, host: self._hold(data, host, self._clock.now_ns() + round(by_s * 1e9)),
        )

    def repeat(self, from_host: bool | None, count: int) -> None:
        """Deliver messages twice in direct succession."""
        self._add(from_host, count, lambda data, _host: data + data)

    def refuse(self, count: int) -> None:
        """Answer an EPOS request with an error code as if from the drive."""

        def change(_data: bytes, _host: bool) -> bytes:
            self._line.deliver(encode(Opcode.ANSWER, ERROR.pack(GENERAL_ERROR)), False)
            return b""

        self._add(True, count, change)

    def cut(self, for_s: float | None) -> None:
        """Unplug the line, for a time (s) or permanently (None)."""
        self._line.cut = True
        if for_s is not None:
            self._clock.call_at(self._clock.now_ns() + round(for_s * 1e9), self._mend)

    def _hold(self, data: bytes, host: bool, until_ns: int) -> bytes:
        self._free_ns[host] = due = max(until_ns, self._free_ns[host])
        self._clock.call_at(due, lambda: self._line.deliver(data, host))
        return b""

    def _mend(self) -> None:
        self._line.cut = False

    def _add(
        self, from_host: bool | None, count: int, change: Callable[[bytes, bool], bytes]
    ) -> None:
        match = lambda host: from_host in (None, host)  # noqa: E731
        self._rules.append(_Rule(match, count or None, change))

    def _filter(self, now: int, data: bytes, host: bool) -> bytes:
        if data and (change := _change(self._rules, host)) is not None:
            data = change(data, host)
        return self._hold(data, host, now) if data and now < self._free_ns[host] else data


_MODE_DISPLAY = key(0x6061)


class Sensor(Protocol):
    """A simulated encoder; ``distort`` changes the counts, or is None without a fault."""

    distort: Callable[[int], int] | None

    @property
    def counts_per_turn(self) -> int:
        """Counts per turn, in the units of ``distort``."""
        ...


def flip_bit(encoder: Sensor, bit: int, count: int) -> None:
    """Invert one bit of the position in the next ``count`` readings; 0 for all."""
    left = count or None

    def distort(counts: int) -> int:
        nonlocal left
        if left is not None:
            left -= 1
            if left <= 0:
                encoder.distort = None
        return counts ^ 1 << bit

    encoder.distort = distort


def jump(encoder: Sensor, by_counts: int) -> None:
    """Shift the position permanently, as after a lost reference or a slipped coupling."""
    encoder.distort = lambda counts: counts + by_counts


def freeze(encoder: Sensor) -> None:
    """Return the position of the next reading in all later readings, while time stamps advance."""
    held: int | None = None

    def distort(counts: int) -> int:
        nonlocal held
        held = counts if held is None else held
        return held

    encoder.distort = distort


def reverse(encoder: Sensor) -> None:
    """Reverse the sign of the counts, as with two wires swapped."""
    encoder.distort = lambda counts: -counts


def on_motor_shaft(encoder: Sensor, machine: DrivenMachine) -> None:
    """Count the motor's turns, as an encoder that is mounted on the other end of the gear."""
    per_turn = encoder.counts_per_turn / (2.0 * math.pi) * machine.constants.motor.gear_ratio
    encoder.distort = lambda _: math.floor(machine.truth().angle_rad * per_turn)


def refuse_mode(drive: SimulatedDrive) -> None:
    """Accept that 6060h is written, but without effect, so that 6061h reports no mode."""
    drive.objects.values[_MODE_DISPLAY] = 0
    ignored: Callable[[int, int], None] = lambda _subindex, _value: None  # noqa: E731
    drive.objects.written[0x6060] = ignored


_PRODUCT: Final = key(0x1018, 2)
_LIMITS: Final = frozenset({0x607D, 0x607F, 0x6072, 0x6073, 0x6065})


@dataclass(frozen=True)
class Mistake:
    """One mistake."""

    words: str  # description of the mistake
    # Function that injects the mistake into the devices of a bench, of which the used joint encoder
    # is an argument.
    spoil: Callable[[SimulatedBench, Sensor], None] | None = None
    # Function that injects the mistake into the machine.
    change: Callable[[Machine], Machine] | None = None
    signs: tuple[Loop, ...] = ()  # parts of the drive that have the wrong sign

    @property
    def any_drive(self) -> bool:
        """Whether the mistake is possible with drives of every kind."""
        return self.spoil is None and self.change is None

    def build_into(self, bench: SimulatedBench | SimulatedDbcBench, encoder: Sensor) -> None:
        """Inject the mistake into a bench and its used joint encoder."""
        for loop in self.signs:
            bench.machine.reverse(loop)
        if self.spoil is not None and isinstance(bench, SimulatedBench):
            self.spoil(bench, encoder)


def _in_rpm(bench: SimulatedBench, _: Sensor) -> None:
    increments = bench.machine.constants.sensing.motor_counts_per_turn or 60
    bench.drive.use_speed_unit(increments / 60.0)


def _motor(**factors: float) -> Callable[[Machine], Machine]:
    def change(machine: Machine) -> Machine:
        values = {name: getattr(machine.motor, name) * f for name, f in factors.items()}
        return dataclasses.replace(machine, motor=dataclasses.replace(machine.motor, **values))

    return change


MISTAKES: Final[Mapping[str, Mistake]] = {
    "another_device": Mistake(
        "the drive on the node is of another product than its EDS file",
        lambda bench, _: bench.drive.objects.values.__setitem__(_PRODUCT, 0x0999),
    ),
    "position_sign": Mistake("the drive's position loop has the wrong sign", signs=("position",)),
    "velocity_sign": Mistake("the drive's speed loop has the wrong sign", signs=("velocity",)),
    "phases_swapped": Mistake("two phases of the motor are swapped", signs=("phases",)),
    # The joint encoder shows the true direction; the machine is the mirror image.
    "motor_encoder": Mistake(
        "the motor encoder counts the other way",
        lambda _, encoder: reverse(encoder),
        signs=("phases",),
    ),
    "zero_off": Mistake(
        "the joint encoder reads 5 deg at zero",
        lambda _, encoder: jump(encoder, round(encoder.counts_per_turn / 72.0)),
    ),
    "limits_ignored": Mistake(
        "the drive acknowledges limits and keeps its own",
        lambda bench, _: setattr(bench.drive.objects, "deaf", _LIMITS),
    ),
    "watchdog_dead": Mistake(
        "the drive goes on when the program is silent",
        lambda bench, _: setattr(bench.drive, "connection_lost", lambda _: None),
    ),
    "stop_ignored": Mistake(
        "the drive ignores the quick stop",
        lambda bench, _: setattr(bench.drive, "deaf_to", frozenset({Command.QUICK_STOP})),
    ),
    "rpm": Mistake("the drive's speeds are in rpm", _in_rpm),
    "current_sign": Mistake(
        "the drive's current has the wrong sign",
        lambda bench, _: setattr(bench.drive, "current_sign", -1),
    ),
    "encoder_sign": Mistake(
        "the joint encoder counts the other way", lambda _, encoder: reverse(encoder)
    ),
    "motor_shaft": Mistake(
        "the joint encoder is on the motor's shaft",
        lambda bench, encoder: on_motor_shaft(encoder, bench.machine),
    ),
    "ratio": Mistake("the gear has 2/3 of the stated ratio", change=_motor(gear_ratio=2.0 / 3.0)),
    "torque_constant": Mistake(
        "the motor has twice the stated torque constant",
        change=_motor(torque_constant_N_m_A=2.0, back_emf_constant_V_s_rad=2.0),
    ),
    "home_jammed": Mistake(
        "the joint is jammed while the drive homes (--home)",
        lambda bench, _: setattr(bench.drive.homing, "jammed", True),
    ),
    "home_endless": Mistake(
        "the drive never ends a homing (--home)",
        lambda bench, _: setattr(bench.drive.homing, "endless", True),
    ),
    "home_switch": Mistake(
        "the limit switches never close (--home 17 or 18)",
        lambda bench, _: setattr(bench.drive.homing, "switches_deg", None),
    ),
}
"""Name to mistake."""
