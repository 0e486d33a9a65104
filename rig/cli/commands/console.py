"""``rig console``: shows and commands runs in a browser."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import click

from rig.cli.entry import DONE
from rig.common.places import require_folder
from rig.config.bench import load_bench
from rig.config.configuration import names
from rig.console.starting import Starter

PORT = 8736
DEFAULT_BENCH = "practical"


@click.command("console")
@click.argument("benches", metavar="[BENCH]...", nargs=-1)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=PORT,
    show_default=True,
    help="Port on this computer; 0 for a free port.",
)
@click.option(
    "--runs",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("runs"),
    show_default=True,
    help="Folder for runs that are started from the page; the page lists the runs in this folder.",
)
def command(benches: tuple[str, ...], port: int, runs: Path) -> int:
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
        serve(starter, shown, port, _announce)
    return DONE


def _announce(address: str) -> None:
    click.echo(f"console: {address}")
