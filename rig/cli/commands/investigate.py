"""``rig investigate`` and ``rig design``: the program chooses, runs and judges the next
experiment, or only proposes it.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

from rig.cli import options as shared
from rig.cli.crash import note_drive
from rig.cli.entry import BAD_VERDICT, DONE, STOPPED
from rig.common.errors import InputError, InUseError
from rig.common.locks import hold_folder
from rig.common.places import is_file, require_file, require_folder, write_asked, write_text
from rig.common.provenance import heading, sha256_file
from rig.terminal.output import ShareBar

if TYPE_CHECKING:
    from rig.config.bench import Bench
    from rig.config.configuration import Document
    from rig.investigate.confirmation import Confirmation
    from rig.investigate.investigation import Judgement, State

FIRST = "figure10"  # sequence of the first run if neither a sequence nor a run is given


@click.command("investigate")
@click.argument("sources", metavar="[SEQUENCE | RUN...]", nargs=-1)
@shared.bench_name
@click.option(
    "--budget",
    "budget_min",
    metavar="MINUTES",
    type=shared.Number(min=0, min_open=True),
    help="Most minutes of the bench for the experiments that the program chooses, prompts and "
    "weight changes included; the first and the confirming one may exceed it.",
)
@click.option(
    "--question",
    metavar='"A, B"',
    help="Names of effects: only hypotheses made of these, and that nothing is missing, are "
    "compared.",
)
@shared.path(
    "--confirm",
    "Choose no experiment: only predict the confirming one with the model of this result of "
    "`rig diagnose` or `rig investigate`, and run it.",
    "result",
    type=shared.FILE,
    metavar="RESULT",
)
@shared.out_folder("Folder of the investigation. [default: ./investigation]")
@shared.yes
@shared.flag("--resume", "Go on with the investigation in the folder --out.")
@shared.seed()
@shared.operator_name
@shared.result_file
def investigate(
    sources: tuple[str, ...],
    bench: str,
    budget_min: float | None,
    question: str | None,
    result: Path | None,
    out: Path | None,
    yes: bool,
    resume: bool,
    seed: int,
    operator_name: str | None,
    json_file: Path | None,
) -> int:
    """Find the missing physics of a bench by experiments that the program chooses.

    The first run is SEQUENCE, a file or packaged name, or the RUNs that exist. After each run all
    recordings are diagnosed together, the hypotheses are weighed, and the experiment that
    separates the likeliest ones best per minute of the bench is simulated under these, within all
    limits, and run with the prompts and the safety of `rig run`. The last experiment is predicted
    before it runs, and compared after.

    Ends as named, nothing missing, outside the catalogue, or ambiguous with what this bench lacks.
    After Ctrl-C or a crash, the same command with --resume continues.

    \b
    Example:
      rig investigate figure10 --bench practical --yes --out investigation
      rig investigate runs/demo runs/slow --bench bench.yaml --budget 30
      rig investigate --resume --out investigation --bench practical --yes
    """
    # Imported late: --help must not wait for the numerics.
    from drivers.errors import DeviceError
    from rig.config.bench import load_bench
    from rig.investigate import investigation
    from rig.wiring.devices import bench_line, until_the_end

    folder = out or Path("investigation")
    require_folder(folder, "--out")
    bench_file = load_bench(bench)
    click.echo(bench_line(bench_file))
    if resume:
        if sources or question or result:
            raise InputError(
                "--resume: runs, --question and --confirm are those of the investigation; leave "
                "them out"
            )
        state = investigation.load_state(folder)
        if budget_min is not None:
            if state.confirmation or state.confirm:
                raise InputError(
                    "--budget: this investigation has ended with its confirming experiment; begin "
                    "a new one with its runs"
                )
            state.budget_min, state.ended = budget_min, ""
        if sha256_file(bench_file.path) != state.bench["sha256"]:
            raise InputError(
                f"{bench_file.path}: changed since the investigation began; resume it with the "
                "same bench file, or begin a new investigation with its runs"
            )
    else:
        if (folder / investigation.STATE_FILE).exists():
            raise InputError(f"{folder}: holds an investigation; give --resume, or another --out")
        names = _effects(question)
        digest = {"file": str(bench_file.path), "sha256": sha256_file(bench_file.path)}
        state = investigation.State(digest, seed, budget_min, names)
        _take_sources(state, sources, result, bench_file)
    folder.mkdir(parents=True, exist_ok=True)
    until_the_end(hold_folder(folder, "rig investigate"))
    try:
        with closing(_Progress()) as progress:
            runner = _runner(bench_file, state, yes, operator_name, progress)
            judged, confirmation = investigation.Investigation(
                bench_file, folder, state, runner, progress.say, progress
            ).run()
    except (KeyboardInterrupt, click.Abort, DeviceError, InUseError) as stop:
        state.save(folder)
        given = ["--bench", bench, "--out", str(folder), *["--yes"] * yes]
        again = shlex.join(["rig", "investigate", "--resume", *given])
        drive = investigation.drive_after(folder, state)
        note_drive(stop, f"{drive}\ngo on with: {again}")
        raise
    return _report(folder, state, judged, confirmation, json_file)


class _Progress:
    """Progress bar that leaves the terminal to the lines of the investigation and of its runs."""

    def __init__(self) -> None:
        self._bar: ShareBar | None = None

    def __call__(self, what: str, share: float) -> None:
        self._bar = self._bar or ShareBar()
        self._bar(what, share)

    def say(self, words: str) -> None:
        """Show a line."""
        self.close()
        click.echo(words)

    def close(self) -> None:
        """Remove the bar until the next step."""
        if self._bar is not None:
            self._bar.__exit__()
            self._bar = None


def _effects(question: str | None) -> list[str]:
    """Return the effects of a question, or an InputError that names the nearest ones."""
    from identification.effects import EFFECTS
    from rig.config.configuration import nearest

    names = [name.strip() for name in (question or "").split(",") if name.strip()]
    unknown = [
        f"--question: {n}: no effect; {nearest(n, list(EFFECTS))}"
        for n in names
        if n not in EFFECTS
    ]
    if unknown:
        raise InputError(unknown)
    return names


def _take_sources(
    state: State, sources: tuple[str, ...], result: Path | None, bench: Document[Bench]
) -> None:
    """Note the first sequence, or the runs that exist, in the state."""
    from rig.config.sequence import load_sequence
    from rig.investigate.investigation import given_run
    from rig.results.diagnose.model_file import read_result
    from rig.runs.run_record import RUN_FILE

    if result is not None:
        record = read_result(result)
        read = {Path(entry["file"]).parent for entry in record["inputs"]}
        sources = sources or tuple(str(f) for f in sorted(read) if is_file(f / RUN_FILE))
        if not sources:
            raise InputError(f"{result}: the runs of this result are not there; give them as RUN")
        state.confirm = str(result.absolute())
        state.ended = "asked for the confirming experiment only"
    runs = [Path(s) for s in sources if is_file(Path(s) / RUN_FILE)]
    if runs and len(runs) < len(sources):
        others = ", ".join(s for s in sources if Path(s) not in runs)
        raise InputError(f"{others}: not a run folder; give one SEQUENCE, or RUN folders")
    if len(sources) > 1 and not runs:
        raise InputError(f"{sources[1]}: give one SEQUENCE, or RUN folders")
    state.experiments += [given_run(folder) for folder in _of_bench(runs, bench)]
    if not runs:
        state.first = sources[0] if sources else FIRST
        load_sequence(state.first)


def _of_bench(runs: Iterable[Path], bench: Document[Bench]) -> list[Path]:
    """Return run folders, each once, or an InputError for a run of a bench with other constants."""
    from rig.runs.run import bench_constants
    from rig.runs.run_file import read_record, recorded_bench

    once = list({folder.resolve(): folder for folder in runs}.values())
    others = [f for f in once if recorded_bench(read_record(f)) != bench_constants(bench.value)]
    if others:
        raise InputError(
            [
                f"{f}: was recorded on a bench with other constants than {bench.value.name}; give "
                "--bench the bench of the run"
                for f in others
            ]
        )
    return once


def _runner(
    bench: Document[Bench], state: State, yes: bool, operator: str | None, progress: _Progress
) -> Callable[[Path, Path], None]:
    """Return the function that runs one experiment, by the command `rig run`."""
    from drivers.errors import DeviceError
    from rig.cli.commands.run import run

    def one(sequence: Path, folder: Path) -> None:
        progress.close()
        if not bench.value.simulated and not yes:
            click.confirm(f"Run {sequence.name} on {bench.value.name}?", default=True, abort=True)
        # Each experiment of a simulated bench gets its own noise.
        status = click.get_current_context().invoke(
            run,
            sequence=str(sequence),
            bench=str(bench.path),
            out=folder,
            yes=yes,
            seed=state.seed + len(state.experiments),
            operator_name=operator,
        )
        if status == STOPPED:
            raise KeyboardInterrupt
        if status not in (DONE, BAD_VERDICT):
            raise DeviceError(f"{folder}: the run ended with status {status}; see its page")

    return one


def _report(
    folder: Path,
    state: State,
    judged: Judgement,
    confirmation: Confirmation | None,
    json_file: Path | None,
) -> int:
    """Write record, page and model files, and print the summary."""
    from rig.investigate import page
    from rig.results.diagnose.diagnose import RESULT_FILE
    from rig.results.diagnose.exports import exports
    from rig.results.document import text, write_page, write_record, write_texts
    from rig.results.measured import facts_of

    outcome = judged.outcome
    write_record(outcome.record(), folder / RESULT_FILE, None)
    write_record(page.investigation_record(state, judged), folder / page.RESULT_FILE, json_file)
    source = folder / state.experiments[0].run
    beside = exports(source, outcome, outcome.record())
    write_texts({file.name: file.text for file in beside.files}, folder)
    files = tuple((file.name, file.use) for file in beside.files)
    document = page.investigation_document(
        folder.name, state, judged, confirmation, files, facts_of(source)
    )
    write_page(document, folder / page.PAGE_FILE)
    click.echo(text(document))
    for file in beside.files:
        click.echo(f"{folder / file.name}: {file.use}")
    click.echo(f"page: {folder / page.PAGE_FILE}")
    return DONE


@click.command("design")
@click.argument("runs", metavar="RUN...", nargs=-1, required=True, type=shared.PATH)
@click.option("--bench", required=True, help="Bench file, or the name of a packaged bench.")
@shared.path(
    "--out", "Sequence file of the experiment.", type=shared.FILE, default=Path("next.yaml")
)
@click.option("--question", metavar='"A, B"', help="Names of effects, as for rig investigate.")
@shared.seed()
@shared.result_file
def design(
    runs: tuple[Path, ...],
    bench: str,
    out: Path,
    question: str | None,
    seed: int,
    json_file: Path | None,
) -> int:
    """Propose the next experiment for the RUNs of a bench, as a sequence file with its reason.

    Runs nothing. The file can be run with `rig run`, and its run be given to `rig investigate` or
    again to `rig design` beside the others. Status 1 if no experiment of this bench helps.

    \b
    Example:
      rig design runs/demo --bench practical --out next.yaml
      rig run next.yaml --yes --out runs/next
      rig design runs/demo runs/next --bench practical
    """
    from rig.config.bench import load_bench
    from rig.config.sequence import plain_sequence, sequence_text
    from rig.investigate.choice import propose
    from rig.investigate.experiments import SimulatedBench
    from rig.investigate.investigation import judge_recordings, read_runs, tripped_stages

    require_file(out, "--out")
    bench_file = load_bench(bench)
    with ShareBar() as bar:
        runs = tuple(_of_bench(runs, bench_file))
        judged = judge_recordings(read_runs(runs), runs[0], seed, _effects(question), bar)
        known = SimulatedBench.of(bench_file), judged.weighed, judged.diagnosis.fit.bandwidth_Hz
        number, tripped = len(runs) + 1, tripped_stages(runs)
        found = (
            propose(*known, seed, number, bar, avoided=tripped).proposal
            or propose(*known, seed, number, bar, avoided=tripped, cover=True).proposal
        )
    record = {
        **heading("loadrig.design/1"),
        "seed": seed,
        "verdict": judged.diagnosis.verdict.value,
        "odds": judged.weighed.odds,
        "experiment": None,
    }
    if found is None:
        click.echo(
            "no experiment within the limits and weights of this bench separates hypotheses or "
            "covers new motions"
        )
    else:
        value = found.sequence.value
        record["experiment"] = {
            "sequence": plain_sequence(value),
            "purpose": found.purpose,
            "reason": found.reason,
            "seconds": found.seconds,
            "weight_changes": found.weight_changes,
            "apart": [{"names": list(pair), "sigma": z} for pair, z in found.apart.items()],
            "refused": dict(found.refused),
        }
        write_text(out, sequence_text(value, f"# {found.reason}\n"))
        click.echo(f"{out}: {found.reason}")
    write_asked(json_file, record)
    return BAD_VERDICT if found is None else DONE
