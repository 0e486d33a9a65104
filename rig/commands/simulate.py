"""``rig simulate``: what a fitted model does in the loop its recordings were made in."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("simulate")
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "--result",
    "results",
    metavar="FILE",
    multiple=True,
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="Result file of rig identify; may be given more than once.",
)
@click.option(
    "--bandwidth",
    metavar="HZ",
    type=click.FloatRange(min=0.0, min_open=True),
    help="Bandwidth of the torque errors; chosen from the recordings if left out.",
)
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for report and figures; ./SOURCE-simulated."
)
@click.option(
    "--json", "json_file", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False), help="Result file."
)
def command(
    source: Path, results: tuple[Path, ...], bandwidth: float | None, out: Path | None, json_file: Path | None
) -> None:
    """Simulate the recordings of SOURCE in closed loop with a fitted model, and compare.

    The errors stand beside those of the same simulation with half of the friction and with none.

    \b
    Example:
      rig identify bench.yaml --json fitted.json
      rig simulate bench.yaml --result fitted.json
    """
    # Imported late: --help must not wait for the numerics.
    from rig.bar import ShareBar
    from rig.places import require_file, require_folder
    from rig.simulate import simulate_source
    from rig.simulate_output import text, write

    folder = out or Path(f"{source.resolve().stem}-simulated")
    require_folder(folder, "--out")
    require_file(json_file, "--json")
    with ShareBar() as bar:
        found = simulate_source(source, results, bandwidth, bar)
        bar("writing the report", 1.0)
        report = write(folder, source.resolve().stem, found, json_file)
    click.echo(text(found))
    click.echo(f"report: {report}")
