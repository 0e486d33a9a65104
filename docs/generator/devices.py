"""Page of what is known of makers' drives (CiA 402)."""

from __future__ import annotations

from keys import table

from drivers.canopen.device_data import SIMULATED, DeviceData, devices

_INTRO = """\
# Makers' drives

Facts on drives where they differ from CiA 402, as far as their makers publish them. The facts are
in `drivers/canopen/devices/*.yaml`. The data apply to a drive whose EDS file states the vendor
(1018h:01h) and, where a vendor has several families, the objects of the third column. Keys under
`servo` in the bench file have priority; `servo.device: none` switches the data off, and a name of
the first column selects the data of another drive.

The program uses an object only if the EDS file has it, and uses it in the cycle only if it can be
process data. `rig check` states which facts are used, which values are not monitored, and which
limits only the program holds. No drive of these makers has been on a bench of this program: compare
everything with the drive's manual before the first run."""


def _objects(data: DeviceData) -> str:
    found = []
    for kind, unit in (
        ("current", data.current_unit_A),
        ("supply", data.supply_unit_V),
        ("temperature", data.temperature_unit_C),
        ("rated_current", data.rated_current_object_unit_A),
        ("rated_torque", data.rated_torque_object_unit_N_m),
    ):
        address = getattr(data, f"{kind}_object")
        if unit is None:
            continue
        at = f" {address[0]:04X}h:{address[1]:02X}h" if address else ""
        symbol = {"current": "A", "supply": "V", "temperature": "deg C"}.get(kind, "")
        symbol = symbol or ("A" if kind == "rated_current" else "N m")
        found.append(f"{kind.replace('_', ' ')}{at} in {unit:g} {symbol}")
    return "; ".join(found)


def _speed(data: DeviceData) -> str:
    if data.velocity_unit_counts_per_s is not None:
        return f"{data.velocity_unit_counts_per_s:g} counts/s"
    return {"rpm": "rpm", "counts_per_s": "counts/s"}.get(data.velocity_unit or "", "")


def _acceleration(data: DeviceData) -> str:
    if data.acceleration_unit_counts_per_s2 is not None:
        return f"{data.acceleration_unit_counts_per_s2:g} counts/s^2"
    if data.acceleration_unit_turns_per_s2 is not None:
        return f"{data.acceleration_unit_turns_per_s2:g} turns/s^2"
    return f"{_speed(data)}/s".replace("/s/s", "/s^2") if _speed(data) else ""


def page() -> str:
    """Return the page."""
    rows = [
        (
            f"`{name}`",
            data.name,
            ("`servo.device`" if data.vendor_id is None else f"{data.vendor_id:X}h")
            + "".join(f", {index:04X}h:{sub:02X}h" for index, sub in data.has),
            _speed(data),
            _acceleration(data),
            _objects(data),
            data.source,
        )
        for name, data in devices().items()
        if name != SIMULATED
    ]
    head = (
        "`servo.device`",
        "drives",
        "recognised by",
        "speeds in",
        "accelerations in",
        "objects",
        "source",
    )
    remarks = [
        f"- {data.name}: {remark}." for data in devices().values() for remark in data.remarks
    ]
    return f"{_INTRO}\n\n{table(head, rows)}\n\n" + "\n".join(remarks) + "\n"
