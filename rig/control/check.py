"""Reads a bench without a write or a motion, and judges whether a run would start."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from rig.common.errors import Cause, Finding, InputError, refusals, verdict, warnings
from rig.common.provenance import sha256_file, utc_now, versions
from rig.common.tables import table
from rig.config.bench import Bench, calibration_records
from rig.config.configuration import Document
from rig.control.readings import Readings, reading_findings, take_readings
from rig.control.session import DEVICES, describe_devices
from rig.planning.plan import bench_limits, servo_limits
from rig.wiring.connect import device_files
from rig.wiring.devices import Devices, Watcher, watcher
from rig.wiring.off import BEFORE_PROMPT, HANDS_OFF
from rig.wiring.preflight import bench_findings, device_findings

SCHEMA = "loadrig.check/1"
STATED = "*"  # mark of a limit that is stated in the bench file and not read from the drive
_UNSET_RAD = 2000.0 * math.pi
"""Larger values of a drive are no limit: without a configured one, it reports the largest number.
"""


def require_connectable(document: Document[Bench]) -> list[Finding]:
    """Return the faults of a bench file that permit a connection; InputError for others."""
    found = bench_findings(document, utc_now().date())
    in_the_way = [finding.text for finding in found if not finding.connectable]
    if in_the_way:
        raise InputError(in_the_way)
    return found


def examine(
    document: Document[Bench], devices: Devices, seed: int, found: list[Finding]
) -> tuple[dict[str, Any], Readings]:
    """Return the record for ``--json`` of what can be read without motion or write, and the
    readings.

    Raises:
        DeviceError: A device does not answer.
    """
    bench = document.value
    described = describe_devices(devices)
    limits = bench_limits(bench)
    wanted = servo_limits(limits, bench)
    readings = take_readings(devices, bench.machine.gear_ratio)
    proof = devices.off_proof(limits).prove()
    if proof.state is None or (not proof.off and not proof.state.energised):
        found = [*found, Finding(Cause.OFF, f"{BEFORE_PROMPT}: {proof.doubt}; {HANDS_OFF}")]
    found = [
        *found,
        *device_findings(devices, wanted, bench.cycle_s),
        *reading_findings(readings, limits),
    ]
    watching, lacks = watcher(devices), devices.servo.lacks(bench.cycle_s)
    return {
        "schema": SCHEMA,
        "created": utc_now().isoformat(timespec="seconds"),
        "versions": versions(),
        "seed": seed,
        "inputs": [
            {"file": str(path), "sha256": sha256_file(path)}
            for path in (document.path, *device_files(document).values())
        ],
        "bench": bench.name,
        "bench_file": str(document.path),
        "real": not bench.simulated,
        "state": readings.state,
        "off": proof.record(),
        "readings": readings.record(),
        "good": not refusals(found),
        "verdict": verdict(found),
        "causes": list(dict.fromkeys(finding.cause.value for finding in found if finding.refused)),
        "problems": refusals(found),
        "warnings": warnings(found),
        "has_watchdog": devices.link.has_watchdog,
        "watched_by": watching.kind,
        "watch_s": watching.after_s,
        "not_held": sorted(lacks.limits),
        "calibrations": calibration_records(bench, utc_now().date()),
        **described,
        "limits_stated": sorted(set(described["limits"]) - devices.servo.limits_taken),
        "bench_limits": dataclasses.asdict(wanted),
    }, readings


def describe(found: dict[str, Any], readings: Readings, watching: Watcher) -> str:
    """Return the results of the check as text for the terminal."""
    lines = [_devices(found), "", table(["reading", "value", "unit"], readings.rows(), right=[1])]
    lines += [
        f"state of the drive: {readings.state}",
        f"watched by: {watching.words}",
        "",
        _limits(found),
        "",
    ]
    lines += [f"warning: {text}" for text in (*watching.warnings, *found["warnings"])]
    lines += [f"problem: {text}" for text in found["problems"]]
    lines.append(f"verdict: {found['verdict']}")
    return "\n".join(lines)


def _devices(found: dict[str, Any]) -> str:
    return table(
        ["device", "name", "vendor", "product", "revision", "serial", "hardware", "software"],
        [
            [
                role,
                who["name"],
                *(f"{who[key]:08X}h" for key in ("vendor_id", "product_code", "revision")),
                *(str(who[k]) for k in ("serial_number", "hardware_version", "software_version")),
            ]
            for role, who in ((role, found[role]) for role in DEVICES if role in found)
        ],
    )


def _limits(found: dict[str, Any]) -> str:
    held = found["limits"]
    note = ["* stated under servo.held, not read from the drive"] * bool(found["limits_stated"])
    rows = table(
        ["limit", "drive holds now", "bench file", "unit"],
        [
            [
                _title(name),
                "has none"
                if name in found["not_held"]
                else _show(name, held[name]) + STATED * (name in found["limits_stated"]),
                _show(name, allowed),
                _unit(name),
            ]
            for name, allowed in found["bench_limits"].items()
            if name != "quick_stop_option"
        ],
        right=[1, 2],
    )
    written = "a run writes the limits of the bench file before it enables the drive"
    return "\n".join([rows, *note, written])


def _angular(name: str) -> bool:
    return name.endswith(("_rad", "_rad_s", "_rad_s2"))


def _title(name: str) -> str:
    for ending in ("_rad_s2", "_rad_s", "_rad", "_N_m", "_A"):
        name = name.removesuffix(ending)
    return name.replace("_", " ")


def _unit(name: str) -> str:
    if _angular(name):
        return "deg" + ("/s^2" if name.endswith("_s2") else "/s" if name.endswith("_s") else "")
    return "N m" if name.endswith("_N_m") else "A"


def _show(name: str, value: float | None) -> str:
    if value is None:
        return "off"
    if _angular(name) and abs(value) > _UNSET_RAD:
        return "not set"
    return f"{math.degrees(value) if _angular(name) else value:.4g}"
