"""Reads the values that a drive reports in its own frames, and waits for those frames."""

from __future__ import annotations

import math
from typing import Final

from drivers.clock import NS
from drivers.dbc.channel import PERIODS_KEPT, DbcChannel, Slot
from drivers.dbc.link import DbcLink
from drivers.errors import LinkError
from drivers.units import Unwrapper

_ANSWER_S: Final = 0.3
_RETRY_S: Final = 0.02


class Feedback:
    """The quantities that a drive reports.

    Args:
        link: The link it is on.
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
        self._status = channel.slot(channel.wiring.status_message)
        self.restart_time()

    def restart_time(self) -> None:
        """Restart counting the overflows of the drive's time."""
        time = self._inputs.get("time")
        self._time = Unwrapper(1 if time is None else 1 << time.signal.width)

    def unasked(self, *names: str) -> list[float]:
        """Return quantities from their next good frames; NaN if these come only in answer to a
        command.
        """
        slots = {name: self._reads[name][0] for name in names}
        messages = {slot.message.name: slot for slot in slots.values()}
        heard = {
            message: self._link.await_frame(self._channel, slot, _patience_s(slot))
            for message, slot in messages.items()
        }
        return [
            self.value(name) if heard[slot.message.name] else math.nan
            for name, slot in slots.items()
        ]

    def limits(self) -> dict[str, float]:
        """Return the limits that the drive reports next.

        Raises:
            LinkError: The drive is silent.
        """
        limits = self._channel.wiring.limits.values()
        for message in sorted({limit.held.message for limit in limits}):
            self.await_frame(message)
        return self._channel.limits()

    def value(self, name: str) -> float:
        """Return a quantity from its last good frame."""
        slot, read = self._reads[name]
        return read(slot.data)

    def device_time(self) -> float:
        """Return the drive's time of its last status, s; the host's time if it reports none."""
        quantity = self._inputs.get("time")
        if quantity is None:
            return self._status.time_ns / NS
        raw = quantity.signal.raw(self._channel.slot(quantity.message).data)
        whole = raw if quantity.signal.real else self._time.update(int(raw))
        return whole * quantity.gain + quantity.bias

    def told(self, name: str, otherwise: int) -> int:
        """Return an integer that the drive reports next, ``otherwise`` if it reports none.

        Raises:
            LinkError: The drive is silent.
        """
        quantity = self._inputs.get(name)
        if quantity is None:
            return otherwise
        self.await_frame(quantity.message)
        return round(self.value(name))

    def await_frame(self, name: str) -> None:
        """Wait for the next good frame of a message.

        Raises:
            LinkError: The drive is silent.
        """
        slot = self._channel.slot(name)
        refused = slot.refused
        if not self._link.await_frame(self._channel, slot, _patience_s(slot)):
            raise self._silent(slot, refused)

    def hear(self, name: str) -> None:
        """Send the current order until a message has come; some come only as an answer.

        Raises:
            LinkError: It does not come, or never complete.
        """
        slot = self._channel.slot(name)
        count, refused = slot.count, slot.refused
        deadline = self._clock.now_ns() + _patience_s(slot) * NS
        while slot.count == count:
            if self._clock.now_ns() >= deadline:
                raise self._silent(slot, refused)
            self._link.command(self._channel)
            self._link.pump(lambda: slot.count != count, _RETRY_S)

    def _silent(self, slot: Slot, refused: int) -> LinkError:
        bad = slot.refused - refused
        why = (
            f"{bad} came with a bad length, checksum or counter: check the map"
            if bad
            else "check its supply and bus"
        )
        message = slot.message
        return LinkError(
            f"{self._channel.label} sent no good {message.name} ({message.identifier:03X}h) "
            f"in {_patience_s(slot):g} s: {why}"
        )


def _patience_s(slot: Slot) -> float:
    return max(_ANSWER_S, PERIODS_KEPT * slot.message.period_s)
