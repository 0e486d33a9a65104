"""Differences between simulated CiA 402 drives: identity, units, additional objects, modes; and
those of drives of common makes.

A simulated drive of a make has only the objects of the make's EDS file. The lists follow
files of the makers, shortened to the objects that a servo uses; the lists of Nanotec, Copley and
Technosoft follow the manuals of these makers. These lists and the data on makes in
:mod:`drivers.canopen.device_data` are written independently of each other, so that a test can
compare them.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Final, Literal

from canopen.objectdictionary import ObjectDictionary

from drivers.canopen.device_data import identity
from drivers.canopen.eds_file import addresses, read_eds
from drivers.canopen.sdo import ONE_AXIS, Axis
from drivers.mock.canopen.dictionary import DeviceDictionary, Entry, key
from drivers.mock.plant.machine import Reading

DRIVE_EDS: Final = Path(__file__).with_name("drive.eds")
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


_OWN: Final = frozenset({0x2100, 0x2101, 0x60E3})
"""Objects that no drive of a make has unless stated."""
MAKES: Final[Mapping[str, Traits]] = {
    "EPOS4": Traits(
        0xFB,
        0x65510000,
        _OWN | {0x1009, 0x100A, 0x1013, 0x6072, 0x6073, 0x6075, 0x6078, 0x6079, 0x607C, 0x60C2},
        (
            Shown((0x30D1, 2), "i", "current_A", 1e-3),
            Shown((0x3001, 1), "I", None, 1e-3),
            Shown((0x2200, 1), "H", "supply_V", 0.1, mappable=False),
            Shown((0x3201, 1), "h", "temperature_C", 0.1, mappable=False),
        ),
        rpm=True,
        rated_torque_unit_N_m=1e-6,
    ),
    "EPOS2": Traits(
        0xFB,
        0x62200000,
        _OWN | {0x1009, 0x100A, 0x603F, 0x605A, 0x6072, 0x6073, 0x6075, 0x6076, 0x6079},
        (
            Shown((0x2027, 0), "h", "current_A", 1e-3),
            Shown((0x6078, 0), "h", "current_A", 1e-3),
            Shown((0x6410, 1), "H", None, 1e-3),
        ),
        rpm=True,
        modes=PP | HM,
    ),
    "Elmo": Traits(
        0x9A, 0x30923, _OWN | {0x1013, 0x6079}, (Shown((0x22A2, 0), "H", "temperature_C", 1.0),)
    ),
    "Trinamic": Traits(
        0x286,
        0x1270,
        _OWN | {0x1013, 0x6007, 0x603F, 0x6073, 0x6075, 0x6076, 0x6078, 0x6079, 0x607F},
    ),
    "Faulhaber": Traits(
        0x147,
        0x30,
        _OWN
        | {0x1013, 0x6007, 0x603F, 0x605A, 0x6065, 0x6072, 0x6073, 0x6075, 0x6076}
        | {0x6078, 0x6079, 0x60C2},
        rpm=True,
        acceleration_turns_s2=1.0,
    ),
    "Schunk": Traits(
        0,
        0,
        _OWN | {0x1013, 0x6007, 0x603F, 0x605A, 0x6072, 0x6076, 0x6078, 0x6079, 0x607F, 0x6085},
    ),
    "Nanotec": Traits(
        0x26C,
        0x44,
        _OWN | {0x1013, 0x6073, 0x6075, 0x6076, 0x6078, 0x6079},
        (
            Shown((0x203B, 1), "I", None, 1e-3),
            Shown((0x4014, 1), "i", "supply_V", 1e-3),
            Shown((0x4014, 3), "i", "temperature_C", 0.1),
        ),
        rpm=True,
    ),
    "Copley": Traits(
        0xAB,
        0x3300,
        _OWN | {0x6073, 0x6078, 0x6079},
        (Shown((0x2201, 0), "h", "supply_V", 0.1), Shown((0x2202, 0), "h", "temperature_C", 1.0)),
        speed_counts_per_s=0.1,
        acceleration_counts_s2=10.0,
    ),
    "Technosoft": Traits(
        0x1A3,
        0x1AB46E5,
        _OWN | {0x1013, 0x6073, 0x6075, 0x6076, 0x6078, 0x6079},
        speed_counts_per_s=1000.0 / 65536.0,
        acceleration_counts_s2=1000.0**2 / 65536.0,
    ),
}
"""Make to the differences of its drives from the simulated drive."""
_ERROR_CONTROL: Final = ((0x100C, 0), (0x100D, 0), (0x1017, 0), (0x1029, 1))
"""Objects whose value after power-on a simulated drive takes from its EDS."""


def described_drive(dictionary: ObjectDictionary, axis: Axis = ONE_AXIS) -> Traits:
    """Return the kind of simulated drive for an EDS: the make follows from vendor and objects in
    the EDS, and the drive has only the objects of the EDS, and its values of NMT error control.
    """
    vendor, product = identity(dictionary)
    usual, described = _usual(), addresses(dictionary)
    single = {(index, sub) for index, sub in usual if sub or (index, 1) not in usual}
    at = {own: axis.at(dictionary, *own) if own in single else own for own in usual | described}
    shown = frozenset(own for own, on_bus in at.items() if on_bus in described)
    places = {on_bus: own for own, on_bus in at.items() if own in usual and on_bus != own}
    found = [
        make
        for make in MAKES.values()
        if make.vendor_id == vendor and all(own.address in shown for own in make.own)
    ]
    traits = max(found, key=lambda make: len(make.own), default=Traits())
    stated = {
        address: variable.default
        for address in _ERROR_CONTROL
        if address in shown
        and (variable := dictionary.get_variable(*address)) is not None
        and isinstance(variable.default, int)
    }
    code = product or traits.product_code
    return replace(
        traits,
        product_code=code,
        shown=shown,
        defaults=stated,
        places=places,
        status_share=axis.share(dictionary, 0x6041, 0),
    )


@lru_cache(maxsize=1)
def _usual() -> frozenset[tuple[int, int]]:
    return addresses(read_eds(DRIVE_EDS, 1))
