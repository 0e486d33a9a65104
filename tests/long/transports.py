"""The Figure 10 sequence over every transport: the same nine parameters, within their intervals.

python -m tests.long.transports [--seeds N] [--seconds S]

CANopen on the simulated bus is what the others are held against. Bytes of the EPOS4 and AMT21 lines
and of the slcan adapter go through pseudo-terminals, those of socketcand through a loopback socket,
in simulated time, so that a busy machine changes nothing. Two honest 90 % intervals of one value
miss each other in 2 % of cases; this passes where at most 5 % of the pairs do.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

import can

from benchmarks.adapters import LawicelAdapter, Ports, SocketcandServer
from drivers.can.slcan import SlcanPort
from drivers.canopen.link import CanopenLink
from drivers.mock.bench import SimulatedBench
from drivers.mock.wires.serial_line import Station
from drivers.serial_port import BytePort
from rig.cli.entry import status
from rig.common.tables import number, table
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.runs.recorded_inputs import true_parameters
from rig.wiring import connect
from rig.wiring import connect as serial_devices
from tests.drivers.lock_step import (
    LockStep,
    LockStepCan,
    LockStepSerial,
    count_socketcand,
    served_meanwhile,
)

MISSES = 0.05
_ADAPTER_BAUD = 115_200
LINES = ("EPOS serial, AMT21", "slcan on a pty", "socketcand on loopback")
BENCHES: Mapping[str, str] = {
    "CANopen": "practical",
    "EPOS serial, AMT21": "practical_serial",
    "own CAN frames (DBC)": "practical_dbc",
    "slcan on a pty": "practical",
    "socketcand on loopback": "practical",
}
"""Transport to bench; the first is the yardstick."""
_Twin = tuple[SimulatedBench, Any]


@contextlib.contextmanager
def wired(transport: str) -> Iterator[None]:
    """Put real pseudo-terminals or sockets between the host and the simulated bench, where the
    transport has any.
    """
    ports = Ports()
    with contextlib.ExitStack() as stack:
        stack.callback(ports.close)
        if transport == "EPOS serial, AMT21":
            stack.enter_context(patch.object(serial_devices, "_simulated", _over_ptys(ports)))
        elif transport in LINES:
            over = _over_slcan(ports) if transport == "slcan on a pty" else _over_socketcand(ports)
            stack.enter_context(patch.object(connect, "_link", over))
        yield


def _over_ptys(
    ports: Ports,
) -> Callable[[SimulatedBench, str, int, Station], Callable[[], BytePort]]:
    def line(
        simulated: SimulatedBench, _name: str, baud: int, station: Station
    ) -> Callable[[], BytePort]:
        path = ports.open_pty(station)
        return lambda: LockStepSerial(path, baud, LockStep(simulated.clock, ports, path))

    return line


def _over_slcan(ports: Ports) -> Callable[..., tuple[CanopenLink, SimulatedBench]]:
    def link(
        bench: Any, servo: Any, bus: Any, seed: int, attach: Any
    ) -> tuple[CanopenLink, SimulatedBench]:
        simulated, clock = connect._simulated_bench(bench, servo, bus.bitrate, seed, attach)
        assert simulated is not None
        path = ports.open_pty(LawicelAdapter(simulated.bus))
        step = LockStep(simulated.clock, ports, path)

        def adapter() -> SlcanPort:
            return SlcanPort(
                LockStepSerial(path, _ADAPTER_BAUD, step), simulated.clock, bus.bitrate
            )

        return CanopenLink(clock, adapter, "slcan"), simulated

    return link


def _over_socketcand(ports: Ports) -> Callable[..., tuple[CanopenLink, SimulatedBench]]:
    def link(
        bench: Any, servo: Any, bus: Any, seed: int, attach: Any
    ) -> tuple[CanopenLink, SimulatedBench]:
        simulated, clock = connect._simulated_bench(bench, servo, bus.bitrate, seed, attach)
        assert simulated is not None
        port = ports.open_socket(SocketcandServer(simulated.bus))
        step = LockStep(simulated.clock, ports, port)
        options = {
            "interface": "socketcand",
            "channel": "can0",
            "host": "127.0.0.1",
            "port": port,
            "tcp_tune": True,
        }

        def client() -> LockStepCan:
            opened = served_meanwhile(ports, lambda: can.Bus(**options))
            step.sent, step.read = step.traffic.taken, step.traffic.given
            count_socketcand(opened, step)
            return LockStepCan(opened, step)

        return CanopenLink(clock, client, "socketcand"), simulated

    return link


def identified(
    transport: str, sequence: Path, seed: int, folder: Path
) -> dict[str, dict[str, Any]]:
    """Run and identify; return parameter name to its record."""
    name = f"{list(BENCHES).index(transport)}-{seed}"
    run, result = folder / name, folder / f"{name}.json"
    commands = (
        [
            "run",
            str(sequence),
            "--yes",
            "--bench",
            BENCHES[transport],
            "--seed",
            str(seed),
            "--out",
            str(run),
        ],
        ["identify", str(run), "--out", str(run / "identified"), "--json", str(result)],
    )
    for words in commands:
        said = io.StringIO()
        with wired(transport), contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            code = status(words)
        if code:
            raise SystemExit(
                f"{transport}: rig {' '.join(words)} ended with status {code}: {said.getvalue()}"
            )
    parameters: dict[str, dict[str, Any]] = json.loads(result.read_text())["parameters"]
    return parameters


def figure10(folder: Path, seconds: float) -> Path:
    """Write the Figure 10 sequence with stages of that many seconds."""
    path = folder / "figure10.yaml"
    path.write_text(
        resolve("figure10", "sequences")
        .read_text()
        .replace("duration_s: 20", f"duration_s: {seconds:g}")
    )
    return path


Found = list[dict[str, dict[str, Any]]]


def overlaps(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two intervals have a value in common; none does with what could not be identified."""
    if one["value"] is None or other["value"] is None:
        return False
    return bool(one["low"] <= other["high"] and other["low"] <= one["high"])


def main(argv: list[str] | None = None) -> int:
    """Print the comparison; return 1 where too many pairs of intervals do not overlap."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each of the two stages")
    options = parser.parse_args(argv)
    machine = load_bench("practical").value.mock
    assert machine is not None
    truth = true_parameters(machine)
    found: dict[str, Found] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sequence = figure10(folder, options.seconds)
        for transport in BENCHES:
            began = time.monotonic()
            found[transport] = [
                identified(transport, sequence, seed, folder) for seed in range(options.seeds)
            ]
            print(
                f"{transport}: {(time.monotonic() - began) / options.seeds:.1f} s a run", flush=True
            )
    return report(found, truth, options.seeds)


def report(found: Mapping[str, Found], truth: Mapping[str, float], seeds: int) -> int:
    """Print values and intervals of the first seed, errors over all, and the count of pairs that
    miss each other.
    """
    first, *others = found
    head = ["parameter", "true", *found]
    rows = []
    for name, true in truth.items():
        cells = (found[transport][0][name] for transport in found)
        rows.append(
            [
                name,
                number(true),
                *(
                    f"{number(c['value'])} ({number(c['low'])} to {number(c['high'])})"
                    for c in cells
                ),
            ]
        )
    print(table(head, rows))
    rows = []
    for name, true in truth.items():
        cells = []
        for runs in found.values():
            known = [run[name] for run in runs if run[name]["value"] is not None]
            error = median(abs(item["value"] / true - 1.0) for item in known) if known else None
            held = sum(item["low"] <= true <= item["high"] for item in known)
            cells.append(
                f"{number(None if error is None else 100 * error, 3)} ({held}/{len(known)})"
            )
        rows.append([name, *cells])
    print(table(["error %, truth in interval", *found], rows, right=range(1, 1 + len(found))))
    bad = False
    for transport in others:
        pairs = [
            (a[name], b[name])
            for a, b in zip(found[first], found[transport], strict=True)
            for name in truth
        ]
        apart = sum(not overlaps(*pair) for pair in pairs)
        bad |= apart > MISSES * len(pairs)
        print(
            f"{transport}: {apart} of {len(pairs)} pairs of intervals do not overlap those of "
            f"{first}, or are missing"
        )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
