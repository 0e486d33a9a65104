"""``rig effects``: lists the catalogue of physical effects that a diagnosis can identify."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import options as shared


@click.command("effects")
@click.argument("name", required=False)
@shared.result_file
def effects(name: str | None, json_file: Path | None) -> None:
    """List the effects that a diagnosis can identify; with NAME, show the whole catalogue entry of
    one effect.

    \b
    Example:
      rig effects
      rig effects backlash
    """
    from identification.effects import EFFECTS
    from rig.common.places import require_file, write_json
    from rig.results.effects import effects_record, entry_of, overview, whole

    require_file(json_file, "--json")
    shown = [entry_of(name)] if name else list(EFFECTS.values())
    click.echo(whole(shown[0]) if name else overview(shown))
    if json_file is not None:
        write_json(json_file, effects_record(shown))
