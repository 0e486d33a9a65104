"""Draws worlds, simulates them on a plant with and without their effects, and writes and seals
them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np

from benchmarks.worlds.draw import draw_world, without_effects, worlds_assignment
from benchmarks.worlds.files import truth_of_world, write_world
from benchmarks.worlds.logger import Columns, columns
from benchmarks.worlds.world import Array, Signals, World
from rig.results.prove.engine import Engine
from rig.results.prove.run import Made, Task, made, making, seal_all
from rig.results.prove.truth import Sealed, random_salt, seal_truth

MOVING = 0.05
"""Share of the greatest speed in a recording above which the joint counts as moving."""


class Plant(Protocol):
    """A simulated machine that simulates the recordings of worlds.

    Attributes:
        effects: Effects of the catalogue that the machine can have.
        outside: Effects outside the catalogue that the machine can have.
        not_scored: Values with another meaning on this machine: a constant, or
            ``effect.parameter``.
    """

    @property
    def effects(self) -> Collection[str]: ...  # noqa: D102 - see the class

    @property
    def outside(self) -> Collection[str]: ...  # noqa: D102 - see the class

    @property
    def not_scored(self) -> Collection[str]: ...  # noqa: D102 - see the class

    def play(self, world: World) -> Iterable[Signals]:
        """Yield the signals of the machine in each recording, one recording after another."""
        ...


def seal_worlds(
    home: Path,
    plant: Plant,
    rigs: int,
    seed: int,
    engine: Engine,
    progress: Callable[[str, float], None],
    salt: Callable[[int], str] = random_salt,
) -> list[Sealed]:
    """Draw, simulate and seal worlds; return the worlds with their digests. Nothing is diagnosed.

    Worlds that exist already are kept, so that a call that was stopped can be repeated.

    Args:
        home: Folder of the sealed rigs.
        plant: The plant; with more than one worker it must be importable.
        rigs: Number of worlds.
        seed: Seed of the draws.
        engine: Engine that simulates the worlds.
        progress: Called with the label of a step and the share that is done.
        salt: Function that returns the salt of the world with a number; random by default.

    Raises:
        InputError: Workers die repeatedly, or the folder holds rigs of other settings.
        OSError: A file cannot be written.
    """
    drawn = list(enumerate(worlds_assignment(rigs, seed, plant.effects, plant.outside), start=1))
    settings = {"plant": type(plant).__name__, "rigs": rigs, "seed": seed}
    one = partial(seal_world, plant=plant, seed=seed)
    return seal_all(home, drawn, one, engine, progress, settings, salt)


def seal_world(task: Task, plant: Plant, seed: int) -> Made:
    """Simulate and seal one world in a temporary folder."""
    with making(task.number) as where:
        world = draw_world(*task.assigned, (seed, task.number))
        logged = log_of(plant, world)
        write_world(where.campaign.parent, world, logged)
        strength: Mapping[str, float] = {}
        if world.effects:
            plain = without_effects(world)
            reference = log_of(plant, plain)
            write_world(where.reference.parent, plain, reference)
            strength = strength_of(world, logged, reference)
        seal_truth(
            where, where.name, truth_of_world(world, sorted(plant.not_scored), strength), task.salt
        )
        return made(where)


def log_of(plant: Plant, world: World) -> list[Columns]:
    """Return the columns of all recordings; their noise does not depend on the effects."""
    return [
        columns(world, k, signals, np.random.default_rng([*world.seed, 9, k]))
        for k, signals in enumerate(plant.play(world))
    ]


def strength_of(
    world: World, logged: Sequence[Columns], reference: Sequence[Columns]
) -> dict[str, float]:
    """Return the rms change by the effects in each channel, relative to the channel's noise.

    The noise consists of the noise and the quantisation of the sensor. Current and voltage are
    compared only while the joint moves both with and without the effects, because the torque that
    holds a joint at rest depends on the motion before the rest.
    """
    sensing = world.sensing
    averaged = np.sqrt(world.drive.rate_Hz / world.log.rate_Hz)
    quiet = averaged if world.log.current == "averaged" else 1.0
    noise = {
        "current": float(
            np.hypot(sensing.current_noise_A / quiet, sensing.current_quantum_A / np.sqrt(12.0))
        ),
        "voltage": max(sensing.voltage_noise_V, sensing.current_noise_A),
        **{
            name: count * float(np.hypot(sensing.flicker, 1.0 / np.sqrt(12.0)))
            for name, count in (
                ("motor_angle", world.motor_count_rad),
                ("angle", world.joint_count_rad),
            )
            if count is not None
        },
    }
    found = {}
    # In a fixed order, because the order of a set differs between processes.
    for name in (n for n in noise if n in logged[0]):
        parts = [
            (a[name] - b[name])[_both_move(a, b) if name in ("current", "voltage") else slice(None)]
            for a, b in zip(logged, reference, strict=True)
        ]
        gap = np.concatenate(parts)
        found[name] = float(np.sqrt(np.mean(gap**2)) / noise[name]) if gap.size else 0.0
    return found


def _both_move(a: Columns, b: Columns) -> Array:
    """Return the rows in which the machines with and without effects both move."""
    name = "angle" if "angle" in a else "motor_angle"
    speeds = [np.abs(np.gradient(c[name])) for c in (a, b)]
    return np.asarray(np.minimum(*speeds) > MOVING * max(s.max() for s in speeds))
