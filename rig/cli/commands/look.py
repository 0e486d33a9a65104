"""``rig look``: shows the content of a log."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli import options as shared
from rig.cli.aftermath import seal_folder, write_page
from rig.cli.entry import DONE
from rig.common.errors import InputError
from rig.common.locks import hold_folder
from rig.common.places import is_file, replacing, require_file, source_name, write_asked
from rig.common.tables import table
from rig.results.document import reading_notes
from rig.results.run.go_on import go_on_words
from rig.results.run.report import REPORT_FILE
from rig.runs.export import FORMATS, TRAFFIC, export_traffic, extension, files, with_ending
from rig.runs.export import export as export_one
from rig.runs.exported import sidecar
from rig.runs.recover import damaged_name, mend
from rig.runs.run_file import read_record
from rig.runs.run_record import RUN_FILE
from rig.sources import load_source
from rig.wiring.devices import until_the_end

if TYPE_CHECKING:
    from rig.sources.look import Look

NEEDED = {
    "the angle": {"angle", "motor_angle", "velocity"},
    "the current, torque or voltage": {"current", "torque", "voltage"},
}
"""Sets of channels; an identification needs at least one channel of each set."""


@click.command("look")
@click.argument("path", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--skip-rows", type=click.IntRange(0), default=0, help="Lines before the header.")
@click.option("--delimiter", help="Delimiter, one character. [default: detected from the file]")
@click.option("--decimal", type=click.Choice([".", ","]), default=".", show_default=True)
@click.option(
    "--dbc",
    multiple=True,
    type=click.Path(dir_okay=False),
    help="DBC file of recorded CAN traffic; may be given several times.",
)
@click.option(
    "--bench",
    help="Bench file, or packaged name, whose signal map applies to recorded CAN traffic.",
)
@click.option("--bus", help="Bus of recorded CAN traffic, by its name in the file.")
@click.option(
    "--campaign",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write a first campaign file, with a comment on every key.",
)
@shared.result_file
def look(
    path: Path,
    skip_rows: int,
    delimiter: str | None,
    decimal: str,
    dbc: tuple[str, ...],
    bench: str | None,
    bus: str | None,
    campaign: Path | None,
    json_file: Path | None,
) -> None:
    """Show what FILE contains: for each column the unit, the range, the quantisation step,
    wrap-arounds and a small plot; and the sample rate and gaps.

    FILE is a log of any format that campaign files can name, a run folder or a campaign file. The
    command guesses the channel of a column from the name and the unit of the column; check these
    guesses.

    \b
    Example:
      rig look log.csv
      rig look log.csv --campaign campaign.yaml
      rig look traffic.blf --dbc drive.dbc
    """
    from rig.common.places import require_file, write_json
    from rig.results.look import described, look_record

    require_file(json_file, "--json")
    read: dict[str, Any] = {"skip_rows": skip_rows, "delimiter": delimiter, "decimal": decimal}
    read |= {"dbc": dbc or None, "bench": bench, "bus": bus}
    looks = _looks(path, read)
    click.echo("\n\n".join(described(look) for look in looks))
    if json_file is not None:
        write_json(json_file, look_record(looks))
    if campaign is not None:
        _write_campaign(campaign, path, looks, read)
    elif len(looks) == 1 and looks[0].format != "recording":
        click.echo(f"\nnext: rig look {path} --campaign campaign.yaml{_missing(looks[0])}")


def _missing(look: Look) -> str:
    """Return a text on the columns that the user must state in the campaign file."""
    lacking = [name for name, any_of in NEEDED.items() if not any_of & look.guesses.keys()]
    return f", and state the column of {' and '.join(lacking)} in that file" if lacking else ""


def _beside(campaign: Path, read: dict[str, Any]) -> dict[str, Any]:
    """Return the names of files among the options, relative to the campaign file."""

    def relative(name: str) -> str:
        return Path(os.path.relpath(name, campaign.parent)).as_posix()

    found: dict[str, Any] = {}
    if "dbc" in read:
        names = [relative(name) for name in read["dbc"]]
        found["dbc"] = names[0] if len(names) == 1 else names
    if "bench" in read and Path(read["bench"]).suffix:
        found["bench"] = relative(read["bench"])
    return found


def _looks(path: Path, read: dict[str, Any]) -> list[Look]:
    from pydantic import ValidationError

    from rig.common.places import is_folder
    from rig.config.campaign_sections import ReadSection
    from rig.sources import load_source
    from rig.sources.look import look_at_file, look_at_recording

    if is_folder(path) or path.suffix.lower() in (".yaml", ".yml"):
        return [look_at_recording(recording) for recording in load_source(path).recordings]
    if not path.exists():
        raise InputError(f"{path}: no such file")
    try:
        options = ReadSection(**read)
    except ValidationError as error:
        first = error.errors()[0]
        option = first["loc"][0] if first["loc"] else "delimiter"
        raise InputError(f"--{option}: {first['msg']}") from error
    return [look_at_file(path, options)]


def _write_campaign(campaign: Path, path: Path, looks: list[Look], read: dict[str, Any]) -> None:
    """Write the campaign file with the guesses; an unknown value has a placeholder that the user
    must change.

    Raises:
        InputError: The source is not one log, or the guesses give no valid file.
    """
    from rig.cli.authoring.campaign import ASKED, NONE, DataFile, campaign_text, questions
    from rig.cli.authoring.questions import ask_all
    from rig.cli.authoring.writing import RefusedError, require_new, write_new
    from rig.config.campaign import load_campaign
    from rig.sources.columns import guess_mass

    (look,) = looks if len(looks) == 1 else (None,)
    if look is None or look.format == "recording":
        raise InputError(
            f"--campaign: {path} is a run folder or a campaign file, which other commands read "
            "without a further campaign file"
        )
    require_new(campaign, "campaign")
    names = tuple(column.name for column in look.columns)
    given: dict[str, Any] = {channel: NONE for channel in ASKED}
    for channel in ASKED:
        guess = look.guesses.get(channel)
        if guess is not None:
            place = int(guess.column)
            unique = names[place] and names.count(names[place]) == 1
            given[channel] = names[place] if unique else str(place)
            given[f"{channel}_scale"] = guess.scale
    file = DataFile(path, names, guess_mass(path.stem))
    stand_in = {"moment_arm": 0.1, "lever_ratio": 1.0} if file.mass_kg else {}
    if given["time"] == NONE:
        stand_in["rate"] = 1000.0
    if given["voltage"] != NONE and given["current"] == given["torque"] == NONE:
        stand_in["resistance"] = 1.0
    answers = ask_all(questions([file]), given | stand_in, None, lambda _: None, {})
    told = {key: value for key, value in read.items() if value not in (None, 0, ".")}
    told |= _beside(campaign, told)
    try:
        written = write_new(
            campaign, "campaign", campaign_text(campaign, [file], answers, told), load_campaign
        )
    except RefusedError as error:
        remedy = f"name the columns: rig new campaign {campaign} {path} --current COLUMN ..."
        raise InputError([*(f"{campaign}: {text}" for text in error.problems), remedy]) from error
    click.echo(f"wrote {', '.join(map(str, written))}")
    guessed = ", ".join(sorted({"torque_constant", "gear_ratio", *stand_in}))
    click.echo(f"set the bench's constants ({guessed}) and check each channel's scale and sign")


@click.command("export")
@click.argument("source", type=click.Path(path_type=Path))
@click.option("--format", "kind", type=click.Choice(FORMATS), default="csv", show_default=True)
@shared.partial
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="File to write [default: <source name>.<format>]; an ending that is missing is added.",
)
def export(source: Path, kind: str, partial: bool, out: Path | None) -> int:
    """Write the recordings of SOURCE, a run folder or a campaign file, for other tools.

    Channels keep their canonical names and SI units. MATLAB, Parquet and MCAP files contain all
    recordings; a field, column or topic names each recording. A CSV file contains one recording;
    several recordings are written to several files, whose names are OUT plus the name of the
    recording. Unfinished excitations of a stopped run are exported only with --partial; their names
    then end in "(partial)".

    The export contains stages, masses, loads and constants as well (for a CSV file in
    FILE.csv.json), so that a campaign can read an export with `file:` alone.

    The formats candump (a .log file) and asc (Vector) contain the raw CAN frames of a run. An mcap
    file contains these frames as can_msgs/msg/Frame, and the events.

    \b
    Example:
      rig export runs/demo --format csv --out demo.csv
      rig export runs/stopped --partial
      rig export runs/demo --format candump
    """
    path = with_ending(out, kind) if out else Path(f"{source_name(source)}.{extension(kind)}")
    require_file(path, "--out")
    if kind in TRAFFIC:
        return _traffic(source, path, kind)
    dataset = load_source(source, partial=partial)
    run = (source, read_record(source)) if is_file(source / RUN_FILE) else None
    wanted = files(dataset, path, kind)
    _require_free([*wanted, *(sidecar(place) for place in wanted if kind == "csv")])
    for place, part in wanted.items():
        try:
            export_one(part, place, kind, run)
        except OSError as error:
            raise InputError(f"{place}: cannot be written: {error.strerror}") from error
        count = sum(len(recording.time) for recording in part.recordings)
        names = ", ".join(recording.name for recording in part.recordings)
        click.echo(f"{place}: {count} samples of {names}")
    for note in reading_notes(dataset.recordings):
        click.echo(note)
    return DONE


def _traffic(source: Path, path: Path, kind: str) -> int:
    if not is_file(source / RUN_FILE):
        raise InputError(f"{source}: raw frames are in run folders only; name a run folder")
    record = read_record(source)
    _require_free([path])
    try:
        with replacing(path) as draft:
            count = export_traffic(source, record, draft, kind)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    click.echo(f"{path}: {count.frames} CAN frames of {', '.join(count.parts)}")
    if count.serial:
        click.echo(f"{count.serial} records of serial lines left out, which are not CAN frames")
    if count.errors and kind == "asc":
        click.echo(
            f"{count.errors} error frames without identifier and data: an asc file has no place "
            "for them"
        )
    return DONE


def _require_free(places: Iterable[Path]) -> None:
    """Check that no existing file would be overwritten.

    Raises:
        InputError: A file exists; the message names every file that exists.
    """
    taken = [place for place in places if place.exists()]
    if taken:
        raise InputError(f"{place}: exists already; give --out another name" for place in taken)


@click.command("recover")
@click.argument("run", type=click.Path(path_type=Path))
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
    require_file(json_file, "--json")
    until_the_end(hold_folder(run, "rig recover"))
    try:
        recovery = mend(run)
    except OSError as error:
        raise InputError(f"{run}: cannot be written: {error.strerror}") from error
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
