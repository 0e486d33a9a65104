"""``rig diagnose`` and ``rig effects``: the missing physics, and the catalogue of effects."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import options as shared


@click.command("diagnose")
@click.argument("source", type=click.Path(path_type=Path))
@shared.bandwidth("Bandwidth of all equations; chosen from the recordings if left out.")
@click.option(
    "--gas",
    is_flag=True,
    help="Diagnose the gas generator, from pressure and valve angle; needed only if the "
    "recordings contain torque as well.",
)
@click.option(
    "--observable",
    is_flag=True,
    help="Make no diagnosis: print which effects the recordings can show, the least size of each "
    "that they show, and which effects they cannot distinguish.",
)
@shared.partial
@shared.seed()
@shared.out_folder(
    "Folder for report, figures and corrected model. [default: RUN/diagnosis or "
    "./CAMPAIGN-diagnosed]"
)
@shared.result_file
def diagnose(
    source: Path,
    bandwidth: float | None,
    gas: bool,
    observable: bool,
    partial: bool,
    seed: int,
    out: Path | None,
    json_file: Path | None,
) -> None:
    """Find the physics missing in the model of SOURCE, a run folder or a campaign file.

    There are four verdicts, all with exit status 0: one or more identified effects; several effects
    that these recordings do not distinguish, with a sequence file of an experiment that
    distinguishes the effects; missing physics outside the catalogue; or nothing missing.

    Recordings with role validate are used in no fit, but an identified effect is kept only if it
    lowers the error on these recordings. Without recordings of this role, parts of the recordings
    are predicted from the other parts. The corrected model is written next to the report.

    \b
    Example:
      rig diagnose runs/demo
      rig diagnose bench.yaml --bandwidth 30 --json result.json
      rig diagnose runs/hot --gas
      rig diagnose bench.yaml --observable
    """
    if observable:
        if gas:
            raise click.UsageError("--observable cannot be combined with --gas; leave --gas out")
        from rig.common.places import write_json
        from rig.results.diagnose.document import observable_document, observe_source
        from rig.results.document import text

        seen = observe_source(source, seed, bandwidth)
        if json_file is not None:
            write_json(json_file, seen.record())
        click.echo(text(observable_document(source, seen)))
        return
    # Imported late: --help must not wait for the numerics.
    from rig.common.places import is_folder, require_folder, source_name
    from rig.results.diagnose.diagnose import RESULT_FILE, diagnose_source
    from rig.results.diagnose.document import diagnose_document
    from rig.results.diagnose.exports import exports
    from rig.results.document import PAGE_FILE, text, write_page, write_record, write_texts
    from rig.results.measured import facts_of
    from rig.terminal.output import ShareBar

    folder = out or (
        source / "diagnosis" if is_folder(source) else Path(f"{source.stem}-diagnosed")
    )
    require_folder(folder, "--out")
    with ShareBar() as bar:
        outcome = diagnose_source(source, seed, bandwidth, bar, True, gas, partial=partial)
        bar("writing the report", 1.0)
        record = outcome.record()
        write_record(record, folder / RESULT_FILE, json_file)
        beside = exports(source, outcome, record)
        write_texts({file.name: file.text for file in beside.files}, folder)
        document = diagnose_document(source_name(source), outcome, beside, facts_of(source))
        write_page(document, folder / PAGE_FILE)
    click.echo(text(document))
    for note in beside.notes:
        click.echo(f"note: {note}")
    for file in beside.files:
        click.echo(f"{folder / file.name}: {file.use}")
    click.echo(f"report: {folder / PAGE_FILE}")


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
    from rig.common.places import write_json
    from rig.results.diagnose.document import effects_record, entry_of, overview, whole

    shown = [entry_of(name)] if name else list(EFFECTS.values())
    click.echo(whole(shown[0]) if name else overview(shown))
    if json_file is not None:
        write_json(json_file, effects_record(shown))
