"""``rig model``: the model of a result for other tools."""

from __future__ import annotations

from pathlib import Path

import click

from rig.cli import options as shared

FORMATS = ("python", "c", "fmu", "modelica", "mjcf", "simulink", "yaml")


@click.command("model")
@click.argument("result", type=click.Path(path_type=Path))
@click.option("--format", "kind", type=click.Choice(FORMATS), default="c", show_default=True)
@click.option(
    "--fmi",
    type=click.Choice(["2", "3"]),
    default="3",
    show_default=True,
    help="Version of FMI of --format fmu.",
)
@shared.out_folder("Folder for the files. [default: ./NAME_FORMAT]")
@shared.result_file
def model(result: Path, kind: str, fmi: str, out: Path | None, json_file: Path | None) -> None:
    """Write the model of RESULT for other tools: RESULT is a result file of rig identify or rig
    diagnose, or the folder of one.

    The model has the nominal parameters and all identified effects. It computes angle and speed
    from the motor current and the load, with friction that holds the joint exactly still, and the
    torque that a motion requires. Effects that a format cannot contain are listed with their size.

    Each export comes with test inputs and expected outputs, and is compared with model.py before it
    is written. The C and the FMU are compiled and run if this computer has a C compiler.

    \b
    Example:
      rig model runs/demo --format c
      rig model runs/demo/diagnosis/diagnose.json --format fmu --fmi 2 --out simulation
      rig model runs/demo --format yaml
    """
    # Imported late: --help must not wait for the numerics.
    from rig.common.errors import InputError
    from rig.common.places import require_folder, write_asked
    from rig.results.document import write_texts
    from rig.results.model import exported, read_model

    read = read_model(result)
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
