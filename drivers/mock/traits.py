"""Lists the differences between simulated CiA 402 drives: identity, units, objects of their own,
modes.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import dataclass, field

from drivers.mock.canopen.dictionary import DeviceDictionary, Entry, key
from drivers.mock.plant.machine import Reading

Quantity = Callable[[Reading], float]
"""What an object shows, in SI units or deg C."""
PP, HM, CSP, CSV, CST = 1 << 0, 1 << 5, 1 << 7, 1 << 8, 1 << 9
"""Bits of 6502h: modes that a drive offers."""


def current_A(reading: Reading) -> float:
    """Return the motor current."""
    return reading.current_A


def supply_V(reading: Reading) -> float:
    """Return the supply voltage."""
    return reading.supply_V


def temperature_C(reading: Reading) -> float:
    """Return the temperature."""
    return reading.temperature_C


@dataclass(frozen=True)
class Shown:
    """An object that a drive has in addition to those of CiA 402, or with another unit.

    Attributes:
        address: Index and subindex.
        code: Struct code of its type.
        quantity: What it shows, or None for the rated current.
        unit: Unit of its value.
        mappable: Whether it can be process data.
    """

    address: tuple[int, int]
    code: str
    quantity: Quantity | None
    unit: float
    mappable: bool = True


@dataclass(frozen=True)
class Traits:
    """One kind of drive.

    Attributes:
        vendor_id: 1018h:01h.
        product_code: 1018h:02h.
        lacks: Indices that it lacks of those of the simulated drive.
        own: Objects that it has besides.
        rpm: Whether its speeds are in revolutions per minute.
        speed_counts_per_s: Unit of its speeds otherwise.
        acceleration_counts_s2: Unit of its accelerations, where it is not one of its speeds per
            second.
        acceleration_turns_s2: The same, in motor turns.
        rated_torque_unit_N_m: Unit of 6076h.
        modes: 6502h.
        shown: Addresses of the objects that it shows to its bus, or None for all.
    """

    vendor_id: int = 0x7FF
    product_code: int = 0x402
    lacks: frozenset[int] = frozenset()
    own: tuple[Shown, ...] = ()
    rpm: bool = False
    speed_counts_per_s: float = 1.0
    acceleration_counts_s2: float | None = None
    acceleration_turns_s2: float | None = None
    rated_torque_unit_N_m: float = 1e-3
    modes: int = PP | HM | CSP | CSV | CST
    shown: Container[tuple[int, int]] | None = None

    def speed_unit(self, counts_per_turn: float) -> float:
        """Return the unit of the drive's speeds, counts per second."""
        return counts_per_turn / 60.0 if self.rpm else self.speed_counts_per_s

    def acceleration_unit(self, counts_per_turn: float) -> float:
        """Return the unit of the drive's accelerations, counts per second squared."""
        if self.acceleration_turns_s2 is not None:
            return counts_per_turn * self.acceleration_turns_s2
        return self.acceleration_counts_s2 or self.speed_unit(counts_per_turn)


@dataclass
class OwnObjects:
    """The objects of :class:`Traits` in a dictionary.

    Attributes:
        measured: Key, quantity and unit of what is measured.
    """

    traits: Traits
    measured: list[tuple[int, Quantity, float]] = field(default_factory=list)

    def add_to(self, objects: DeviceDictionary) -> None:
        """Add the drive's own objects to its dictionary, and remove the objects that the drive does
        not have.
        """
        for shown in self.traits.own:
            number = key(*shown.address)
            known = objects.entries.get(number)
            if known is None:
                objects.entries[number] = Entry(
                    shown.code, True, False, shown.mappable, None, None, 0
                )
            objects.values[number] = 0
            if shown.quantity is not None:
                self.measured.append((number, shown.quantity, shown.unit))
        if self.traits.shown is not None:
            objects.remove_except(self.traits.shown)

    def restore(self, values: dict[int, int], rated_current_A: float) -> None:
        """Set what never changes."""
        values[key(0x1018, 1)] = self.traits.vendor_id
        values[key(0x1018, 2)] = self.traits.product_code
        values[key(0x6502)] = self.traits.modes
        for shown in self.traits.own:
            if shown.quantity is None:
                values[key(*shown.address)] = round(rated_current_A / shown.unit)

    def measure(self, values: dict[int, int], reading: Reading, current_sign: int) -> None:
        """Set the measured values in the drive's own objects; currents have the drive's own
        sign.
        """
        for number, quantity, unit in self.measured:
            sign = current_sign if quantity is current_A else 1
            values[number] = sign * round(quantity(reading) / unit)
