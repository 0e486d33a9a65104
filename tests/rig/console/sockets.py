"""A program that speaks to control sockets, for tests."""

import json
import os
import socket
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self


class Peer:
    """One end that sends messages to a run and reads what comes back."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / f"peer-{os.urandom(4).hex()}"
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(str(self.path))
        self.socket.settimeout(20.0)
        self.run = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.socket.close()
        self.path.unlink(missing_ok=True)

    def attach(self, path: Path) -> None:
        """Take messages for the run whose socket that is."""
        self.to = path

    def put(self, message: dict[str, Any] | bytes) -> None:
        data = message if isinstance(message, bytes) else json.dumps(message).encode()
        self.socket.sendto(data, str(self.to))

    def get(self) -> dict[str, Any]:
        found = json.loads(self.socket.recv(65536))
        assert isinstance(found, dict)
        return found

    def order(self, command: str, **more: Any) -> dict[str, Any]:
        """Return a command as the console sends it."""
        return {
            "command": command,
            "run": self.run,
            "number": time.monotonic_ns(),
            "who": "a test",
            **more,
        }


@contextmanager
def short_folder() -> Iterator[Path]:
    """Make a folder with a name short enough for a socket in it."""
    with tempfile.TemporaryDirectory(prefix="rig-", dir="/tmp") as name:
        yield Path(name)


def only_socket(folder: Path) -> Path:
    """Return the control socket of the only run."""
    (found,) = folder.glob("run-*.sock")
    return found
