"""Differences between simulated CiA 402 drives: identity, units, additional objects, modes."""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from drivers.mock.canopen.dictionary import DeviceDictionary, Entry, key
from drivers.mock.plant.machine import Reading

Quantity = Literal["current_A", "supply_V", "temperature_C"]
"""Field of a reading that an object contains."""
PP, HM, CSP, CSV, CST = 1 << 0, 1 << 5, 1 << 7, 1 << 8, 1 << 9
"""Bits of 6502h: modes that a drive offers."""


@dataclass(frozen=True)
class Shown:
    """An object that a drive has in addition to those of CiA 402, or with another unit."""

    address: tuple[int, int]  # index and subindex
    code: str  # struct code of the type of the object
    quantity: Quantity | None  # quantity that the object contains, or None for the rated current
    unit: float  # unit of the value of the object
    mappable: bool = True  # whether the object can be process data


@dataclass(frozen=True)
class Traits:
    """Properties of one kind of simulated drive."""

    vendor_id: int = 0x7FF  # vendor, 1018h:01h
    product_code: int = 0x402  # product code, 1018h:02h
    # Indices of the objects of the usual simulated drive that this drive lacks.
    lacks: frozenset[int] = frozenset()
    own: tuple[Shown, ...] = ()  # additional objects
    rpm: bool = False  # whether speeds are in revolutions per minute
    speed_counts_per_s: float = 1.0  # unit of speeds unless `rpm`, counts/s
    # Unit of accelerations if it is not the unit of speeds per second, counts/s^2.
    acceleration_counts_s2: float | None = None
    # Unit of accelerations, in motor turns per second squared.
    acceleration_turns_s2: float | None = None
    rated_torque_unit_N_m: float = 1e-3  # unit of the rated torque 6076h, N m
    modes: int = PP | HM | CSP | CSV | CST  # modes of operation, the value of 6502h
    # Addresses of the objects that can be accessed over the bus, or None for all objects.
    shown: Container[tuple[int, int]] | None = None
    # Values after power-on that differ from those of the usual simulated drive, by index and
    # subindex.
    defaults: Mapping[tuple[int, int], int] = field(default_factory=dict)
    remote_frames: bool = True  # whether the drive answers guard requests, which are remote frames
    # Index and subindex on the bus of each object of a second axis, or of an object with a member
    # for each axis, to those of the usual simulated drive.
    places: Mapping[tuple[int, int], tuple[int, int]] = field(default_factory=dict)
    # Number, from 0, of those 16 bits of a statusword of 32 bits that belong to this axis, or None
    # for a statusword of 16 bits.
    status_share: int | None = None

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
    """The objects of :class:`Traits` in a dictionary."""

    traits: Traits
    # Key, quantity and unit of each object with a measured value.
    measured: list[tuple[int, Quantity, float]] = field(default_factory=list)

    def add_to(self, objects: DeviceDictionary) -> None:
        """Add the drive's own objects to its dictionary, and remove those it lacks."""
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
        objects.places = {key(*on_bus): key(*own) for on_bus, own in self.traits.places.items()}
        if self.traits.status_share is not None:
            status = objects.entries[key(0x6041)]
            objects.entries[key(0x6041)] = replace(status, code="I")

    def restore(self, values: dict[int, int], rated_current_A: float) -> None:
        """Set the values that do not change."""
        values[key(0x1018, 1)] = self.traits.vendor_id
        values[key(0x1018, 2)] = self.traits.product_code
        values[key(0x6502)] = self.traits.modes
        values.update((key(*address), value) for address, value in self.traits.defaults.items())
        for shown in self.traits.own:
            if shown.quantity is None:
                values[key(*shown.address)] = round(rated_current_A / shown.unit)

    def measure(self, values: dict[int, int], reading: Reading, current_sign: int) -> None:
        """Set the drive's own measured objects; currents have the drive's own sign."""
        for number, quantity, unit in self.measured:
            sign = current_sign if quantity == "current_A" else 1
            values[number] = sign * round(getattr(reading, quantity) / unit)
