"""CANopen network with this program as master, over any python-can interface, without threads.

Frames are received while a method of the link waits for them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Self

import canopen

from drivers.can.port import ANSWER_SHARE, ERROR_FLAG, FramePort, PythonCanPort, open_bus, raw_frame
from drivers.can.slcan import open_slcan
from drivers.canopen.eds_file import read_eds
from drivers.canopen.node import (
    INITIALISING,
    NMT_NAMES,
    OPERATIONAL,
    SIGN_S,
    CanopenNode,
    require_node,
)
from drivers.canopen.sdo import ONE_AXIS, Axis
from drivers.clock import NS, Clock
from drivers.errors import DriveFault, LinkError
from drivers.interfaces import Link, RawFrame
from drivers.port_errors import close_all, is_gone, opened, require_one_cycle, words

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


MASTER_ID: Final = 0x7F
"""Node identifier of this program's own heartbeat."""
_FRAMES_KEPT: Final = 1 << 16
_SIGN_NS: Final = round(SIGN_S * NS)
_OPERATIONAL_HEARTBEAT: Final = bytes([OPERATIONAL])
_SYNC: Final = 0x080
_SDO_ANSWER: Final = 0x580
_HIGHEST_ID: Final = 0x7FF


class _Network(canopen.Network):
    """Dispatcher of the library canopen, which sends through the link."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self._send = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a frame of a request of the library canopen."""
        if remote:
            raise NotImplementedError("this program does not send remote frames")
        self._send(can_id, bytes(data))


class CanopenLink(Link):
    """A CANopen network with this program as its only master.

    Args:
        clock: Real or simulated clock, as the bus.
        connect: Opens the bus.
        name: Name of the bus in messages.
        master_id: Node identifier of the master's heartbeat.
        sdo_timeout_s: Time-out of an SDO request, s.

    Attributes:
        cycle: Number of exchanges so far.
        sync_ns: Time of the last SYNC.
        exchanged: Whether the last exchange sent all outputs and SYNC.
        alive_until_ns: Time until which the signs of the control loop are sent also while an SDO
            answer is awaited; 0 to send them in exchanges only.
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
        self.cycle = 0
        self.sync_ns = 0
        self.exchanged = False
        self.alive_until_ns = 0
        self.master_id = master_id
        self.sdo_timeout_s = sdo_timeout_s
        self._name = name
        self._connect = connect
        self._port: FramePort | None = None
        self._lost = False
        self._network = _Network(self.send)
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

        Args:
            node_id: Node identifier.
            eds: Its EDS file.
            axis: The axis that is used of a device with several axes.

        Raises:
            ConfigurationError: The node identifier is out of range or in use, or the EDS cannot be
                read.
        """
        require_node(node_id, {self.master_id, *self._nodes})
        dictionary = read_eds(eds, node_id)
        node = CanopenNode(node_id, dictionary, self, axis)
        self._network.add_node(node.remote)
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
        """Set the cycle time, which must be the same for all devices.

        Raises:
            ConfigurationError: Another device has a different cycle time.
        """
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
        """Send one frame.

        Raises:
            LinkError: The bus refuses the frame.
        """
        port = self._port or self._opened()
        try:
            port.transmit(identifier, data)
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

    def forget(self, node_id: int) -> None:
        """Drop the losses of a device that no exchange has raised yet. An emergency message stays
        until the device clears it.
        """
        self._troubles = [
            (origin, trouble)
            for origin, trouble in self._troubles
            if origin != node_id or isinstance(trouble, DriveFault)
        ]

    def pump(self, ready: Callable[[], bool], timeout_s: float) -> bool:
        """Receive and dispatch frames until ``ready()`` is true; return False after ``timeout_s``.

        Raises:
            LinkError: The bus failed.
        """
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
        """Close a dead port, so that the next frame opens it again: an adapter that is plugged in
        again carries the stop of a drive.
        """
        if is_gone(error) and self._port is not None:
            CanopenLink.close(self)
            self._lost = True

    def _receive(self, timeout_s: float) -> None:
        """Dispatch the received frames; wait if no frame has arrived."""
        port = self._port or self._opened()
        try:
            frames = port.collect(timeout_s)
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
            # Only these frames need the dispatcher of the library canopen, whose callbacks raise
            # errors on shorter frames. A frame that a callback rejects counts as lost; a request
            # that waits for it has a time-out.
            with suppress(Exception):
                self._network.notify(identifier, bytearray(data), time_ns / NS)

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
