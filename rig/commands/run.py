"""``rig run``: run a sequence on a bench."""

from __future__ import annotations

from pathlib import Path

import click

from drivers.errors import LinkError
from rig.aftermath import STATUS, conclude
from rig.bench import load_bench
from rig.calibration import require_current
from rig.cli import DONE
from rig.connect import connect
from rig.crash import noting_folder
from rig.feedforward import load_feedforward
from rig.inject import describe as describe_findings
from rig.inject import sabotage
from rig.operator import AutomaticOperator, ConsoleOperator, StopButton
from rig.places import require_file, require_folder
from rig.plan import make_plan
from rig.plan_text import describe
from rig.progress import RunProgress
from rig.provenance import utc_now
from rig.reference import load_reference
from rig.run import bench_constants, create_folder
from rig.sequence import load_sequence
from rig.session import Inputs, execute
from rig.text import valid


@click.command("run")
@click.argument("sequence")
@click.option("--bench", default="practical", show_default=True, help="Bench file, or the name of a packaged one.")
@click.option("--out", type=click.Path(path_type=Path), help="Run folder, new or empty. [default: runs/<utc>-<name>]")
@click.option("--yes", is_flag=True, help="Answer the weight prompts as planned.")
@click.option("--realtime", is_flag=True, help="Hold the mock bench to real time.")
@click.option("--dry-run", is_flag=True, help="Print the plan; connect to nothing, move nothing.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of the mock bench's noise.")
@click.option(
    "--faults",
    "fault_file",
    type=click.Path(path_type=Path),
    help="Schedule (YAML or CSV) of what goes wrong on the mock bench.",
)
@click.option("--operator", "operator_name", metavar="NAME", type=valid, help="Who runs it; kept with the recording.")
@click.option(
    "--identification",
    type=click.Path(path_type=Path),
    help="Accepted result of `rig identify --json` on this bench; the weights are checked by it.",
)
@click.option(
    "--feedforward",
    "feedforward_file",
    type=click.Path(path_type=Path),
    help="Result of `rig identify --json` on this bench: the drive adds the friction and inertia torque it predicts.",
)
@click.option(
    "--first-pass/--no-first-pass",
    default=None,
    help="Go through each stage at 10 % first. [default: on a real bench, or with --identification]",
)
@click.option(
    "--reset-fault", is_flag=True, help="Clear a fault that the drive is in; its cause must be removed first."
)
@click.option(
    "--prompt-timeout",
    "prompt_timeout_s",
    type=click.FloatRange(min=0, min_open=True),
    help="Seconds to wait for an answer, then stop with status 3. [default: prompt_timeout_s of the bench file]",
)
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Also write run.json to this file.")
def command(
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
    json_file: Path | None,
) -> int:
    """Run SEQUENCE, a file or the name of a packaged one, and record it.

    Before each stage the drive is de-energised and the weight is asked for; `repeat` and `abort` are answers too.
    SIGUSR1 pauses at the end of the stage, where the drive is off; `rig resume` goes on after a stop or a crash.

    Ctrl-C, or SIGTERM, once: stops at once, brakes with the drive's ramp, takes the power off and verifies that it is.
    Again while it brakes: takes the power off without waiting for the ramp. After that it changes nothing: the reading
    back has a time-out of its own and is always done. It is a stop function in software, not an emergency stop.

    \b
    Example:
      rig run figure10 --dry-run
      rig run figure10 --yes --out runs/demo
      rig run slow_ramp --yes --feedforward runs/demo/identify.json --out runs/compensated
    """
    require_file(json_file, "--json")
    bench_file, sequence_file = load_bench(bench), load_sequence(sequence)
    constants = bench_constants(bench_file.value)
    feedforward = None if feedforward_file is None else load_feedforward(feedforward_file, constants)
    low = True if first_pass is None and identification else first_pass
    plan = make_plan(sequence_file, bench_file, low, feedforward)
    if feedforward is not None and feedforward.remark:
        click.echo(feedforward.remark, err=True)
    if dry_run:
        click.echo(describe(plan))
        return DONE
    path = out or Path("runs") / f"{utc_now():%Y%m%dT%H%M%SZ}-{plan.name}"
    require_folder(path, "--out")
    require_current(bench_file, utc_now().date())
    reference = None if identification is None else load_reference(identification, constants)
    inputs = Inputs(bench_file, sequence_file, seed, realtime, operator_name, reference, reset_fault, feedforward)
    patience_s = prompt_timeout_s or bench_file.value.prompt_timeout_s
    saboteur = None if fault_file is None else sabotage(fault_file, bench_file, sequence_file, patience_s)
    with (
        noting_folder(path),
        connect(
            bench_file, seed, realtime, None if saboteur is None else saboteur.attach, feedforward is not None
        ) as devices,
        StopButton() as stop,
    ):
        create_folder(path)
        operator = AutomaticOperator() if yes else ConsoleOperator(patience_s)
        carry_out = execute if saboteur is None else saboteur.execute
        with RunProgress(plan.cycle_s, plan.duration_s) as progress:
            try:
                folder, outcome = carry_out(inputs, plan, devices, path, operator, stop, progress)
            except OSError as error:
                raise LinkError(f"{path}: the recording cannot be started: {error.strerror}; nothing moved") from error
    status = conclude(folder, outcome, reference, json_file)
    if saboteur is not None:
        click.echo(describe_findings(saboteur.conclude(STATUS[outcome.ending], outcome.message)))
    return status
