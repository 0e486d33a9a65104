"""A bench process: simulated devices in real time behind the wires that a host program opens.

`python -m tests.long.bench_serve TRANSPORT` takes one order a line on its standard input and
answers each with a line of JSON, which holds ``ns``, the reading of the monotonic clock at which
the order was carried out:

- ``renew``: a bench as new, on the same ports, or on new ones where the old ones are gone; answers
  with ``ports``.
- ``state``: answers with what the drive has done since the last ``renew``, see
  :class:`tests.long.benches.Account`.
- ``hang KG``: hangs a mass on the lever.
- ``unplug``: takes the drive's adapter away: EIO on a terminal, the end of a connection on a
  socket.
- ``plug``: puts the adapter of a terminal back, under the same name.
- ``garbage SEED``: sends the host program bytes that mean nothing, on the drive's line.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import shutil
import tempfile
import time
import weakref
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from benchmarks.adapters import LawicelAdapter, Ports, SocketcandServer
from drivers.clock import NS
from drivers.interfaces import RawFrame
from drivers.mock import dbc_drive, power_state
from drivers.mock.bench import (
    SimulatedBench,
    SimulatedDbcBench,
    simulated_bench,
    simulated_dbc_bench,
)
from drivers.mock.drive import SimulatedEposPort
from drivers.mock.encoder import SimulatedAmt21
from drivers.mock.wires.bus import Timer
from drivers.mock.wires.serial_line import Station
from rig.config.bench import load_bench

from .benches import TRANSPORTS

_STEP_NS = NS // 20
_IDLE_S = 0.02
_PAUSE_NS = NS // 20
_NONSENSE: Mapping[str, tuple[bytes, ...]] = {
    "serial": (b"\x90\x02\x00", b"\x90\x02\x60\x04\xff", b"\x90\x90\x02\x02"),
    "slcan": (b"tZZZ8\r", b"t1819\r", b"t18180011\r", b"T\r", b"\a", b"r181\r", b"t18184G00\r"),
    "dbc": (b"tZZZ8\r", b"t1909\r", b"t19080011\r", b"T\r", b"\a", b"r190\r", b"t19084G00\r"),
    "socketcand": (
        b"< frame ZZZ 1.0 00 >",
        b"< frame >",
        b"> <",
        b"< error >",
        b"< frame 181 x 1122 >",
    ),
}
"""What a line brings that is broken in the ways of its own protocol."""


class _Slot:
    """A place on a line for a station that can be exchanged; notes when something comes in."""

    def __init__(self, heard_ns: deque[int]) -> None:
        self.station: Station | None = None
        self._heard_ns = heard_ns

    def receive(self, data: bytes) -> bytes:
        if data:
            self._heard_ns.append(time.monotonic_ns())
        return b"" if self.station is None else self.station.receive(data)


class _Tap:
    """One of several hosts of a bus; each gets every frame."""

    def __init__(self, hub: _Hub) -> None:
        self._hub = hub
        self.waiting: list[RawFrame] = []

    def transmit(self, identifier: int, data: bytes) -> None:
        self._hub.bus.transmit(identifier, data)

    def collect(self, timeout_s: float) -> list[RawFrame]:
        self._hub.spread()
        frames, self.waiting = self.waiting, []
        return frames


class _Hub:
    """The host's side of a simulated bus, shared by the connections to a server."""

    def __init__(self, bus: Any) -> None:
        self.bus = bus
        self._taps: weakref.WeakSet[_Tap] = weakref.WeakSet()

    def tap(self) -> _Tap:
        tap = _Tap(self)
        self._taps.add(tap)
        return tap

    def spread(self) -> None:
        frames = self.bus.collect(0.0)
        for tap in self._taps:
            tap.waiting += frames


class Served:
    """A bench as a process of its own serves it: devices, ports, and the account of what they
    did.
    """

    def __init__(self, transport: str) -> None:
        self._transport = transport
        machine = load_bench(TRANSPORTS[transport]).value.mock
        assert machine is not None
        self._machine = machine
        self._ports = Ports()
        self._names: list[str | int] = []
        self._folder = Path(tempfile.mkdtemp(prefix="bench-"))
        self._heard_ns: deque[int] = deque(maxlen=100_000)
        self._slots = [_Slot(self._heard_ns), _Slot(self._heard_ns)]
        self._bench: SimulatedBench | SimulatedDbcBench | None = None
        self._whole = False
        self._renew()

    def _renew(self) -> dict[str, Any]:
        """Build new devices and put them behind the ports."""
        if self._bench is not None:
            self._bench.bus.shutdown()
        if self._transport == "dbc":
            self._bench = bench = simulated_dbc_bench(self._machine, 0)
            on = dbc_drive.POWERED
        else:
            self._bench = bench = simulated_bench(self._machine, 0)  # type: ignore[assignment]
            on = power_state.POWERED  # type: ignore[assignment]
        # The first step loads the compiled machine, which takes longer than a host waits for an
        # answer.
        bench.clock.sleep_until_ns(NS // 50)
        if isinstance(bench, SimulatedBench):
            bench.drive.refresh()
        self._ahead_ns = bench.clock.now_ns() - time.monotonic_ns()
        self._powered = [(time.monotonic_ns(), False)]
        self._angles: deque[tuple[int, float]] = deque(maxlen=20_000)
        self._pauses: list[tuple[int, int]] = []
        self._heard_ns.clear()

        def entered(state: Any) -> None:
            if (state in on) is not self._powered[-1][1]:
                self._powered.append((bench.clock.now_ns() - self._ahead_ns, state in on))

        bench.drive.entered.append(entered)
        self._timer = Timer(bench.clock, self._keep_up)
        self._keep_up()
        self._wire(bench)
        return {"ports": self._names}

    def _wire(self, bench: Any) -> None:
        """Put the devices behind their ports, which stay what they are where they are still
        there.
        """
        if self._transport == "serial":
            stations: list[Station] = [SimulatedEposPort(bench.bus, bench.clock, bench.drive)]
            stations.append(SimulatedAmt21(bench.clock, bench.sampler))
        elif self._transport == "socketcand":
            stations = []
            self._hub = _Hub(bench.bus)
            if not self._whole:
                self._names = [self._ports.open_server(self._connected)]
        else:
            stations = [LawicelAdapter(bench.bus)]
        for slot, station in zip(self._slots, stations, strict=False):
            slot.station = station
        if stations and not self._whole:
            for name in self._names:
                self._pull(Path(name))
            self._names = [
                self._plug(self._folder / f"port{n}", self._slots[n]) for n in range(len(stations))
            ]
        self._whole = True

    def _plug(self, name: Path, slot: _Slot) -> str:
        """Have a terminal under a name that stays the same, as one under /dev/serial/by-id does."""
        name.symlink_to(self._ports.open_pty(slot))
        return str(name)

    def _pull(self, name: Path) -> None:
        if name.is_symlink():
            self._ports.unplug(os.readlink(name))
            name.unlink()

    def _connected(self) -> _Slot:
        slot = _Slot(self._heard_ns)
        slot.station = SocketcandServer(self._hub.tap())  # type: ignore[arg-type]
        return slot

    def _keep_up(self) -> None:
        # Asked after a long pause, the machine would take long to catch up, and the answer come too
        # late.
        bench = self._bench
        if isinstance(bench, SimulatedBench):
            bench.drive.refresh()
        self._angles.append(
            (bench.clock.now_ns() - self._ahead_ns, math.degrees(bench.machine.truth().angle_rad))
        )
        self._timer.start(bench.clock.now_ns() + _STEP_NS)

    def serve(self) -> None:
        """Live in real time, and obey, until the standard input ends."""
        with suppress(PermissionError):
            # Devices do not wait for what else a computer does.
            os.setpriority(os.PRIO_PROCESS, 0, -15)
        pending = b""
        before = time.monotonic_ns()
        while True:
            now_ns = time.monotonic_ns()
            if now_ns - before > _PAUSE_NS:
                self._pauses.append((now_ns, now_ns - before))
            before = now_ns
            clock = self._bench.clock
            due = clock.next_event_ns()
            now = time.monotonic_ns() + self._ahead_ns
            wait_s = _IDLE_S if due is None else min(_IDLE_S, max(0.0, (due - now) / NS))
            ready = self._ports.wait(wait_s, 0)
            clock.sleep_until_ns(time.monotonic_ns() + self._ahead_ns)
            self._ports.serve([descriptor for descriptor in ready if descriptor])
            if 0 in ready:
                data = os.read(0, 4096)
                if not data:
                    break
                *lines, pending = (pending + data).split(b"\n")
                for line in lines:
                    told = {"ns": time.monotonic_ns(), **self._obey(*line.decode().split())}
                    print(json.dumps(told), flush=True)
        self._ports.close()
        shutil.rmtree(self._folder)
        self._bench.bus.shutdown()

    def _obey(self, order: str, *words: str) -> dict[str, Any]:
        match order:
            case "renew":
                return self._renew()
            case "hang":
                self._bench.machine.hang(float(words[0]))
            case "unplug":
                if isinstance(self._names[0], int):
                    self._ports.unplug(self._names[0])
                else:
                    self._pull(Path(self._names[0]))
                self._whole = False
            case "plug":
                self._plug(Path(self._names[0]), self._slots[0])
                self._whole = True
            case "garbage":
                name = self._names[0]
                port = name if isinstance(name, int) else os.readlink(name)
                self._ports.babble(port, nonsense(self._transport, int(words[0])))
            case "state":
                if isinstance(self._bench, SimulatedBench):
                    self._bench.drive.refresh()
                return {
                    "powered": self._powered,
                    "heard_ns": list(self._heard_ns),
                    "angles": list(self._angles),
                    "pauses": self._pauses,
                    "speed": self._bench.machine.truth().velocity_rad_s,
                }
            case _:
                raise ValueError(f"unknown order {order!r}")
        return {}


def nonsense(transport: str, seed: int) -> bytes:
    """Return some 200 bytes: noise between lines that are broken in the ways of this protocol."""
    dice = random.Random(seed)
    pieces = [
        piece
        for chosen in _NONSENSE[transport]
        for piece in (dice.randbytes(dice.randint(1, 24)), chosen)
    ]
    return b"".join(pieces) + dice.randbytes(16) + (b"\r" if transport in ("slcan", "dbc") else b"")


def main() -> None:
    """Be a bench."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("transport", choices=TRANSPORTS)
    Served(parser.parse_args().transport).serve()


if __name__ == "__main__":
    main()
