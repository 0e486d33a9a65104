"""A console that ``benchmarks/console.py`` has started, as pages in a browser use it."""

from __future__ import annotations

import base64
import collections
import http.client
import json
import os
import re
import select
import selectors
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress


class Console:
    """A console that was started, as a page sees it.

    Args:
        runtime: Folder of the control sockets.
        runs: Folder of the recorded runs.
        environment: Variables of its own environment, and of the runs'.
    """

    def __init__(self, runtime: str, runs: str, environment: Mapping[str, str]) -> None:
        self.environment = {**os.environ, **environment, "XDG_RUNTIME_DIR": runtime}
        entry = "from rig.cli.entry import main; main()"
        self.process = subprocess.Popen(
            [sys.executable, "-c", entry, "console", "--port", "0", "--runs", runs],
            stdout=subprocess.PIPE,
            text=True,
            env=self.environment,
        )
        assert self.process.stdout is not None
        address = [self.process.stdout.readline() for _ in range(2)][1].split()[-1]
        self.port = int(re.search(r":(\d+)/", address)[1])  # type: ignore[index]
        self.token = address.partition("#token=")[2]
        self._number = 0

    def stop(self, run: str) -> tuple[int, int, str]:
        """Press STOP; return when it was pressed and when that was answered, ns, and the answer."""
        pressed = time.monotonic_ns()
        words = self._post("/command", {"page": "", "run": run, "command": "stop"})
        return pressed, time.monotonic_ns(), words

    def _post(self, path: str, body: Mapping[str, object]) -> str:
        self._number += 1
        host = f"127.0.0.1:{self.port}"
        connection = http.client.HTTPConnection(host, timeout=10.0)
        heads = {
            "Origin": f"http://{host}",
            "Authorization": f"Bearer {self.token}",
            "Content-Type": "application/json",
        }
        connection.request("POST", path, json.dumps({**body, "number": self._number}), heads)
        words = connection.getresponse().read().decode()
        connection.close()
        return words

    def watch(self, ending: threading.Event, counts: list[int]) -> None:
        """Read all that a page without the token is sent until the event; add its bytes to
        ``counts``.
        """
        host = f"127.0.0.1:{self.port}"
        with socket.create_connection(("127.0.0.1", self.port)) as page:
            key = base64.b64encode(os.urandom(16)).decode()
            page.sendall(
                f"GET /live HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n"
                f"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
                f"Sec-WebSocket-Key: {key}\r\n\r\n".encode()
            )
            page.recv(4096)
            for message in ({"token": ""}, {"window_s": 30, "pixels": 500}):
                page.sendall(_frame(json.dumps(message).encode()))
            count = 0
            while not ending.is_set():
                if select.select([page], [], [], 0.5)[0]:
                    count += len(page.recv(1 << 16))
        counts.append(count)

    def crowd(self, kind: str, count: int, token: str, ending: threading.Event) -> None:
        """Keep many connections open until the event, each opened again when it is closed.

        Args:
            kind: ``idle``: nothing is sent; ``requests``: the list of runs is requested again and
                again; else a page, which reads all that it is sent.
            count: Number of connections.
            token: Token of the pages, or empty.
            ending: Ends the crowd.
        """
        host = f"127.0.0.1:{self.port}"
        head = f"Host: {host}\r\nOrigin: http://{host}\r\n"
        request = f"GET /recorded HTTP/1.1\r\n{head}\r\n".encode()
        upgrade = (
            f"GET /live HTTP/1.1\r\n{head}Upgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n\r\n"
        ).encode() + _frame(json.dumps({"token": token}).encode())
        said = {"idle": b"", "requests": request}.get(kind, upgrade)
        closed: collections.deque[float] = collections.deque([0.0] * count)
        with selectors.DefaultSelector() as open_:
            while not ending.is_set():
                # A browser opens a connection again half a second after it was closed.
                while closed and closed[0] < time.monotonic() - 0.5 and not ending.is_set():
                    closed.popleft()
                    try:
                        made = socket.create_connection(("127.0.0.1", self.port), timeout=1.0)
                        made.sendall(said)
                    except OSError:
                        closed.append(time.monotonic())
                        continue
                    made.setblocking(False)
                    open_.register(made, selectors.EVENT_READ)
                for key, _ in open_.select(0.1):
                    connection = key.fileobj
                    assert isinstance(connection, socket.socket)
                    data = b""
                    with suppress(OSError):
                        data = connection.recv(1 << 16)
                        if data and kind == "requests":
                            connection.sendall(said)
                    if not data:
                        open_.unregister(connection)
                        connection.close()
                        closed.append(time.monotonic())
                time.sleep(0.02)
            for key in list(open_.get_map().values()):
                connection = key.fileobj
                assert isinstance(connection, socket.socket)
                connection.close()


def _frame(data: bytes) -> bytes:
    """Return a text frame of a client, RFC 6455, masked with zeros."""
    head = bytes([0x81, 0x80 | len(data)]) if len(data) < 126 else b"\x81\xfe"
    head += len(data).to_bytes(2) if len(data) >= 126 else b""
    return head + bytes(4) + data
