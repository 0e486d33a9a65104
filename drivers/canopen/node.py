"""One CANopen device on a link: SDO access, process data, NMT start and heartbeat monitoring."""

from __future__ import annotations

import struct
from collections.abc import Container, Sequence
from typing import Final

from canopen.objectdictionary import ObjectDictionary

from drivers.canopen.pdo import PDO_BITS, RECEIVE, TRANSMIT, Input, configure, plan
from drivers.canopen.sdo import PumpedNode, Wire, described, translated, unfit, variable
from drivers.clock import NS
from drivers.errors import ConfigurationError, LinkError, StateError
from drivers.objects import ObjectAddress, PdoLayout, optional, refusal

_MS: Final = 1_000_000
_BOOT_TIMEOUT_S: Final = 1.0
HEARTBEAT_S: Final = 0.05
"""Requested period of the device's heartbeat (1017h), s; a device may round the period up."""
_CONSUMER: Final = (0x1016, 1)
_PRODUCER: Final = (0x1017, 0)
HEARTBEATS_MISSED: Final = 4
"""Number of periods without a heartbeat after which the device counts as lost."""

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


class CanopenNode:
    """A device behind a :class:`~drivers.canopen.link.CanopenLink`; a
    :class:`~drivers.objects.ProcessChannel`.

    Attributes:
        node_id: Node identifier, 1 to 127.
        remote: Object of the library canopen for the device.
        outputs: Data of each RPDO for the next exchange, by CAN identifier.
        inputs: Last frame of each TPDO, by CAN identifier.
        expected: Number of TPDOs that the device sends with every SYNC.
        missing: Number of these TPDOs that have not been received since the last exchange began.
        cycle: Number of the last exchange.
        nmt_state: NMT state in the last heartbeat; None before the first heartbeat.
        heard_ns: Time of the last heartbeat, ns.
        silence_ns: Time without a heartbeat after which the device counts as lost, ns.
        monitored: Whether process data is exchanged, so that a lost device is detected; False
            after the device was reported as lost.
    """

    def __init__(self, node_id: int, dictionary: ObjectDictionary, wire: Wire) -> None:
        self.node_id = node_id
        self.remote = PumpedNode(node_id, dictionary, wire)
        self.outputs: dict[int, bytes] = {}
        self.inputs: dict[int, Input] = {}
        self.expected = 0
        self.missing = 0
        self.cycle = wire.cycle
        self.nmt_state: int | None = None
        self.heard_ns = 0
        self.silence_ns = 0
        self.monitored = False
        self._wire = wire
        self._dictionary = dictionary
        self._staged: dict[int, tuple[int, struct.Struct]] = {}
        self._then: dict[int, bytes] = {}
        self._numbered: dict[int, Input] = {}
        self._slow: list[Input] = []
        self._watched = False

    @property
    def label(self) -> str:
        """Name of the device in messages."""
        return f"node {self.node_id}"

    @property
    def latches(self) -> bool:
        """True: the values of an exchange are all sampled at the SYNC."""
        return True

    @property
    def fresh(self) -> bool:
        """Whether all values that the device had to send in the last exchange arrived."""
        if self.missing or not self._wire.exchanged:
            return False
        for slot in self._slow:  # noqa: SIM110  (a generator costs a microsecond a cycle)
            if self.cycle - slot.cycle > slot.slack:
                return False
        return True

    def read(self, index: int, subindex: int = 0) -> int:
        """Read an integer object.

        Raises:
            ConfigurationError: The EDS has no such object, or the length of the answer differs from
                that in the EDS.
            ObjectAccessError: The device refuses.
            LinkError: No answer.
        """
        item = variable(self._dictionary, index, subindex)
        data = self._upload(index, subindex)
        if not item.fixed_size or len(data) != len(item) // 8:
            raise ConfigurationError(
                f"{self.label}: object {index:04X}h:{subindex:02X}h has {len(data)} bytes, but "
                f"{len(item) // 8} in its EDS; use the EDS file of this device"
            )
        return int(item.decode_raw(data))

    def read_text(self, index: int, subindex: int = 0) -> str:
        """Read a visible-string object; the errors are those of :meth:`read`."""
        return self._upload(index, subindex).decode("ascii", errors="replace").rstrip("\0")

    def write(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object.

        Raises:
            ConfigurationError: The EDS has no such object, or the value does not fit its type.
            ObjectAccessError: The device refuses.
            LinkError: No answer.
        """
        data = self._packed(index, subindex, value)
        with translated(self.node_id, index, subindex):
            self.remote.sdo.download(index, subindex, data)

    @property
    def sync_us(self) -> int:
        """Time of the last SYNC on the clock of the host, microseconds modulo 2^32."""
        return self._wire.sync_ns // 1000 & 0xFFFFFFFF

    def describes(self, index: int, subindex: int, mappable: bool = False) -> bool:
        """Return whether the EDS contains an object and, with ``mappable``, allows the object in
        process data. Nothing is sent.
        """
        return described(self._dictionary, index, subindex, mappable)

    def fit_together(self, addresses: Sequence[ObjectAddress]) -> bool:
        """Return whether a PDO can hold these objects. Nothing is sent."""
        found = (self._dictionary.get_variable(*address) for address in addresses)
        return sum(len(item) for item in found if item is not None) <= PDO_BITS

    def stated(self, index: int, subindex: int) -> int | None:
        """Return the default value of an object in the EDS, or None without a default value,
        without sending anything.
        """
        item = self._dictionary.get_variable(index, subindex)
        default = None if item is None else item.default
        return default if isinstance(default, int) else None

    def require_watchable(self) -> None:
        """Check that the EDS contains a heartbeat consumer; the errors are those of :meth:`watch`.
        Nothing is sent.
        """
        for error in refusal(self._packed, *_CONSUMER, 0):
            raise ConfigurationError(
                f"{error}; every run needs this object, by which the drive detects that this "
                "program has ended"
            ) from error

    def require_fit(self, index: int, subindex: int, value: int) -> None:
        """Check that the EDS contains an object and that a value fits its type; the errors are
        those of :meth:`write`.

        Nothing is sent.
        """
        self._packed(index, subindex, value)

    def insist(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object; the SDO request is sent even if no answer can be received.

        The errors are those of :meth:`write`.
        """
        self.write(index, subindex, value)

    def announce(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object if the last heartbeat shows that the device does not accept
        process data, or if the last exchange did not send them.

        The errors are those of :meth:`write`.
        """
        if self.nmt_state != OPERATIONAL or not self._wire.exchanged:
            self.write(index, subindex, value)

    def require_mappable(self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout]) -> None:
        """Make those checks of :meth:`map_process_data` that need no write, with its errors.

        Nothing is sent.
        """
        for error in refusal(self._packed, *_PRODUCER, 0):
            raise ConfigurationError(
                f"{error}; every run needs this object, by which this program detects that the "
                "device is lost"
            ) from error
        for direction, layouts in ((RECEIVE, outputs), (TRANSMIT, inputs)):
            plan(self._dictionary, self.label, direction, layouts)

    def map_process_data(
        self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout], cycle_s: float
    ) -> None:
        """Configure PDOs and heartbeat by SDO in PRE-OPERATIONAL, then start the node.

        The first values of the inputs are read by SDO.

        Raises:
            ConfigurationError: Another device has another cycle time, an object is not in the EDS,
                or a PDO is too long.
            ObjectAccessError: The device refuses the mapping.
            LinkError: No answer.
        """
        self._wire.set_cycle(cycle_s, self.label)
        self.monitored = False
        self._command(0x80)
        self._disarm()
        self._produce_heartbeat()
        self.outputs, self._staged, self._then = {}, {}, {}
        for layout, (identifier, packing) in zip(
            outputs, configure(self, self._dictionary, RECEIVE, outputs), strict=True
        ):
            self.outputs[identifier] = bytes(packing.size)
            self._staged[layout.number] = (identifier, packing)
        self.inputs, self._numbered, self._slow = {}, {}, []
        for layout, (identifier, packing) in zip(
            inputs, configure(self, self._dictionary, TRANSMIT, inputs), strict=True
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
        """Set the values that RPDO ``number`` contains from the next exchange on."""
        identifier, packing = self._staged[number]
        self.outputs[identifier] = packing.pack(*values)
        if self._then:
            self._then.pop(identifier, None)

    def stage_once(self, number: int, values: tuple[int, ...], then: tuple[int, ...]) -> None:
        """Set the values of RPDO ``number`` for the next exchange, and the values for the exchanges
        after it.
        """
        identifier, packing = self._staged[number]
        self.outputs[identifier] = packing.pack(*values)
        self._then[identifier] = packing.pack(*then)

    def sent(self) -> None:
        """Register that the outputs were sent: values for one exchange are replaced by the
        following values.
        """
        if self._then:
            self.outputs.update(self._then)
            self._then.clear()

    def latest(self, number: int) -> tuple[int, ...]:
        """Return the values of the last valid frame of TPDO ``number``.

        Raises:
            StateError: The process data are not set up.
        """
        if number not in self._numbered:
            raise StateError(f"{self.label}: no process data are set up; prepare the device first")
        return self._numbered[number].values

    def watch(self, limit_s: float) -> None:
        """Activate the device's heartbeat consumer (1016h), and send the first heartbeat, which
        starts the time-out.

        Raises:
            ConfigurationError: The value of 1016h that is read back differs from the written value.
        """
        setting = self._wire.master_id << 16 | round(limit_s * 1e3)
        self._watched = True
        self.write(*_CONSUMER, setting)
        self._wire.heartbeat()
        found = self.read(*_CONSUMER)
        if found != setting:
            raise ConfigurationError(
                f"{self.label}: heartbeat consumer 1016h:01h reads {found:08X}h after "
                f"{setting:08X}h was written; with this value the device would not detect that the "
                "control loop has stopped"
            )

    def unwatch(self) -> None:
        """Deactivate the heartbeat consumer."""
        self.write(*_CONSUMER, 0)
        self._watched = False

    def limit_wait(self, limit_s: float | None) -> None:
        """Wait at most ``limit_s`` for an SDO answer if the heartbeat consumer is active, because
        no heartbeat is sent meanwhile; None restores the time-out of the link.
        """
        self.remote.limit_wait(limit_s if self._watched else None)

    def _disarm(self) -> None:
        """Deactivate a heartbeat consumer that an earlier program left active when it ended.

        The host sends a heartbeat first, because a device that has detected the loss of its master
        waits for a heartbeat. Without the deactivation, the heartbeat before the start of the node
        would start the time-out again.
        """
        if optional(self.read, *_CONSUMER):
            self._wire.heartbeat()
            self.unwatch()

    def _produce_heartbeat(self) -> None:
        """Set the period of the device's heartbeat, and read the period that the device stores.

        Raises:
            ConfigurationError: The device sends no heartbeat.
        """
        wanted_ms = round(HEARTBEAT_S * 1e3)
        self.write(*_PRODUCER, wanted_ms)
        period_ms = self.read(*_PRODUCER)
        if not period_ms:
            raise ConfigurationError(
                f"{self.label}: heartbeat period 1017h reads 0 after {wanted_ms} ms was written; "
                "without a heartbeat this program would not detect a lost device"
            )
        self.silence_ns = HEARTBEATS_MISSED * period_ms * _MS

    def _packed(self, index: int, subindex: int, value: int) -> bytes:
        item = variable(self._dictionary, index, subindex)
        try:
            return bytes(item.STRUCT_TYPES[item.data_type].pack(value))
        except (KeyError, struct.error) as error:
            raise unfit(self.label, item, value) from error

    def _upload(self, index: int, subindex: int) -> bytes:
        with translated(self.node_id, index, subindex):
            return bytes(self.remote.sdo.upload(index, subindex))

    def _command(self, code: int) -> None:
        self._wire.send(0x000, bytes([code, self.node_id]))

    def _start(self) -> None:
        self.nmt_state = None
        # A device may refuse the NMT command "start" until it receives a heartbeat of its master.
        self._wire.heartbeat()
        self._command(0x01)
        timeout_s = _BOOT_TIMEOUT_S + self.silence_ns / NS
        if not self._wire.pump(lambda: self.nmt_state == OPERATIONAL, timeout_s):
            state = (
                "none"
                if self.nmt_state is None
                else NMT_NAMES.get(self.nmt_state, f"{self.nmt_state}")
            )
            raise LinkError(
                f"{self.label} did not report the NMT state OPERATIONAL within {timeout_s:g} s "
                f"(last heartbeat: {state})"
            )
        self.monitored = True
