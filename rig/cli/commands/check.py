"""``rig check``: connects to a bench and reads its values back."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import options as shared
from rig.cli.entry import BAD_VERDICT, DEVICE_FAILED, DONE
from rig.common.errors import Cause
from rig.common.places import require_file, write_asked
from rig.config.bench import load_bench
from rig.control.check import describe, examine, require_connectable
from rig.wiring.connect import connect
from rig.wiring.devices import bench_line, say_taken_over, watcher


@click.command("check")
@click.argument("bench")
@shared.simulated_seed
@shared.record_file("Also write the findings to this file.")
def command(bench: str, seed: int, json_file: Path | None) -> int:
    """Connect to BENCH, and read identities, live values, state and limits.

    Nothing moves, nothing is energised, and no value is written to a device.

    The exit status is 1 if `rig run` would refuse to start on this bench; the reasons are printed:
    a limit looser than the drive's own limit, units that differ between file and device, an overdue
    calibration, implausible constants, a drive that is energised or in fault, or a reading beyond
    its limit. If the drive reports off, but current flows or the joint moves, the exit status is 4.
    If the connection to the bench fails, the exit status is 2 or 4.

    \b
    Example:
      rig check practical
    """
    require_file(json_file, "--json")
    document = load_bench(bench)
    click.echo(bench_line(document))
    found = require_connectable(document)
    with connect(document, seed, realtime=False, purpose="rig check") as devices:
        say_taken_over(devices.lock)
        findings, readings = examine(document, devices, seed, found)
        watching = watcher(devices)
    click.echo(describe(findings, readings, watching))
    write_asked(json_file, findings)
    if Cause.OFF.value in findings["causes"]:
        return DEVICE_FAILED
    return DONE if findings["good"] else BAD_VERDICT
