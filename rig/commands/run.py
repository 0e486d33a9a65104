"""``rig run``: run a sequence on a bench."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import click

from drivers.errors import LinkError
from rig.bench import load_bench
from rig.cli import BAD_VERDICT, DEVICE_FAILED, DONE, STOPPED
from rig.connect import connect
from rig.operator import AutomaticOperator, ConsoleOperator, StopButton
from rig.plan import Plan, make_plan
from rig.progress import RunProgress
from rig.provenance import utc_now
from rig.run import RunFolder, create_folder, write_json
from rig.sequence import load_sequence
from rig.sequencer import Ending, Outcome
from rig.session import Inputs, execute
from rig.tables import table

_STATUS = {
    Ending.DONE: DONE,
    Ending.TRIPPED: BAD_VERDICT,
    Ending.STOPPED: STOPPED,
    Ending.FAILED: DEVICE_FAILED,
}


@click.command("run")
@click.argument("sequence")
@click.option("--bench", default="practical", show_default=True, help="Bench file, or the name of a packaged one.")
@click.option("--out", type=click.Path(path_type=Path), help="Run folder, new or empty. [default: runs/<utc>-<name>]")
@click.option("--yes", is_flag=True, help="Answer the weight prompts as planned.")
@click.option("--realtime", is_flag=True, help="Hold the mock bench to real time.")
@click.option("--dry-run", is_flag=True, help="Print the plan; connect to nothing, move nothing.")
@click.option("--seed", default=0, show_default=True, help="Of the mock bench's noise.")
@click.option("--json", "json_file", type=click.Path(path_type=Path), help="Also write run.json to this file.")
def command(
    sequence: str,
    bench: str,
    out: Path | None,
    yes: bool,
    realtime: bool,
    dry_run: bool,
    seed: int,
    json_file: Path | None,
) -> int:
    """Run SEQUENCE, a file or the name of a packaged one, and record it.

    Before each stage the drive is de-energised and the weight is asked for. Ctrl-C stops at once, brakes and takes the
    power off. It is a stop function in software, not an emergency stop.

    \b
    Example:
      rig run figure10 --dry-run
      rig run figure10 --yes --out runs/demo
    """
    bench_file, sequence_file = load_bench(bench), load_sequence(sequence)
    plan = make_plan(sequence_file, bench_file)
    if dry_run:
        click.echo(describe(plan))
        return DONE
    inputs = Inputs(bench_file, sequence_file, seed, realtime)
    with connect(bench_file, seed, realtime) as devices, StopButton() as stop:
        path = out or Path("runs") / f"{utc_now():%Y%m%dT%H%M%SZ}-{plan.name}"
        create_folder(path)
        operator = AutomaticOperator() if yes else ConsoleOperator()
        with RunProgress(plan.cycle_s, plan.duration_s) as progress:
            try:
                folder, outcome = execute(inputs, plan, devices, path, operator, stop, progress)
            except OSError as error:
                raise LinkError(f"{path}: the recording cannot be started: {error.strerror}; nothing moved") from error
    _tell(folder, outcome)
    if json_file is not None:
        write_json(json_file, dataclasses.asdict(folder.record))
    return _STATUS[outcome.ending]


def describe(plan: Plan) -> str:
    """Return the plan as tables: the stages and the limits in force."""
    stages = table(
        ["stage", "load", "repeats", "duration s", "weight kg", "force N", "peak deg/s", "peak deg"],
        [
            [
                s.name,
                s.stage,
                str(s.repeats),
                f"{s.duration_s:g}",
                f"{s.weight_kg:g}",
                f"{s.contact_force_N:.1f}",
                f"{math.degrees(s.peak_speed_rad_s):.2f}",
                f"{math.degrees(s.peak_angle_rad):+.2f}",
            ]
            for s in plan.stages
        ],
        right=range(2, 8),
    )
    limits = plan.limits
    held = table(
        ["limit", "value", "unit"],
        [
            ["joint angle", f"{math.degrees(limits.angle_min):g} to {math.degrees(limits.angle_max):g}", "deg"],
            ["joint speed", f"{math.degrees(limits.speed):g}", "deg/s"],
            ["joint torque", f"{limits.torque:g}", "N m"],
            ["motor current", f"{limits.current:g}", "A"],
            ["following error", f"{math.degrees(limits.following_error):g}", "deg"],
            ["encoder against drive", f"{math.degrees(limits.encoder_disagreement):g}", "deg"],
            ["motor temperature", f"{limits.temperature:g}", "deg C"],
            ["sample age", f"{limits.sample_age * 1e3:g}", "ms"],
        ],
    )
    head = f"{plan.name}: {plan.duration_s:.1f} s at {1.0 / plan.cycle_s:g} Hz, and moves to the start"
    return f"{head}\n\n{stages}\n\n{held}"


def _tell(folder: RunFolder, outcome: Outcome) -> None:
    record = folder.record
    rows = [[s.name, s.stage, f"{s.weight_kg:g}", s.state] for s in record.stages]
    click.echo(table(["stage", "load", "weight kg", "state"], rows, right=[2]))
    click.echo(f"{record.cycles} cycles, {record.overruns} late, {record.stale} incomplete; recorded in {folder.path}")
    click.echo(f"{outcome.ending.value}: {outcome.message}", err=outcome.ending is not Ending.DONE)
