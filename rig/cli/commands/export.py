"""``rig export``: recordings for other tools."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import options as shared
from rig.cli.entry import DONE
from rig.common.errors import InputError
from rig.common.input_files import source_name
from rig.common.places import replacing, require_file
from rig.results.sections import reading_notes
from rig.runs.export import WRITERS, export, files
from rig.sources import load_source


@click.command("export")
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "--format", "kind", type=click.Choice(list(WRITERS)), default="csv", show_default=True
)
@shared.partial
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="File to write [default: <source name>.<format>].",
)
def command(source: Path, kind: str, partial: bool, out: Path | None) -> int:
    """Write the recordings of SOURCE, a run folder or a campaign file, for other tools.

    Channels keep their canonical names and SI units. MATLAB and Parquet files hold all recordings,
    and a field or column names each. A CSV file holds one recording; of several, each is written to
    its own file, named OUT plus the recording's name. Excitations that a run stopped in are left
    out unless --partial is given; their names then end in "(partial)".

    \b
    Example:
      rig export runs/demo --format csv --out demo.csv
      rig export runs/stopped --partial
    """
    path = out or Path(f"{source_name(source)}.{kind}")
    require_file(path, "--out")
    dataset = load_source(source, partial=partial)
    wanted = files(dataset, path, kind)
    taken = [
        f"{place}: exists already; give --out another name" for place in wanted if place.exists()
    ]
    if taken:
        raise InputError(taken)
    for place, part in wanted.items():
        try:
            with replacing(place) as draft:
                export(part, draft, kind)
        except OSError as error:
            raise InputError(f"{place}: cannot be written: {error.strerror}") from error
        count = sum(len(recording.time) for recording in part.recordings)
        names = ", ".join(recording.name for recording in part.recordings)
        click.echo(f"{place}: {count} samples of {names}")
    for note in reading_notes(dataset.recordings):
        click.echo(note)
    return DONE
