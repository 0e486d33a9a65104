"""State of one drive with its own CAN frames: received values and the next frames to send.

The module adds and checks counters and checksums, and has no input and output.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from drivers.can.port import REMOTE_FLAG
from drivers.clock import NS
from drivers.dbc.codec import BoundMessage, BoundPage, Images, Order, Wiring
from drivers.errors import DriveFault, StateError
from drivers.interfaces import ServoState

PERIODS_KEPT: Final = 2.5
"""Age of a periodic message, in periods of the message, up to which its values count as new."""


class Slot:
    """The last valid frame of one message.

    A frame with a wrong length or checksum, or with a life counter that did not change or
    decreased, updates nothing. After a counter that decreased the next frame is accepted, because
    the drive may have restarted.
    """

    def __init__(self, message: BoundMessage) -> None:
        self.message = message
        self.data = bytes(message.size)  # data of the frame
        self.count = 0  # number of valid frames so far
        self.cycle = -1  # number of the exchange in which the last valid frame was received
        self.time_ns = 0  # time of the last valid frame, ns
        self.refused = 0  # number of invalid frames
        self.pages: list[tuple[BoundPage, Slot]] = []  # pages of this message, each with its slot
        self._counter = message.counter
        self._checksum = message.checksum
        self._last: int | None = None

    def accept(self, data: bytes, cycle: int, time_ns: int) -> bool:
        """Store a frame if it is valid."""
        if not self._good(data):
            self.refused += 1
            for _, slot in self.pages:
                slot.refused += 1
            return False
        self._keep(data, cycle, time_ns)
        for page, slot in self.pages:
            if page.selector.bits(data) == page.number:
                slot._keep(data, cycle, time_ns)
        return True

    def _keep(self, data: bytes, cycle: int, time_ns: int) -> None:
        self.data = data
        self.count += 1
        self.cycle = cycle
        self.time_ns = time_ns

    def _good(self, data: bytes) -> bool:
        if len(data) != self.message.size:
            return False
        checksum = self._checksum
        if checksum is not None and self.message.algorithm(data) != checksum.bits(data):
            return False
        counter = self._counter
        if counter is None:
            return True
        number, last = counter.bits(data), self._last
        self._last = number
        turn = self.message.turn
        if number >= turn:
            return False
        return last is None or 0 < (number - last) % turn <= turn // 2


class _Output:
    """A message of the host: order, target if it has one, life counter and checksum."""

    def __init__(self, message: BoundMessage) -> None:
        self.message = message
        self.image = bytes(message.size)
        self.every = 1
        self._count = 0

    def frame(self, image: bytes | None = None) -> bytes:
        """Return the next frame; ``image`` replaces the data of the current order."""
        data, message = self.image if image is None else image, self.message
        if (counter := message.counter) is not None:
            self._count = (self._count + 1) % message.turn
            data = counter.insert(data, self._count)
        if (checksum := message.checksum) is not None:
            data = checksum.insert(data, message.algorithm(data))
        return data


class DbcChannel:
    """State of one drive for its link.

    Attributes:
        slots: Slots of the messages of the drive, by CAN identifier.
        cycle: Number of exchanges so far.
        heard: Number of frames received from the drive, valid or invalid.
        commanded: Whether any frame has been sent to the drive; if not, closing the link sends no
            stop frame.
        stopping: Whether the present order is to brake.
    """

    def __init__(self, wiring: Wiring, label: str) -> None:
        self.wiring = wiring
        self.label = label
        self.cycle = 0
        self.heard = 0
        self.commanded = False
        by_name = {name: Slot(message) for name, message in wiring.received.items()}
        self.slots = {slot.message.identifier: slot for slot in by_name.values()}
        self._by_name = by_name
        for key, page in wiring.pages.items():
            base = by_name[page.message]
            # Each page is sent once in as many messages as there are pages.
            period_s = base.message.period_s * page.count
            by_name[key] = slot = Slot(replace(base.message, period_s=period_s))
            base.pages.append((page, slot))
        self._sampled = [by_name[name] for name in sorted(wiring.sampled)]
        self._answers: list[Slot] = []
        self._timed: list[tuple[Slot, float]] = []
        self._outputs = {name: _Output(message) for name, message in wiring.sent.items()}
        self._once = {name: _Output(message) for name, message in wiring.once.items()}
        self._pending: list[_Output] = []
        stop = wiring.stop_message
        known = {**self._once, **self._outputs}
        self._stop = known.get(stop.name) or _Output(stop)
        self._settings = {name: _Output(message) for name, message in wiring.settings.items()}
        self._requests = [slot for slot in self.slots.values() if slot.message.remote]
        self._request_every: dict[int, int] = {}
        self._pinned: dict[str, float] = {}
        self._limit_slots = [
            by_name[name] for name in sorted({held.message for held in wiring.reported.values()})
        ]
        self._limits_heard = 0
        self._target_bits = 0
        self._offset_bits = 0
        self._own_target = False
        self._holding = False
        self._begun_ns = 0
        fault = wiring.inputs.get("fault_code")
        self._fault = None if fault is None else (by_name[fault.message], fault.read)
        self.rest()
        self.order(wiring.disable)

    def slot(self, message: str) -> Slot:
        """Return the slot of a message by name."""
        return self._by_name[message]

    def set_cycle(self, cycle_s: float) -> None:
        """Set the cycle time and compute the period in cycles of each message of the host."""
        for output in self._outputs.values():
            output.every = max(1, round(output.message.period_s / cycle_s))
        for slot in self._requests:
            every = max(1, round(slot.message.period_s / cycle_s))
            self._request_every[slot.message.identifier] = every
        pages = {id(slot): page for base in self.slots.values() for page, slot in base.pages}
        self._answers, self._timed = [], []
        for slot in self._sampled:
            period_s = slot.message.period_s
            if (page := pages.get(id(slot))) is not None and page.count > 1:
                period_s = max(period_s, cycle_s * page.count)
            if period_s <= cycle_s:
                self._answers.append(slot)
            else:
                self._timed.append((slot, period_s))

    def order(self, order: Order, *, hold: bool = False) -> None:
        """Put an order into every frame from the next exchange on; a message that is sent only with
        an order is sent once.

        Args:
            order: The order.
            hold: Whether the drive must continue to run; if the drive stops by itself, the order
                ``disable`` replaces this order.
        """
        outputs, once = self._outputs, self._once
        # Frames of an earlier order that have not been sent yet are dropped.
        self._pending = []
        for name, image in order.frames.items():
            output = outputs.get(name)
            if output is None:
                output = once[name]
                self._pending.append(output)
            output.image = image
        self._own_target = order.own_target
        self.stopping = order is self.wiring.stop
        self._holding = hold
        if not hold:
            self.rest()
        self._fill()

    def aim(self, bits: int) -> None:
        """Put a target, as raw bits, into every frame of an order without own target."""
        self._target_bits = bits
        self._fill()

    def push(self, bits: int) -> None:
        """Put a torque offset, as raw bits, into every frame from the next exchange on.

        While the drive is not ordered to run, the frames contain a torque offset of zero.
        """
        if self._holding:
            self._offset_bits = bits
            self._fill()

    def rest(self) -> None:
        """Put a torque offset of zero into every frame from the next exchange on."""
        offset = self.wiring.torque_offset
        if offset is not None:
            self._offset_bits = offset.bits(0.0)

    def _fill(self) -> None:
        wiring = self.wiring
        if self._own_target:
            return
        for quantity, bits in (
            (wiring.target, self._target_bits),
            (wiring.torque_offset, self._offset_bits),
        ):
            if quantity is None:
                continue
            output, signal = self._outputs[quantity.message], quantity.signal
            image = output.image
            if signal.selector is not None:
                image = signal.selector.insert(image, signal.pages[0])
            output.image = signal.insert(image, bits)

    def frames(self, *, all_now: bool = False) -> Iterator[tuple[int, bytes]]:
        """Yield identifier and data of each frame that is due in this cycle, or of all frames.

        A message that is sent only with an order is due from this order until it has been sent.
        """
        self.commanded = True
        for output in self._outputs.values():
            if all_now or self.cycle % output.every == 0:
                yield output.message.identifier, output.frame()
        # The target is sent before the order, because a drive that is started by an order uses the
        # last received target.
        while self._pending:
            output = self._pending[0]
            yield output.message.identifier, output.frame()
            if self._pending and self._pending[0] is output:
                del self._pending[0]

    def requests(self) -> Iterator[int]:
        """Yield the identifiers of the remote frames that are due."""
        for slot in self._requests:
            identifier = slot.message.identifier
            if self.cycle % self._request_every.get(identifier, 1) == 0:
                yield identifier | REMOTE_FLAG

    def stop_frame(self) -> tuple[int, bytes]:
        """Return identifier and data of the next stop frame."""
        return self._stop.message.identifier, self._stop.frame(self.wiring.stop_image)

    def settings(self, images: Images) -> list[tuple[int, bytes]]:
        """Return identifier and data of the frames that contain settings."""
        for name, image in images.items():
            self._settings[name].image = image
        return [(output.message.identifier, output.frame()) for output in self._settings.values()]

    def limits(self) -> dict[str, float]:
        """Return the limits in the last valid frames, by name in the map."""
        return {
            name: quantity.read(self._by_name[quantity.message].data)
            for name, quantity in self.wiring.reported.items()
        }

    def pin(self, limits: dict[str, float]) -> None:
        """Set the limits that the drive must report from now on; empty for no check."""
        self._pinned = limits

    def begin(self, now_ns: int) -> None:
        """Start an exchange."""
        self.cycle += 1
        self._begun_ns = now_ns

    def receive(self, slot: Slot, data: bytes, time_ns: int) -> None:
        """Process a received frame."""
        self.heard += 1
        slot.accept(data, self.cycle, time_ns)

    @property
    def answered(self) -> bool:
        """Whether all messages that answer the command were received in this exchange."""
        cycle = self.cycle
        return all([slot.cycle == cycle for slot in self._answers])

    @property
    def fresh(self) -> bool:
        """Whether all messages of a sample were received without error and in time."""
        begun = self._begun_ns
        return self.answered and all(
            [
                slot.count and begun - slot.time_ns <= PERIODS_KEPT * period_s * NS
                for slot, period_s in self._timed
            ]
        )

    @property
    def state(self) -> ServoState | None:
        """State of the drive in the last valid frames, or None if the status value is not in the
        map.

        A fault code other than 0 means a fault, whatever the value of the status signal; the drive
        counts as energised until this signal shows that the power is off. After an order to brake,
        only the status signal shows whether the drive brakes: the fault code may be a warning.
        """
        wiring = self.wiring
        shown = wiring.states.get(wiring.status.raw(self._by_name[wiring.status_message].data))
        if not self.fault_code:
            return shown
        if shown is None or shown.energised:
            return shown if self.stopping else ServoState.FAULT_REACTION
        return ServoState.FAULT

    @property
    def fault_code(self) -> int:
        """Fault code in the last valid frame; 0 if there is none."""
        if self._fault is None:
            return 0
        slot, read = self._fault
        return round(read(slot.data)) if slot.count else 0

    def settle(self) -> None:
        """End an exchange: a drive that has stopped by itself is not commanded to run again.

        Raises:
            DriveFault: The drive went into fault while it was running.
            StateError: The drive reports limits that differ from the written limits; this error is
                raised once.
        """
        self._check_limits()
        if not self._holding or (state := self.state) is ServoState.OPERATION_ENABLED:
            return
        self.order(self.wiring.disable)
        if state in (ServoState.FAULT, ServoState.FAULT_REACTION):
            raise self.fault()

    def _check_limits(self) -> None:
        heard = sum(slot.count for slot in self._limit_slots)
        if heard == self._limits_heard:
            return
        self._limits_heard = heard
        changed = [
            name for name, value in self.limits().items() if self._pinned.get(name, value) != value
        ]
        if changed:
            self._pinned = {}
            raise StateError(
                f"{self.label} no longer reports the limits written into it "
                f"({', '.join(changed)}): "
                f"the drive has restarted, or another program or device has changed the limits; "
                "check the supply of the drive and the other devices on the bus"
            )

    def fault(self) -> DriveFault:
        """Return the fault that the drive reports."""
        return DriveFault(
            self.fault_code,
            f"{self.label} is in fault: look up the code in its manual, remove the cause, then "
            "reset the fault",
        )
