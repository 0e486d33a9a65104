"""``rig export`` and ``rig recover``: recordings for other tools, runs whose writer died."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import click

from rig.cli import options as shared
from rig.cli.aftermath import seal_folder, write_page
from rig.cli.entry import DONE
from rig.common.errors import InputError
from rig.common.locks import hold_folder
from rig.common.places import is_file, replacing, require_file, source_name, usable, write_asked
from rig.common.tables import table
from rig.results.document import reading_notes
from rig.results.run.go_on import go_on_words
from rig.results.run.report import REPORT_FILE
from rig.runs.export import CANDUMP, FORMATS, export_traffic, extension, files, with_ending
from rig.runs.export import export as export_one
from rig.runs.exported import sidecar
from rig.runs.recover import damaged_name, mend
from rig.runs.run_file import read_record
from rig.runs.run_record import RUN_FILE
from rig.sources import load_source
from rig.wiring.devices import until_the_end


@click.command("export")
@click.argument("source", type=shared.PATH)
@click.option("--format", "kind", type=click.Choice(FORMATS), default="csv")
@shared.partial
@shared.path(
    "--out", "File to write [default: <source name>.<format>]; an ending that is missing is added."
)
def export(source: Path, kind: str, partial: bool, out: Path | None) -> int:
    """Write the recordings of SOURCE, a run folder or a campaign file, for other tools.

    Channels keep their canonical names and SI units. MATLAB, Parquet and MCAP files contain all
    recordings; a field, column or topic names each recording. A CSV file contains one recording;
    several recordings are written to several files, whose names are OUT plus the name of the
    recording. Unfinished excitations of a stopped run are exported only with --partial; their names
    then end in "(partial)".

    The export contains stages, masses, loads, constants and the channels that are means as well
    (for a CSV file in FILE.csv.json). A campaign that reads an export states its channels.

    The format candump (a .log file) contains the raw CAN frames of a run. An mcap file contains
    these frames as can_msgs/msg/Frame, and the events.

    \b
    Example:
      rig export runs/demo --format csv --out demo.csv
      rig export runs/stopped --partial
      rig export runs/demo --format candump
    """
    path = with_ending(out, kind) if out else Path(f"{source_name(source)}.{extension(kind)}")
    require_file(path, "--out")
    if kind == CANDUMP:
        return _traffic(source, path)
    dataset = load_source(source, partial=partial)
    run = (source, read_record(source)) if is_file(source / RUN_FILE) else None
    wanted = files(dataset, path, kind)
    _require_free([*wanted, *(sidecar(place) for place in wanted if kind == "csv")])
    for place, part in wanted.items():
        with usable(place, "written"):
            export_one(part, place, kind, run)
        count = sum(len(recording.time) for recording in part.recordings)
        names = ", ".join(recording.name for recording in part.recordings)
        click.echo(f"{place}: {count} samples of {names}")
    for note in reading_notes(dataset.recordings):
        click.echo(note)
    return DONE


def _traffic(source: Path, path: Path) -> int:
    if not is_file(source / RUN_FILE):
        raise InputError(f"{source}: raw frames are in run folders only; name a run folder")
    record = read_record(source)
    _require_free([path])
    with usable(path, "written"), replacing(path) as draft:
        count = export_traffic(source, record, draft)
    click.echo(f"{path}: {count.frames} CAN frames of {', '.join(count.parts)}")
    if count.serial:
        click.echo(f"{count.serial} records of serial lines left out, which are not CAN frames")
    return DONE


def _require_free(places: Iterable[Path]) -> None:
    """Refuse to overwrite files."""
    taken = [place for place in places if place.exists()]
    if taken:
        raise InputError(f"{place}: exists already; give --out another name" for place in taken)


@click.command("recover")
@click.argument("run", type=shared.PATH)
@shared.record_file("Also write the completed run.json to this file.")
def recover(run: Path, json_file: Path | None) -> int:
    """Write a clean recording of RUN from all readable records of the damaged recording, and
    complete run.json and the page of the run.

    The damaged file is kept next to the clean file. A complete run is not changed; only a missing
    page is written.

    \b
    Example:
      rig recover runs/20261120T101500Z-figure10
    """
    until_the_end(hold_folder(run, "rig recover"))
    with usable(run, "written"):
        recovery = mend(run)
    if not recovery.damage:
        click.echo(f"recording complete: {recovery.samples} samples")
    for problem in recovery.damage:
        kept = damaged_name(problem.partition(":")[0])
        click.echo(f"{problem}; the damaged file is kept as {kept}")
    rows = [[s.name, s.stage, f"{s.weight_kg:g}", s.state] for s in recovery.record.stages]
    click.echo(table(["stage", "load", "weight kg", "state"], rows, right=[2]))
    if words := go_on_words(recovery.record, run):
        click.echo(words)
    if recovery.changed or not (run / REPORT_FILE).exists():
        write_page(run, recovery.record, lambda words, good: click.echo(words, err=not good))
    if recovery.changed:
        seal_folder(run, recovery.record, lambda words, good: click.echo(words, err=not good))
    write_asked(json_file, dataclasses.asdict(recovery.record))
    return DONE
