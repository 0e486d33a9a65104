"""``rig console``: shows and commands runs in a browser."""

from __future__ import annotations

import asyncio
import secrets
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlencode

import click

from rig.cli import options as shared
from rig.cli.entry import DONE
from rig.common.errors import InputError
from rig.common.places import require_folder
from rig.config.bench import load_bench
from rig.config.configuration import names
from rig.console.starting import Starter
from rig.runs.live import HOST, Offer, layout, serve
from rig.runs.run_file import read_record
from rig.runs.run_record import RunRecord

PORT = 8736
DEFAULT_BENCH = "practical"


@click.command("console")
@click.argument("benches", metavar="[BENCH]...", nargs=-1)
@shared.port(PORT)
@shared.path(
    "--runs",
    "Folder for runs that are started from the page; the page lists the runs in this folder.",
    type=shared.FOLDER,
    default=Path("runs"),
)
def console(benches: tuple[str, ...], port: int, runs: Path) -> int:
    """Watch, stop and pause runs on a page, answer their prompts, and start new runs on BENCH, a
    bench file or the name of a packaged bench; without BENCH, on any packaged bench.

    The command prints the address of the page, which only this computer can open, and serves the
    page until Ctrl-C. The address contains a token that is valid until this command ends; without
    the token the page is read-only. Runs go on when the page or this command ends. STOP in the page
    is a stop function in software, not an emergency stop.

    \b
    Example:
      rig console
      rig console bench.yaml --runs runs
    """
    require_folder(runs, "--runs")
    shown = frozenset(load_bench(bench).value.name for bench in benches)
    from rig.console.app import serve  # the server is imported only where it is needed

    click.echo("STOP in the page is a software stop, not an emergency stop.")
    # The bench that `rig run` takes by default is offered first.
    packaged = sorted(names("benches"), key=lambda name: name != DEFAULT_BENCH)
    starter = Starter(benches or tuple(packaged), runs)
    # Ctrl-C is the ordinary end.
    with suppress(KeyboardInterrupt):
        serve(starter, shown, port, lambda address: click.echo(f"console: {address}"))
    return DONE


FOXGLOVE_PORT = 8765
_NO_TOKEN = (
    "no token, because PlotJuggler's client accepts only a host and a port; while the recording is "
    "served, every program on this computer can read it (pages in a browser cannot)"
)


@click.command("watch")
@click.argument("run", type=shared.PATH)
@shared.flag("--foxglove", "Serve over Foxglove's WebSocket.")
@shared.port(FOXGLOVE_PORT)
@shared.flag(
    "--no-token", "Require no token in the address, because PlotJuggler cannot send a token."
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
def watch(
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
    count = len(record.parts)
    if part is not None and part > count:
        have = "1 recording" if count == 1 else f"{count} recordings"
        raise InputError(f"--part: {run} has {have} (got {part})")
    number = part or count
    recording = run / record.parts[number - 1].file
    if not recording.is_file():
        raise InputError(f"{recording}: no such file; the run folder is incomplete")
    bench = "simulated" if record.simulated else "REAL"
    shown = f"{bench} bench, recording {number}" if count > 1 else f"{bench} bench"
    offer = Offer(
        recording=recording,
        name=f"{record.name} in {run} ({shown})",
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
