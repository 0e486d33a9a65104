"""Drives of common makes: which objects of the simulated drive their EDS files lack, and which
other objects they have, with their units.

A simulated drive of a make has only the objects of the make's EDS file. The lists follow
files of the makers, shortened to the objects that a servo uses; the lists of Nanotec, Copley and
Technosoft follow the manuals of these makers. These lists and the data on makes in
:mod:`drivers.canopen.device_data` are written independently of each other, so that a test can
compare them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Final

from canopen.objectdictionary import ObjectDictionary

from drivers.canopen.device_data import identity
from drivers.canopen.eds_file import addresses, read_eds
from drivers.canopen.sdo import ONE_AXIS, Axis
from drivers.mock.drive import DRIVE_EDS
from drivers.mock.traits import HM, PP, Shown, Traits

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
