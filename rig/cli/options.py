"""Options shared by several commands, each with one meaning and one type."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from rig.common.places import require_file
from rig.common.text import valid

Decorator = Callable[[Any], Any]
PATH = click.Path(path_type=Path)  # a file, or a folder
FILE = click.Path(path_type=Path, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)


class Number(click.FloatRange):
    """Type of every option that takes a real number: NaN and infinity are bad input.

    The comparisons of :class:`click.FloatRange` let NaN pass, and infinity where an end is open.
    """

    def __init__(
        self, min: float | None = None, max: float | None = None, min_open: bool = False
    ) -> None:
        super().__init__(min, max, min_open)
        if min is None and max is None:
            self.name = "float"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number

    def _describe_range(self) -> str:
        return "" if self.min is None and self.max is None else super()._describe_range()


def flag(name: str, words: str, *key: str) -> Decorator:
    """Return a decorator that adds an option without a value; ``key`` names its parameter."""
    return click.option(name, *key, is_flag=True, help=words)


def path(name: str, words: str, *key: str, type: click.Path = PATH, **more: Any) -> Decorator:
    """Return a decorator that adds an option that takes a path."""
    return click.option(name, *key, type=type, help=words, **more)


def _writable(context: click.Context, option: click.Parameter, path: Path | None) -> Path | None:
    """Refuse a file that cannot be written, before any work."""
    require_file(path, option.opts[0])
    return path


bench_name: Decorator = click.option(
    "--bench", default="practical", help="Bench file, or the name of a packaged bench."
)
realtime: Decorator = flag("--realtime", "Run the simulated bench in real time.")
result_file: Decorator = path(
    "--json", "Result file.", "json_file", type=FILE, metavar="FILE", callback=_writable
)
own_effects: Decorator = path(
    "--effects",
    "Python file with effects of one's own, which is run.",
    "effects_file",
    type=FILE,
    metavar="FILE.py",
)
partial: Decorator = flag(
    "--partial", "Also use the recorded part of the unfinished excitations of a stopped run."
)
yes: Decorator = flag(
    "--yes", "Answer the weight prompts as planned; refused with weights on a real bench."
)
in_console: Decorator = flag(
    "--console",
    "Ask the weight prompts in `rig console` only, for a run without a terminal.",
    "in_console",
)
wait: Decorator = click.option(
    "--wait",
    "wait_s",
    metavar="SECONDS",
    type=Number(min=0.0),
    default=0.0,
    help="Time to wait for a bench that another program uses. [default: do not wait]",
)
operator_name: Decorator = click.option(
    "--operator",
    "operator_name",
    metavar="NAME",
    type=valid,
    help="Name of the operator; stored with the recording.",
)
identification: Decorator = path(
    "--identification",
    "Accepted result of `rig identify --json` on this bench; the weight check uses the "
    "friction of this result.",
)
junit: Decorator = path(
    "--junit",
    "Also write the acceptance as JUnit XML.",
    "junit_file",
    type=FILE,
    metavar="FILE",
    callback=_writable,
)
first_pass: Decorator = click.option(
    "--first-pass/--no-first-pass",
    default=None,
    help="Run a first pass at 10 % amplitude before each stage. [default: on a real bench, "
    "and of rig run with --identification]",
)


def record_file(words: str) -> Decorator:
    """Return a decorator that adds ``--json`` for a copy of the record, as ``json_file``."""
    return path("--json", words, "json_file", callback=_writable)


def out_folder(words: str) -> Decorator:
    """Return a decorator that adds ``--out`` for the report folder."""
    return path("--out", words, type=FOLDER)


def port(default: int) -> Decorator:
    """Return a decorator that adds ``--port``."""
    words = "Port on this computer; 0 for a free port."
    return click.option("--port", type=click.IntRange(0, 65535), default=default, help=words)


def seed(words: str = "Seed of the random generator.") -> Decorator:
    """Return a decorator that adds ``--seed``."""
    return click.option("--seed", type=click.IntRange(min=0), default=0, help=words)


simulated_seed = seed("Seed of the simulated bench's noise.")


def bandwidth(words: str) -> Decorator:
    """Return a decorator that adds ``--bandwidth``, Hz."""
    return click.option(
        "--bandwidth", metavar="HZ", type=Number(min=0.0, min_open=True), help=words
    )


def acceptance(default: str) -> Decorator:
    """Return a decorator that adds ``--acceptance`` for a file of limits."""
    return path(
        "--acceptance",
        f"File of the acceptance limits for a complete run. [default: {default}]",
        type=FILE,
        metavar="FILE",
    )


def reset_fault(more: str = "") -> Decorator:
    """Return a decorator that adds ``--reset-fault``."""
    return flag(
        "--reset-fault", "Clear a fault of the drive; remove the cause of the fault first." + more
    )


def require_not_given(names: Collection[str], why: str) -> None:
    """Refuse options of the present command that were typed, by the names of its arguments.

    Raises:
        click.UsageError: One of them was typed; ``why`` ends the message.
    """
    context = click.get_current_context()
    typed = ParameterSource.COMMANDLINE
    given = [
        each.opts[0]
        for each in context.command.params
        if each.name in names and context.get_parameter_source(each.name) is typed
    ]
    if given:
        raise click.UsageError(f"{', '.join(given)}: {why}")
