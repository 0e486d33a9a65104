"""``rig watch``: shows a recording in other tools, during the run or later."""

from __future__ import annotations

import asyncio
import secrets
from pathlib import Path
from urllib.parse import urlencode

import click

from rig.cli import options as shared
from rig.cli.entry import DONE
from rig.common.errors import InputError
from rig.runs.live import HOST, Offer, layout, serve
from rig.runs.run_file import read_record
from rig.runs.run_record import RunRecord

PORT = 8765
_NO_TOKEN = (
    "no token, because PlotJuggler's client accepts only a host and a port; while the recording is "
    "served, every program on this computer can read it (pages in a browser cannot)"
)


@click.command("watch")
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--foxglove", is_flag=True, help="Serve over Foxglove's WebSocket.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=PORT,
    show_default=True,
    help="Port on this computer; 0 for a free port.",
)
@click.option(
    "--no-token",
    is_flag=True,
    help="Require no token in the address, because PlotJuggler cannot send a token.",
)
@click.option(
    "--last",
    metavar="SECONDS",
    type=shared.Number(min=0.0),
    help="Send only the last SECONDS of the existing part of the recording. [default: all]",
)
@click.option(
    "--part",
    type=click.IntRange(min=1),
    help="Number of the recording of a resumed run. [default: the newest]",
)
def command(
    run: Path, foxglove: bool, port: int, no_token: bool, last: float | None, part: int | None
) -> int:
    """Serve the recording of RUN to Foxglove or PlotJuggler until Ctrl-C.

    The recording of a run in progress is sent as it grows; a finished recording is sent as fast as
    the tool reads it. Each subscriber receives a topic from its beginning. The tools cannot command
    the run, and only programs on this computer can connect.

    \b
    Topics:
      /sample   every field of a sample, SI units
      /event    events, JSON (Foxglove only)
      /can      raw CAN frames, as can_msgs/msg/Frame
      /serial   raw bytes of serial lines

    \b
    Example:
      rig watch runs/demo --foxglove
      rig watch runs/demo --foxglove --no-token   (for PlotJuggler)
    """
    if not foxglove:
        raise InputError("rig watch: no protocol is chosen; add --foxglove")
    record = read_record(run)
    number = _number(run, record, part)
    recording = run / record.parts[number - 1].file
    if not recording.is_file():
        raise InputError(f"{recording}: no such file; the run folder is incomplete")
    offer = Offer(
        recording=recording,
        name=_name(run, record, number),
        token=None if no_token else secrets.token_urlsafe(16),
        last_s=last,
    )
    try:
        asyncio.run(serve(offer, port, lambda bound: _announce(offer, record, bound)))
    except KeyboardInterrupt:
        click.echo("no longer served")
    except OSError as error:
        raise InputError(
            f"--port: {port} cannot be used ({error.strerror}); give another port, or 0 for a "
            "free port"
        ) from error
    return DONE


def _number(run: Path, record: RunRecord, part: int | None) -> int:
    count = len(record.parts)
    if part is not None and part > count:
        have = "1 recording" if count == 1 else f"{count} recordings"
        raise InputError(f"--part: {run} has {have} (got {part})")
    return part or count


def _name(run: Path, record: RunRecord, number: int) -> str:
    bench = "simulated" if record.simulated else "REAL"
    part = f", recording {number}" if len(record.parts) > 1 else ""
    return f"{record.name} in {run} ({bench} bench{part})"


def _announce(offer: Offer, record: RunRecord, port: int) -> None:
    """Print the address for each tool, and the paths of the layouts."""
    query = "" if offer.token is None else "/?" + urlencode({"token": offer.token})
    address = f"ws://{HOST}:{port}{query}"
    state = "followed as it grows" if record.state == "running" else f"ended: {record.state}"
    click.echo(f"{offer.name}: {state}")
    click.echo(f"Foxglove:    open connection, Foxglove WebSocket, {address}")
    click.echo(f"             layout: {layout('foxglove')}")
    if offer.token is None:
        click.echo(f"PlotJuggler: streaming, Foxglove ROS2 Bridge, address {HOST}, port {port}")
        click.echo(f"             layout: {layout('plotjuggler')}")
        click.echo(_NO_TOKEN)
    else:
        click.echo("PlotJuggler: its client cannot send a token; give this command --no-token")
    click.echo("read only; Ctrl-C ends this command")
