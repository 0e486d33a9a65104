"""Interfaces by which a device profile accesses its device: single objects, and process data.

A profile uses only these interfaces, so that it is independent of the transport.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Final, ParamSpec, Protocol, TypeVar

from drivers.errors import ConfigurationError, DeviceError, NotDescribedError, ObjectAccessError
from drivers.interfaces import Identity

ObjectAddress = tuple[int, int]  # index and subindex of an object
VENDOR: Final = (0x1018, 1)
"""Vendor of a device, the only part of its identity that CiA 301 prescribes."""
PRODUCT: Final = (0x1018, 2)
ABSENT: Final = (0x06020000, 0x06090011)
"""Abort codes of a device that lacks an object or a subindex."""
_WRITE_ONLY: Final = 0x06010001
CONSUMER: Final = (0x1016, 1)
GUARD_TIME: Final = (0x100C, 0)
LIFE_FACTOR: Final = (0x100D, 0)
WATCHES: Final[tuple[tuple[ObjectAddress, ...], ...]] = ((CONSUMER,), (GUARD_TIME, LIFE_FACTOR))
"""Objects by which a device monitors its master: the heartbeat consumer, or life guarding."""
P = ParamSpec("P")
V = TypeVar("V")


def short_name(address: ObjectAddress) -> str:
    """Return the name of an object in messages: 6064h, or 607Dh:01h."""
    index, subindex = address
    return f"{index:04X}h:{subindex:02X}h" if subindex else f"{index:04X}h"


def problem_of(
    act: Callable[P, object], *args: P.args, **kwargs: P.kwargs
) -> Iterator[DeviceError]:
    """Call ``act``, and yield the error if the device or its EDS refuses the request; yield nothing
    if the request is accepted.

    Raises:
        LinkError: The device cannot be reached; this is no refusal.
    """
    try:
        act(*args, **kwargs)
    except (ConfigurationError, ObjectAccessError) as error:
        yield error


class ObjectAccess(Protocol):
    """Reads and writes single objects of one device, as integers in the device's own units."""

    def read(self, index: int, subindex: int = 0) -> int:
        """Read an integer object.

        Raises:
            ObjectAccessError: The device refuses.
            LinkError: No answer.
        """
        ...

    def read_text(self, index: int, subindex: int = 0) -> str:
        """Read a visible-string object; the errors are those of :meth:`read`."""
        ...

    def write(self, index: int, subindex: int, value: int) -> None:
        """Write an integer object; the errors are those of :meth:`read`."""
        ...

    def require_fit(self, index: int, subindex: int, value: int) -> None:
        """Check that the EDS contains an object and that a value fits into it. Nothing is sent.

        Raises:
            ConfigurationError: The EDS does not contain the object, or the value does not fit.
        """
        ...


@dataclass(frozen=True)
class PdoLayout:
    """Objects that are exchanged together in one PDO.

    Attributes:
        number: PDO number, from 1.
        objects: Addresses of the objects in the order of the PDO.
        every: Period of the exchange in cycles.
        slack: Number of cycles that an input may be late and still count as fresh; the exchange
            does not wait for inputs with slack.
        mean: Object that is a mean over the cycle, which a transport without SYNC interpolates to
            the instant of the position, or None without such an object.
    """

    number: int
    objects: tuple[ObjectAddress, ...]
    every: int = 1
    slack: int = 0
    mean: ObjectAddress | None = None


class ProcessChannel(ObjectAccess, Protocol):
    """Interface of one device on a link: its objects, and its part of the cyclic exchange.

    Attributes:
        node_id: Node identifier, 1 to 127.
    """

    node_id: int

    @property
    def label(self) -> str:
        """Name of the device in messages."""
        ...

    @property
    def latches(self) -> bool:
        """Whether all values of an exchange are sampled at one instant, as with a SYNC; otherwise
        the values are read one after another, and the period of a mean value ends when it is read.
        """
        ...

    @property
    def cycle(self) -> int:
        """Number of exchanges so far."""
        ...

    @property
    def fresh(self) -> bool:
        """Whether all values that the device had to send in the last exchange arrived."""
        ...

    @property
    def sync_us(self) -> int:
        """Time at which the values of the last exchange were sampled, on the clock of the host,
        microseconds modulo 2^32. This time is used for a device that sends no time stamp.
        """
        ...

    def describes(self, index: int, subindex: int, mappable: bool = False) -> bool:
        """Return whether the EDS of the device contains an object and, with ``mappable``, allows
        this object in process data.

        An object with a faulty entry in the EDS counts as contained, so that the use of the object
        raises an error; but with ``mappable`` the result is False. Nothing is sent.
        """
        ...

    def fit_together(self, addresses: Sequence[ObjectAddress]) -> bool:
        """Return whether these objects fit into one PDO. Nothing is sent."""
        ...

    def stated(self, index: int, subindex: int) -> int | None:
        """Return the value that the EDS states for an object, or None if it states no value.

        Nothing is sent.
        """
        ...

    def insist(self, index: int, subindex: int, value: int) -> None:
        """Write an object that must be sent even if no answer can be received; the errors are those
        of :meth:`write`.

        This method is only for commands that take the power off, because the value may be written
        more than once.
        """
        ...

    def announce(self, index: int, subindex: int, value: int) -> None:
        """Write an output before the next exchange if exchanges may not bring it to the device. The
        wait for the answer is as short as the transport permits.

        Raises:
            LinkError: The request cannot be sent, or has no answer.
        """
        ...

    def require_mappable(self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout]) -> None:
        """Check by the EDS that process data can be mapped.

        Nothing is sent.

        Raises:
            ConfigurationError: The EDS does not contain an object, an object is no integer, or the
                objects of a PDO are too long.
        """
        ...

    def accessed(
        self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout], watched: bool
    ) -> Iterator[ObjectAddress]:
        """Yield the objects that mapping and watch read or write. Nothing is sent."""
        ...

    def unguarded(self, watched: bool) -> Iterator[DeviceError]:
        """Yield an error for a device that :meth:`map_process_data` would guard by remote frames,
        and that does not answer one. Nothing is written.

        Raises:
            LinkError: The request cannot be sent.
        """
        ...

    def forget_faults(self) -> None:
        """Drop the device's emergency messages, as its fault was cleared and its state shows it."""
        ...

    def map_process_data(
        self,
        outputs: Sequence[PdoLayout],
        inputs: Sequence[PdoLayout],
        cycle_s: float,
        watched: bool = False,
    ) -> None:
        """Configure which values are exchanged and how often, and start the exchange. The device is
        not energised.

        Args:
            outputs: Objects that are sent to the device.
            inputs: Objects that the device sends.
            cycle_s: Control cycle, s.
            watched: Whether the device shall be able to monitor the control loop (:meth:`watch`).

        Raises:
            ConfigurationError: The device lacks an object, or another device on the link has
                another cycle time.
            ObjectAccessError: The device refuses the mapping.
            LinkError: No answer.
        """
        ...

    def stage(self, number: int, *values: int) -> None:
        """Set the values of output ``number`` from the next exchange on."""
        ...

    def stage_once(self, number: int, values: tuple[int, ...], then: tuple[int, ...]) -> None:
        """Set the values of output ``number`` for the next exchange, and the values ``then`` for
        the exchanges after it, until the next call sets other values.
        """
        ...

    def latest(self, number: int) -> tuple[int, ...]:
        """Return the last good values of input ``number``.

        Raises:
            StateError: The inputs are not set up.
        """
        ...

    def watch(self, limit_s: float) -> None:
        """Make the device monitor the control loop: without an exchange for ``limit_s`` the device
        stops by itself. Nothing is done for a device that cannot monitor the control loop.

        Raises:
            ConfigurationError: The device did not store the time-out.
        """
        ...

    def unwatch(self) -> None:
        """End the monitoring of the control loop; only for a de-energised device."""
        ...

    def kept_alive(self, limit_s: float) -> AbstractContextManager[None]:
        """Return a context in which the signs of the control loop are sent to the device also while
        an answer is awaited, for ``limit_s`` at most.
        """
        ...

    def limit_wait(self, limit_s: float | None) -> None:
        """Wait at most ``limit_s`` for an answer outside the exchange, if the device stops by
        itself during a longer wait; None restores the time-out of the link. Nothing is sent.
        """
        ...


def read_identity(objects: ObjectAccess) -> Identity:
    """Read the identity of the device (1018h, 1008h, 1009h, 100Ah).

    CiA 301 prescribes the vendor (1018h:01h) only; all other texts that a device lacks are empty,
    and all other numbers 0.

    Raises:
        ObjectAccessError: The device refuses to read the vendor.
        LinkError: No answer.
    """
    return Identity(
        name=optional(objects.read_text, 0x1008, 0) or "",
        vendor_id=objects.read(*VENDOR),
        product_code=optional(objects.read, 0x1018, 2) or 0,
        revision=optional(objects.read, 0x1018, 3) or 0,
        serial_number=optional(objects.read, 0x1018, 4) or 0,
        hardware_version=optional(objects.read_text, 0x1009, 0) or "",
        software_version=optional(objects.read_text, 0x100A, 0) or "",
    )


def identity_problems(channel: ProcessChannel) -> Iterator[ConfigurationError]:
    """Yield an error for each number of the identity object (1018h) that differs from the EDS."""
    for address, what in ((VENDOR, "vendor"), (PRODUCT, "product")):
        stated = channel.stated(*address)
        found = optional(channel.read, *address) if stated else None
        if stated and found is not None and found != stated:
            yield ConfigurationError(
                f"{channel.label} reports the {what} {found:X}h, but its EDS file is for the "
                f"{what} {stated:X}h: the device or the EDS file is the wrong one; check node "
                "identifier and EDS file in the bench file"
            )


def access_problems(
    channel: ProcessChannel,
    outputs: Sequence[PdoLayout],
    inputs: Sequence[PdoLayout],
    watched: bool = False,
    others: Iterable[ObjectAddress] = (),
) -> Iterator[DeviceError]:
    """Yield an error for each object of the process data that cannot be mapped by the EDS; if there
    is none, an error for each object of a preparation that the device refuses to read.

    Raises:
        LinkError: No answer.
    """
    unmappable = list(problem_of(channel.require_mappable, outputs, inputs))
    yield from unmappable
    if unmappable:
        return
    for address in dict.fromkeys((*others, *channel.accessed(outputs, inputs, watched))):
        for error in problem_of(channel.read, *address):
            if not (isinstance(error, ObjectAccessError) and error.code == _WRITE_ONLY):
                yield error
    yield from channel.unguarded(watched)


def optional(read: Callable[[int, int], V], index: int, subindex: int) -> V | None:
    """Read an object that a device may lack; return None if the device or its EDS lacks the object.

    Raises:
        ObjectAccessError: The device refuses the read for another reason.
        ConfigurationError: The entry of the object in the EDS is faulty.
        LinkError: No answer.
    """
    try:
        return read(index, subindex)
    except NotDescribedError:
        return None
    except ObjectAccessError as refused:
        if refused.code in ABSENT:
            return None
        raise
