"""``rig export``: recordings for other tools."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import DONE
from rig.errors import InputError
from rig.export import WRITERS, export
from rig.places import replacing, require_file
from rig.sources import load_source


@click.command("export")
@click.argument("source", type=click.Path(path_type=Path))
@click.option("--format", "kind", type=click.Choice(list(WRITERS)), default="csv", show_default=True)
@click.option("--out", type=click.Path(path_type=Path), help="File to write [default: <source name>.<format>].")
def command(source: Path, kind: str, out: Path | None) -> int:
    """Write the recordings of SOURCE, a run folder or a campaign file, into one file for other tools.

    Channels keep their canonical names and SI units; a column or field names the recording.

    \b
    Example:
      rig export runs/demo --format csv --out demo.csv
    """
    path = out or Path(f"{source.resolve().stem}.{kind}")
    if path.exists():
        raise InputError(f"{path}: exists already; give --out another name")
    require_file(path, "--out")
    dataset = load_source(source)
    try:
        with replacing(path) as draft:
            export(dataset, draft, kind)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error
    count = sum(len(recording.time) for recording in dataset.recordings)
    click.echo(f"{len(dataset.recordings)} recordings, {count} samples written to {path}")
    return DONE
