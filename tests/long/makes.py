"""Drives of common makes on the practical bench: the Figure 10 sequence, and every fault.

python -m tests.long.makes figure10 [MAKE|MAKE:serial|MODE ...]  the nine parameters of each
python -m tests.long.makes faults [--some] [MAKE|MODE ...]  every fault, or some, in every phase
python -m tests.long.makes homing [MAKE|MAKE:serial ...]  every fault while the drive homes

Each make is simulated with the objects and units of its maker; csv, cst and pp are the simulated
drive in these modes. Over the serial line of the EPOS4 run the objects of three makes; only maxon's
drives speak that protocol.
"""

import json
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivers.mock.traits import MAKES
from rig.common.tables import number, table
from rig.config.bench import load_bench
from rig.config.configuration import names, resolve
from rig.control.cycle import Cycle
from rig.runs.recorded_inputs import true_parameters
from tests.drivers.makes import description

from . import fault_matrix
from .console import rig
from .fault_cases import PHASES, STATES, Transport
from .fault_cases_homing import BUS_ONLY, HOST, HomingCase
from .fault_cases_homing import CASES as HOMING
from .fault_cases_homing import run as home
from .fault_cases_makes import MODES, cases

BASELINES = ("practical", "practical_serial")
"""The simulated drive on CAN and on a serial line, which the others are held against."""
OWN_FRAMES = ("odrive_can", "mit_mini")
"""Packaged benches of drives with frames of their own."""
SERIAL = ("EPOS4:serial", "Elmo:serial", "Trinamic:serial")
HOMES = tuple(make for make, traits in MAKES.items() if 0x607C not in traits.lacks)
"""Makes with a home offset; the others are refused a homing."""
HOMES_SERIAL = ("Elmo:serial", "Trinamic:serial")
SOME = (
    "one frame lost",
    "the drive's frames lost, 40 of them",
    "cable pulled",
    "target with a bit wrong",
    "host's heartbeat lost",
    "EMCY",
    "drive fault",
    "drive restarts",
    "mode refused",
    "SDO abort",
    "control loop hangs 0.5 s",
    "Ctrl-C",
)
"""Faults whose course depends on the drive."""


def write_bench(folder: Path, make: str, packaged: str = "practical") -> Path:
    """Write the bench of a make and its EDS file, or of a mode; returns the bench file."""
    folder.mkdir(parents=True, exist_ok=True)
    keys = MODES.get(make, "eds: drive.eds, ")
    if make not in MODES:
        (folder / "drive.eds").write_text(description(make))
    text = resolve(packaged, "benches").read_text()
    path = folder / "bench.yaml"
    path.write_text(text.replace("servo: {", f"servo: {{{keys}", 1))
    return path


def identified(bench: str, folder: Path) -> tuple[dict[str, dict[str, Any]], list[str]]:
    """Run Figure 10 and identify; returns the parameters, and what was said to be unwatched."""
    run, result = folder / "run", folder / "result.json"
    said = rig("run", "figure10", "--yes", "--bench", bench, "--seed", "1", "--out", str(run))
    rig("identify", str(run), "--out", str(run / "identified"), "--json", str(result))
    unwatched = [line for line in said.splitlines() if "servo: not monitored" in line]
    return json.loads(result.read_text())["parameters"], unwatched


def figure10(makes: list[str]) -> int:
    """Run Figure 10 with each make; 1 where an interval misses the truth far."""
    machine = load_bench("practical").value.mock
    assert machine is not None
    truth = true_parameters(machine)
    found: dict[str, Mapping[str, dict[str, Any]]] = {}
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for label in (*BASELINES, *makes):
            began = time.monotonic()
            make, _, serial = label.partition(":")
            bench = label
            if label not in names("benches"):
                packaged = BASELINES[1 if serial else 0]
                bench = str(write_bench(folder / label, make, packaged))
            found[label], unwatched = identified(bench, folder / label)
            what = "; ".join(
                line.partition("not monitored: ")[2].partition(";")[0] for line in unwatched
            )
            held = sum(_held(found[label][name], true) for name, true in truth.items())
            print(
                f"{label}: {time.monotonic() - began:.0f} s; {held} of {len(truth)} constants in "
                f"their intervals; not monitored: {what or 'nothing'}",
                flush=True,
            )
    return report(found, truth)


def _held(item: Mapping[str, Any], true: float) -> bool:
    return item["value"] is not None and item["low"] <= true <= item["high"]


def report(found: Mapping[str, Mapping[str, dict[str, Any]]], truth: Mapping[str, float]) -> int:
    """Print the parameters of each make."""
    rows, missed, apart, pairs = [], 0, 0, 0
    for parameter, true in truth.items():
        row = [parameter, number(true)]
        for label, parameters in found.items():
            item = parameters[parameter]
            mine = found[BASELINES[":" in label]][parameter]
            held = _held(item, true)
            missed += not held
            if label not in BASELINES:
                pairs += 1
                apart += _disjoint(item, mine)
            row.append(f"{number(item['value'])}{'' if held else ' *'}")
        rows.append(row)
    print(table(["parameter", "true", *found], rows, right=range(1, 2 + len(found))))
    cells = len(rows) * len(found)
    print(f"* truth outside the 90 % interval: {missed} of {cells}")
    print(f"intervals apart from those of the simulated drive: {apart} of {pairs}")
    return 1 if apart > 0.05 * pairs else 0


def _disjoint(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Return whether two intervals do not overlap, or a value is missing."""
    if one["value"] is None or other["value"] is None:
        return True
    return one["low"] > other["high"] or other["low"] > one["high"]


def faults(makes: list[str], some: bool) -> int:
    """Run every fault in every phase with each make; 1 where one ends otherwise than it must."""
    problems: list[str] = []
    count = 0
    with tempfile.TemporaryDirectory() as name:
        for make in makes:
            began, folder = time.monotonic(), Path(name) / make
            bench = str(write_bench(folder, make))
            found: list[str] = []
            for fault, case in cases(make).items():
                for phase in () if some and fault not in SOME else PHASES:
                    cell = fault_matrix.run_case(case, phase, bench, folder / f"{fault} {phase}")
                    for problem in cell.problems:
                        found.append(f"{make}: {fault}, {phase}: {problem}")
                        print(f"  {found[-1]}", flush=True)
                    count += 1
            for state in STATES:
                rows, must = fault_matrix.state_rows(state, Transport(bench, {}))
                if state == "switch_on_disabled" and make in MAKES and 0x603F in MAKES[make].lacks:
                    must = replace(must, words="fault code .603Fh. cannot be read")
                cell = fault_matrix.run_rows(rows, must, bench, folder / state)
                for problem in cell.problems:
                    found.append(f"{make}: fault in {state}: {problem}")
                    print(f"  {found[-1]}", flush=True)
                count += 1
            print(f"{make}: {len(found)} problems, {time.monotonic() - began:.0f} s", flush=True)
            problems += found
    print(f"{count} cells on {len(makes)} makes, {len(problems)} problems")
    return 1 if problems else 0


def homing_bench(folder: Path, label: str) -> str:
    """Write the bench of a make for homing, at a quarter of the cycles; returns its path."""
    make, _, serial = label.partition(":")
    path = write_bench(folder, make, BASELINES[1 if serial else 0])
    text = re.sub(r"(?m)^cycle_Hz: \d+", "cycle_Hz: 250", path.read_text())
    path.write_text(re.sub(r"sample_age_ms: \d+", "sample_age_ms: 20", text))
    return str(path)


def homing_cases() -> Iterator[tuple[str, int, HomingCase, Callable[[Cycle], None] | None]]:
    """Yield name, method, case, and what the host does in it."""
    for name, case in HOMING.items():
        yield from ((name, method, case, None) for method in case.methods)
    for name, (act, case) in HOST.items():
        yield from ((name, method, case, act) for method in case.methods)


def homing(makes: list[str]) -> int:
    """Home with every fault and each make; 1 where one ends otherwise than it must."""
    problems, count = 0, 0
    with tempfile.TemporaryDirectory() as name:
        for label in makes:
            began, folder, found = time.monotonic(), Path(name) / label, 0
            bench = homing_bench(folder, label)
            for fault, method, case, act in homing_cases():
                if ":" in label and fault in BUS_ONLY:
                    continue
                for problem in home(case, method, bench, folder / f"{fault} {method}", act):
                    print(f"  {label}: {fault}, method {method}: {problem}", flush=True)
                    found += 1
                count += 1
            print(f"{label}: {found} problems, {time.monotonic() - began:.0f} s", flush=True)
            problems += found
    print(f"{count} homings on {len(makes)} drives, {problems} problems")
    return 1 if problems else 0


def main() -> int:
    """Do what the first word says with the makes that follow, or with all."""
    what, *words = sys.argv[1:]
    named = [word for word in words if word != "--some"]
    makes = named or [*MAKES, *MODES]
    if what == "figure10":
        return figure10(named or [*makes, *SERIAL, *OWN_FRAMES])
    if what == "homing":
        return homing(named or [*HOMES, *HOMES_SERIAL])
    return faults(makes, "--some" in words)


if __name__ == "__main__":
    sys.exit(main())
