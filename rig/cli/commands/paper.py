"""``rig paper``: reproduces the paper's tables and figures, with the printed values."""

from __future__ import annotations

import time
from pathlib import Path

import click

from rig.cli import options as shared

_STUDY_SHARE = 0.4  # share of the figures' runs in the time of the command with 20 seeds


@click.command("paper")
@click.option(
    "--seeds",
    type=click.IntRange(min=1),
    default=20,
    show_default=True,
    help="Number of searches per method.",
)
@shared.seed("First seed; each search has the next seed.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("paper"),
    show_default=True,
    help="Folder for page and figures.",
)
@shared.result_file
def command(seeds: int, seed: int, out: Path, json_file: Path | None) -> None:
    """Reproduce the paper's tables and figures, each beside the paper's statement, on one page
    (paper.html).

    The literal bench is simulated, and identified with every seed by the paper's method and by the
    default method; slow ramps, uniform motion and a hot firing run through the whole simulated
    chain. Every figure is also written as PNG, and its numbers as CSV.

    \b
    Example:
      rig paper --out paper --json paper.json
      rig paper --seeds 3
    """
    # Imported late: --help must not wait for the numerics.
    from rig.common.places import require_file, require_folder
    from rig.common.provenance import Provenance
    from rig.results.document import text, write_page, write_record, write_texts
    from rig.results.paper.document import PAGE_FILE, paper_document
    from rig.results.paper.exhibit import data_files
    from rig.results.paper.study import study
    from rig.results.paper.tables import RESULT_FILE, exhibits, paper_record, reproduce
    from rig.terminal.output import ShareBar

    require_folder(out, "--out")
    require_file(json_file, "--json")
    started = time.perf_counter()
    with ShareBar() as bar:
        shown = study(seed, lambda what, share: bar(what, _STUDY_SHARE * share))
        found = reproduce(
            range(seed, seed + seeds),
            lambda what, share: bar(what, _STUDY_SHARE + (1.0 - _STUDY_SHARE) * share),
        )
        provenance = Provenance.of(seed, found.dataset.recordings, time.perf_counter() - started)
        of_tables = exhibits(found)
        every = [*shown, *of_tables]
        write_record(paper_record(found, every, provenance), out / RESULT_FILE, json_file)
        write_texts(data_files(every), out)
        document = paper_document(found, shown, of_tables, provenance)
        write_page(document, out / PAGE_FILE)
    click.echo(text(document))
    click.echo(f"report: {out / PAGE_FILE}")
