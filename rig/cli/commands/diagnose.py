"""``rig diagnose``, ``rig effects``, ``rig model``: missing physics, and models for other tools."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import options as shared
from rig.common.errors import InputError
from rig.common.places import is_folder, require_folder, write_asked
from rig.terminal.output import ShareBar


@click.command("diagnose")
@click.argument("source", type=shared.PATH)
@shared.bandwidth("Bandwidth of all equations; chosen from the recordings if left out.")
@shared.flag(
    "--gas",
    "Diagnose the gas generator, from pressure and valve angle; needed only if the "
    "recordings contain torque as well.",
)
@shared.flag(
    "--observable",
    "Make no diagnosis: print which effects the recordings can show, the least size of each "
    "that they show, and which effects they cannot distinguish.",
)
@shared.own_effects
@shared.partial
@shared.seed()
@shared.out_folder(
    "Folder for report, figures and corrected model. [default: RUN/diagnosis or "
    "./CAMPAIGN-diagnosed]"
)
@shared.result_file
def diagnose(
    source: Path,
    bandwidth: float | None,
    gas: bool,
    observable: bool,
    effects_file: Path | None,
    partial: bool,
    seed: int,
    out: Path | None,
    json_file: Path | None,
) -> None:
    """Find the physics missing in the model of SOURCE, a run folder or a campaign file.

    There are four verdicts, all with exit status 0: one or more identified effects; several effects
    that these recordings do not distinguish (`rig design` proposes an experiment that does);
    missing physics outside the catalogue; or nothing missing.

    Recordings with role validate are used in no fit, but an identified effect is kept only if it
    lowers the error on these recordings. Without recordings of this role, parts of the recordings
    are predicted from the other parts. The corrected model is written next to the report.

    \b
    Example:
      rig diagnose runs/demo
      rig diagnose bench.yaml --bandwidth 30 --json result.json
      rig diagnose runs/hot --gas
      rig diagnose bench.yaml --observable
      rig diagnose bench.yaml --effects mine.py
    """
    if observable:
        if gas:
            raise click.UsageError("--observable cannot be combined with --gas; leave --gas out")
        from rig.results.diagnose.document import observable_document, observe_source
        from rig.results.diagnose.own_effects import read_effects
        from rig.results.document import text

        seen = observe_source(source, seed, bandwidth, read_effects(effects_file), partial)
        write_asked(json_file, seen.record())
        click.echo(text(observable_document(source, seen)))
        return
    # Imported late: --help must not wait for the numerics.
    from rig.results.diagnose.diagnose import diagnose_source
    from rig.results.diagnose.exports import write_diagnosis
    from rig.results.diagnose.own_effects import read_effects
    from rig.results.document import PAGE_FILE, text

    folder = out or (
        source / "diagnosis" if is_folder(source) else Path(f"{source.stem}-diagnosed")
    )
    require_folder(folder, "--out")
    with ShareBar() as bar:
        own = read_effects(effects_file)
        outcome = diagnose_source(source, seed, bandwidth, bar, True, gas, None, partial, own)
        bar("writing the report", 1.0)
        _, document, beside = write_diagnosis(source, outcome, folder, json_file)
    click.echo(text(document))
    for note in beside.notes:
        click.echo(f"note: {note}")
    for file in beside.files:
        click.echo(f"{folder / file.name}: {file.use}")
    click.echo(f"report: {folder / PAGE_FILE}")


@click.command("effects")
@click.argument("name", required=False)
@shared.path(
    "--check",
    "Run a Python file with effects of one's own, and say what is wrong with each: units, a "
    "size that no parameter determines.",
    type=shared.FILE,
    metavar="FILE.py",
)
@shared.path(
    "--on",
    "With --check, also say whether these recordings can show each effect, and which effect "
    "of the catalogue it copies.",
    metavar="SOURCE",
)
@shared.result_file
def effects(name: str | None, check: Path | None, on: Path | None, json_file: Path | None) -> int:
    """List the effects that a diagnosis can identify; with NAME, show the whole catalogue entry of
    one effect; with --check, check effects of one's own.

    The exit status of a check is 1 if something is wrong with an effect.

    \b
    Example:
      rig effects
      rig effects backlash
      rig effects --check mine.py --on runs/demo
    """
    from identification.effects import EFFECTS
    from rig.results.diagnose.document import effects_record, entry_of, overview, whole

    if check is not None:
        from rig.results.diagnose.document import check_effects, check_record, check_text
        from rig.results.diagnose.own_effects import read_effects

        if name is not None:
            raise click.UsageError(f"--check checks all effects of a file; leave {name} out")
        own = read_effects(check)
        checks = check_effects(own, on)
        write_asked(json_file, check_record(own, checks))
        click.echo(check_text(checks))
        return int(any(c.problems for c in checks))
    if on is not None:
        raise click.UsageError("--on belongs to --check; add --check FILE.py")
    shown = [entry_of(name)] if name else list(EFFECTS.values())
    click.echo(whole(shown[0]) if name else overview(shown))
    write_asked(json_file, effects_record(shown))
    return 0


FORMATS = ("python", "c", "fmu", "modelica", "mjcf", "simulink", "yaml")


@click.command("model")
@click.argument("result", type=shared.PATH)
@click.option("--format", "kind", type=click.Choice(FORMATS), default="c")
@click.option(
    "--fmi", type=click.Choice(["2", "3"]), default="3", help="Version of FMI of --format fmu."
)
@shared.own_effects
@shared.out_folder("Folder for the files. [default: ./NAME_FORMAT]")
@shared.result_file
def model(
    result: Path,
    kind: str,
    fmi: str,
    effects_file: Path | None,
    out: Path | None,
    json_file: Path | None,
) -> None:
    """Write the model of RESULT for other tools: RESULT is a result file of rig identify or rig
    diagnose, or the folder of one.

    The model has the nominal parameters and all identified effects. It computes angle and speed
    from the motor current and the load, with friction that holds the joint exactly still, and the
    torque that a motion requires. Effects that a format cannot contain are listed with their size.

    Each export comes with test inputs and expected outputs, and is compared with model.py before it
    is written. The C is compiled and run, the FMU compiled, if this computer has a C compiler.

    \b
    Example:
      rig model runs/demo --format c
      rig model runs/demo/diagnosis/diagnose.json --format fmu --fmi 2 --out simulation
      rig model runs/demo --format yaml
      rig model runs/demo --effects mine.py
    """
    # Imported late: --help must not wait for the numerics.
    from rig.results.diagnose.own_effects import read_effects
    from rig.results.document import write_texts
    from rig.results.model import exported, read_model

    own = read_effects(effects_file)
    read = read_model(result, own)
    folder = out or Path(f"{read.name}_{kind}")
    require_folder(folder, "--out")
    found = exported(read, kind, int(fmi))
    if taken := [name for name in found.files if (folder / name).exists()]:
        raise InputError(f"{folder / taken[0]}: exists already; give --out another name")
    write_texts(found.files, folder)
    for name in found.files:
        click.echo(f"{folder / name}")
    if found.checks:
        click.echo(f"greatest difference in the checks: {max(found.checks.values()):.2g}, relative")
    left_out = read.machine.left_out if read.machine and kind != "yaml" else ()
    for left in left_out:
        click.echo(f"not in the simulation: {left.words}")
    for note in found.notes:
        click.echo(f"note: {note}")
    write_asked(
        json_file,
        {
            "result": str(read.path),
            **own.record,
            "format": kind,
            "files": sorted(found.files),
            "checks": dict(found.checks),
            "not_simulated": [
                {"name": e.name, "parameters": dict(e.parameters), "reason": e.reason}
                for e in left_out
            ],
            "notes": list(found.notes),
        },
    )
