"""``rig run`` and ``rig resume``: run a sequence on a bench, and continue a run that stopped."""

from __future__ import annotations

import dataclasses
from contextlib import closing
from pathlib import Path

import click

from rig.cli import options as shared
from rig.cli.accepting import accept_at_the_end, given_acceptance, limits_before
from rig.cli.aftermath import conclude
from rig.cli.crash import noting_folder
from rig.cli.entry import BAD_VERDICT, DONE
from rig.common.locks import OWNER_FILE, hold_folder
from rig.common.places import require_folder, usable, write_asked
from rig.common.provenance import utc_now
from rig.common.text import stored_path
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.attendance import connected, require_attendance
from rig.control.operator import operator_for
from rig.control.remote import RunProgress, observed, reachable
from rig.control.session import Inputs, execute
from rig.fault_injection.inject import FaultInjector, fault_injector
from rig.fault_injection.inject import describe as describe_findings
from rig.planning.feedforward import load_feedforward
from rig.planning.plan import Plan, make_plan
from rig.planning.predicted_load import PredictedLoad, friction_model, of_another_bench
from rig.planning.reference import load_reference
from rig.results.run.dry_run import describe_dry_run, dry_run_record
from rig.results.run.dry_run import dry_run as compute_dry_run
from rig.runs.recorded_inputs import recorded_acceptance
from rig.runs.recover import prepare, stopped_words
from rig.runs.run import (
    bench_constants,
    create_folder,
    first_unfinished,
    require_space,
    require_unused,
)
from rig.runs.run_record import FEEDFORWARD_INPUT
from rig.terminal.prompt import at_terminal
from rig.terminal.screen import Screen
from rig.terminal.stop_button import StopButton
from rig.wiring.devices import bench_line, say_taken_over, until_the_end
from rig.wiring.preflight import require_startable


@click.command("run")
@click.argument("sequence")
@shared.bench_name
@shared.path("--out", "Run folder, new or empty. [default: runs/<utc>-<name>]")
@shared.yes
@shared.realtime
@shared.flag(
    "--dry-run", "Print the plan and its predicted torque, without a connection to the bench."
)
@shared.simulated_seed
@shared.path(
    "--faults", "Schedule (YAML or CSV) of injected faults on the simulated bench.", "fault_file"
)
@shared.operator_name
@shared.identification
@shared.path(
    "--feedforward",
    "Result of `rig identify --json` on this bench; the drive adds the torque of friction "
    "and inertia that this result predicts.",
    "feedforward_file",
)
@shared.first_pass
@shared.reset_fault()
@click.option(
    "--prompt-timeout",
    "prompt_timeout_s",
    type=shared.Number(min=0, min_open=True),
    help="Seconds to wait for an answer; then the run stops with status 3. [default: "
    "prompt_timeout_s of the bench file]",
)
@shared.in_console
@shared.wait
@shared.acceptance("those of the sequence")
@shared.junit
@shared.record_file("Also write run.json, or the result of --dry-run, to this file.")
def run(
    sequence: str,
    bench: str,
    out: Path | None,
    yes: bool,
    realtime: bool,
    dry_run: bool,
    seed: int,
    fault_file: Path | None,
    operator_name: str | None,
    identification: Path | None,
    feedforward_file: Path | None,
    first_pass: bool | None,
    reset_fault: bool,
    prompt_timeout_s: float | None,
    in_console: bool,
    wait_s: float,
    acceptance: Path | None,
    junit_file: Path | None,
    json_file: Path | None,
) -> int:
    """Run SEQUENCE, a file or the name of a packaged sequence, and record the run.

    Before each stage the drive is de-energised, and the program asks for the weight; `repeat` and
    `abort` are also possible answers. SIGUSR1 pauses the run at the end of the stage, with the
    drive off. After a stop or a crash, `rig resume` continues the run.

    One Ctrl-C or SIGTERM stops the run immediately: the program brakes with the drive's ramp, takes
    the power off and reads the drive's state back. A second Ctrl-C during braking takes the power
    off without waiting for the ramp. Any further Ctrl-C changes nothing: the state is always read
    back, with a separate time-out. Ctrl-C is a stop function in software, not an emergency stop.

    \b
    Example:
      rig run figure10 --dry-run
      rig run figure10 --yes --out runs/demo
      rig run slow_ramp --yes --feedforward runs/demo/identify.json --out runs/compensated
    """
    # Everything that can be checked before any motion is checked first.
    bench_file, sequence_file = load_bench(bench), load_sequence(sequence)
    if junit_file is not None and not limits_before(acceptance, sequence_file.value)[0]:
        raise click.UsageError(
            "--junit needs acceptance limits: give --acceptance, or state them in the sequence"
        )
    click.echo(bench_line(bench_file))
    constants = bench_constants(bench_file.value)
    feedforward = (
        None if feedforward_file is None else load_feedforward(feedforward_file, constants)
    )
    low = True if first_pass is None and identification else first_pass
    plan = make_plan(sequence_file, bench_file, low, feedforward)
    model = friction_model(constants, identification or feedforward_file)
    load = PredictedLoad.of(plan, bench_file.value, model)
    if not dry_run:
        load.require_within(sequence_file)
    if feedforward is not None and feedforward.remark:
        click.echo(feedforward.remark, err=True)
    path = out or Path("runs") / f"{utc_now():%Y%m%dT%H%M%SZ}-{plan.name}"
    require_folder(path, "--out")
    # If another program uses the folder, the message of the lock is more helpful.
    if not (path / OWNER_FILE).exists():
        require_unused(path)
    require_space(path, plan.cycles)
    inputs = Inputs(
        bench_file,
        sequence_file,
        seed,
        realtime,
        operator_name,
        None if identification is None else load_reference(identification, constants),
        reset_fault,
        feedforward,
        acceptance=given_acceptance(acceptance),
        load=load,
    )
    patience_s = prompt_timeout_s or bench_file.value.prompt_timeout_s
    injector = None
    if fault_file is not None:
        injector = fault_injector(fault_file, bench_file, sequence_file, patience_s)
    require_startable(bench_file, utc_now().date(), lambda words: click.echo(words, err=True))
    require_attendance(plan, bench_file, yes, dry_run or in_console or at_terminal())
    for file in filter(None, (identification, feedforward_file)):
        if (words := of_another_bench(file, constants)) is not None:
            click.echo(f"warning: {words}", err=True)
    if dry_run:
        limits = limits_before(acceptance, sequence_file.value)
        computed = compute_dry_run(bench_file, load, not yes, *limits)
        click.echo(describe_dry_run(computed))
        write_asked(json_file, dry_run_record(computed))
        return BAD_VERDICT if load.problems else DONE
    status = _carry_out(
        inputs, plan, path, yes, patience_s, in_console, wait_s, json_file, injector
    )
    return _accepted(status, path, junit_file)


@click.command("resume")
@click.argument("run", type=shared.PATH)
@shared.yes
@shared.operator_name
@shared.identification
@shared.first_pass
@shared.reset_fault(
    " If the program died during the run, the fault is always cleared, because the watchdog of "
    "the drive has then tripped."
)
@shared.in_console
@shared.wait
@shared.acceptance("those of the run")
@shared.junit
@shared.record_file("Also write run.json to this file.")
def resume(
    run: Path,
    yes: bool,
    operator_name: str | None,
    identification: Path | None,
    first_pass: bool | None,
    reset_fault: bool,
    in_console: bool,
    wait_s: float,
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
    given = given_acceptance(acceptance)
    until_the_end(hold_folder(run, "rig resume"))
    with usable(run, "written"):
        resumed = prepare(run)
    for problem in resumed.mended:
        click.echo(problem)
    click.echo(stopped_words(resumed.record))
    require_startable(resumed.bench, utc_now().date(), lambda words: click.echo(words, err=True))
    constants = bench_constants(resumed.bench.value)
    reference = None if identification is None else load_reference(identification, constants)
    record, feedforward = resumed.record, None
    if (stated := record.inputs.get(FEEDFORWARD_INPUT)) is not None:
        feedforward = load_feedforward(stored_path(stated["file"]), constants)
    low = True if first_pass is None and identification else first_pass
    plan = make_plan(resumed.sequence, resumed.bench, low, feedforward)
    first = first_unfinished(record) or 0
    left = dataclasses.replace(plan, stages=plan.stages[first:])
    source = None if feedforward is None else Path(feedforward.source)
    load = PredictedLoad.of(
        left, resumed.bench.value, friction_model(constants, identification or source)
    )
    load.require_within(resumed.sequence)
    inputs = Inputs(
        resumed.bench,
        resumed.sequence,
        record.seed + len(record.parts),  # each recording gets its own noise
        record.realtime,
        operator_name,
        reference,
        reset_fault or resumed.died,
        feedforward,
        record,
        given or recorded_acceptance(run, record),
        load,
    )
    require_space(run, left.cycles)
    require_attendance(plan, resumed.bench, yes, in_console or at_terminal())
    patience_s = resumed.bench.value.prompt_timeout_s
    status = _carry_out(inputs, plan, run, yes, patience_s, in_console, wait_s, json_file)
    return _accepted(status, run, junit_file)


def _accepted(status: int, path: Path, junit_file: Path | None) -> int:
    """Judge a completed run; return the exit status."""
    if status == DONE:
        return accept_at_the_end(path, junit_file)
    if junit_file is not None:
        click.echo(f"the run was not completed, so it is not judged: no {junit_file}", err=True)
    return status


def _carry_out(
    inputs: Inputs,
    plan: Plan,
    path: Path,
    yes: bool,
    patience_s: float | None,
    in_console: bool,
    wait_s: float,
    json_file: Path | None,
    injector: FaultInjector | None = None,
) -> int:
    """Connect, run or continue, and report the outcome; return the exit status."""
    bench, purpose = inputs.bench, "rig run" if inputs.resumed is None else "rig resume"
    screen = Screen()
    screen.silence()
    with (
        noting_folder(path),
        closing(screen),
        StopButton(screen.say) as stop,
        reachable(stop, screen, inputs, plan, path, in_console) as control,
    ):
        attach = None if injector is None else injector.attach
        offset = inputs.feedforward is not None
        with connected(
            stop, bench, inputs.seed, inputs.realtime, attach, offset, purpose, wait_s, screen.say
        ) as devices:
            say_taken_over(devices.lock, screen)
            if inputs.resumed is None:
                until_the_end(create_folder(path, purpose))
            tolerance = bench.value.weight_tolerance
            operator = operator_for(yes, screen, patience_s, tolerance, control, in_console)
            carry_out = execute if injector is None else injector.execute
            duration_s = (plan if inputs.load is None else inputs.load.plan).duration_s
            progress = RunProgress(plan.cycle_s, duration_s, screen)
            devices = observed(devices, control, progress)
            folder, outcome = carry_out(inputs, plan, devices, path, operator, stop, progress)
        status = conclude(folder, outcome, inputs.reference, json_file, screen)
    if injector is not None:
        click.echo(describe_findings(injector.conclude(status, outcome.message)))
    return status
