"""``rig resume``: continues a run that stopped."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from identification.recording import Bench as BenchConstants
from rig.cli import options as shared
from rig.cli.accepting import accept_at_the_end, given_acceptance
from rig.cli.aftermath import conclude
from rig.cli.entry import DONE
from rig.common.errors import InputError
from rig.common.locks import hold_folder
from rig.common.places import require_file
from rig.common.provenance import utc_now
from rig.control.attendance import carry_out, require_attendance
from rig.control.session import Inputs
from rig.planning.feedforward import Feedforward, load_feedforward
from rig.planning.plan import make_plan
from rig.planning.predicted_load import PredictedLoad, friction_model
from rig.planning.reference import load_reference
from rig.runs.recorded_inputs import recorded_acceptance, recorded_input
from rig.runs.resume import prepare, stopped_words
from rig.runs.run import bench_constants, first_unfinished, require_space
from rig.runs.run_record import FEEDFORWARD_INPUT, RunRecord
from rig.terminal.prompt import at_terminal
from rig.wiring.devices import until_the_end
from rig.wiring.preflight import require_startable


@click.command("resume")
@click.argument("run", type=click.Path(path_type=Path))
@shared.yes
@shared.operator_name
@shared.identification
@shared.first_pass
@shared.reset_fault(
    " If the program died during the run, the fault is always cleared, because the watchdog of "
    "the drive has then tripped."
)
@shared.in_console
@shared.acceptance("those of the run")
@shared.junit
@shared.record_file("Also write run.json to this file.")
def command(
    run: Path,
    yes: bool,
    operator_name: str | None,
    identification: Path | None,
    first_pass: bool | None,
    reset_fault: bool,
    in_console: bool,
    acceptance: Path | None,
    junit_file: Path | None,
    json_file: Path | None,
) -> int:
    """Continue RUN at its first unfinished stage, after a crash, a stop or a trip, in the same run
    folder.

    A recording whose writer died is repaired first. The unfinished stage is repeated from its
    beginning; earlier samples of this stage stay in the recording but are not used. Bench and
    sequence file must be unchanged since the start of the run. The complete run is judged by the
    limits of --acceptance, else by the limits of the file given to `rig run`, else by the limits of
    the sequence. Ctrl-C acts as in `rig run`.

    \b
    Example:
      rig resume runs/20261120T101500Z-figure10
    """
    require_file(json_file, "--json")
    require_file(junit_file, "--junit")
    given = given_acceptance(acceptance)
    until_the_end(hold_folder(run, "rig resume"))
    try:
        resumed = prepare(run)
    except OSError as error:
        raise InputError(f"{run}: cannot be written: {error.strerror}") from error
    for problem in resumed.mended:
        click.echo(problem)
    click.echo(stopped_words(resumed.record))
    require_startable(resumed.bench, utc_now().date(), lambda words: click.echo(words, err=True))
    constants = bench_constants(resumed.bench.value)
    reference = None if identification is None else load_reference(identification, constants)
    record = resumed.record
    feedforward = _feedforward(run, record, constants)
    seed = record.seed + len(record.parts)  # each recording gets its own noise
    reset = reset_fault or resumed.died
    low = True if first_pass is None and identification else first_pass
    plan = make_plan(resumed.sequence, resumed.bench, low, feedforward)
    left = replace(plan, stages=plan.stages[first_unfinished(record) or 0 :])
    source = None if feedforward is None else Path(feedforward.source)
    model = friction_model(constants, identification or source)
    load = PredictedLoad.of(left, resumed.bench.value, model)
    load.require_within(resumed.sequence)
    inputs = Inputs(
        resumed.bench,
        resumed.sequence,
        seed,
        record.realtime,
        operator_name,
        reference,
        reset,
        feedforward,
        record,
        given or recorded_acceptance(run, record),
        load,
    )
    require_space(run, left.cycles)
    require_attendance(plan, resumed.bench, yes, in_console or at_terminal())
    status = carry_out(
        inputs,
        plan,
        run,
        "rig resume",
        yes=yes,
        in_console=in_console,
        left_s=left.duration_s,
        patience_s=resumed.bench.value.prompt_timeout_s,
        conclude=lambda folder, outcome, screen: conclude(
            folder, outcome, reference, json_file, screen
        ),
    )
    return accept_at_the_end(run, junit_file) if status == DONE else status


def _feedforward(run: Path, record: RunRecord, constants: BenchConstants) -> Feedforward | None:
    """Return the feed-forward with which the run was started, or None."""
    stated = record.inputs.get(FEEDFORWARD_INPUT)
    return None if stated is None else load_feedforward(recorded_input(run, stated), constants)
