"""``rig check``: connect to a bench and read it back."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import click

from drivers.interfaces import ServoLimits
from rig.bench import Bench, load_bench
from rig.calibration import calibration_records, overdue
from rig.cli import BAD_VERDICT, DONE
from rig.configuration import Document
from rig.connect import connect, device_files
from rig.cycle import Devices
from rig.drive_limits import loosened, show
from rig.ownership import say_taken_over
from rig.places import require_file, write_asked
from rig.plan import bench_limits, servo_limits
from rig.provenance import sha256_file, utc_now, versions
from rig.serial_bus import NO_WATCHDOG
from rig.session import DEVICES, describe_devices
from rig.tables import table

SCHEMA = "loadrig.check/1"
_UNSET_RAD = 2000.0 * math.pi
"""A drive in which nothing was set holds the ends of its range; a thousand joint turns (a second) are no limit."""


@click.command("check")
@click.argument("bench")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the mock bench's noise.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Also write the findings to this file.")
def command(bench: str, seed: int, json_file: Path | None) -> int:
    """Connect to BENCH, read identities, state and limits back. Nothing moves and nothing is energised.

    The bench file's limits are held against the drive's own, which a run would refuse to loosen. Exits with 1 when
    they are looser, a calibration is overdue, or the drive is energised or in fault: then something else controls it,
    or a cause must be removed.

    \b
    Example:
      rig check practical
    """
    require_file(json_file, "--json")
    document = load_bench(bench)
    with connect(document, seed, realtime=False, purpose="rig check") as devices:
        say_taken_over(devices.lock)
        findings = examine(document, devices, seed)
    click.echo(describe(findings))
    write_asked(json_file, findings)
    return DONE if findings["good"] else BAD_VERDICT


def examine(document: Document[Bench], devices: Devices, seed: int) -> dict[str, Any]:
    """Read everything that can be read without moving or changing anything.

    Raises:
        DeviceError: A device does not answer.
    """
    state = devices.servo.state()
    described = describe_devices(devices)
    wanted = servo_limits(bench_limits(document.value), document.value)
    calibrations = calibration_records(document.value, utc_now().date())
    problems = overdue(calibrations) + [
        f"{row.name} ({row.objects}): the bench file's {show(row.field, row.first)} is looser than the drive's own "
        f"{show(row.field, row.second)}; a run would refuse"
        for row in loosened(wanted, ServoLimits(**described["limits"]))
    ]
    if state.energised or "fault" in state.value:
        problems.append(f"the drive is in state '{state.value}'")
    return {
        "schema": SCHEMA,
        "created": utc_now().isoformat(timespec="seconds"),
        "versions": versions(),
        "seed": seed,
        "inputs": [
            {"file": str(path), "sha256": sha256_file(path)}
            for path in (document.path, *device_files(document).values())
        ],
        "bench": document.value.name,
        "state": state.value,
        "good": not problems,
        "problems": problems,
        "has_watchdog": devices.link.has_watchdog,
        "calibrations": calibrations,
        **described,
        "bench_limits": dataclasses.asdict(wanted),
    }


def describe(findings: dict[str, Any]) -> str:
    """Return the findings as tables."""
    devices = table(
        ["device", "name", "vendor", "product", "revision", "serial", "hardware", "software"],
        [
            [
                role,
                who["name"],
                f"{who['vendor_id']:08X}h",
                f"{who['product_code']:08X}h",
                f"{who['revision']:08X}h",
                str(who["serial_number"]),
                who["hardware_version"],
                who["software_version"],
            ]
            for role, who in ((role, findings[role]) for role in DEVICES if role in findings)
        ],
    )
    held = findings["limits"]
    limits = table(
        ["limit", "drive holds now", "bench file", "unit"],
        [
            [_title(name), _show(name, held[name]), _show(name, allowed), _unit(name)]
            for name, allowed in findings["bench_limits"].items()
            if name != "quick_stop_option"
        ],
        right=[1, 2],
    )
    verdict = "good" if findings["good"] else "NOT good: remove the cause before a run"
    state = f"state: {findings['state']} ({verdict}); a run writes the bench's limits into the drive, and its own back"
    watch = "" if findings["has_watchdog"] else f"\n{NO_WATCHDOG}"
    problems = "".join(f"\nproblem: {problem}" for problem in findings["problems"])
    return f"{devices}\n\n{limits}\n\n{state}{watch}{problems}"


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
