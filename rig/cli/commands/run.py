"""``rig run``: runs a sequence on a bench."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from rig.cli import options as shared
from rig.cli.accepting import accept_at_the_end, given_acceptance, limits_before
from rig.cli.aftermath import conclude
from rig.cli.crash import noting_folder
from rig.cli.entry import BAD_VERDICT, DONE
from rig.common.locks import OWNER_FILE
from rig.common.places import require_file, require_folder, write_asked
from rig.common.provenance import utc_now
from rig.config.bench import Bench, load_bench
from rig.config.sequence import load_sequence
from rig.control.attendance import carry_out, require_attendance
from rig.control.sequencer import Outcome
from rig.control.session import Inputs, execute
from rig.fault_injection.inject import FaultInjector, fault_injector
from rig.fault_injection.inject import describe as describe_findings
from rig.planning.feedforward import load_feedforward
from rig.planning.plan import Plan, make_plan
from rig.planning.predicted_load import (
    PredictedLoad,
    friction_model,
    of_another_bench,
)
from rig.planning.reference import load_reference
from rig.results.run.dry_run import describe_dry_run, dry_run_record
from rig.results.run.dry_run import dry_run as compute_dry_run
from rig.runs.run import RunFolder, bench_constants, create_folder, require_space, require_unused
from rig.terminal.prompt import at_terminal
from rig.terminal.screen import Screen
from rig.wiring.devices import bench_line, until_the_end
from rig.wiring.preflight import require_startable


@click.command("run")
@click.argument("sequence")
@click.option(
    "--bench",
    default="practical",
    show_default=True,
    help="Bench file, or the name of a packaged bench.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    help="Run folder, new or empty. [default: runs/<utc>-<name>]",
)
@shared.yes
@click.option("--realtime", is_flag=True, help="Run the simulated bench in real time.")
@click.option(
    "--dry-run",
    is_flag=True,
    help="Print the plan and its predicted torque, without a connection to the bench.",
)
@shared.simulated_seed
@click.option(
    "--faults",
    "fault_file",
    type=click.Path(path_type=Path),
    help="Schedule (YAML or CSV) of injected faults on the simulated bench.",
)
@shared.operator_name
@shared.identification
@click.option(
    "--feedforward",
    "feedforward_file",
    type=click.Path(path_type=Path),
    help="Result of `rig identify --json` on this bench; the drive adds the torque of friction "
    "and inertia that this result predicts.",
)
@shared.first_pass
@shared.reset_fault()
@click.option(
    "--prompt-timeout",
    "prompt_timeout_s",
    type=shared.Number(min=0, min_open=True),
    help="Seconds to wait for an answer; then the run stops with status 3. [default: "
    "prompt_timeout_s of "
    "the bench file]",
)
@shared.in_console
@shared.acceptance("those of the sequence")
@shared.junit
@shared.record_file("Also write run.json, or the result of --dry-run, to this file.")
def command(**options: Any) -> int:
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
    return _run(_Options(**options))


@dataclass(frozen=True)
class _Options:
    """Argument and options of the command; click sets names and types."""

    sequence: str
    bench: str
    out: Path | None
    yes: bool
    realtime: bool
    dry_run: bool
    seed: int
    fault_file: Path | None
    operator_name: str | None
    identification: Path | None
    feedforward_file: Path | None
    first_pass: bool | None
    reset_fault: bool
    prompt_timeout_s: float | None
    in_console: bool
    acceptance: Path | None
    junit_file: Path | None
    json_file: Path | None

    def patience_s(self, bench: Bench) -> float | None:
        """Return the time to wait for an answer of the operator, s, or None for unlimited time."""
        return self.prompt_timeout_s or bench.prompt_timeout_s


def _run(options: _Options) -> int:
    """Check everything that can be checked before any motion, then run; return the exit status."""
    require_file(options.json_file, "--json")
    require_file(options.junit_file, "--junit")
    bench, sequence = load_bench(options.bench), load_sequence(options.sequence)
    click.echo(bench_line(bench))
    constants = bench_constants(bench.value)
    identification, feedforward_file = options.identification, options.feedforward_file
    feedforward = (
        None if feedforward_file is None else load_feedforward(feedforward_file, constants)
    )
    low = True if options.first_pass is None and identification else options.first_pass
    plan = make_plan(sequence, bench, low, feedforward)
    load = PredictedLoad.of(
        plan, bench.value, friction_model(constants, identification or feedforward_file)
    )
    if not options.dry_run:
        load.require_within(sequence)
    if feedforward is not None and feedforward.remark:
        click.echo(feedforward.remark, err=True)
    path = options.out or Path("runs") / f"{utc_now():%Y%m%dT%H%M%SZ}-{plan.name}"
    require_folder(path, "--out")
    # If another program uses the folder, the message of the lock is more helpful.
    if not (path / OWNER_FILE).exists():
        require_unused(path)
    require_space(path, plan.cycles)
    reference = None if identification is None else load_reference(identification, constants)
    inputs = Inputs(
        bench,
        sequence,
        options.seed,
        options.realtime,
        options.operator_name,
        reference,
        options.reset_fault,
        feedforward,
        acceptance=given_acceptance(options.acceptance),
        load=load,
    )
    injector = (
        None
        if options.fault_file is None
        else fault_injector(options.fault_file, bench, sequence, options.patience_s(bench.value))
    )
    require_startable(bench, utc_now().date(), lambda words: click.echo(words, err=True))
    asked = options.dry_run or options.in_console or at_terminal()
    require_attendance(plan, bench, options.yes, asked)
    for words in (
        of_another_bench(file, constants) for file in (identification, feedforward_file) if file
    ):
        if words is not None:
            click.echo(f"warning: {words}", err=True)
    if options.dry_run:
        return _dry_run(options, inputs, load)
    return _carry_out(options, inputs, plan, path, injector)


def _carry_out(
    options: _Options, inputs: Inputs, plan: Plan, path: Path, injector: FaultInjector | None
) -> int:
    """Run into a new folder; return the exit status."""
    ended: list[Outcome] = []

    def concluded(folder: RunFolder, outcome: Outcome, screen: Screen) -> int:
        ended.append(outcome)
        return conclude(folder, outcome, inputs.reference, options.json_file, screen)

    with noting_folder(path):
        status = carry_out(
            inputs,
            plan,
            path,
            "rig run",
            yes=options.yes,
            in_console=options.in_console,
            left_s=plan.duration_s,
            patience_s=options.patience_s(inputs.bench.value),
            conclude=concluded,
            begin=lambda: until_the_end(create_folder(path, "rig run")),
            attach=None if injector is None else injector.attach,
            run=execute if injector is None else injector.execute,
        )
    if injector is not None:
        click.echo(describe_findings(injector.conclude(status, ended[-1].message)))
    return accept_at_the_end(path, options.junit_file) if status == DONE else status


def _dry_run(options: _Options, inputs: Inputs, load: PredictedLoad) -> int:
    limits = limits_before(options.acceptance, inputs.sequence.value)
    computed = compute_dry_run(inputs.bench, load, not options.yes, *limits)
    click.echo(describe_dry_run(computed))
    write_asked(options.json_file, dry_run_record(computed))
    return BAD_VERDICT if load.problems else DONE
