"""``rig prove``: the blind proof."""

from __future__ import annotations

import time
from pathlib import Path

import click

from rig.cli import options as shared


@click.command("prove")
@click.option(
    "--rigs", type=click.IntRange(min=1), default=600, show_default=True, help="How many."
)
@click.option(
    "--from",
    "source",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Campaigns sealed by someone else: rig-NNNN/campaign.yaml and sealed/NNNN.json.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("proof"),
    show_default=True,
    help="Folder; a proof begun there before is continued.",
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True, help="Processes.")
@shared.seed("Seed of draws and diagnosis.")
@click.option(
    "--gas",
    is_flag=True,
    help="Trials with effects injected into the gas generator; only pressure and angle are used.",
)
@click.option("--keep", is_flag=True, help="Keep the recordings of scored trials, 7 MB each.")
@shared.result_file
def command(
    rigs: int,
    source: Path | None,
    out: Path,
    jobs: int,
    seed: int,
    gas: bool,
    keep: bool,
    json_file: Path | None,
) -> None:
    """Test the diagnosis blind: draw trials with injected effects, seal the truth, diagnose,
    unseal, score.

    The SHA-256 of every sealed truth is printed before the first diagnosis starts.

    \b
    Example:
      rig prove --rigs 24 --jobs 2 --out proof
      rig prove --gas --rigs 100 --out gas-proof
      rig prove --from sealed-by-others --json proof.json
    """
    # Imported late: --help must not wait for the numerics.
    from rig.common.errors import InputError
    from rig.common.places import require_file, require_folder
    from rig.common.result_files import Provenance
    from rig.results.files import PAGE_FILE, write_page, write_record
    from rig.results.prove.document import prove_document
    from rig.results.prove.family import GAS, MOTION
    from rig.results.prove.judge import judge
    from rig.results.prove.run import PROOF_FILE, begin, work
    from rig.results.prove.score import RESULT_FILE, proof_record
    from rig.results.terminal import text
    from rig.terminal.bar import ShareBar

    require_folder(out, "--out")
    require_file(json_file, "--json")
    started = time.perf_counter()
    try:
        proof = begin(out, rigs, seed, source, GAS if gas else MOTION)
        for sealed in proof.seals:
            click.echo(f"rig {sealed.number:04d} sealed, SHA-256 {sealed.digest}")
        with ShareBar() as bar:
            rows = work(proof, judge, jobs, keep, bar)
        provenance = Provenance.of(seed, (), time.perf_counter() - started, out / PROOF_FILE)
    except OSError as error:
        raise InputError(
            f"{error.filename or out}: cannot be written: {error.strerror}; give --out another "
            f"place"
        ) from error
    result = proof_record(rows, provenance)
    write_record(result, out / RESULT_FILE, json_file)
    document = prove_document(result, provenance)
    write_page(document, out / PAGE_FILE)
    click.echo(text(document))
    click.echo(f"report: {out / PAGE_FILE}")
