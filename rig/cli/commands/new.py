"""``rig new``: writes bench, sequence and campaign files to start from."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import click

from rig.cli.authoring import bench as benches
from rig.cli.authoring import campaign as campaigns
from rig.cli.authoring import sequence as sequences
from rig.cli.authoring.campaign import OPTIONS as CAMPAIGN_OPTIONS
from rig.cli.authoring.questions import Answers, ask_all, assumed, options
from rig.cli.authoring.writing import RefusedError, require_new, write_new
from rig.config.bench import load_bench
from rig.config.campaign import load_campaign
from rig.config.sequence import load_sequence
from rig.terminal.prompt import Asker, Prompt
from rig.terminal.screen import Screen

_PATH = click.argument("path", type=click.Path(path_type=Path))
_YES = click.option(
    "--yes",
    is_flag=True,
    help="Ask no questions: values that no option gives have their defaults.",
)

_DATA_SHEET = (
    "torque_constant",
    "resistance",
    "inductance",
    "gear_ratio",
    "rated_current",
    "motor_counts",
    "moment_arm",
)
"""Answers of `rig new bench` that are properties of the machine."""


@click.group("new")
def command() -> None:
    """Write a bench, sequence or campaign file to start from, after a few questions or from
    options.

    A comment explains every key of the file. The first line of the file names a JSON Schema, which
    is written to the folder schemas next to the file; editors use the schema to complete and check
    the file.

    \b
    Example:
      rig new bench bench.yaml
      rig new sequence sequence.yaml --bench bench.yaml
      rig new campaign campaign.yaml log_0kg.csv log_5kg.csv
    """


@contextmanager
def _terminal(yes: bool) -> Iterator[tuple[Asker | None, Callable[[str], None]]]:
    """Yield the object that asks questions (None if the defaults are used) and the object that
    shows messages.
    """
    with closing(Screen()) as screen:
        yield None if yes else Prompt(screen), screen.say


def _name(path: Path) -> str:
    """Return a name for a file's content: letters, digits, dot, dash and underscore."""
    return "".join(c if c.isascii() and (c.isalnum() or c in "._-") else "-" for c in path.stem)


@command.command("bench")
@_PATH
@options(benches.QUESTIONS)
@_YES
def bench(path: Path, yes: bool, **given: Any) -> None:
    """Write a bench file to PATH. The command asks for every value that no option gives, and
    proposes a default.

    The machine of a simulated bench has the values of the file, with friction in proportion to the
    torque limit, so that sequences can be tried before there is hardware.

    \b
    Example:
      rig new bench bench.yaml --drive canopen --torque-constant 0.0259 --gear-ratio 51 --supply 24
      rig new bench bench.yaml --yes --lever-ratio 1 --weights 2,5
    """
    require_new(path, "bench")
    with _terminal(yes) as (asker, tell):
        answers, written = _until_valid(
            lambda before: ask_all(benches.QUESTIONS, given, asker, tell, before),
            lambda found: write_new(
                path, "bench", benches.bench_text(_name(path), found), load_bench
            ),
            given,
            asker,
            tell,
        )
        for remark in benches.remarks(answers):
            tell(remark)
        if yes and (note := assumed(benches.QUESTIONS, given, answers, _DATA_SHEET)):
            tell(note)
    _say(written, f"rig check {path}")


@command.command("sequence")
@_PATH
@options(sequences.QUESTIONS)
@click.option(
    "--bench",
    "bench_name",
    metavar="BENCH",
    help="Bench file or packaged name whose limits the sequence must keep.",
)
@_YES
def sequence(path: Path, bench_name: str | None, yes: bool, **given: Any) -> None:
    """Write a sequence file to PATH, with one sine in each stage: one stage with the empty lever,
    and one stage for each weight.

    \b
    Example:
      rig new sequence sequence.yaml --bench bench.yaml --weights 2,5 --amplitude 15 --frequency 0.3
    """
    require_new(path, "sequence")
    limits = None if bench_name is None else load_bench(bench_name)
    with _terminal(yes) as (asker, tell):
        _, written = _until_valid(
            lambda before: ask_all(sequences.QUESTIONS, given, asker, tell, before),
            lambda found: write_new(
                path,
                "sequence",
                sequences.sequence_text(_name(path), found),
                lambda draft: sequences.load_for(limits, draft),
            ),
            given,
            asker,
            tell,
        )
    load_sequence(path)
    _say(written, f"rig run {path} --bench {bench_name or 'BENCH'} --dry-run")


@command.command("campaign")
@_PATH
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@options(CAMPAIGN_OPTIONS)
@_YES
def campaign(path: Path, files: tuple[Path, ...], yes: bool, **given: Any) -> None:
    """Write a campaign file to PATH that describes FILES, which are recordings made elsewhere.

    The command reads the columns from the files and proposes a channel for each column, with a
    scale to SI if a name states a unit. A mass in a file's name, such as log_5kg.csv, is used as
    the mass on the lever. On a linear bench, units are m instead of rad and N instead of N m.

    \b
    Example:
      rig new campaign campaign.yaml log_0kg.csv log_5kg.csv --current i_meas --lever-ratio 1
      rig new campaign slide.yaml a.csv b.csv --motion linear --terms offset --validate b.csv
    """
    require_new(path, "campaign")
    tables = campaigns.read_names(files)
    with _terminal(yes) as (asker, tell):
        _, written = _until_valid(
            lambda before: campaigns.answer(tables, given, asker, tell, before),
            lambda found: write_new(
                path, "campaign", campaigns.campaign_text(path, tables, found), load_campaign
            ),
            given,
            asker,
            tell,
        )
    _say(written, f"rig identify {path}")


def _until_valid(
    ask: Callable[[Answers], Answers],
    write: Callable[[Answers], list[Path]],
    given: Mapping[str, Any],
    asker: Asker | None,
    tell: Callable[[str], None],
) -> tuple[Answers, list[Path]]:
    """Ask until the answers give a valid file; return the answers and the written files.

    Args:
        ask: Returns answers; takes earlier answers as defaults.
        write: Writes the file.
        given: Answers given as options.
        asker: Asks again, or None if nobody can be asked.
        tell: Shows why answers were refused.

    Raises:
        RefusedError: The answers give no valid file, and no answer to a question can change this.
    """
    answers: Answers = {}
    while True:
        answers = ask(answers)
        try:
            return answers, write(answers)
        except RefusedError as error:
            if asker is None or all(given.get(name) is not None for name in answers):
                raise
            for line in error.problems:
                tell(line)
            tell("The questions are asked again; your answers are now the defaults.")


def _say(written: list[Path], following: str) -> None:
    """Print the written files, and the next command."""
    for path in written:
        click.echo(f"wrote {path}")
    click.echo(f"next: {following}")
