"""``rig prove`` and ``rig paper``: blind trials of the diagnosis, and the paper's results."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from rig.cli import options as shared
from rig.common.errors import InputError
from rig.common.places import require_folder
from rig.common.provenance import Provenance
from rig.terminal.output import ShareBar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from rig.results.document import Document
    from rig.results.prove.engine import Engine
    from rig.results.prove.truth import Sealed


_TRIALS = 600  # trials of a proof
_STUDY_SHARE = 0.3  # share of the figures' runs in the time of the command with 20 seeds


@click.command("paper")
@click.option(
    "--seeds", type=click.IntRange(min=1), default=20, help="Number of searches per method."
)
@shared.seed("First seed; each search has the next seed.")
@shared.path("--out", "Folder for page and figures.", type=shared.FOLDER, default=Path("paper"))
@shared.result_file
def paper(seeds: int, seed: int, out: Path, json_file: Path | None) -> None:
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
    from rig.results.document import shown, write_record, write_texts
    from rig.results.paper import tables
    from rig.results.paper.figures import data_files

    require_folder(out, "--out")
    started = time.perf_counter()
    with ShareBar() as bar:
        figures = tables.study(seed, lambda what, share: bar(what, _STUDY_SHARE * share))
        found = tables.reproduce(
            range(seed, seed + seeds),
            lambda what, share: bar(what, _STUDY_SHARE + (1.0 - _STUDY_SHARE) * share),
        )
        provenance = Provenance.of(seed, found.dataset.recordings, time.perf_counter() - started)
        of_tables = tables.exhibits(found)
        every = [*figures, *of_tables]
        record = tables.paper_record(found, every, provenance)
        write_record(record, out / tables.RESULT_FILE, json_file)
        write_texts(data_files(every), out)
        document = tables.paper_document(found, figures, of_tables, provenance)
        report = shown(document, out / tables.PAGE_FILE)
    click.echo(report)


@click.command("prove")
@click.option(
    "--rigs",
    type=click.IntRange(min=1),
    help="Number of trials. [default: 600; with --from, all]",
)
@shared.path(
    "--seal",
    "Write sealed trials into this folder, for --from or other tools; nothing is diagnosed.",
    "home",
    type=shared.FOLDER,
)
@click.option(
    "--from",
    "source",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    help="Judge campaigns sealed by others: NAME/campaign.yaml and sealed/NAME.yaml.",
)
@shared.path(
    "--out",
    "Folder of the proof; a proof begun in this folder is continued.",
    type=shared.FOLDER,
    default=Path("proof"),
)
@click.option("--jobs", type=click.IntRange(min=1), default=1, help="Processes.")
@click.option(
    "--cluster",
    "workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Use N worker processes of a dask cluster on this machine (needs the extra `dask`).",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Use the workers of this dask scheduler, which you trust, e.g. tls://10.0.0.5:8786 (needs "
    "the extra `dask`).",
)
@shared.seed("Seed of draws and diagnosis.")
@shared.flag(
    "--investigate",
    "Test `rig investigate` on simulated machines, beside Figure 10 repeated for the same "
    "time; of 34 machines, 27 have one effect, 4 none, and 3 one outside the catalogue.",
    "investigated",
)
@shared.result_file
def prove(
    rigs: int | None,
    home: Path | None,
    source: Path | None,
    out: Path,
    jobs: int,
    workers: int | None,
    scheduler: str | None,
    seed: int,
    investigated: bool,
    json_file: Path | None,
) -> None:
    """Test the diagnosis on blind trials: draw trials with injected effects, seal the truth,
    diagnose, open the truth and score.

    The command prints the SHA-256 of every sealed truth before the first diagnosis starts, and
    diagnoses all rigs before it opens the first truth; with --investigate, each truth is opened
    after the investigation of its own machine. Trials are kept in OUT/trials, about 12 MB each,
    machines of --investigate in OUT/machines. The result files have the same bytes for any number
    of processes or workers; SHA256SUMS in the folder lists their digests.

    \b
    Example:
      rig prove --rigs 24 --jobs 2 --out proof
      rig prove --investigate --rigs 34 --jobs 2 --out investigated
      rig prove --seal sealed --rigs 24 --seed 7
      rig prove --from sealed-by-others --json proof.json
      rig prove --rigs 400 --scheduler tls://10.0.0.5:8786 --out proof
    """
    # Imported late: --help must not wait for the numerics.
    from rig.results.prove.engine import engine

    if home is not None and source is not None:
        raise InputError(
            "--seal writes trials and --from reads trials; give only one of these options"
        )
    if investigated and any(other is not None for other in (home, source, scheduler)):
        raise InputError(
            "--investigate cannot be combined with --seal, --from or --scheduler; leave it out"
        )
    if home is not None and json_file is not None:
        raise InputError("--seal has no result; leave --json out")
    require_folder(out, "--out")
    started, number = time.perf_counter(), rigs or _TRIALS
    try:
        with engine(jobs, workers, scheduler) as shared_out:
            if investigated:
                _investigate(out, number, seed, shared_out, started, json_file)
                return
            if home is not None:
                require_folder(home, "--seal")
                _tell(_seal(home, number, seed, shared_out))
                return
            if source is None:
                source, rigs = out / "trials", number
                _seal(source, rigs, seed, shared_out, repeated=True)
            rows = _judge(source, out, rigs, seed, shared_out)
        from rig.results.prove.document import prove_document
        from rig.results.prove.score import proof_record

        _report(proof_record, prove_document, rows, out, seed, started, json_file)
    except OSError as error:
        raise InputError(
            f"{error.filename or out}: cannot be written: {error.strerror}; give --out or --seal "
            f"another place"
        ) from error


def _investigate(
    out: Path, rigs: int, seed: int, engine: Engine, started: float, json_file: Path | None
) -> None:
    """Draw, seal, investigate and score machines, write the result and the report, and print."""
    from rig.investigate.proof import begin, proof_document, proof_record, work

    proof = begin(out, rigs, seed)
    for sealed in proof.rigs:
        click.echo(f"machine {sealed.name} sealed, SHA-256 {sealed.digest}")
    with ShareBar() as bar:
        rows = work(proof, engine, bar)
    _report(proof_record, proof_document, rows, out, seed, started, json_file)


def _report(
    record: Callable[[list[dict[str, Any]], Provenance], dict[str, Any]],
    document: Callable[[Mapping[str, Any], Provenance], Document],
    rows: list[dict[str, Any]],
    out: Path,
    seed: int,
    started: float,
    json_file: Path | None,
) -> None:
    """Write the result and the report of a proof, and print the result."""
    from rig.results.document import PAGE_FILE, shown, write_record
    from rig.results.prove.run import PROOF_FILE
    from rig.results.prove.score import RESULT_FILE

    provenance = Provenance.of(seed, (), time.perf_counter() - started, out / PROOF_FILE)
    result = record(rows, provenance)
    write_record(result, out / RESULT_FILE, json_file)
    click.echo(shown(document(result, provenance), out / PAGE_FILE))


def _seal(home: Path, rigs: int, seed: int, engine: Engine, repeated: bool = False) -> list[Sealed]:
    """Draw trials and seal them; the salts of a ``repeated`` seal follow from the seed."""
    from rig.results.prove.run import seal_own
    from rig.results.prove.truth import random_salt, repeated_salt

    salt = partial(repeated_salt, seed) if repeated else random_salt
    with ShareBar() as bar:
        return seal_own(home, rigs, seed, engine, bar, salt)


def _tell(rigs: Iterable[Sealed]) -> None:
    for rig in rigs:
        click.echo(f"{rig.name} sealed, SHA-256 {rig.digest}")


def _judge(
    source: Path, out: Path, rigs: int | None, seed: int, engine: Engine
) -> list[dict[str, Any]]:
    """Print the digests of sealed rigs, diagnose and score them; return their rows."""
    from rig.results.prove.judge import judge, oracle_of
    from rig.results.prove.run import begin_from, diagnose_all, score_all
    from rig.results.prove.simulate import floors_of

    proof = begin_from(out, rigs, seed, source)
    _tell(proof.rigs)
    with ShareBar() as bar:
        diagnose_all(proof, judge, engine, bar)
    with ShareBar() as bar:
        return score_all(proof, oracle_of, floors_of, engine, bar)
