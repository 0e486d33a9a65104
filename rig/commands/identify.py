"""``rig identify``: staged identification of a run or a campaign, with tables, figures and a report."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

_METHODS: dict[str, tuple[str, ...]] = {"default": ("default",), "paper": ("paper",), "both": ("default", "paper")}


@click.command("identify")
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "--method",
    type=click.Choice(list(_METHODS)),
    default="default",
    show_default=True,
    help="Estimator; both shows them side by side.",
)
@click.option(
    "--compare",
    "compared",
    is_flag=True,
    help="Also the paper's GA, differential evolution, CMA-ES and multi-start least squares, on one problem.",
)
@click.option(
    "--bandwidth",
    metavar="HZ",
    type=click.FloatRange(min=0.0, min_open=True),
    help="Bandwidth of torque and regressors; chosen from the recordings if left out.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the random generator.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for report and figures; the run folder itself, or ./CAMPAIGN-identified.",
)
@click.option(
    "--json", "json_file", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False), help="Result file."
)
def command(
    source: Path,
    method: Literal["default", "paper", "both"],
    compared: bool,
    bandwidth: float | None,
    seed: int,
    out: Path | None,
    json_file: Path | None,
) -> None:
    """Identify inertia, system load and working load from SOURCE, a run folder or a campaign file.

    \b
    Example:
      rig identify runs/demo
      rig identify runs/demo --compare
      rig identify bench.yaml --method both --bandwidth 30 --json result.json
    """
    # Imported late: --help must not wait for the numerics.
    from rig.bar import ShareBar
    from rig.identify import compare_methods, identify_source
    from rig.identify_output import text, write
    from rig.places import require_file, require_folder
    from rig.truth import truth_of

    if compared and method == "paper":
        raise click.UsageError("--compare sets the others beside the default method; leave out --method paper")
    folder = out or (source if source.is_dir() else Path(f"{source.stem}-identified"))
    require_folder(folder, "--out")
    require_file(json_file, "--json")
    with ShareBar() as bar:
        outcome = identify_source(source, _METHODS[method], bandwidth, seed, bar)
        truth = truth_of(source)
        if compared:
            outcome = compare_methods(source, outcome, truth, bar)
        bar("writing the report", 1.0)
        report = write(folder, source.resolve().stem, outcome, truth, json_file)
    click.echo(text(outcome, truth))
    click.echo(f"report: {report}")
