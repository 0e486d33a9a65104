"""Interfaces by which a device profile accesses its device: objects by index, cyclic process data.

A profile is written against these protocols, so that one profile runs over every transport.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final, ParamSpec, Protocol, TypeVar

from drivers.errors import ConfigurationError, DeviceError, NotDescribedError, ObjectAccessError
from drivers.interfaces import Identity

ObjectAddress = tuple[int, int]
"""Index and subindex of an object."""
VENDOR: Final = (0x1018, 1)
"""Vendor of a device, the only part of its identity that CiA 301 prescribes."""
PRODUCT: Final = (0x1018, 2)
ABSENT: Final = (0x06020000, 0x06090011)
"""Abort codes of a device that lacks an object or a subindex."""
P = ParamSpec("P")
V = TypeVar("V")


def refusal(act: Callable[P, object], *args: P.args, **kwargs: P.kwargs) -> Iterator[DeviceError]:
    """Yield the error by which a device or its description refuses a request; yield nothing if the
    request is accepted.

    Raises:
        LinkError: The device cannot be reached; this is not a refusal.
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
        """Check that an object is described and can hold a value. Nothing is sent.

        Raises:
            ConfigurationError: The object is not described, or cannot hold the value.
        """
        ...


@dataclass(frozen=True)
class PdoLayout:
    """Objects that are exchanged together once a cycle.

    Attributes:
        number: PDO number, from 1.
        objects: Addresses in order.
        every: Period of the exchange in cycles.
        slack: Cycles that an input may be late and still count as fresh; the exchange does not wait
            for inputs with slack.
        mean: Object that is a mean over the cycle, which a transport without SYNC interpolates at
            the instant of the position, or None if there is none.
    """

    number: int
    objects: tuple[ObjectAddress, ...]
    every: int = 1
    slack: int = 0
    mean: ObjectAddress | None = None


class ProcessChannel(ObjectAccess, Protocol):
    """One device on a link: its objects, and its share of the cyclic exchange."""

    @property
    def label(self) -> str:
        """Name of the device in messages."""
        ...

    @property
    def latches(self) -> bool:
        """Whether all values of an exchange are of one instant, as after a SYNC; otherwise the
        values are read one after another, and reading a mean value ends its averaging period.
        """
        ...

    @property
    def cycle(self) -> int:
        """Number of exchanges so far."""
        ...

    @property
    def fresh(self) -> bool:
        """Whether all data due at the last exchange arrived complete."""
        ...

    @property
    def sync_us(self) -> int:
        """Host's time of the last exchange's sampling, microseconds modulo 2^32; this time replaces
        the time stamp of a device that has none.
        """
        ...

    def describes(self, index: int, subindex: int, mappable: bool = False) -> bool:
        """Return whether the device's description has an object, and, with ``mappable``, allows it
        in process data.

        An object whose description is faulty counts as contained, so that its use is refused with
        an error, but not as allowed in process data.

        Nothing is sent.
        """
        ...

    def fit_together(self, addresses: Sequence[ObjectAddress]) -> bool:
        """Return whether these objects can be exchanged in one layout; the result is True for
        unknown objects, which :meth:`require_mappable` refuses. Nothing is sent.
        """
        ...

    def stated(self, index: int, subindex: int) -> int | None:
        """Return the value that the description states for an object, or None if no value is
        stated.

        Sends nothing.
        """
        ...

    def require_watchable(self) -> None:
        """Check against the description that the device can monitor the control loop, unless the
        transport has another monitor. Nothing is sent.

        Raises:
            ConfigurationError: It cannot.
        """
        ...

    def insist(self, index: int, subindex: int, value: int) -> None:
        """Write an object that must be sent even if no answer can be received; the errors are those
        of :meth:`write`.

        The method is only for commands that take the power off, because the write may arrive more
        than once.
        """
        ...

    def require_mappable(self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout]) -> None:
        """Check against the device's description that process data can be mapped.

        Nothing is sent.

        Raises:
            ConfigurationError: An object is not described or is no integer, or too many travel
                together.
        """
        ...

    def map_process_data(
        self, outputs: Sequence[PdoLayout], inputs: Sequence[PdoLayout], cycle_s: float
    ) -> None:
        """Configure which values are exchanged and how often, and start the exchange. Energises
        nothing.

        Raises:
            ConfigurationError: The device lacks an object, or another device on the link has
                another cycle.
            ObjectAccessError: The device refuses the mapping.
            LinkError: No answer.
        """
        ...

    def stage(self, number: int, *values: int) -> None:
        """Set the values of output ``number`` from the next exchange on."""
        ...

    def stage_once(self, number: int, values: tuple[int, ...], then: tuple[int, ...]) -> None:
        """Set the values of output ``number`` for the next exchange, and the values for the
        exchanges after it unless others are staged.
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
        stops by itself.

        Raises:
            ConfigurationError: The device did not take it.
        """
        ...

    def unwatch(self) -> None:
        """End the monitoring of the control loop; only for a de-energised device."""
        ...


def read_identity(objects: ObjectAccess) -> Identity:
    """Read the identity of the device (1018h, 1008h, 1009h, 100Ah).

    CiA 301 prescribes only the vendor (1018h:01h); any other text that a device lacks is empty, and
    any other number is 0.

    Raises:
        ObjectAccessError: The device refuses to tell its vendor.
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


def identity_doubts(channel: ProcessChannel) -> Iterator[str]:
    """Yield the numbers of the identity object that differ from those that the description states.

    Raises:
        LinkError: No answer.
    """
    for address, what in ((VENDOR, "vendor"), (PRODUCT, "product")):
        stated = channel.stated(*address)
        found = optional(channel.read, *address) if stated else None
        if stated and found is not None and found != stated:
            yield (
                f"{channel.label} says {what} {found:X}h, its EDS file is for {what} "
                f"{stated:X}h: the device or the EDS file is a wrong one; check the node numbers "
                "and the file"
            )


def optional(read: Callable[[int, int], V], index: int, subindex: int) -> V | None:
    """Read an object that a device may lack; return None if the device or its EDS lacks the object.

    Raises:
        ObjectAccessError: The device refuses for another reason.
        ConfigurationError: Its EDS describes the object wrongly.
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
