"""``rig schema``: writes JSON Schemas of the files that a user writes."""

from __future__ import annotations

import json
from pathlib import Path

import click

_KINDS = ("bench", "sequence", "campaign", "faults")


@click.command("schema")
@click.argument("kind", required=False, type=click.Choice(_KINDS))
@click.option(
    "--out",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write KIND.schema.json into this folder; without KIND, the schemas of all kinds of file.",
)
def command(kind: str | None, out: Path | None) -> None:
    """Write the JSON Schema of bench, sequence, campaign or faults files; editors use the schema to
    complete and check these files.

    The first line of a file that `rig new` writes names the schema; the last example adds such a
    line to a file written by hand.

    \b
    Example:
      rig schema bench
      rig schema --out schemas
      sed -i '1i # yaml-language-server: $schema=schemas/bench.schema.json' bench.yaml
    """
    # Imported late: --help must not wait for the records of the files.
    from rig.cli.authoring.schema import json_schema
    from rig.cli.authoring.writing import write_schema

    if out is None:
        if kind is None:
            raise click.UsageError(
                f"name a KIND ({', '.join(_KINDS)}), or give --out DIR for all of them"
            )
        click.echo(json.dumps(json_schema(kind), indent=1))
        return
    for name in (kind,) if kind else _KINDS:
        click.echo(f"wrote {write_schema(name, out)}")
