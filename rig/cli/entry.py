"""The ``rig`` command: imports subcommands on demand, and turns errors into exit statuses."""

from __future__ import annotations

import gc
import importlib
import logging
import os
import stat
import sys
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Self

import click
from click.shell_completion import CompletionItem

from rig.cli import crash
from rig.common.errors import InputError, InUseError, StorageError
from rig.terminal.output import Streams, complain
from rig.terminal.stop_button import ignore_stops

COMMANDS: Mapping[str, tuple[str, str]] = {
    "new": ("new", "Write a bench, sequence or campaign file to start from."),
    "run": ("run", "Run a sequence on a bench."),
    "resume": ("run", "Continue a run that stopped."),
    "off": ("bench", "Make a bench safe, whoever uses it."),
    "jog": ("bench", "Move a bench by hand, at low limits."),
    "watch": ("console", "Show a recording live in Foxglove or PlotJuggler."),
    "commission": ("commission", "Go through a new bench with the operator, step by step."),
    "check": ("bench", "Connect to a bench and read its values; nothing moves."),
    "response": ("response", "Measure the frequency response of a bench, and its margins."),
    "tune": ("response", "Propose gains of the drive for stated margins."),
    "identify": ("identify", "Identify friction and inertia from a run or a campaign."),
    "simulate": ("identify", "Predict recordings with a fitted model, and compare."),
    "diagnose": ("diagnose", "Find physics that the model lacks, and add it to the model."),
    "investigate": (
        "investigate",
        "Choose and run experiments until the missing physics is named.",
    ),
    "design": ("investigate", "Propose the next experiment for recorded runs; run nothing."),
    "model": ("diagnose", "Write a fitted model for other tools."),
    "effects": ("diagnose", "List the effects of a diagnosis."),
    "paper": ("prove", "Reproduce the paper's tables and figures."),
    "prove": ("prove", "Test the diagnosis on blind trials with injected effects."),
    "runs": ("runs", "List, show, compare and accept recorded runs."),
    "look": ("look", "Show the content of a log made elsewhere."),
    "export": ("export", "Convert recordings for other tools."),
    "recover": ("export", "Repair a run whose writer died."),
    "console": ("console", "Watch, stop and start runs on a page in the browser."),
    "schema": ("new", "Write JSON Schemas, by which editors complete and check files."),
}
"""Module of :mod:`rig.cli.commands` and help line of each command, which is a function of this name
there; ``rig --help`` imports none of the modules.
"""

_SILENCE = logging.NullHandler()
GARBAGE_THRESHOLD = 200_000
"""Number of allocations between two garbage collections.

Imported objects are never freed; with the default of 700, repeated scans of these objects would
take a tenth of a second in every command.
"""

DONE, BAD_VERDICT, BAD_INPUT, STOPPED, DEVICE_FAILED, CRASHED = 0, 1, 2, 3, 4, 5
"""Exit statuses. Status 4 is also used if a file cannot be written."""


class _HiddenError(Exception):
    """Wraps an error that click would otherwise handle, so that the error reaches the caller."""

    def __init__(self, hidden: Exception) -> None:
        super().__init__(str(hidden))
        self.hidden = hidden


class LazyGroup(click.Group):
    """A group that imports a subcommand only when it is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one subcommand."""
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"rig.cli.commands.{COMMANDS[cmd_name][0]}")
        command = getattr(module, cmd_name)
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the subcommand; the error for an unknown name suggests the nearest name."""
        if args[0] not in COMMANDS and not args[0].startswith("-"):
            # Imported here, because only this error needs it.
            from rig.config.configuration import nearest

            raise click.UsageError(
                f"no such command {args[0]!r}; {nearest(args[0], list(COMMANDS))}", ctx
            )
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete subcommands from the table, without an import, and options."""
        names = [
            CompletionItem(name, help=text)
            for name, (_, text) in COMMANDS.items()
            if name.startswith(incomplete)
        ]
        return names + click.Command.shell_complete(self, ctx, incomplete)

    def invoke(self, ctx: click.Context) -> object:
        """Run the subcommand; errors that click would take for Ctrl-C or a closed output pass."""
        try:
            return super().invoke(ctx)
        except (EOFError, OSError) as error:
            raise _HiddenError(error) from error

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the subcommands of :data:`COMMANDS` without an import of their modules."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


_SETTINGS = {"help_option_names": ["-h", "--help"], "show_default": True}


@click.group(cls=LazyGroup, context_settings=_SETTINGS)
@click.version_option(package_name="loadrig", prog_name="rig")
@click.option("--verbose", is_flag=True, help="Show what the libraries log.")
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
        # This program reports every important problem as its own error; without a handler, the logs
        # of the libraries would be printed. matplotlib warns of folders that cannot be written and
        # continues without these folders.
        for name in ("can", "canopen", "matplotlib"):
            logging.getLogger(name).addHandler(_SILENCE)


def find_kernel_folder() -> None:
    """Give numba, before its import, a private folder if it could cache nowhere else."""
    if os.name != "posix":
        return
    home = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    existing = next((path for path in (home, *home.parents) if path.exists()), home)
    if any(
        os.access(path, os.W_OK, effective_ids=os.access in os.supports_effective_ids)
        for path in (Path(__file__).parent, existing)
    ):
        return
    private = Path(tempfile.gettempdir()) / f"loadrig-kernels-{os.geteuid()}"
    with suppress(OSError):
        private.mkdir(mode=0o700, exist_ok=True)
        found = private.lstat()
        # Machine code is executed; no other user may be able to write it.
        mine = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
        if mine and not found.st_mode & 0o077:
            os.environ.setdefault("NUMBA_CACHE_DIR", str(private))


def main() -> None:
    """Entry point: run the command line and exit with its status.

    Linear algebra runs in one thread: worker threads would load the processor during the control
    loop and make sums depend on the number of threads, and the matrices are small. Freezing the
    objects in memory avoids a last garbage collection at exit.
    """
    streams = Streams()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A handler that cannot write must not print a traceback of its own.
    logging.raiseExceptions = False
    gc.set_threshold(GARBAGE_THRESHOLD)
    find_kernel_folder()
    arguments = sys.argv[1:]
    with _Threads(arguments) as threads:
        try:
            code = status(arguments)
        except KeyboardInterrupt:
            # Ctrl-C was pressed again while the first message was printed.
            code = STOPPED
        if code == STOPPED:
            ignore_stops()
    if threads.broken:
        code = code or CRASHED
    lost = streams.finish()
    if lost is not None:
        complain(f"storage error: {lost}; the command itself ended with status {code}")
        code = code or DEVICE_FAILED
    gc.freeze()
    sys.exit(code)


def status(arguments: list[str]) -> int:
    """Run the command line and return its exit status; every error becomes a message on stderr."""
    try:
        result = cli.main(arguments, prog_name="rig", standalone_mode=False)
    except click.exceptions.Exit as error:
        return error.exit_code
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except InputError as error:
        return _ended(error, "\n".join(error.problems), BAD_INPUT)
    except (KeyboardInterrupt, click.Abort) as error:
        return _ended(error, "stopped by the operator", STOPPED)
    except InUseError as error:
        return _ended(error, f"in use: {error}", DEVICE_FAILED)
    except _device_errors() as error:
        return _ended(error, f"device error: {error}", DEVICE_FAILED)
    except StorageError as error:
        return _ended(error, f"storage error: {error}", DEVICE_FAILED)
    except SystemExit:
        raise
    except _HiddenError as error:
        return _broke_down(error.hidden, arguments)
    except BaseException as error:  # noqa: BLE001 - without it, an operator would see a traceback
        return _broke_down(error, arguments)
    return result if isinstance(result, int) else DONE


def _device_errors() -> tuple[type[BaseException], ...]:
    """Return the base class of the device errors, or nothing if no driver was imported."""
    errors = sys.modules.get("drivers.errors")
    return () if errors is None else (errors.DeviceError,)


def _broke_down(error: BaseException, arguments: list[str]) -> int:
    """Report an unexpected exception, or a full disk as a storage error. Return the exit status."""
    words = crash.storage_words(error) if isinstance(error, OSError) else None
    if words is not None:
        return _ended(error, f"storage error: {words}", DEVICE_FAILED)
    complain(crash.report(error, arguments, _command(arguments)))
    return CRASHED


class _Threads:
    """Reports errors of other threads without a traceback; ``broken`` if a result is missing."""

    def __init__(self, arguments: list[str]) -> None:
        self.broken = False
        self._arguments = arguments

    def __enter__(self) -> Self:
        """Install the hooks of the interpreter."""
        threading.excepthook = self._in_thread
        sys.unraisablehook = self._ignored
        return self

    def __exit__(self, *exception: object) -> None:
        """Restore the hooks of the interpreter."""
        threading.excepthook, sys.unraisablehook = threading.__excepthook__, sys.__unraisablehook__

    def _in_thread(self, failure: threading.ExceptHookArgs) -> None:
        self.broken = True
        if failure.exc_value is not None:
            complain(crash.report(failure.exc_value, self._arguments, _command(self._arguments)))

    def _ignored(self, failure: sys.UnraisableHookArgs) -> None:
        logging.getLogger(__name__).info("ignored: %r in %r", failure.exc_value, failure.object)


def _ended(error: BaseException, words: str, code: int) -> int:
    """Print why a command ended and, if known, how the drive was left."""
    complain(words)
    drive = crash.drive_words(error)
    if drive is not None:
        complain(drive)
    return code


def _command(arguments: list[str]) -> str:
    return next((argument for argument in arguments if argument in COMMANDS), "")
