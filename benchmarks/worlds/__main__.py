"""Draws worlds, simulates them on a plant, and seals them for ``rig prove --from``."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from benchmarks.worlds.gas import seal_gas
from benchmarks.worlds.seal import Plant, seal_worlds
from rig.results.prove.engine import Processes
from rig.results.prove.truth import random_salt, repeated_salt

OWN, THIRD, MUJOCO, GAS = "own", "third", "mujoco", "gas"
ELECTRIC_MOTOR, MOTULATOR = "electric-motor", "motulator"


def plant_named(name: str) -> Plant:
    """Return the plant with this name.

    Raises:
        InputError: The plant needs a package that is not installed.
    """
    if name == OWN:
        from benchmarks.worlds.own_plant.plant import OwnPlant

        return OwnPlant()
    if name == THIRD:
        from benchmarks.worlds.third.plant import OdePlant

        return OdePlant()
    if name == ELECTRIC_MOTOR:
        from benchmarks.worlds.others.electric_motor import ElectricMotorPlant

        return ElectricMotorPlant()
    if name == MOTULATOR:
        from benchmarks.worlds.others.motulator import MotulatorPlant

        return MotulatorPlant()
    from benchmarks.worlds.mujoco_plant.plant import MujocoPlant, require_mujoco

    require_mujoco()
    return MujocoPlant()


@click.command()
@click.argument("out", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--plant",
    type=click.Choice([OWN, THIRD, MUJOCO, ELECTRIC_MOTOR, MOTULATOR, GAS]),
    default=OWN,
    show_default=True,
    help="own: the machine of the simulated bench; third: differential equations written from the "
    "paper alone; mujoco: a machine in MuJoCo (needs the extra `mujoco`); electric-motor: a DC "
    "machine of gym-electric-motor; motulator: a synchronous machine and two masses of motulator "
    "(both need the extra `plants`); gas: the gas generator of the simulated bench.",
)
@click.option("--rigs", type=click.IntRange(min=1), default=12, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option("--jobs", type=click.IntRange(min=1), default=1, show_default=True)
@click.option(
    "--secret",
    is_flag=True,
    help="Seal with random salts, so that nobody can find a truth by trying seeds. Without it the "
    "digests repeat with the seed.",
)
def main(out: Path, plant: str, rigs: int, seed: int, jobs: int, secret: bool) -> None:
    """Seal worlds into OUT; nothing is diagnosed.

    \b
    Example:
      python -m benchmarks.worlds worlds --plant third --rigs 12 --jobs 2
      rig prove --from worlds --jobs 2 --out proof
    """
    salt = random_salt if secret else partial(repeated_salt, seed)
    seal = seal_gas if plant == GAS else partial(seal_worlds, plant=plant_named(plant))

    def told(what: str, _share: float) -> None:
        click.echo(what, err=True)

    for rig in seal(out, rigs=rigs, seed=seed, engine=Processes(jobs), progress=told, salt=salt):
        click.echo(f"{rig.name} sealed, SHA-256 {rig.digest}")


if __name__ == "__main__":
    main()
