"""Simulated benches in a process of their own, in real time, behind the wires that a host program opens.

`python -m tests.long.benches TRANSPORT` is such a process. It takes one order a line on its standard input and answers
each with a line of JSON, which holds ``ns``, the reading of the monotonic clock at which the order was carried out:

- ``renew``: a bench as new, on new ports where the old ones are gone; answers with ``ports``.
- ``state``: answers with what the drive has done since the last ``renew``, see :class:`Account`.
- ``hang KG``: hangs a mass on the lever.
- ``unplug``: takes the drive's adapter away: EIO on a terminal, the end of a connection on a socket.
- ``garbage SEED``: sends the host program bytes that mean nothing, on the drive's line.

:class:`Bench` is the other end, for harnesses.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import random
import subprocess
import sys
import time
import weakref
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

import drivers.mock
from drivers.clock import NS
from drivers.interfaces import RawFrame
from drivers.mock import dbc_drive, power_state
from drivers.mock.amt21 import SimulatedAmt21
from drivers.mock.bench import SimulatedBench, simulated_bench
from drivers.mock.dbc_bench import SimulatedDbcBench, simulated_dbc_bench
from drivers.mock.epos_serial import SimulatedEposPort
from drivers.mock.pty import Ports
from drivers.mock.serial_line import Station
from drivers.mock.slcan import LawicelAdapter, SocketcandServer
from drivers.mock.timer import Timer
from rig.bench import load_bench
from rig.packaged import resolve

TRANSPORTS: Mapping[str, str] = {
    "serial": "practical_serial",
    "slcan": "practical",
    "dbc": "practical_dbc",
    "socketcand": "practical",
}
"""Name to the packaged bench that is behind it."""
TITLES: Mapping[str, str] = {
    "serial": "EPOS serial, AMT21",
    "slcan": "CANopen over slcan",
    "dbc": "CAN frames of its own (DBC) over slcan",
    "socketcand": "CANopen over socketcand",
}
_EDS = Path(drivers.mock.__file__).parent
_STEP_NS = NS // 20
_IDLE_S = 0.02
_PAUSE_NS = NS // 20
_START_S = 60.0
_ANSWER_S = 20.0
_NONSENSE: Mapping[str, tuple[bytes, ...]] = {
    "serial": (b"\x90\x02\x00", b"\x90\x02\x60\x04\xff", b"\x90\x90\x02\x02"),
    "slcan": (b"tZZZ8\r", b"t1819\r", b"t18180011\r", b"T\r", b"\a", b"r181\r", b"t18184G00\r"),
    "dbc": (b"tZZZ8\r", b"t1909\r", b"t19080011\r", b"T\r", b"\a", b"r190\r", b"t19084G00\r"),
    "socketcand": (b"< frame ZZZ 1.0 00 >", b"< frame >", b"> <", b"< error >", b"< frame 181 x 1122 >"),
}
"""What a line brings that is broken in the ways of its own protocol."""


class _Loader(yaml.SafeLoader):
    """Takes OFF for a word, as bench files do, and knows no booleans, which the packaged ones have none of."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - the base class owns this attribute
        letter: [pair for pair in pairs if pair[0] != "tag:yaml.org,2002:bool"]
        for letter, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }


@dataclass(frozen=True)
class Account:
    """What a bench has seen since it was as new; times are those of the monotonic clock, ns.

    Attributes:
        powered: Each change of the power stage: when, and whether it is on.
        heard_ns: When bytes came in from the host program.
        angles: Joint angle in deg, 20 times a second: when, and what.
        pauses: Where the bench itself had to wait for this computer: until when, and for how long, ns.
        speed: Of the joint now, rad/s.
    """

    powered: list[tuple[int, bool]]
    heard_ns: list[int]
    angles: list[tuple[int, float]]
    pauses: list[tuple[int, int]]
    speed: float

    @property
    def on(self) -> bool:
        """Whether the power stage is on now."""
        return self.powered[-1][1]

    def on_at(self, ns: int) -> bool:
        """Whether it was on then."""
        return [on for when, on in self.powered if when <= ns][-1] if ns >= self.powered[0][0] else False

    def off_after_s(self, ns: int) -> float | None:
        """Return how long after ``ns`` the power was off for good, s; 0 where it already was, None where it is on."""
        if self.on:
            return None
        return max(0.0, (self.powered[-1][0] - ns) / NS)

    def ever_on(self, begin_ns: int, end_ns: int) -> bool:
        """Whether it was on at any time in between."""
        return self.on_at(begin_ns) or any(on for when, on in self.powered if begin_ns <= when <= end_ns)


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
    """A bench as a process of its own serves it: devices, ports, and the account of what they did."""

    def __init__(self, transport: str) -> None:
        self._transport = transport
        machine = load_bench(TRANSPORTS[transport]).value.mock
        assert machine is not None
        self._machine = machine
        self._ports = Ports()
        self._names: list[str | int] = []
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
        # The first step loads the compiled machine, which takes longer than a host waits for an answer.
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
        """Put the devices behind their ports; a server forgets its connections, terminals stay what they are."""
        if self._transport == "serial":
            stations: list[Station] = [SimulatedEposPort(bench.bus, bench.clock, bench.drive)]
            stations.append(SimulatedAmt21(bench.clock, bench.sampler))
        elif self._transport == "socketcand":
            stations = []
            hub = _Hub(bench.bus)
            for name in self._names:
                self._ports.unplug(name)
            self._names = [self._ports.open_server(lambda: self._connected(hub))]
        else:
            stations = [LawicelAdapter(bench.bus)]
        for slot, station in zip(self._slots, stations, strict=False):
            slot.station = station
        if stations and not self._whole:
            for name in self._names:
                self._ports.unplug(name)
            self._names = [self._ports.open_pty(slot) for slot, _ in zip(self._slots, stations, strict=False)]
        self._whole = True

    def _connected(self, hub: _Hub) -> _Slot:
        slot = _Slot(self._heard_ns)
        slot.station = SocketcandServer(hub.tap())  # type: ignore[arg-type]
        return slot

    def _keep_up(self) -> None:
        # Asked after a long pause, the machine would take long to catch up, and the answer come too late.
        bench = self._bench
        assert bench is not None
        if isinstance(bench, SimulatedBench):
            bench.drive.refresh()
        self._angles.append((bench.clock.now_ns() - self._ahead_ns, math.degrees(bench.machine.truth().angle_rad)))
        self._timer.start(bench.clock.now_ns() + _STEP_NS)

    def serve(self) -> None:
        """Live in real time, and obey, until the standard input ends."""
        pending = b""
        before = time.monotonic_ns()
        while True:
            now_ns = time.monotonic_ns()
            if now_ns - before > _PAUSE_NS:
                self._pauses.append((now_ns, now_ns - before))
            before = now_ns
            assert self._bench is not None
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
        self._bench.bus.shutdown()

    def _obey(self, order: str, *words: str) -> dict[str, Any]:
        assert self._bench is not None
        match order:
            case "renew":
                return self._renew()
            case "hang":
                self._bench.machine.hang(float(words[0]))
            case "unplug":
                self._ports.unplug(self._names[0])
                self._whole = False
            case "garbage":
                self._ports.babble(self._names[0], nonsense(self._transport, int(words[0])))
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
    pieces = [piece for chosen in _NONSENSE[transport] for piece in (dice.randbytes(dice.randint(1, 24)), chosen)]
    return b"".join(pieces) + dice.randbytes(16) + (b"\r" if transport in ("slcan", "dbc") else b"")


class BenchError(Exception):
    """A bench process has ended or does not answer."""


class Bench:
    """A bench process, as a harness uses it.

    Attributes:
        transport: How a host reaches it.
        ports: What the host opens: paths of terminals, or the number of a TCP port.
        env: What a host needs in its environment to find it.
    """

    def __init__(self, transport: str, process: Any) -> None:
        self.transport = transport
        self._process = process
        self.ports: list[str | int] = []
        self.env: dict[str, str] = {}
        self.renew()

    def ask(self, order: str) -> dict[str, Any]:
        """Have an order carried out; returns the answer.

        Raises:
            BenchError: The process has ended.
        """
        try:
            self._process.stdin.write(order + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except OSError as error:
            raise BenchError(f"the bench on {self.transport} is gone: {error}") from error
        if not line:
            raise BenchError(f"the bench on {self.transport} ended at the order {order!r}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def renew(self) -> None:
        """Have a bench as new: at rest, without power, nothing hung, no fault."""
        self.ports = self.ask("renew")["ports"]
        options: dict[str, Any] = {"sleep_after_open": 0.0}
        if self.transport == "socketcand":
            options = {"host": "127.0.0.1", "port": self.ports[0], "tcp_tune": True}
        self.env = {} if self.transport == "serial" else {"CAN_CONFIG": json.dumps(options)}

    def account(self) -> Account:
        """Return what it has seen."""
        told = self.ask("state")
        powered = [(when, on) for when, on in told["powered"]]
        angles = [(when, angle) for when, angle in told["angles"]]
        pauses = [(when, long) for when, long in told["pauses"]]
        return Account(powered, told["heard_ns"], angles, pauses, told["speed"])

    def hang(self, mass_kg: float) -> None:
        """Hang a mass on the lever."""
        self.ask(f"hang {mass_kg:g}")

    def unplug(self) -> int:
        """Take the drive's adapter away; returns when, ns."""
        return int(self.ask("unplug")["ns"])

    def garbage(self, seed: int) -> int:
        """Send bytes that mean nothing; returns when, ns."""
        return int(self.ask(f"garbage {seed}")["ns"])

    def wait_for_host(self, ended: Callable[[], object], patience_s: float = _START_S) -> None:
        """Wait until a host program has sent something.

        Raises:
            BenchError: ``ended()`` returns something before it does, or it takes too long.
        """
        limit = time.monotonic() + patience_s
        while not self.account().heard_ns:
            if (why := ended()) is not None or time.monotonic() > limit:
                raise BenchError(f"the host never spoke to the bench on {self.transport}: {why}")
            time.sleep(0.02)

    def write_file(self, folder: Path, name: str = "bench.yaml", cycle_Hz: int = 100, **limits: float) -> Path:
        """Write the bench file that names its ports; slow and patient, as the machine may be busy with other things."""
        bench = yaml.load(resolve(TRANSPORTS[self.transport], "benches").read_text(), _Loader)  # noqa: S506
        del bench["mock"]
        bench["name"] = self.transport
        if self.transport == "serial":
            bench["bus"]["port"], bench["encoder"]["port"] = self.ports
            bench["servo"]["eds"] = str(_EDS / "drive.eds")
        else:
            slcan = self.transport != "socketcand"
            bench["bus"]["interface"] = "slcan" if slcan else "socketcand"
            # A server has one channel; its name holds the port, so that no two benches of this computer share it.
            bench["bus"]["channel"] = str(self.ports[0]) if slcan else f"can{self.ports[0]}"
            bench["encoder"]["eds"] = str(_EDS / "encoder.eds")
            if self.transport == "dbc":
                bench["servo"]["file"] = str(dbc_drive.DRIVE_DBC)
            else:
                bench["servo"]["eds"] = str(_EDS / "drive.eds")
        bench["cycle_Hz"] = cycle_Hz
        bench["limits"] |= {"sample_age_ms": 150, "lateness_ms": 50, "encoder_disagreement_deg": 5, **limits}
        path = folder / name
        path.write_text(yaml.safe_dump(bench))
        return path


@contextmanager
def bench_process(transport: str) -> Iterator[Bench]:
    """Start a bench in a process of its own, and end it at the end."""
    words = [sys.executable, "-m", "tests.long.benches", transport]
    root = Path(__file__).resolve().parents[2]
    with subprocess.Popen(words, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=root) as process:
        assert process.stdin is not None
        try:
            yield Bench(transport, process)
        finally:
            process.stdin.close()
            try:
                process.wait(_ANSWER_S)
            except subprocess.TimeoutExpired:
                process.kill()


def main() -> None:
    """Be a bench."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("transport", choices=TRANSPORTS)
    Served(parser.parse_args().transport).serve()


if __name__ == "__main__":
    main()
