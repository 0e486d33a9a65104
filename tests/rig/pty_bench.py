"""A simulated bench behind pseudo-terminals, in real time: ``python -m tests.rig.pty_bench
serial|slcan``.

It lives in a process of its own, writes its paths as JSON in one line, then answers each line of
its input with how many bytes it has been sent.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import yaml

import drivers.mock
from benchmarks.adapters import LawicelAdapter, RealTimeBench
from drivers.mock.bench import simulated_bench
from drivers.mock.drive import SimulatedEposPort
from drivers.mock.encoder import SimulatedAmt21
from rig.config.bench import load_bench
from rig.config.configuration import resolve

PACKAGED = {"serial": "practical_serial", "slcan": "practical"}


class PtyBench:
    """The other side: the bench file, and what went over the wire.

    Attributes:
        path: Of a bench file that names the terminals as real ports.
        port: The drive's, or the adapter's.
    """

    def __init__(self, process: subprocess.Popen[str], kind: str, folder: Path) -> None:
        self._process = process
        ports = json.loads(self._line())
        bench = yaml.safe_load(resolve(PACKAGED[kind], "benches").read_text())
        del bench["mock"]
        eds = Path(drivers.mock.__file__).parent
        bench["servo"]["eds"] = str(eds / "drive.eds")
        self.port = ports[0]
        if kind == "serial":
            bench["bus"]["port"], bench["encoder"]["port"] = ports
        else:
            bench["bus"] |= {"interface": "slcan", "channel": self.port}
            bench["encoder"]["eds"] = str(eds / "encoder.eds")
        self.path = folder / f"{kind}.yaml"
        self.path.write_text(yaml.safe_dump(bench))

    def bytes_sent(self) -> int:
        """Return how many bytes programs have sent to it so far."""
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return int(self._line())

    def _line(self) -> str:
        return self._process.stdout.readline()


@contextmanager
def pty_bench(kind: str, folder: Path) -> Iterator[PtyBench]:
    """Start a bench, and end it."""
    words = [sys.executable, "-m", "tests.rig.pty_bench", kind]
    root = Path(__file__).parents[2]
    with subprocess.Popen(
        words, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=root
    ) as process:
        try:
            yield PtyBench(process, kind, folder)
            process.stdin.close()
            process.wait(10)
        finally:
            process.kill()


def main(kind: str) -> None:
    """Be the bench."""
    machine = load_bench(PACKAGED[kind]).value.mock
    assert machine is not None
    bench = simulated_bench(machine, 0)
    ports = RealTimeBench(bench.clock)
    if kind == "serial":
        stations = [
            SimulatedEposPort(bench.bus, bench.clock, bench.drive),
            SimulatedAmt21(bench.clock, bench.sampler),
        ]
    else:
        stations = [LawicelAdapter(bench.bus)]
    paths = [ports.open_pty(station) for station in stations]
    with ports:
        print(json.dumps(paths), flush=True)
        for _ in sys.stdin:
            print(sum(traffic.taken for traffic in ports.traffic.values()), flush=True)
    bench.bus.shutdown()


if __name__ == "__main__":
    main(sys.argv[1])
