"""Simulated benches in processes of their own (:mod:`tests.long.bench_serve`), as harnesses use
them.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

import drivers.mock
from drivers.clock import NS
from drivers.mock import dbc_drive
from rig.config.configuration import resolve

TRANSPORTS: Mapping[str, str] = {
    "serial": "practical_serial",
    "slcan": "practical",
    "dbc": "practical_dbc",
    "socketcand": "practical",
}
"""Name to the packaged bench that is behind it."""
_EDS = Path(drivers.mock.__file__).parent
_START_S = 60.0
_ANSWER_S = 20.0


class _Loader(yaml.SafeLoader):
    """Takes OFF for a word, as bench files do, and knows no booleans, which the packaged ones have
    none of.
    """

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
        pauses: Where the bench itself had to wait for this computer: until when, and for how long,
            ns.
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
        return (
            [on for when, on in self.powered if when <= ns][-1]
            if ns >= self.powered[0][0]
            else False
        )

    def off_after_s(self, ns: int) -> float | None:
        """Return how long after ``ns`` the power was off for good, s."""
        if self.on:
            return None
        return max(0.0, (self.powered[-1][0] - ns) / NS)

    def ever_on(self, begin_ns: int, end_ns: int) -> bool:
        """Whether it was on at any time in between."""
        return self.on_at(begin_ns) or any(
            on for when, on in self.powered if begin_ns <= when <= end_ns
        )


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
        """Have an order carried out."""
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

    def plug(self) -> int:
        """Put the drive's adapter back, under the same name; returns when, ns."""
        return int(self.ask("plug")["ns"])

    def garbage(self, seed: int) -> int:
        """Send bytes that mean nothing; returns when, ns."""
        return int(self.ask(f"garbage {seed}")["ns"])

    def wait_for_host(self, ended: Callable[[], object], patience_s: float = _START_S) -> None:
        """Wait until a host program has sent something."""
        limit = time.monotonic() + patience_s
        while not self.account().heard_ns:
            if (why := ended()) is not None or time.monotonic() > limit:
                raise BenchError(f"the host never spoke to the bench on {self.transport}: {why}")
            time.sleep(0.02)

    def write_file(
        self, folder: Path, name: str = "bench.yaml", cycle_Hz: int = 100, **limits: float
    ) -> Path:
        """Write the bench file that names its ports."""
        bench = yaml.load(resolve(TRANSPORTS[self.transport], "benches").read_text(), _Loader)  # noqa: S506
        del bench["mock"]
        bench["name"] = self.transport
        if self.transport == "serial":
            bench["bus"]["port"], bench["encoder"]["port"] = self.ports
            bench["servo"]["eds"] = str(_EDS / "drive.eds")
        else:
            slcan = self.transport != "socketcand"
            bench["bus"]["interface"] = "slcan" if slcan else "socketcand"
            # A server has one channel; its name holds the port, so that no two benches of this
            # computer share it.
            bench["bus"]["channel"] = str(self.ports[0]) if slcan else f"can{self.ports[0]}"
            bench["encoder"]["eds"] = str(_EDS / "encoder.eds")
            if self.transport == "dbc":
                bench["servo"]["file"] = str(dbc_drive.DRIVE_DBC)
            else:
                bench["servo"]["eds"] = str(_EDS / "drive.eds")
        bench["cycle_Hz"] = cycle_Hz
        bench["limits"] |= {
            "sample_age_ms": 150,
            "lateness_ms": 50,
            "encoder_disagreement_deg": 5,
            **limits,
        }
        path = folder / name
        path.write_text(yaml.safe_dump(bench))
        return path


@contextmanager
def bench_process(transport: str) -> Iterator[Bench]:
    """Start a bench in a process of its own, and end it at the end."""
    words = [sys.executable, "-m", "tests.long.bench_serve", transport]
    root = Path(__file__).resolve().parents[2]
    with subprocess.Popen(
        words, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=root
    ) as process:
        try:
            yield Bench(transport, process)
        finally:
            process.stdin.close()
            try:
                process.wait(_ANSWER_S)
            except subprocess.TimeoutExpired:
                process.kill()
