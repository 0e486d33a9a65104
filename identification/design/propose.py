"""Which excitation, within a bench's limits and in the same time, would pin the weakest parameter best.

Informations of stages add and grow with time. So many sines are judged once on short stages, and a convex problem
shares the time among them (:mod:`identification.design.shares`). The few that get a share take the place of the stages:
one sine alone leaves parameters that trade off, and a slow one beside a fast one, or a light weight beside a heavy one,
tells them apart. What rests on the drive loop that was assumed is dropped: each sine that gets a share is judged with
softer and stiffer drives too. In the end the best few designs are rehearsed with those drives, which decides.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.design.excitation import Bounds, Frame, Part
from identification.design.pinning import Nominal, Pinned, pinned, stage_information
from identification.design.rehearsal import rehearse
from identification.design.search import STIFFNESSES, Design, Search, merit, planned

CANDIDATES = 30
"""Random excitations judged for each of unloaded and loaded stages."""
REFINEMENTS = 16
"""Small changes tried afterwards of those that get a share."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Proposal:
    """What the present excitation pins, what is proposed instead, and what that would pin.

    Attributes:
        weakest: The parameter that is to be pinned better.
        present: By the rehearsal of the present excitation.
        stages: The proposal; the present excitation where nothing better was found.
        pinned: By its rehearsal.
        promised: By its Fisher information.
        judged: Excitations simulated.
        rehearsed: Whole experiments rehearsed.
    """

    weakest: str
    present: Pinned
    stages: tuple[Part, ...]
    pinned: Pinned
    promised: Pinned
    judged: int
    rehearsed: int


def present_pins(frames: Sequence[Frame], nominal: Nominal) -> Pinned:
    """Return what the excitation of these stages pins as it stands."""
    found = [stage_information(planned(f, f.present), nominal) for f in frames]
    return pinned(found, any(f.loaded for f in frames))


def propose(
    frames: Sequence[Frame],
    nominal: Nominal,
    bounds: Bounds,
    rng: np.random.Generator,
    progress: Progress | None = None,
    weakest: str | None = None,
) -> Proposal:
    """Search for the excitation that narrows one parameter's relative interval most.

    Args:
        frames: The stages; their total time stays, and so do unloaded and loaded ones.
        nominal: The model.
        bounds: Limits of the bench.
        rng: Source of all randomness.
        progress: Called with what is done and its share.
        weakest: That parameter; None for the one that a rehearsal of the present excitation pins worst.
    """
    tell = progress or (lambda _label, _share: None)
    present = tuple(Part(k, f.present) for k, f in enumerate(frames))
    best = now = _rehearsed(frames, present, nominal)
    target = weakest or now.weakest
    search = Search(frames, nominal, bounds, rng, target)
    kinds = sorted({f.loaded for f in frames})
    for number, loaded in enumerate(kinds):
        for k in range(CANDIDATES):
            search.add(search.random(loaded))
            tell("candidates", (number + (k + 1) / CANDIDATES) / len(kinds))
    for k in range(REFINEMENTS):
        search.add(search.changed())
        tell("refinement", (k + 1) / REFINEMENTS)
    designs = search.designs()
    chosen = Design(present, present_pins(frames, nominal))
    tried = 0
    for k, design in enumerate(designs):
        if merit(design.promised, target) > merit(best, target):
            break  # a rehearsal is seldom better than the information, and designs come the most promising first
        found = _rehearsed(frames, design.parts, nominal)
        tried += 1
        if merit(found, target) < merit(best, target):
            best, chosen = found, design
        tell("rehearsal", (k + 1) / len(designs))
    return Proposal(target, now, chosen.parts, best, chosen.promised, search.count, 1 + tried)


def _rehearsed(frames: Sequence[Frame], parts: Sequence[Part], nominal: Nominal) -> Pinned:
    """Return the worst of the rehearsals of one design, with drives that are softer and stiffer than assumed."""
    stages = [planned(frames[p.frame], p.excitation) for p in parts]
    runs = [
        rehearse(stages, replace(nominal, stiffness=stiffness), np.random.default_rng(k))
        for k, stiffness in enumerate(STIFFNESSES)
    ]
    return Pinned({name: max(run.half_widths[name] for run in runs) for name in runs[0].half_widths})
