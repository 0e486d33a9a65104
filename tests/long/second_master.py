"""A second independent master drives the simulated drives of the makes: the npm package `canopen`.

python -m tests.long.second_master [MAKE ...]

Needs Node with npm; the package has a part that is compiled (g++). Frames pass as JSON lines, and
each takes a millisecond of simulated time. Enabling, motion, quick stop, disabling, a fault and its
reset are ordered by the master, and held against the power stage and the motion of the bench.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

from drivers.mock.bench import DRIVE_NODE, SimulatedBench, simulated_bench
from drivers.mock.makes import MAKES, described_drive, description
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.power_state import POWERED
from drivers.mock.traits import CSP

from ..drivers.host import read_eds

HERE = Path(__file__).parent
PACKAGE = "canopen@6.2.1"
CYCLE_NS = 1_000_000
ENABLED, QUICK_STOP, OFF, FAULT = 0x27, 0x07, 0x40, 0x08
SLOW_RAD_S = 1e-3


def drive(make: str, folder: Path) -> list[str]:
    """Let the master drive a make's simulated drive; returns what is not as it must be."""
    eds = folder / f"{make}.eds"
    eds.write_text(description(make))
    bench = simulated_bench(Machine(), 1, traits=described_drive(read_eds(eds, DRIVE_NODE)))
    cyclic = "1" if MAKES[make].modes & CSP else "0"
    words = ["node", "second_master.js", eds.name, str(DRIVE_NODE), cyclic]
    problems: list[str] = []
    found: Mapping[str, Any] = {}
    with subprocess.Popen(
        words, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as node:
        assert node.stdin is not None
        assert node.stdout is not None
        for line in node.stdout:
            row = json.loads(line)
            if "id" in row:
                _pass_on(bench, row, node.stdin)
            elif "mark" in row:
                problems += _wrong(row["mark"], bench)
                _answer({"done": True}, node.stdin)
            else:
                found = row.get("found", {})
                problems += [row["error"]] if "error" in row else []
    bench.bus.shutdown()
    return problems + list(_unlike(make, found))


def _pass_on(bench: SimulatedBench, row: Mapping[str, Any], to: IO[str]) -> None:
    """Put a frame of the master on the bus, and give it what arrives within a millisecond."""
    bench.bus.transmit(row["id"], bytes.fromhex(row["data"]))
    bench.clock.sleep_until_ns(bench.clock.now_ns() + CYCLE_NS)
    for _, identifier, data, _ in bench.bus.collect(0.0):
        if identifier != row["id"]:
            _answer({"id": identifier, "data": bytes(data).hex()}, to)


def _answer(row: Mapping[str, Any], to: IO[str]) -> None:
    to.write(json.dumps(row) + "\n")
    to.flush()


def _wrong(mark: str, bench: SimulatedBench) -> Iterator[str]:
    """Yield what the bench shows otherwise than the master has ordered."""
    powered = bench.drive.power_state in POWERED
    if mark == "enabled" and not powered:
        yield "the drive is not energised"
    if mark in ("disabled", "failed") and powered:
        yield f"{mark}: the drive is energised"
    if mark == "stopped" and abs(bench.machine.truth().velocity_rad_s) > SLOW_RAD_S:
        yield "the joint moves after the quick stop"
    if mark == "fail":
        if not powered:
            yield "the drive was not enabled again"
        bench.drive.fail(0x7320)


def _unlike(make: str, found: Mapping[str, Any]) -> Iterator[str]:
    """Yield what the master read otherwise than it must."""
    expected: dict[str, Any] = {
        "vendor": MAKES[make].vendor_id,
        "enabled": ENABLED,
        "failed": FAULT,
        "reset": OFF,
    }
    for name, value in expected.items():
        if found.get(name) != value:
            yield f"{name}: the master read {found.get(name)}, must be {value}"
    if not 800 <= found.get("moved", 0) <= 1200:
        yield f"moved by {found.get('moved')} counts, must be 1000"
    # Which follows is the option 605Ah of the make.
    if found.get("stopped") not in (OFF, OFF | 0x20, QUICK_STOP):
        yield f"after the quick stop the statusword is {found.get('stopped')}"
    if "object" not in str(found.get("refused", "")).lower():
        yield f"an unknown object is refused with {found.get('refused')!r}"


def main() -> int:
    """Install the master and let it drive all makes, or those named; 1 where one is not driven."""
    makes = sys.argv[1:] or list(MAKES)
    wrong = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run(["npm", "install", "--silent", PACKAGE], cwd=folder, check=True)
        subprocess.run(["npm", "rebuild", "--silent", "node-crc"], cwd=folder, check=True)
        shutil.copy(HERE / "second_master.js", folder)
        for make in makes:
            problems = drive(make, folder)
            print(f"{make}: {'; '.join(problems) or 'driven'}", flush=True)
            wrong += bool(problems)
    print(f"{len(makes) - wrong} of {len(makes)} driven by the npm package {PACKAGE}")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
