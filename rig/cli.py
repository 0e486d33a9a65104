"""The ``rig`` command: finds its subcommands when they are asked for, and turns errors into exit statuses."""

from __future__ import annotations

import gc
import importlib
import logging
import os
import sys
from collections.abc import Mapping

import click

from drivers.errors import DeviceError
from rig.allocation import keep_freed_memory
from rig.errors import InputError, InUseError, StorageError

COMMANDS: Mapping[str, tuple[str, str]] = {
    "run": ("rig.commands.run:command", "Run a sequence on a bench."),
    "resume": ("rig.commands.resume:command", "Go on with a run that stopped."),
    "jog": ("rig.commands.jog:command", "Move a bench by hand, at low limits."),
    "check": ("rig.commands.check:command", "Connect to a bench and read it back; nothing moves."),
    "identify": ("rig.commands.identify:command", "Identify friction and inertia from a run or a campaign."),
    "simulate": ("rig.commands.simulate:command", "Predict recordings with a fitted model, and compare."),
    "diagnose": ("rig.commands.diagnose:command", "Say what physics was left out, and model it."),
    "effects": ("rig.commands.effects:command", "List the effects that a diagnosis can name."),
    "paper": ("rig.commands.paper:command", "Reproduce the paper's tables and figures."),
    "prove": ("rig.commands.prove:command", "Prove the diagnosis blind on rigs that hide physics."),
    "export": ("rig.commands.export:command", "Convert recordings for other tools."),
    "recover": ("rig.commands.recover:command", "Mend a run whose writer died."),
}
"""Name to module and attribute, and the line shown by ``rig --help`` without importing them."""

_SILENCE = logging.NullHandler()
GARBAGE_THRESHOLD = 200_000
"""Allocations between two garbage collections. What importing allocates stays for good, and the default of 700 would
walk over it again and again: a tenth of a second of every command."""

DONE, BAD_VERDICT, BAD_INPUT, STOPPED, DEVICE_FAILED, CRASHED = 0, 1, 2, 3, 4, 5


class LazyGroup(click.Group):
    """A group that imports a subcommand only when it is called, so that ``rig --help`` stays quick."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one subcommand."""
        if cmd_name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[cmd_name][0].partition(":")
        command = getattr(importlib.import_module(module), attribute)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the subcommands from the table, importing none."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="loadrig", prog_name="rig")
@click.option("--verbose", is_flag=True, help="Show what the bus libraries log.")
def cli(verbose: bool) -> None:
    """Run, identify and diagnose a hardware-in-the-loop load rig.

    \b
    Example:
      rig run figure10 --yes --out runs/demo
      rig identify runs/demo
    """
    if verbose:
        logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
    else:
        # Whatever matters of it comes as an error in this program's own words; without a handler it would be printed.
        for name in ("can", "canopen"):
            logging.getLogger(name).addHandler(_SILENCE)


def main() -> None:
    """Entry point: run the command line and exit with its status.

    Worker threads of the linear algebra would spin beside the control loop, and make sums depend on their number; the
    matrices here are too small to need them. Freezing spares the interpreter a last walk over everything as it exits.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(GARBAGE_THRESHOLD)
    keep_freed_memory()
    code = status(sys.argv[1:])
    gc.freeze()
    sys.exit(code)


def status(arguments: list[str]) -> int:
    """Run the command line and return its exit status; errors the user can act on become words on stderr."""
    try:
        result = cli.main(arguments, prog_name="rig", standalone_mode=False)
    except click.exceptions.Exit as error:
        return error.exit_code
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except InputError as error:
        for problem in error.problems:
            click.echo(problem, err=True)
        return BAD_INPUT
    except (KeyboardInterrupt, click.Abort):
        click.echo("stopped by the operator", err=True)
        return STOPPED
    except InUseError as error:
        click.echo(f"in use: {error}", err=True)
        return DEVICE_FAILED
    except DeviceError as error:
        click.echo(f"device error: {error}", err=True)
        return DEVICE_FAILED
    except StorageError as error:
        click.echo(f"storage error: {error}", err=True)
        return DEVICE_FAILED
    return result if isinstance(result, int) else DONE
