"""Waits for frames of a drive with its own CAN frames and returns their values in SI units."""

from __future__ import annotations

import math
from typing import Final

from drivers.can.port import hexadecimal
from drivers.clock import NS
from drivers.dbc.channel import PERIODS_KEPT, DbcChannel, Slot
from drivers.dbc.link import DbcLink
from drivers.errors import LinkError
from drivers.interfaces import ServoState
from drivers.units import Unwrapper

_ANSWER_S: Final = 0.3
_BRAKING_S: Final = 0.04
"""Time-out of an answer while the drive brakes, s; no cycle is sent meanwhile."""
_RETRY_S: Final = 0.02


class Feedback:
    """The quantities that a drive reports.

    Args:
        link: The link to the drive.
        channel: The drive.
    """

    def __init__(self, link: DbcLink, channel: DbcChannel) -> None:
        self._link = link
        self._clock = link.clock
        self._channel = channel
        self._inputs = channel.wiring.inputs
        self._reads = {
            name: (channel.slot(quantity.message), quantity.read)
            for name, quantity in self._inputs.items()
        }
        self._fault_asked = False
        self._position: float | None = None
        self.restart_time()

    def restart_time(self) -> None:
        """Restart the count of overflows of the drive's time stamp."""
        time = self._inputs.get("time")
        self._time = Unwrapper(1 if time is None else 1 << time.signal.width)

    def unasked(self, *names: str) -> list[float]:
        """Return quantities from their next valid frames, or NaN for a quantity that the drive does
        not report, or that the drive sends only in answer to a command.
        """
        slots = {name: self._reads[name][0] for name in names if name in self._reads}
        heard = {
            key: self._await(slot)
            for key, slot in {id(slot): slot for slot in slots.values()}.items()
        }
        return [
            self.value(name) if name in slots and heard[id(slots[name])] else math.nan
            for name in names
        ]

    def limits(self) -> dict[str, float]:
        """Return the limits in the next frames of the drive.

        Raises:
            LinkError: The drive sends no frames.
        """
        reported = self._channel.wiring.reported.values()
        for message in sorted({held.message for held in reported}):
            self.await_frame(message)
        return self._channel.limits()

    def fault_code(self, *, again: bool = False) -> None:
        """Wait for the fault code, if none has been received yet or if ``again`` is true.

        For a drive that sends the fault code only in answer to a command, this method waits once.
        """
        quantity = self._inputs.get("fault_code")
        if quantity is None or quantity.message == self._channel.wiring.status_message:
            return
        slot = self._channel.slot(quantity.message)
        if again or not (slot.count or self._fault_asked):
            self._fault_asked = True
            self._await(slot)

    def state_since(self, since_ns: int, cycle_ns: int) -> ServoState | None:
        """Return the state, or None if its last frame is not after ``since_ns``, or is older than
        its period permits, or if no cycle is set.
        """
        channel = self._channel
        slot = channel.slot(channel.wiring.status_message)
        kept_ns = PERIODS_KEPT * max(slot.message.period_s * NS, cycle_ns)
        recent = since_ns < slot.time_ns >= self._clock.now_ns() - kept_ns
        return channel.state if cycle_ns and recent else None

    def value(self, name: str) -> float:
        """Return a quantity from its last valid frame, or NaN if the drive does not report the
        quantity.
        """
        if name not in self._reads:
            return math.nan
        slot, read = self._reads[name]
        found = read(slot.data)
        if name != "position" or (period := self._inputs[name].wraps_after) is None:
            return found
        last = found if self._position is None else self._position
        self._position = last + math.remainder(found - last, period)
        return self._position

    def device_time(self) -> float:
        """Return the drive's time of the last sample, s; if the drive reports no time, the host's
        time at which the position was received.
        """
        quantity = self._inputs.get("time")
        if quantity is None:
            return self._reads["position"][0].time_ns / NS
        raw = quantity.signal.raw(self._channel.slot(quantity.message).data)
        whole = raw if quantity.signal.real else self._time.update(int(raw))
        return whole * quantity.gain + quantity.bias

    def told(self, name: str, otherwise: int) -> int:
        """Return an integer from the next frame of the drive; ``otherwise`` if the drive does not
        report the value.

        Raises:
            LinkError: The drive sends no frames.
        """
        quantity = self._inputs.get(name)
        if quantity is None:
            return otherwise
        self.await_frame(quantity.message)
        return round(self.value(name))

    def await_frame(self, name: str) -> None:
        """Wait for the next valid frame of a message.

        Raises:
            LinkError: The drive sends no frames.
        """
        slot = self._channel.slot(name)
        refused = slot.refused
        if not self._await(slot):
            raise self._silent(slot, refused)

    def _await(self, slot: Slot) -> bool:
        """Wait for the next valid frame of a slot; if the drive sends frames only in answer to a
        command, repeat the current order.
        """
        link, channel, message = self._link, self._channel, slot.message
        patience_s = self._patience_s(slot)
        if not channel.wiring.asked or message.remote or message.period_s:
            return link.await_frame(channel, slot, patience_s)
        deadline = self._clock.now_ns() + round(patience_s * NS)
        link.drain(channel)
        count = slot.count
        while (left := deadline - self._clock.now_ns()) > 0:
            link.command(channel)
            if link.pump(lambda: slot.count != count, min(_RETRY_S, left / NS)):
                return True
        return False

    def hear(self, name: str) -> None:
        """Send the current order until a message is received; a drive may send a message only as an
        answer.

        Raises:
            LinkError: The message is not received, or is never complete.
        """
        slot = self._channel.slot(name)
        count, refused = slot.count, slot.refused
        deadline = self._clock.now_ns() + self._patience_s(slot) * NS
        while slot.count == count:
            if self._clock.now_ns() >= deadline:
                raise self._silent(slot, refused)
            self._link.command(self._channel)
            self._link.request(slot)
            self._link.pump(lambda: slot.count != count, _RETRY_S)

    def _silent(self, slot: Slot, refused: int) -> LinkError:
        bad = slot.refused - refused
        why = (
            f"{bad} had a wrong length, checksum or counter: check these in the map"
            if bad
            else "check the supply and the bus of the drive"
        )
        name, identifier = slot.message.name, hexadecimal(slot.message.identifier)
        return LinkError(
            f"{self._channel.label} sent no valid {name} ({identifier}) "
            f"in {self._patience_s(slot):g} s: {why}"
        )

    def _patience_s(self, slot: Slot) -> float:
        answer_s = _BRAKING_S if self._channel.stopping else _ANSWER_S
        return max(answer_s, PERIODS_KEPT * slot.message.period_s)
