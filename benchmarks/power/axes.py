"""Worlds that differ in one axis at a time: a base world, and each value of each axis."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from rig.results.prove.worlds.draw import draw_world
from rig.results.prove.worlds.motion import MOTIONS, Reach, command
from rig.results.prove.worlds.world import COMMAND_S, Pendulum, Planned, World

RECORDINGS, SECONDS = 4, 8.0
LOOP_HZ = 4000
BITS_MOTOR, BITS_JOINT = 14, 20
RATE_HZ, WEIGHTS = 1000, 2
MIXED = "mixed"
"""Base excitation: four kinds, one in each recording."""
AXES: dict[str, tuple[str, ...]] = {
    "rate": ("100 Hz", "250 Hz", "1000 Hz", "4000 Hz"),
    "bits": ("12 bit", "16 bit", "20 bit", "24 bit"),
    "encoders": ("motor", "joint", "both"),
    "loads": ("none", "1 weight", "2 weights", "3 weights", "on the joint"),
    "excitation": (MIXED, *MOTIONS),
    "voltage": ("absent", "measured", "commanded"),
}
BASE = {
    "rate": "1000 Hz",
    "bits": "20 bit",
    "encoders": "both",
    "loads": "2 weights",
    "excitation": MIXED,
    "voltage": "commanded",
}
KINDS = ("several sines", "steps", "pick and place", "random")
WITH_LEVER = "load_exponent"
"""Effect that makes a drawn world have weights on a lever, and friction that may fall."""
FALLS = "friction_memory"


def base_world(seed: int, number: int) -> World:
    """Draw the machine, its noise and its gains, and set the axes to their base values."""
    for draw in itertools.count():
        world = draw_world("two", (WITH_LEVER, FALLS), (seed, number, draw))
        if getattr(world, "motion", "rotary") == "rotary":
            break
    drive, sensing, log = world.drive, world.sensing, world.log
    return replace(
        world,
        effects={},
        drive=replace(
            drive,
            kind="cascade",
            rate_Hz=LOOP_HZ,
            velocity_Hz=min(drive.velocity_Hz, LOOP_HZ / 60.0),
            current_Hz=min(drive.current_Hz, LOOP_HZ / 10.0),
        ),
        sensing=replace(sensing, motor_bits=BITS_MOTOR, joint_bits=BITS_JOINT),
        log=replace(
            log,
            rate_Hz=RATE_HZ,
            current="averaged",
            voltage="commanded",
            supply=False,
            jitter=0.0,
            clock=True,
            packed=True,
        ),
        recordings=_recordings(world, WEIGHTS, BASE["excitation"]),
    )


def worlds(base: World) -> Iterator[tuple[str, str, World]]:
    """Yield axis, value and world; the base world is the first, as axis and value ``base``."""
    yield "base", "base", base
    for axis, values in AXES.items():
        for value in values:
            if value != BASE[axis]:
                yield axis, value, _moved(base, axis, value)


def _moved(base: World, axis: str, value: str) -> World:
    """Return the base world with another value of one axis."""
    if axis == "rate":
        return replace(base, log=replace(base.log, rate_Hz=int(value.split()[0])))
    if axis == "bits":
        return replace(base, sensing=replace(base.sensing, joint_bits=int(value.split()[0])))
    if axis == "encoders":
        none = {"motor": "joint_bits", "joint": "motor_bits"}[value]
        return replace(base, sensing=replace(base.sensing, **{none: None}))
    if axis == "voltage":
        return replace(base, log=replace(base.log, voltage=value))
    if axis == "excitation":
        return replace(base, recordings=_recordings(base, WEIGHTS, value))
    if value == "on the joint":
        return replace(base, recordings=_recordings(base, 0, MIXED, hung=True))
    weights = 0 if value == "none" else int(value.split()[0])
    return replace(base, recordings=_recordings(base, weights, MIXED))


def _recordings(
    world: World, weights: int, excitation: str, hung: bool = False
) -> tuple[Planned, ...]:
    """Return recordings of one excitation, with weights from none to the heaviest of the world.

    Args:
        world: World whose commands show its limits of travel, speed and acceleration.
        weights: Number of weights.
        excitation: Kind, or :data:`MIXED`.
        hung: Whether a weight turns with the joint, of twice the Coulomb friction's torque.
    """
    heaviest = max(r.weight_kg for r in world.recordings)
    pendulum = None
    if hung:
        length = 0.1
        mass = 2.0 * world.constants.Mc / (world.gravity_m_s2 * length)
        pendulum = Pendulum(mass, length, 0.0)
    planned = []
    for k in range(RECORDINGS):
        kind = KINDS[k % len(KINDS)] if excitation == MIXED else excitation
        # The same draws of each recording in every world of one machine.
        rng = np.random.default_rng([*world.seed, 77, k])
        path = command(rng, kind, SECONDS, 0.0, _reach(world))
        weight = heaviest * (k % (weights + 1)) / weights if weights else 0.0
        planned.append(Planned(f"rec{k:02d}", "fit", kind, path, 0.0, weight, pendulum, 5.0))
    return tuple(planned)


def _reach(world: World) -> Reach:
    """Return the greatest travel, speed and acceleration of the world's own commands."""
    speeds = [np.gradient(r.command, COMMAND_S) for r in world.recordings]
    changes = [np.gradient(v, COMMAND_S) for v in speeds]
    travel = max(float(np.abs(r.command).max()) for r in world.recordings)
    return Reach(travel, *(max(float(np.abs(x).max()) for x in of) for of in (speeds, changes)))
