"""The two kinds of proof: trials with effects in the motion, and trials with effects in the gas
generator.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from rig.results.prove.draw import Assigned, assignment, draw
from rig.results.prove.gas_draw import gas_assignment
from rig.results.prove.gas_simulate import seal_gas, simulate_gas
from rig.results.prove.generate import Sealed, seal_rig, simulate_rig
from rig.results.prove.seal import repeated_salt

Seed = Sequence[int]


class Family(NamedTuple):
    """Functions that make the trials of one proof.

    Attributes:
        assignment: Function of number of trials and seed; returns kind and effects of each trial.
        seal: Function of folder, number, kind and effects, and seed; returns the sealed trial.
        simulate: Function of sealed trial, kind and effects, and seed; writes the campaign and
            returns the strength by channel.
    """

    assignment: Callable[[int, int], list[Assigned]]
    seal: Callable[[Path, int, Assigned, Seed], Sealed]
    simulate: Callable[[Sealed, Assigned, Seed], dict[str, float]]


def _seal_motion(out: Path, number: int, assigned: Assigned, seed: Seed) -> Sealed:
    return seal_rig(out, number, draw(*assigned, seed), repeated_salt(*seed))


def _simulate_motion(where: Sealed, assigned: Assigned, seed: Seed) -> dict[str, float]:
    return simulate_rig(where, draw(*assigned, seed))


MOTION, GAS = "motion", "gas"
FAMILIES: Mapping[str, Family] = {
    MOTION: Family(assignment, _seal_motion, _simulate_motion),
    GAS: Family(gas_assignment, seal_gas, simulate_gas),
}
