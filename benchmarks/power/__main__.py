"""For every effect of the motion, the least size that recordings can show, along the axes of the
worlds: rate, bits, encoders, loads, excitation, voltage.

    python -m benchmarks.power out/power --machines 8 --jobs 2

A map that was stopped continues where it stopped. The worlds are simulated by MuJoCo without any
effect; which effects they can show follows from excitation, channels and noise (`rig diagnose
--observable`).
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from benchmarks.power.measure import measured
from rig.common.input_files import is_file
from rig.common.places import write_json
from rig.results.prove.engines.choice import engine
from rig.results.prove.mujoco_plant.plant import require_mujoco


@click.command()
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option("--machines", type=click.IntRange(min=1), default=8, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True)
@click.option("--cluster", "workers", type=click.IntRange(min=1))
@click.option("--scheduler")
def main(
    out: Path, machines: int, seed: int, jobs: int, workers: int | None, scheduler: str | None
) -> None:
    """Compute the map into OUT, one file a machine."""
    require_mujoco()
    out.mkdir(parents=True, exist_ok=True)
    todo = [n for n in range(1, machines + 1) if not is_file(out / f"{seed}-{n:03d}.json")]
    with engine(jobs, workers, scheduler) as shared_out:
        for found in shared_out.each(partial(measured, seed=seed), todo):
            write_json(out / f"{seed}-{found['number']:03d}.json", found)
            click.echo(f"machine {found['number']}, {found['processor_s']:.0f} s")


if __name__ == "__main__":
    main()
