"""``rig runs``: lists, shows, compares, studies and accepts recorded runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import date, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli import options as shared
from rig.cli.entry import BAD_VERDICT, DONE
from rig.common.errors import InputError
from rig.common.places import require_folder, write_asked
from rig.runs.catalogue.entry import VERDICTS, time_of

if TYPE_CHECKING:
    from rig.config.acceptance import Limit
    from rig.results.document import Document
    from rig.runs.catalogue.entry import Entry

    _Time = click.ParamType[datetime]
else:
    _Time = click.ParamType

DEFAULT_FOLDER = Path("runs")


class _Day(_Time):
    """A date or a time in UTC; with ``last``, a date stands for the end of the day."""

    name = "date"

    def __init__(self, *, last: bool) -> None:
        self._last = last

    def convert(self, value: Any, param: Any, ctx: Any) -> datetime:
        """Return the time."""
        found = time_of(value)
        if found is None:
            self.fail(f"{value!r} is no date; write 2026-11-27 or 2026-11-27T08:30", param, ctx)
        with suppress(ValueError, OverflowError):
            if self._last and date.fromisoformat(value):
                found += timedelta(days=1)
        return found


_FILTERS = (
    click.option(
        "--bench", metavar="NAME", help="Only runs of this bench; * and ? stand for any text."
    ),
    click.option("--sequence", metavar="NAME", help="Only runs of this sequence."),
    click.option("--operator", metavar="NAME", help="Only runs of this operator."),
    click.option(
        "--weight",
        "weight_kg",
        metavar="KG",
        type=shared.Number(min=0),
        help="Only runs with this mass on the lever.",
    ),
    click.option(
        "--verdict", type=click.Choice(VERDICTS), help="Only runs with this ending or verdict."
    ),
    click.option(
        "--since", type=_Day(last=False), help="Only runs that began on this day or later (UTC)."
    ),
    click.option(
        "--until", type=_Day(last=True), help="Only runs that began on this day or before (UTC)."
    ),
)


def _filters(command: Any) -> Any:
    """Add the options that choose runs to a command."""
    for option in reversed(_FILTERS):
        command = option(command)
    return command


_last = click.option("--last", type=click.IntRange(min=1), metavar="N", help="Only the N latest.")
_folder = click.argument("folder", type=shared.FOLDER, default=DEFAULT_FOLDER)
_page = shared.out_folder("Also write a page with figures into this folder.")


@click.group("runs")
def runs() -> None:
    """List, show, compare, study and accept recorded runs.

    An index beside the run folders (.runs.index) makes a repeated command faster. The index can be
    deleted at any time; the output depends only on the folders.

    \b
    Example:
      rig runs list --since 2026-11-01 --verdict done
      rig runs show runs/demo
      rig runs accept runs/demo --acceptance limits.yaml
    """


@runs.command("list")
@_folder
@_filters
@_last
@_page
@shared.result_file
def list_(
    folder: Path, last: int | None, out: Path | None, json_file: Path | None, **given: Any
) -> None:
    """List the runs in and below FOLDER (`runs` if left out), the latest run last.

    A folder without a complete run is listed as half written, of another version, or unreadable,
    with a remedy.

    \b
    Example:
      rig runs list
      rig runs list --bench practical --weight 30.6
      rig runs list archive --operator Ada --json runs.json
    """
    from rig.results.catalogue.listing import listing_document, listing_record
    from rig.runs.catalogue.entry import latest

    entries, wanted = _chosen(folder, given)
    shown = latest(wanted, last)
    hidden, earlier = len(entries) - len(wanted), len(wanted) - len(shown)
    write_asked(json_file, listing_record(folder, shown))
    _show(listing_document(folder, shown, hidden, earlier), out)


@runs.command("show")
@click.argument("run", type=shared.PATH)
@_page
@shared.result_file
def show(run: Path, out: Path | None, json_file: Path | None) -> None:
    """Show the data of one RUN: stages, weights, identified parameters with intervals, verdicts,
    pages.

    \b
    Example:
      rig runs show runs/demo
    """
    from rig.results.catalogue.listing import show_document, show_record

    entry = _one(run)
    write_asked(json_file, show_record(run, entry))
    _show(show_document(run, entry), out)


@runs.command("compare")
@click.argument("runs", nargs=-1, required=True, type=shared.PATH)
@_page
@shared.result_file
def compare(runs: tuple[Path, ...], out: Path | None, json_file: Path | None) -> None:
    """Compare RUNS: state, verdicts and measured values side by side, and the identified parameters
    with those of the first identified run.

    Measured values are tracking error, current, temperature, lateness and lost samples. Runs that
    are not identified are compared by these values only. A parameter has changed if the difference
    is larger than the 90 % interval of the difference. --out writes a page with the figures side by
    side.

    \b
    Example:
      rig runs compare runs/monday runs/friday --out compared
    """
    from rig.results.catalogue.compare import (
        Compared,
        compare_document,
        compare_record,
        figures_of,
        require_comparable,
    )

    if len(runs) < 2:
        raise click.UsageError("give two or more runs, which are compared with each other")
    found = [Compared(run, entry := _one(run), entry.parsed()) for run in runs]
    require_comparable(found)
    found = [replace(each, measured=figures_of(each.run)) for each in found]
    write_asked(json_file, compare_record(found))
    _show(compare_document(found), out)


@runs.command("trend")
@_folder
@_filters
@_last
@click.option(
    "--constant", metavar="NAME", help="Only this constant; the test accounts for all constants."
)
@shared.seed("Seed of the test's simulated distribution.")
@_page
@shared.result_file
def trend(
    folder: Path,
    last: int | None,
    constant: str | None,
    seed: int,
    out: Path | None,
    json_file: Path | None,
    **given: Any,
) -> None:
    """Follow each identified parameter over the runs of each bench in FOLDER, and test each
    parameter for a change.

    The command reports a drift, or a step from one run to the next, if the change is larger than
    the scatter of the runs and the intervals explain. At most one in 100 series of runs without a
    change gives a false report. If a parameter has a step at a run, the output names the devices
    that were replaced before that run.

    \b
    Example:
      rig runs trend
      rig runs trend --bench practical --since 2026-10-01 --out trend
      rig runs trend --constant Mc --last 30
    """
    from rig.results.catalogue.compare import histories, trend_document, trend_record
    from rig.runs.catalogue.entry import latest

    _, wanted = _chosen(folder, given)
    found = histories(folder, latest(wanted, last), seed, constant)
    if constant is not None and not found:
        raise InputError(
            f"{folder}: no identified run that the options choose has a constant {constant}; "
            "`rig runs trend` without --constant shows the constants"
        )
    write_asked(json_file, trend_record(found))
    _show(trend_document(found), out)


@runs.command("study")
@click.argument("folders", nargs=-1, type=click.Path(path_type=Path, file_okay=False))
@_filters
@_last
@shared.acceptance("those of the last run")
@shared.seed("Seed of the random draws for the intervals.")
@shared.out_folder("Also write a page into this folder.")
@shared.result_file
def study(
    folders: tuple[Path, ...],
    last: int | None,
    acceptance: Path | None,
    seed: int,
    out: Path | None,
    json_file: Path | None,
    **given: Any,
) -> None:
    """Study how far the constants of one unit repeat in the identified runs in FOLDERS (`runs` if
    left out): standard deviations within an operator's day, between operators and between days.

    Every standard deviation has a 90 % interval; the numbers of runs need not be equal. If a
    constant has acceptance limits, six standard deviations are compared with their distance. Choose
    runs of one unit with one sequence.

    \b
    Example:
      rig runs study --bench practical --sequence figure10 --since 2026-11-23
      rig runs study runs/monday runs/tuesday --json study.json
    """
    from rig.cli.accepting import stated_limits
    from rig.results.catalogue.study import studies, study_document, study_record
    from rig.runs.catalogue.entry import latest

    # A run that is in several of the folders counts once.
    wanted = {
        (folder / entry.folder).resolve(): replace(entry, folder=str(folder / entry.folder))
        for folder in folders or (DEFAULT_FOLDER,)
        for entry in _chosen(folder, given)[1]
    }
    entries = latest(sorted(wanted.values(), key=lambda entry: entry.head.created), last)

    def limits(run: Path) -> Sequence[Limit]:
        try:
            return stated_limits(run, acceptance)[0]
        except InputError as error:
            if acceptance is not None:
                raise
            click.echo(f"no tolerances: {error}", err=True)
            return ()

    found = studies(entries, limits, seed)
    if not found:
        raise InputError("no identified run is chosen; `rig identify RUN` identifies a run")
    write_asked(json_file, study_record(found, seed))
    _show(study_document(found), out)


@runs.command("accept")
@click.argument("run", type=shared.PATH)
@shared.acceptance("those of the run")
@shared.junit
@shared.result_file
def accept(
    run: Path, acceptance: Path | None, junit_file: Path | None, json_file: Path | None
) -> int:
    """Compare a finished RUN with acceptance limits, and write its certificate.

    The limits are those of --acceptance, else those of the file that was given to `rig run`, else
    those of the recorded sequence. If the limits need identified parameters or a diagnosis, and the
    run folder has no such result, RUN is identified or diagnosed. The command writes
    acceptance.json, certificate.html and SHA256SUMS into the run folder. The exit
    status is 1 if a limit is not met.

    \b
    Example:
      rig runs accept runs/demo --acceptance limits.yaml --junit junit.xml
    """
    from rig.cli.accepting import accept_run, limits_for
    from rig.common.locks import hold_folder
    from rig.wiring.devices import until_the_end

    _one(run)
    limits, source = limits_for(run, acceptance)
    until_the_end(hold_folder(run, "rig runs accept"))
    found = accept_run(run, limits, source, junit_file)
    write_asked(json_file, found.record)
    return DONE if found.accepted else BAD_VERDICT


def _chosen(folder: Path, given: Mapping[str, Any]) -> tuple[list[Entry], list[Entry]]:
    """Return all runs of a folder, and the runs that the options choose."""
    from rig.runs.catalogue.entry import Wanted, chosen
    from rig.runs.catalogue.index import list_runs
    from rig.terminal.output import ShareBar

    with ShareBar() as bar:
        listing = list_runs(folder, lambda done, of: bar("reading run folders", done / of))
    if listing.note:
        click.echo(f"note: {listing.note}", err=True)
    return listing.entries, chosen(folder, listing.entries, Wanted(**given))


def _one(run: Path) -> Entry:
    """Return the entry of one run folder."""
    from rig.runs.catalogue.index import list_runs, signature_of

    if signature_of(str(run)) is None:
        raise InputError(
            f"{run}: not a run folder: the folder has neither run.json nor recording.mcap"
        )
    return list_runs(run).entries[0]


def _show(document: Document, out: Path | None) -> None:
    """Print a document, and write its page if requested."""
    from rig.results.document import PAGE_FILE, text, write_page

    click.echo(text(document))
    if out is not None:
        require_folder(out, "--out")
        write_page(document, out / PAGE_FILE)
        click.echo(f"page: {out / PAGE_FILE}")
