"""Which excitation, within a bench's limits and in the same time, would pin the weakest parameter
best.

Informations of stages add and grow with time. So many sines and ramps are judged once on short
stages, and a convex problem shares the time among them (:mod:`identification.design.shares`). The
few that get a share take the place of the stages: one sine alone leaves parameters that trade off,
and a slow one beside a fast one, or a light weight beside a heavy one, tells them apart. Each is
judged with softer and stiffer drives too, as where a shaft sticks and slips rests on the loop. In
the end the best few designs are simulated with those drives and noise, and the best of them that
the default method identifies is proposed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from identification.design.excitation import Bounds, Frame, Part
from identification.design.pinning import Pinned
from identification.design.search import Design, Search, halved, planned, promised
from identification.design.simulated import Nominal, PlannedStage, with_drives
from identification.design.simulated_trial import expected, rehearse

CANDIDATES = (60, 200)
"""Random excitations judged for unloaded and for loaded stages, which have a weight to choose as
well.
"""
REFINEMENTS, TOGETHER = 24, 10
"""How often small changes of those that get a share are tried afterwards, and how many each
time.
"""
REHEARSALS = 3
"""Designs that go through the whole method before milder ones are tried, at most."""
BORNE_OUT = 2.0
"""What the whole method gives, over what was expected, at which no other design is rehearsed."""
NOISES = 3
"""With which a design goes through the whole method; the worst counts."""
WHOLE_SEED = 100
"""Of the noise in what goes through the whole method; drives are numbered from 0."""
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Proposal:
    """What the present excitation pins, what is proposed instead, and what that would pin.

    Attributes:
        weakest: The parameter that is to be pinned better.
        present: What a simulation of the present excitation gives.
        stages: The proposal; the present excitation where nothing better was found.
        pinned: What simulations of it give, the default method's among them.
        promised: By its Fisher information.
        judged: Excitations simulated.
        rehearsed: Whole experiments that the default method identified.
    """

    weakest: str
    present: Pinned
    stages: tuple[Part, ...]
    pinned: Pinned
    promised: Pinned
    judged: int
    rehearsed: int


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
        weakest: That parameter; the one that the present excitation pins worst where it is None, or
            has no part in these stages.
    """
    tell = progress or (lambda _label, _share: None)
    present = tuple(Part(k, f.present) for k, f in enumerate(frames))
    nominals = with_drives(nominal)
    now, _ = expected(_stages(frames, present), nominals)
    target = weakest if weakest is not None and weakest in now.half_widths else now.weakest
    search = Search(frames, nominals, bounds, rng, target, now.half_widths[target])
    kinds = sorted({f.loaded for f in frames})
    for number, loaded in enumerate(kinds):
        wanted = CANDIDATES[loaded]
        for k in range(wanted):
            search.add(search.draws.random(loaded))
            tell("candidates", (number + (k + 1) / wanted) / len(kinds))
    if not search.complete:
        # No draw is one that an identification can start from; the present excitations are.
        for part in present:
            search.add(part)
    for k in range(REFINEMENTS):
        for part in search.changed(TOGETHER):
            search.add(part)
        tell("refinement", (k + 1) / REFINEMENTS)
    best, chosen, tried = now, Design(present, promised(frames, present, nominals, target)), 0
    designs = search.designs()
    for step in (designs, (halved(d, frames, nominals, target) for d in designs)):
        found, design, rehearsed = _likeliest_to_hold(step, search, now, tell)
        tried += rehearsed
        if design is not None and search.merit(found) < search.merit(best):
            best, chosen = found, design
            break
    return Proposal(target, now, chosen.parts, best, chosen.promised, search.count, tried)


def _likeliest_to_hold(
    designs: Iterable[Design], search: Search, now: Pinned, tell: Progress
) -> tuple[Pinned, Design | None, int]:
    """Return the best of some designs that the default method identifies, what it gives, and how
    many were rehearsed.

    The first whose rehearsal bears out what was expected of it; where none does, the one that comes
    out best.
    """
    frames, nominals = search.frames, search.nominals
    judged = [(*expected(_stages(frames, design.parts), nominals), design) for design in designs]
    # What the values simulated are not likely under will come out beside them: its widths are worth
    # less.
    ranked = sorted(
        (p for p in judged if search.merit(p[0]) < search.merit(now)),
        key=lambda p: search.merit(p[0]) * p[1],
    )
    best: tuple[Pinned, Design | None] = now, None
    for tried, (found, _, design) in enumerate(ranked[:REHEARSALS], 1):
        stages = _stages(frames, design.parts)
        whole = _worst(stages, search)
        tell("rehearsal", tried / len(ranked))
        worse = max(found, whole, key=search.merit)
        if search.merit(worse) < search.merit(best[0]):
            best = worse, design
        if best[1] is not None and search.merit(whole) < BORNE_OUT * search.merit(found):
            return *best, tried
    return *best, min(len(ranked), REHEARSALS)


def _worst(stages: Sequence[PlannedStage], search: Search) -> Pinned:
    """Return the worst of a few replicates; the first that fails is the last."""
    found = []
    for seed in range(WHOLE_SEED, WHOLE_SEED + NOISES):
        found.append(rehearse(stages, search.nominals[0], np.random.default_rng(seed)))
        if math.isinf(search.merit(found[-1])):
            break
    return max(found, key=search.merit)


def _stages(frames: Sequence[Frame], parts: Sequence[Part]) -> list[PlannedStage]:
    return [planned(frames[p.frame], p.excitation) for p in parts]
