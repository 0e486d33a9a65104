"""CANopen network with this program as master, over any python-can interface, without threads.

Frames are received while a method of the link waits for them.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Self, TypeVar

from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.exceptions import SdoCommunicationError

from drivers.can.port import (
    ANSWER_SHARE,
    ERROR_FLAG,
    REMOTE_FLAG,
    FramePort,
    PythonCanPort,
    open_bus,
    raw_frame,
)
from drivers.can.slcan import open_slcan
from drivers.canopen.eds_file import read_eds
from drivers.canopen.pdo import PDO_BITS, RECEIVE, TRANSMIT, Input, accessed, configure, plan
from drivers.canopen.sdo import (
    ONE_AXIS,
    Axis,
    PumpedSdoClient,
    described,
    translated,
    unfit,
    variable,
)
from drivers.clock import NS, Clock
from drivers.errors import ConfigurationError, DeviceError, DriveFault, LinkError, StateError
from drivers.interfaces import Link, RawFrame
from drivers.objects import CONSUMER, GUARD_TIME, LIFE_FACTOR, ObjectAddress, PdoLayout, optional
from drivers.port_errors import close_all, is_gone, opened, require_one_cycle, words

V = TypeVar("V")
_MS: Final = 1_000_000
_BOOT_TIMEOUT_S: Final = 1.0
HEARTBEAT_S: Final = 0.05
"""Requested period of the device's heartbeat (1017h), s; a device may round the period up."""
_PRODUCER: Final = (0x1017, 0)
HEARTBEATS_MISSED: Final = 4
"""Number of periods without a heartbeat after which the device counts as lost."""
SIGN_S: Final = 0.025
"""Period of the signs of this program, the heartbeat and the guard requests, s."""
_LIFE_FACTOR: Final = 4
"""Number of guard times without a guard request after which a device reacts (100Dh)."""
_ERROR_CONTROL: Final = 0x700
_REQUEST: Final = bytes(1)
"""A guard request has the length of its answer; a remote frame has no data."""
_ENTER_PRE_OPERATIONAL: Final = 0x80
_PROBE_S: Final = 0.1  # time in which a device answers a guard request

INITIALISING, STOPPED, OPERATIONAL, PRE_OPERATIONAL = 0, 4, 5, 127
NMT_NAMES: Final = {
    INITIALISING: "INITIALISING",
    STOPPED: "STOPPED",
    OPERATIONAL: "OPERATIONAL",
    PRE_OPERATIONAL: "PRE-OPERATIONAL",
}


def require_node(node_id: int, taken: Container[int]) -> None:
    """Check the node identifier of a new device on a link.

    Raises:
        ConfigurationError: The identifier is out of range or in use.
    """
    if not 1 <= node_id <= 127 or node_id in taken:
        raise ConfigurationError(
            f"node identifier {node_id} is not between 1 and 127, or another device has it: "
            "correct the bench file"
        )


class Guarding:
    """Node guarding of one device (CiA 301, 7.2.8.2.2.1): this program requests the NMT state by a
    remote frame, and the toggle bit of the answer alternates.
    """

    def __init__(self) -> None:
        # Time of the first request since the last answer, or None.
        self.unanswered_ns: int | None = None
        self.toggle: int | None = None  # toggle bit of the last answer, or None before the first

    def asked(self, now_ns: int) -> None:
        """Register a request."""
        if self.unanswered_ns is None:
            self.unanswered_ns = now_ns

    def accepts(self, answer: int) -> bool:
        """Register an answer, unless it repeats the last toggle bit (CiA 301: not received)."""
        toggle = answer >> 7
        if toggle == self.toggle:
            return False
        self.toggle, self.unanswered_ns = toggle, None
        return True


class CanopenNode:
    """A device behind a :class:`~drivers.canopen.link.CanopenLink`; a
    :class:`~drivers.objects.ProcessChannel`.
    """

    def __init__(
        self, node_id: int, dictionary: ObjectDictionary, wire: CanopenLink, axis: Axis = ONE_AXIS
    ) -> None:
        self.node_id = node_id  # node identifier, 1 to 127
        self._axis = axis
        self.sdo = PumpedSdoClient(node_id, dictionary, wire)  # SDO client for the device
        # Data of each RPDO for the next exchange, by CAN identifier.
        self.outputs: dict[int, bytes] = {}
        self.inputs: dict[int, Input] = {}  # last frame of each TPDO, by CAN identifier
        self.expected = 0  # number of TPDOs that the device sends with every SYNC
        # Number of these TPDOs that have not been received since the last exchange began.
        self.missing = 0
        self.cycle = wire.cycle  # number of the last exchange
        # NMT state in the last heartbeat; None before the first heartbeat.
        self.nmt_state: int | None = None
        self.heard_ns = 0  # time of the last heartbeat, ns
        self.silence_ns = 0  # time without a heartbeat after which the device counts as lost, ns
        # Whether process data is exchanged, so that a lost device is detected; False after the
        # device was reported as lost.
        self.monitored = False
        # Node guarding, or None for a device that sends heartbeats.
        self.guarding: Guarding | None = None
        self._wire = wire
        self._dictionary = dictionary
        self._staged: dict[int, tuple[int, struct.Struct]] = {}
        self._then: dict[int, bytes] = {}
        self._numbered: dict[int, Input] = {}
        self._slow: list[Input] = []
        self._watched = self._braking = False

    @property
    def label(self) -> str:
        return f"node {self.node_id}"

    @property
    def latches(self) -> bool:
        return True

    @property
    def fresh(self) -> bool:
        if self.missing or not self._wire.exchanged:
            return False
        for slot in self._slow:  # noqa: SIM110  (a generator costs a microsecond a cycle)
            if self.cycle - slot.cycle > slot.slack:
                return False
        return True

    def read(self, index: int, subindex: int = 0) -> int:
        index, subindex = self._at(index, subindex)
        item = variable(self._dictionary, index, subindex)
        data = self._upload(index, subindex)
        if not item.fixed_size or len(data) != len(item) // 8:
            raise ConfigurationError(
                f"{self.label}: object {index:04X}h:{subindex:02X}h has {len(data)} bytes, but "
                f"{len(item) // 8} in its EDS; use the EDS file of this device"
            )
        value = int(item.decode_raw(data))
        share = self._axis.share(self._dictionary, index, subindex)
        return value if share is None else value >> 16 * share & 0xFFFF

    def read_text(self, index: int, subindex: int = 0) -> str:
        return self._upload(index, subindex).decode("ascii", errors="replace").rstrip("\0")

    def write(self, index: int, subindex: int, value: int) -> None:
        index, subindex = self._at(index, subindex)
        data = self._packed(index, subindex, value)
        self._access(index, subindex, lambda: self.sdo.download(index, subindex, data))

    @property
    def sync_us(self) -> int:
        return self._wire.sync_ns // 1000 & 0xFFFFFFFF

    def describes(self, index: int, subindex: int, mappable: bool = False) -> bool:
        if (index, subindex) in self._axis.unlike:
            return False
        return described(self._dictionary, *self._at(index, subindex), mappable)

    def fit_together(self, addresses: Sequence[ObjectAddress]) -> bool:
        found = (self._dictionary.get_variable(*self._at(*address)) for address in addresses)
        return sum(len(item) for item in found if item is not None) <= PDO_BITS

    def stated(self, index: int, subindex: int) -> int | None:
        item = self._dictionary.get_variable(*self._at(index, subindex))
        default = None if item is None else item.default
        return default if isinstance(default, int) else None

    def require_fit(self, index: int, subindex: int, value: int) -> None:
        self._packed(*self._at(index, subindex), value)

    def insist(self, index: int, subindex: int, value: int) -> None:
        self.write(index, subindex, value)

    def announce(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object if the last heartbeat shows that the device does not accept
        process data, or if the last exchange did not send them.

        The errors are those of :meth:`write`.
        """
        if self.nmt_state != OPERATIONAL or not self._wire.exchanged:
            self.write(index, subindex, value)

    def require_mappable(self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout]) -> None:
        if not self.describes(*_PRODUCER) and not self._guarded(watched=False):
            raise ConfigurationError(
                "neither object 1017h:00h nor the objects 100Ch:00h and 100Dh:00h are in the "
                "device's EDS; every run needs the heartbeat or the node guarding of the device, "
                "by which this program detects that the device is lost"
            )
        for direction, layouts in ((RECEIVE, outputs), (TRANSMIT, inputs)):
            plan(self._dictionary, self.label, direction, layouts, self._axis)

    def accessed(
        self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout], watched: bool
    ) -> Iterator[ObjectAddress]:
        yield from (address for address in self._error_control(watched) if self.describes(*address))
        for direction, layouts in ((RECEIVE, outputs), (TRANSMIT, inputs)):
            yield from accessed(direction, layouts)
        for layout in (*outputs, *inputs):
            yield from layout.objects

    def unguarded(self, watched: bool) -> Iterator[DeviceError]:
        """Yield an error for a device that is to be guarded and does not answer a guard request.

        A device that sends heartbeats answers none, and a device with a life time would expect
        more; these devices are not asked.
        """
        if not self._guarded(watched) or any(
            self.describes(*address) and optional(self.read, *address)
            for address in (_PRODUCER, LIFE_FACTOR)
        ):
            return
        usual, self.guarding = self.guarding, Guarding()
        try:
            if not self._answers_guarding():
                yield self._no_remote_frames(_PROBE_S)
        finally:
            self.guarding = usual

    def forget_faults(self) -> None:
        self._wire.forget(self.node_id, faults=True)

    def map_process_data(
        self,
        outputs: Sequence[PdoLayout],
        inputs: Sequence[PdoLayout],
        cycle_s: float,
        watched: bool = False,
    ) -> None:
        """Configure PDOs and heartbeat or node guarding by SDO in PRE-OPERATIONAL, then start the
        node.

        The first values of the inputs are read by SDO. A device that is to monitor this program,
        but has no heartbeat consumer (1016h), is guarded if it has the objects 100Ch and 100Dh. A
        device that sends no heartbeat (1017h) is guarded, too.
        """
        self._wire.set_cycle(cycle_s, self.label)
        self.monitored, self.guarding = False, None
        self._command(_ENTER_PRE_OPERATIONAL)
        self._disarm()
        if self._guarded(watched):
            self._begin_guarding(cycle_s)
        else:
            self._produce_heartbeat()
        self.outputs, self._staged, self._then = {}, {}, {}
        for layout, (identifier, packing) in zip(
            outputs, configure(self, self._dictionary, RECEIVE, outputs, self._axis), strict=True
        ):
            self.outputs[identifier] = bytes(packing.size)
            self._staged[layout.number] = (identifier, packing)
        self.inputs, self._numbered, self._slow = {}, {}, []
        for layout, (identifier, packing) in zip(
            inputs, configure(self, self._dictionary, TRANSMIT, inputs, self._axis), strict=True
        ):
            slot = Input(packing, layout.every, layout.slack)
            slot.values = tuple(self.read(*address) for address in layout.objects)
            if slot.slack:
                slot.cycle = self.cycle
                self._slow.append(slot)
            self.inputs[identifier] = self._numbered[layout.number] = slot
        self.expected = self.missing = sum(not slot.slack for slot in self.inputs.values())
        self._start()

    def stage(self, number: int, *values: int) -> None:
        identifier, packing = self._staged[number]
        self.outputs[identifier] = packing.pack(*values)
        if self._then:
            self._then.pop(identifier, None)

    def stage_once(self, number: int, values: tuple[int, ...], then: tuple[int, ...]) -> None:
        identifier, packing = self._staged[number]
        self.outputs[identifier] = packing.pack(*values)
        self._then[identifier] = packing.pack(*then)

    def sent(self) -> None:
        """Replace the outputs for one exchange, which was made, by those that follow."""
        if self._then:
            self.outputs.update(self._then)
            self._then.clear()

    def latest(self, number: int) -> tuple[int, ...]:
        if number not in self._numbered:
            raise StateError(f"{self.label}: no process data are set up; prepare the device first")
        return self._numbered[number].values

    def watch(self, limit_s: float) -> None:
        """Activate the device's heartbeat consumer (1016h) or life guarding (100Ch, 100Dh), and
        send the first heartbeat or guard request, which starts the time-out. Nothing is done for a
        device with neither.
        """
        if self.guarding is None and not self.describes(*CONSUMER):
            return
        self._watched = True
        for address, setting in self._watching(limit_s):
            self.write(*address, setting)
        self.sign()
        for address, setting in self._watching(limit_s):
            found = self.read(*address)
            if found != setting:
                raise ConfigurationError(
                    f"{self.label}: object {address[0]:04X}h:{address[1]:02X}h reads {found:X}h "
                    f"after {setting:X}h was written; with this value the device would not detect "
                    "that the control loop has stopped"
                )

    def unwatch(self) -> None:
        if self.guarding is not None:
            self.write(*LIFE_FACTOR, 0)
        elif self.describes(*CONSUMER):
            self.write(*CONSUMER, 0)
        self._watched = False

    def sign(self) -> None:
        """Send that sign of the control loop which this device monitors."""
        if self.guarding is None:
            self._wire.heartbeat()
        else:
            self.request()

    def request(self) -> None:
        """Send a guard request."""
        if self.guarding is not None:
            self.guarding.asked(self._wire.clock.now_ns())
            self._wire.send(REMOTE_FLAG | _ERROR_CONTROL | self.node_id, _REQUEST)

    def silent_ns(self, now_ns: int) -> int:
        """Return the time without a heartbeat, or since the first unanswered guard request."""
        if self.guarding is None:
            return now_ns - self.heard_ns
        asked = self.guarding.unanswered_ns
        return 0 if asked is None else now_ns - asked

    @contextmanager
    def kept_alive(self, limit_s: float) -> Iterator[None]:
        """While this context is open, but at most for ``limit_s``, send the signs of the control
        loop also while an SDO answer is awaited. A context within another does not extend it.
        """
        wire, outer_ns = self._wire, self._wire.alive_until_ns
        until_ns = wire.clock.now_ns() + round(limit_s * NS)
        wire.alive_until_ns = min(until_ns, outer_ns) if outer_ns else until_ns
        try:
            yield
        finally:
            wire.alive_until_ns = outer_ns

    def limit_wait(self, limit_s: float | None) -> None:
        """Wait at most ``limit_s`` for an SDO answer if the heartbeat consumer is active, because
        no heartbeat is sent meanwhile; None restores the time-out of the link.
        """
        self._braking = self._watched and limit_s is not None
        self.sdo.limit_s = limit_s if self._braking else None

    def _at(self, index: int, subindex: int) -> ObjectAddress:
        """Return the address of an object of the first axis in the objects of the axis used."""
        return self._axis.at(self._dictionary, index, subindex)

    def _guarded(self, watched: bool) -> bool:
        """Return whether the device is guarded; otherwise it sends heartbeats."""
        by_heartbeat = self.describes(*_PRODUCER) and (not watched or self.describes(*CONSUMER))
        return not by_heartbeat and self.describes(*GUARD_TIME) and self.describes(*LIFE_FACTOR)

    def _error_control(self, watched: bool) -> tuple[ObjectAddress, ...]:
        """Return the objects by which the device and this program monitor each other."""
        if self._guarded(watched):
            return (_PRODUCER, GUARD_TIME, LIFE_FACTOR)
        return (CONSUMER, _PRODUCER)

    def _watching(self, limit_s: float) -> tuple[tuple[ObjectAddress, int], ...]:
        """Return the objects that activate the monitoring of this program, with their values."""
        limit_ms = round(limit_s * 1e3)
        if self.guarding is None:
            return ((CONSUMER, self._wire.master_id << 16 | limit_ms),)
        return ((GUARD_TIME, limit_ms // _LIFE_FACTOR), (LIFE_FACTOR, _LIFE_FACTOR))

    def _disarm(self) -> None:
        """Deactivate a heartbeat consumer or life guarding that an earlier program left active when
        it ended.

        The host sends a heartbeat first, because a device that has detected the loss of its master
        waits for a heartbeat. Without the deactivation, the heartbeat before the start of the node
        would start the time-out again.
        """
        self._watched = False
        for address in (CONSUMER, LIFE_FACTOR):
            if self.describes(*address) and (optional(self.read, *address) or 0) > 0:
                self._wire.heartbeat()
                self.write(*address, 0)

    def _produce_heartbeat(self) -> None:
        """Set the period of the device's heartbeat, and read the period that the device stores."""
        wanted_ms = round(HEARTBEAT_S * 1e3)
        self.write(*_PRODUCER, wanted_ms)
        period_ms = self.read(*_PRODUCER)
        if not period_ms:
            raise ConfigurationError(
                f"{self.label}: heartbeat period 1017h reads 0 after {wanted_ms} ms was written; "
                "without a heartbeat this program would not detect a lost device"
            )
        self.silence_ns = HEARTBEATS_MISSED * period_ms * _MS

    def _begin_guarding(self, cycle_s: float) -> None:
        """Guard the device, which must send no heartbeats then."""
        if self.describes(*_PRODUCER) and (optional(self.read, *_PRODUCER) or 0) > 0:
            self.write(*_PRODUCER, 0)
        self.guarding = Guarding()
        self.silence_ns = round(HEARTBEATS_MISSED * max(HEARTBEAT_S, cycle_s) * NS)

    def _packed(self, index: int, subindex: int, value: int) -> bytes:
        item = variable(self._dictionary, index, subindex)
        try:
            return bytes(item.STRUCT_TYPES[item.data_type].pack(value))
        except (KeyError, struct.error) as error:
            raise unfit(self.label, item, value) from error

    def _upload(self, index: int, subindex: int) -> bytes:
        return self._access(index, subindex, lambda: bytes(self.sdo.upload(index, subindex)))

    def _access(self, index: int, subindex: int, act: Callable[[], V]) -> V:
        """Make an SDO transfer. A device in the NMT state STOPPED, which 1029h may select after the
        loss of its master, answers no SDO; the device is set to PRE-OPERATIONAL and asked again.
        """
        with translated(self.node_id, index, subindex):
            try:
                return act()
            except SdoCommunicationError:
                if not self._stopped():
                    raise
                self._command(_ENTER_PRE_OPERATIONAL)
                return act()

    def _stopped(self) -> bool:
        """Return whether the device, which has not answered, is in the NMT state STOPPED. While the
        device brakes, no guard request asks for it, because its watchdog may have to brake it.
        """
        if not self._braking:
            self._answers_guarding()
        return self.nmt_state == STOPPED

    def _answers_guarding(self) -> bool:
        """Send a guard request to a guarded device; return whether it is answered."""
        guarding = self.guarding
        if guarding is None:
            return False
        self.request()
        return self._wire.pump(lambda: guarding.unanswered_ns is None, _PROBE_S)

    def _no_remote_frames(self, waited_s: float) -> LinkError:
        return LinkError(
            f"{self.label} did not answer the guard requests (remote frames "
            f"{_ERROR_CONTROL | self.node_id:03X}h) within {waited_s:g} s: the device or the CAN "
            "interface has no remote frames, so that the drive cannot monitor this program; set "
            "servo.stops_alone: false, which reduces the limits"
        )

    def _command(self, code: int) -> None:
        self._wire.send(0x000, bytes([code, self.node_id]))

    def _start(self) -> None:
        self.nmt_state = None
        # A device may refuse the NMT command "start" until it receives a heartbeat of its master.
        self._wire.heartbeat()
        self._command(0x01)
        timeout_s = _BOOT_TIMEOUT_S + self.silence_ns / NS
        if not self._started(timeout_s):
            state = (
                "none"
                if self.nmt_state is None
                else NMT_NAMES.get(self.nmt_state, f"{self.nmt_state}")
            )
            if self.guarding is not None and self.nmt_state is None:
                raise self._no_remote_frames(timeout_s)
            raise LinkError(
                f"{self.label} did not report the NMT state OPERATIONAL within {timeout_s:g} s "
                f"(last heartbeat: {state})"
            )
        # What the device has reported before, such as a fault, is over or shown by its state.
        self._wire.forget(self.node_id)
        self.monitored = True

    def _started(self, timeout_s: float) -> bool:
        """Wait for the NMT state OPERATIONAL; return False after ``timeout_s``."""
        if self.guarding is None:
            return self._wire.pump(lambda: self.nmt_state == OPERATIONAL, timeout_s)
        for _ in range(round(timeout_s / SIGN_S)):
            self.request()
            if self._wire.pump(lambda: self.nmt_state == OPERATIONAL, SIGN_S):
                return True
        return False


_MEANINGS: Final[Mapping[int, str]] = {
    0x2310: "continuous over-current: check whether the axis is jammed",
    0x2320: "short circuit at the output: check the motor cable before power is switched on again",
    0x3210: "DC link over-voltage: reduce the deceleration, or install a brake resistor",
    0x3220: "DC link under-voltage: check the supply",
    0x4210: "device over-temperature: let the device cool, check the ventilation",
    0x4310: "drive over-temperature: let the drive cool, check the ventilation",
    0x7320: "position sensor: check the encoder and its cable",
    0x8100: "communication lost: the drive received a stop command, or the bus failed",
    0x8130: (
        "heartbeat lost: the control loop stopped or the bus is overloaded; find the "
        "cause before enabling again"
    ),
    0x8210: (
        "process data frame too short: the mapping in the device differs from that of this "
        "program; prepare the device again"
    ),
    0x8611: "following error: the axis did not keep up with the target; check whether the axis is "
    "jammed, then reset the fault",
}
_CLASSES: Final[Mapping[int, str]] = {
    0x1: "generic error",
    0x2: "current",
    0x3: "voltage",
    0x4: "temperature",
    0x5: "device hardware",
    0x6: "device software",
    0x7: "additional modules",
    0x8: "monitoring",
    0x9: "external error",
    0xF: "additional functions or vendor specific",
}


def explain(code: int) -> str:
    """Return the meaning of an error code and its remedy."""
    if code in _MEANINGS:
        return _MEANINGS[code]
    return f"{_CLASSES.get(code >> 12, 'unknown class')}; see the drive's manual"


MASTER_ID: Final = 0x7F  # node identifier of this program's own heartbeat
_FRAMES_KEPT: Final = 1 << 16
_SIGN_NS: Final = round(SIGN_S * NS)
_OPERATIONAL_HEARTBEAT: Final = bytes([OPERATIONAL])
_SYNC: Final = 0x080
_SDO_ANSWER: Final = 0x580
_HIGHEST_ID: Final = 0x7FF


class CanopenLink(Link):
    """A CANopen network with this program as its only master.

    Args:
        clock: Real or simulated clock, as the bus.
        connect: Opens the bus.
        name: Name of the bus in messages.
        master_id: Node identifier of the master's heartbeat.
        sdo_timeout_s: Time-out of an SDO request, s.
    """

    def __init__(
        self,
        clock: Clock,
        connect: Callable[[], FramePort],
        name: str = "CAN bus",
        master_id: int = MASTER_ID,
        sdo_timeout_s: float = 0.3,
    ) -> None:
        self.clock = clock
        self.cycle = 0  # number of exchanges so far
        self.sync_ns = 0  # time of the last SYNC
        self.exchanged = False  # whether the last exchange sent all outputs and SYNC
        # Time until which the signs of the control loop are sent also while an SDO answer is
        # awaited; 0 to send them in exchanges only.
        self.alive_until_ns = 0
        self.master_id = master_id
        self.sdo_timeout_s = sdo_timeout_s
        self._name = name
        self._connect = connect
        self._port: FramePort | None = None
        self._lost = False
        self._nodes: dict[int, CanopenNode] = {}
        self._frames: deque[RawFrame] = deque(maxlen=_FRAMES_KEPT)
        self._cycle_s: float | None = None
        self._answer_ns = 0
        self._heartbeat_every = 1
        self._heartbeat_ns = 0
        self._missing = 0
        self._troubles: list[tuple[int, LinkError | DriveFault]] = []

    @classmethod
    def on_interface(
        cls,
        clock: Clock,
        interface: str,
        channel: str,
        bitrate: int,
        bus_options: Mapping[str, Any] | None = None,
        sdo_timeout_s: float = 0.3,
    ) -> Self:
        """Return a link over an interface of python-can, which is selected by name (``socketcan``,
        ``slcan``, ``pcan``...).

        ``bus_options`` are further options of this interface, as in python-can. For ``slcan`` a
        port of this package is used, :class:`~drivers.can.slcan.SlcanPort`.
        """
        options = dict(bus_options or {})

        def connect() -> FramePort:
            if interface == "slcan":
                return open_slcan(channel, clock, bitrate, **options)
            return PythonCanPort(open_bus(interface, channel, bitrate, options), clock)

        name = f"{interface} {channel} at {bitrate} bit/s"
        return cls(clock, connect, name, sdo_timeout_s=sdo_timeout_s)

    def add_node(self, node_id: int, eds: Path, axis: Axis = ONE_AXIS) -> CanopenNode:
        """Declare a device on the bus.

        Raises:
            ConfigurationError: The node identifier is out of range or in use, or the EDS cannot be
                read.
        """
        require_node(node_id, {self.master_id, *self._nodes})
        dictionary = read_eds(eds, node_id)
        node = CanopenNode(node_id, dictionary, self, axis)
        self._nodes[node_id] = node
        return node

    def open(self) -> None:
        if self._port is not None:
            return
        self._port = self._connected()

    def close(self) -> None:
        port, self._port, self._lost = self._port, None, False
        if port is not None:
            close_all(port.shutdown)

    def set_cycle(self, cycle_s: float, who: str) -> None:
        """Set the cycle time, which must be the same for all devices."""
        require_one_cycle(self._cycle_s, cycle_s, who)
        self._cycle_s = cycle_s
        self._answer_ns = round(ANSWER_SHARE * cycle_s * NS)
        self._heartbeat_every = max(1, int(SIGN_S / cycle_s))

    def exchange(self) -> None:
        """Send every device's outputs and SYNC, and collect the inputs.

        Only this method sends heartbeats of the master and guard requests (except the first, which
        starts the time-out in a device, and those of :meth:`CanopenNode.kept_alive`), so that they
        end when the control loop stops. The method waits for process data at most 80 % of the
        cycle.
        """
        self.exchanged = False
        self._receive(0.0)
        self.cycle += 1
        self._missing = 0
        now = self.clock.now_ns()
        for node in self._nodes.values():
            # After a frame that cannot be sent, no device counts as fresh.
            node.cycle = self.cycle
            node.missing = node.expected
        for node in self._nodes.values():
            if node.monitored and node.silent_ns(now) > node.silence_ns:
                self._lose(node, self._silence(node, now))
            for identifier, data in node.outputs.items():
                self.send(identifier, data)
            node.sent()
            self._missing += node.expected
        self.sync_ns = self.clock.now_ns()
        self.send(_SYNC, b"")
        self.exchanged = True
        late = now - self._heartbeat_ns > _SIGN_NS
        if late or self.cycle % self._heartbeat_every == 0:
            self._signs()
        deadline = self.clock.now_ns() + self._answer_ns
        while self._missing and (left := deadline - self.clock.now_ns()) > 0:
            self._receive(left / NS)
        if self._troubles:
            self._raise_troubles()

    def take_frames(self) -> list[RawFrame]:
        frames = list(self._frames)
        self._frames.clear()
        return frames

    def send(self, identifier: int, data: bytes) -> None:
        """Send one frame."""
        port = self._port or self._opened()
        try:
            port.transmit(identifier, data)
        except DeviceError:
            raise
        except Exception as error:
            self._check_gone(error)
            raise LinkError(
                f"{self._name} cannot send a frame: {words(error)}; check cabling, termination, "
                "and that at least one device has power"
            ) from error
        self._frames.append(raw_frame((self.clock.now_ns(), identifier, data, True)))

    def heartbeat(self) -> None:
        """Send the master's heartbeat."""
        self._heartbeat_ns = self.clock.now_ns()
        self.send(0x700 + self.master_id, _OPERATIONAL_HEARTBEAT)

    def _signs(self) -> None:
        """Send the master's heartbeat and the guard requests."""
        self.heartbeat()
        for node in self._nodes.values():
            node.request()

    def keep_alive(self) -> None:
        """Send the signs of the control loop that are due, until :attr:`alive_until_ns`."""
        now = self.clock.now_ns()
        if now < self.alive_until_ns and now - self._heartbeat_ns >= _SIGN_NS:
            self._signs()

    def forget(self, node_id: int, faults: bool = False) -> None:
        """Drop the losses of a device that no exchange has raised yet, and with ``faults`` its
        emergency messages, which otherwise stay until the device clears them.
        """
        self._troubles = [
            (origin, trouble)
            for origin, trouble in self._troubles
            if origin != node_id or (isinstance(trouble, DriveFault) and not faults)
        ]

    def pump(self, ready: Callable[[], bool], timeout_s: float) -> bool:
        """Dispatch frames until ``ready()`` is true; return False after ``timeout_s``."""
        deadline = self.clock.now_ns() + round(timeout_s * NS)
        while not ready():
            left = deadline - self.clock.now_ns()
            if left <= 0:
                return False
            self._receive(left / NS)
        return True

    def _connected(self) -> FramePort:
        advice = "check the interface, its driver and your permission to use it"
        return opened(self._connect, self._name, advice)

    def _opened(self) -> FramePort:
        """Return the port; a port whose adapter was unplugged is opened again by its name."""
        if self._port is None:
            if not self._lost:
                raise LinkError(f"{self._name} is not open: call open() first")
            self._port = self._connected()
        return self._port

    def _check_gone(self, error: Exception) -> None:
        """Close a dead port: the next frame opens it again, and carries the stop of a drive."""
        if is_gone(error) and self._port is not None:
            CanopenLink.close(self)
            self._lost = True

    def _receive(self, timeout_s: float) -> None:
        """Dispatch the received frames; wait if no frame has arrived."""
        port = self._port or self._opened()
        try:
            frames = port.collect(timeout_s)
        except DeviceError:
            raise
        except Exception as error:
            self._check_gone(error)
            raise LinkError(
                f"{self._name} cannot receive frames: {words(error)}; check the interface and its "
                "cable"
            ) from error
        for frame in frames:
            self._handle(frame)

    def _handle(self, frame: RawFrame) -> None:
        time_ns, identifier, data, _ = frame
        if identifier > _HIGHEST_ID:
            if identifier & ERROR_FLAG:
                text = (
                    f"{self._name}: an error frame was received; check termination (120 ohm at "
                    "both ends), cabling and bit rate"
                )
                self._troubles.append((0, LinkError(text)))
            return
        self._frames.append(frame)
        node = self._nodes.get(identifier & 0x7F)
        if node is None:
            return
        slot = node.inputs.get(identifier)
        if slot is not None:
            # A frame of the wrong length updates no value, and its values count as missing in this
            # cycle.
            if len(data) == slot.size:
                slot.values = slot.layout.unpack(data)
                if slot.cycle != self.cycle and not slot.slack:
                    node.missing -= 1
                    self._missing -= 1
                slot.cycle = self.cycle
            return
        function = identifier & 0x780
        if function == 0x080 and len(data) == 8:
            self._emergency(node, data)
        elif function == 0x700 and len(data) == 1:
            self._heard(node, data[0], time_ns)
        elif function == _SDO_ANSWER and len(data) == 8:
            node.sdo.responses.put(data)

    def _emergency(self, node: CanopenNode, data: bytes) -> None:
        code = int.from_bytes(data[:2], "little")
        if code >> 8:
            fault = DriveFault(code, f"{node.label} sent an emergency message: {explain(code)}")
            self._troubles.append((node.node_id, fault))
        else:
            # "Error reset": all errors that were reported before are cleared.
            self._troubles = [
                (origin, trouble)
                for origin, trouble in self._troubles
                if origin != node.node_id or isinstance(trouble, LinkError)
            ]

    def _heard(self, node: CanopenNode, word: int, time_ns: int) -> None:
        state = word & 0x7F
        # The boot-up message of a device is no answer to a guard request.
        if node.guarding is not None and state != INITIALISING and not node.guarding.accepts(word):
            return
        node.heard_ns = time_ns
        node.nmt_state = state
        if node.monitored and state != OPERATIONAL:
            what = (
                "restarted"
                if state == INITIALISING
                else f"left the NMT state OPERATIONAL for {NMT_NAMES.get(state, state)}"
            )
            remedy = "check the supply of the device, then prepare the device again"
            self._lose(node, f"{node.label} {what}; {remedy}")

    def _lose(self, node: CanopenNode, words: str) -> None:
        # Reported once: further exchanges then return values while the drive brakes.
        node.monitored = False
        self._troubles.append((node.node_id, LinkError(words)))

    def _silence(self, node: CanopenNode, now_ns: int) -> str:
        sign = "heartbeat" if node.guarding is None else "answer to guard requests"
        return (
            f"{node.label} sent no {sign} for {node.silent_ns(now_ns) / NS:.3f} s "
            f"(limit {node.silence_ns / NS:g} s); check its supply and the bus cable"
        )

    def _raise_troubles(self) -> None:
        troubles = [trouble for _, trouble in self._troubles]
        self._troubles = []
        # A failed bus explains all other errors; of several drive faults the first is the cause.
        raise next((trouble for trouble in troubles if isinstance(trouble, LinkError)), troubles[0])
