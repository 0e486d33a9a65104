"""Serves the console on this computer's loopback address."""

from __future__ import annotations

import socket
from collections.abc import Callable

import uvicorn

from rig.common.errors import InputError
from rig.console.app import Console
from rig.console.gate import BURST, QUEUE, Token, bounded
from rig.console.hub import Hub
from rig.console.starting import Starter

HOST = "127.0.0.1"


def serve(
    starter: Starter, only: frozenset[str], port: int, announce: Callable[[str], None]
) -> None:
    """Serve the console until SIGINT or SIGTERM.

    Args:
        starter: Starts runs.
        only: Names of the benches whose runs are shown; empty for all.
        port: Port, or 0 for a free port.
        announce: Called with the address, including the token, when the address can be opened.

    Raises:
        InputError: The port is in use.
        OSError: The control sockets cannot be used.
    """
    with _listening(port) as listener:
        port = listener.getsockname()[1]
        token = Token()
        hosts = frozenset({f"{HOST}:{port}", f"localhost:{port}"})
        console = Console(Hub(starter, only), token, hosts)
        config = uvicorn.Config(
            console.app,
            log_level="warning",
            access_log=False,
            ws="wsproto",
            http=bounded(),
            backlog=BURST,
            loop="asyncio",
            timeout_graceful_shutdown=1,
            server_header=False,
            date_header=False,
        )
        announce(f"http://{HOST}:{port}/#token={token.text}")
        server = _Server(config)

        def end() -> None:
            server.should_exit = True

        console.broken = end
        server.run(sockets=[listener])
        if console.failure is not None:
            raise console.failure


class _Server(uvicorn.Server):
    """Server whose queue in the system is longer than the burst that it accepts at once."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start to serve."""
        await super().startup(sockets)
        for listener in sockets or ():
            listener.listen(QUEUE)


def _listening(port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((HOST, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise InputError(
            f"port {port}: {error.strerror}; another console may use this port; give --port 0 "
            "for a free port"
        ) from error
    return listener
