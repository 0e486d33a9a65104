"""The console and runs in processes of their own, with a folder of control sockets of their own."""

import http.client
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .sockets import Peer, short_folder

PATIENT = """
import dataclasses
import sys
import rig.terminal.control_socket as messages

folders = messages.socket_folders
# Runs of this computer that are no part of the test are neither seen nor stopped.
messages.socket_folders = lambda: folders()[:1]
import rig.planning.plan
import rig.cli.commands.console as console

limits = rig.planning.plan._limits
# A busy machine is late; lateness is not on trial here.
rig.planning.plan._limits = lambda values, bench: dataclasses.replace(
    limits(values, bench), lateness=30.0
)
starter = console.Starter
own = (sys.executable, "-c", sys.orig_argv[2])
console.Starter = lambda benches, runs: starter(benches, runs, own)
from rig.cli.entry import main
main()
"""
"""The command line with a wide limit of lateness, for itself and for the runs that it starts."""
SEQUENCE = """\
sequence: 1
name: {name}
limits: {{speed_deg_s: 60}}
stages:
  - {{name: empty, stage: unloaded, tones: [{{amplitude_deg: 4, frequency_Hz: 1}}],
     duration_s: {duration_s}, ramp_in_s: 0.2, ramp_out_s: 0.2, settle_s: 0.1}}
  - {{name: heavy, stage: loaded, weight_kg: 20, tones: [{{amplitude_deg: 4, frequency_Hz: 1}}],
     duration_s: {heavy_s}, ramp_in_s: 0.2, ramp_out_s: 0.2, settle_s: 0.1}}
"""
WAIT_S = 150.0


@dataclass
class Place:
    """Where one console and its runs live.

    Attributes:
        folder: Files and run folders.
        runtime: Folder of the control sockets' folder.
        started: Runs that were started here.
    """

    folder: Path
    runtime: Path
    started: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def environment(self) -> dict[str, str]:
        """Of every process."""
        path = os.pathsep.join(filter(None, sys.path))
        return {**os.environ, "XDG_RUNTIME_DIR": str(self.runtime), "PYTHONPATH": path}

    @property
    def sockets(self) -> Path:
        """Folder of the control sockets."""
        return self.runtime / "loadrig"

    def sequence(self, name: str, duration_s: float, heavy_s: float | None = None) -> Path:
        """Write a sequence of two stages, the second with 20 kg and as long as the first unless
        stated.
        """
        path = self.folder / f"{name}.yaml"
        path.write_text(
            SEQUENCE.format(name=name, duration_s=duration_s, heavy_s=heavy_s or duration_s)
        )
        return path

    def run(self, sequence: Path, *options: str) -> subprocess.Popen[bytes]:
        """Start a run on the simulated bench."""
        out = self.folder / "runs" / f"{sequence.stem}-{len(self.started)}"
        return self.command("run", str(sequence), "--out", str(out), *options)

    def command(self, *command: str) -> subprocess.Popen[bytes]:
        """Start a command of ``rig``."""
        child = subprocess.Popen(
            [sys.executable, "-c", PATIENT, *command],
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.STDOUT,
        )
        self.started.append(child)
        return child

    def records(self) -> list[dict[str, Any]]:
        """Return every run.json."""
        return [json.loads(path.read_text()) for path in self.folder.glob("runs/*/run.json")]

    def stop_all(self) -> None:
        """Stop every run of this place, and wait until their sockets are gone."""
        self.sockets.mkdir(mode=0o700, exist_ok=True)
        wait_until(lambda: not any([*map(self._stop, self.sockets.glob("run-*.sock"))]))
        for child in self.started:
            child.wait(WAIT_S)

    def _stop(self, path: Path) -> bool:
        """Ask a run to stop; return whether its socket may still be there."""
        with Peer(self.sockets) as peer:
            # A run that is ending does not answer any more, and takes its socket away.
            peer.socket.settimeout(1.0)
            peer.attach(path)
            try:
                peer.put({"ask": "about"})
                peer.run = peer.get()["about"]["run"]
                peer.put(peer.order("stop"))
            except TimeoutError:
                return True
            except OSError:
                path.unlink(missing_ok=True)
                return False
        return True


@dataclass
class Served:
    """A console that runs.

    Attributes:
        place: Where.
        address: As printed, with the token.
        process: Its process.
    """

    place: Place
    address: str
    process: subprocess.Popen[str]
    number: int = 0

    @property
    def port(self) -> int:
        """Its port."""
        return int(re.search(r":(\d+)/", self.address)[1])  # type: ignore[index]

    @property
    def token(self) -> str:
        """Its token."""
        return self.address.partition("#token=")[2]

    def request(
        self, method: str, path: str, content: object = None, **headers: str | None
    ) -> tuple[int, str, Mapping[str, str]]:
        """Send a request as the page does, with some headers replaced or, by None, left out.

        Returns:
            Status, body, and headers in lower case.
        """
        self.number += 1
        host = f"127.0.0.1:{self.port}"
        given: dict[str, str | None] = {"host": host}
        if method == "POST":
            given |= {
                "origin": f"http://{host}",
                "authorization": f"Bearer {self.token}",
                "content_type": "application/json",
            }
        given |= headers
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        for name, value in given.items():
            if value is not None:
                connection.putheader(name.replace("_", "-"), value)
        body = content if isinstance(content, bytes) else json.dumps(content).encode()
        if method == "POST":
            connection.putheader("content-length", str(len(body)))
        connection.endheaders(body if method == "POST" else None)
        answer = connection.getresponse()
        text = answer.read().decode()
        connection.close()
        return answer.status, text, {name.lower(): value for name, value in answer.getheaders()}


@contextmanager
def place(folder: Path) -> Iterator[Place]:
    """Provide a place; its runs are stopped at the end."""
    with short_folder() as runtime:
        made = Place(folder, runtime)
        try:
            yield made
        finally:
            made.stop_all()


@contextmanager
def served(where: Place, *benches: str) -> Iterator[Served]:
    """Serve a console."""
    command = ["console", *benches, "--port", "0", "--runs", str(where.folder / "runs")]
    with subprocess.Popen(
        [sys.executable, "-c", PATIENT, *command],
        env=where.environment,
        cwd=where.folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            lines = [process.stdout.readline() for _ in range(2)]
            yield Served(where, lines[1].split()[-1], process)
        finally:
            process.terminate()
            process.wait(WAIT_S)


def wait_until(done: Callable[[], object], seconds: float = WAIT_S) -> None:
    """Wait until something of another process is so."""
    deadline = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.02)
