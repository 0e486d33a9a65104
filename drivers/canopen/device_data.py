"""Known data of drives of certain makers, in ``devices/*.yaml``, matched by the identity of a
drive.

A file states the objects and units of a family of drives that differ from CiA 402, as far as the
maker publishes them. Values in the bench file have priority over these data.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Final, Literal, Self

import yaml
from canopen.objectdictionary import ObjectDictionary
from pydantic import BaseModel, ConfigDict, Field, model_validator

from drivers.canopen.motion import ModeName
from drivers.canopen.sdo import described
from drivers.objects import VENDOR

FOLDER: Final = Path(__file__).with_name("devices")
PRODUCT: Final = (0x1018, 2)
SIMULATED: Final = "loadrig_simulated"  # name of the data of the simulated drive

_Index = Annotated[int, Field(ge=0, le=0xFFFF)]
_Subindex = Annotated[int, Field(ge=0, le=0xFF)]
_U32 = Annotated[int, Field(ge=0, le=0xFFFFFFFF)]
_Unit = Annotated[float, Field(gt=0)]
Address = tuple[_Index, _Subindex]
VelocityUnit = Literal["counts_per_s", "rpm"]


class DeviceData(BaseModel):
    """Data of a family of drives. An empty field means that the drive uses the value of CiA 402, or
    that the value is unknown.

    Attributes:
        name: Maker and family.
        source: Documents of the maker in which these data are stated.
        vendor_id: Vendor of the drives, 1018h:01h; empty for data that only the bench file selects.
        product_codes: Product codes of the drives, 1018h:02h; empty if the vendor and ``has``
            identify the family.
        has: Objects by which the family is distinguished from other families of the vendor.
        velocity_unit: Name of the unit of 606Ch and 607Fh; accelerations have this unit per second.
        velocity_unit_counts_per_s: Unit of 606Ch and 607Fh if it has no name, counts/s.
        acceleration_unit_counts_per_s2: Unit of the accelerations (6083h, 6084h, 6085h, 609Ah) if
            it is not the unit of the speed per second, counts/s^2.
        acceleration_unit_turns_per_s2: Unit of the accelerations, in motor turns per second
            squared.
        current_object: Object of the motor current.
        current_unit_A: Unit of this object, A.
        supply_object: Object of the supply voltage.
        supply_unit_V: Unit of this object, V.
        temperature_object: Object of the temperature.
        temperature_unit_C: Unit of this object, deg C.
        voltage_object: Object of the motor voltage.
        voltage_unit_V: Unit of this object, V.
        rated_current_object: Object of the rated current.
        rated_current_object_unit_A: Unit of this object, or of 6075h, A.
        rated_torque_object: Object of the rated torque.
        rated_torque_object_unit_N_m: Unit of this object, or of 6076h, N m.
        mode: Mode of operation in which the drive is commanded, or None for cyclic synchronous
            position.
        unlike: Objects of CiA 402 that have another meaning in these drives, and are not used.
        remarks: Sentences with what the operator must know of these drives.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: str
    source: str
    vendor_id: _U32 | None = None
    product_codes: tuple[_U32, ...] = ()
    has: tuple[Address, ...] = ()
    velocity_unit: VelocityUnit | None = None
    velocity_unit_counts_per_s: _Unit | None = None
    acceleration_unit_counts_per_s2: _Unit | None = None
    acceleration_unit_turns_per_s2: _Unit | None = None
    current_object: Address | None = None
    current_unit_A: _Unit | None = None
    supply_object: Address | None = None
    supply_unit_V: _Unit | None = None
    temperature_object: Address | None = None
    temperature_unit_C: _Unit | None = None
    voltage_object: Address | None = None
    voltage_unit_V: _Unit | None = None
    rated_current_object: Address | None = None
    rated_current_object_unit_A: _Unit | None = None
    rated_torque_object: Address | None = None
    rated_torque_object_unit_N_m: _Unit | None = None
    mode: ModeName | None = None
    unlike: tuple[Address, ...] = ()
    remarks: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _stated_once(self) -> Self:
        if self.velocity_unit is not None and self.velocity_unit_counts_per_s is not None:
            raise ValueError(
                "velocity_unit and velocity_unit_counts_per_s are both set; remove one"
            )
        acceleration = (self.acceleration_unit_counts_per_s2, self.acceleration_unit_turns_per_s2)
        if None not in acceleration:
            raise ValueError(
                "acceleration_unit_counts_per_s2 and acceleration_unit_turns_per_s2 are both set; "
                "remove one"
            )
        for kind in ("current_unit_A", "supply_unit_V", "temperature_unit_C", "voltage_unit_V"):
            of = f"{kind.rsplit('_', 2)[0]}_object"
            if (getattr(self, kind) is None) is not (getattr(self, of) is None):
                raise ValueError(f"{kind} is the unit of {of}: state both keys or neither")
        return self

    @property
    def words(self) -> str:
        """Return the stated units and objects as text for the operator."""
        stated = self.model_dump(
            exclude={"name", "source", "vendor_id", "product_codes", "has", "remarks"},
            exclude_defaults=True,
        )
        shown = (f"{field} {_shown(value)}" for field, value in stated.items())
        return ", ".join(shown) or "nothing that differs from CiA 402"

    def fits(self, vendor_id: int, product_code: int | None, dictionary: ObjectDictionary) -> bool:
        """Return whether these data apply to a device with this identity and these objects."""
        return (
            vendor_id == self.vendor_id
            and (not self.product_codes or product_code in self.product_codes)
            and all(described(dictionary, *address, mappable=False) for address in self.has)
        )


def _shown(value: object) -> str:
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return " ".join(map(_shown, value))
    if isinstance(value, tuple):
        index, subindex = value
        return f"{index:04X}h:{subindex:02X}h"
    return f"{value:g}" if isinstance(value, float) else f"{value}"


def parse(text: str) -> DeviceData:
    """Return the data of one file.

    Raises:
        ValueError: The file is no valid YAML, or has a key or value that is not allowed.
    """
    try:
        return DeviceData.model_validate(yaml.safe_load(text))
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error


@lru_cache(maxsize=1)
def devices() -> Mapping[str, DeviceData]:
    """Return all packaged data: file name without extension to its data."""
    return {
        path.stem: parse(path.read_text(encoding="utf-8")) for path in sorted(FOLDER.glob("*.yaml"))
    }


def identity(dictionary: ObjectDictionary) -> tuple[int | None, int | None]:
    """Return vendor and product code in an EDS; None for a number that it does not state."""
    found = (dictionary.get_variable(*address) for address in (VENDOR, PRODUCT))
    vendor, product = (
        item.default if item is not None and isinstance(item.default, int) else None
        for item in found
    )
    stated = getattr(dictionary, "identity", (None, None))
    return vendor or stated[0], product or stated[1]


def match(dictionary: ObjectDictionary) -> DeviceData | None:
    """Return the data of the drive that an EDS describes, or None if there are no such data."""
    vendor, product = identity(dictionary)
    if vendor is None:
        return None
    for data in devices().values():
        if data.fits(vendor, product, dictionary):
            return data
    return None
