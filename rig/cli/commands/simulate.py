"""``rig simulate``: predicts recordings with a fitted model, and simulates the control loop in
which the recordings were made.
"""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import options as shared


@click.command("simulate")
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "--result",
    "results",
    metavar="FILE",
    multiple=True,
    required=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="Result file of rig identify or rig diagnose; may be given more than once.",
)
@shared.bandwidth("Bandwidth of the errors. [default: that of the first result]")
@shared.out_folder("Folder for report and figures. [default: ./SOURCE-simulated]")
@shared.result_file
def command(
    source: Path,
    results: tuple[Path, ...],
    bandwidth: float | None,
    out: Path | None,
    json_file: Path | None,
) -> None:
    """Predict the recordings of SOURCE with the model of a result, and compare the prediction with
    the recordings.

    The model predicts torque, voltage and the difference of the encoders from the motion, with and
    without the effects of a diagnosis. If the campaign declares a controller, the closed loop is
    also simulated, from its command alone; the errors of this simulation are listed beside those of
    simulations with half of the friction and without friction. The model as a simulated bench is
    written next to the report.

    \b
    Example:
      rig diagnose bench.yaml --json found.json
      rig simulate later.yaml --result found.json
    """
    # Imported late: --help must not wait for the numerics.
    from rig.common.places import require_file, require_folder, source_name
    from rig.results.document import PAGE_FILE, text, write_page, write_record, write_texts
    from rig.results.identify.simulate import (
        RESULT_FILE,
        as_bench,
        simulate_document,
        simulate_source,
        simulation_record,
    )
    from rig.terminal.output import ShareBar

    folder = out or Path(f"{source_name(source)}-simulated")
    require_folder(folder, "--out")
    require_file(json_file, "--json")
    with ShareBar() as bar:
        found = simulate_source(source, results, bandwidth, bar)
        bar("writing the report", 1.0)
        write_record(simulation_record(found), folder / RESULT_FILE, json_file)
        bench, said = as_bench(source, found)
        write_texts(bench, folder)
        document = simulate_document(source_name(source), found, said)
        write_page(document, folder / PAGE_FILE)
    click.echo(text(document))
    click.echo(f"report: {folder / PAGE_FILE}")
