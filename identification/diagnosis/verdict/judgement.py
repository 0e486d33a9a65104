"""Verdict of a search: which effects are identified, with their rivals and confidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.diagnosis.catalogue import ENTRIES
from identification.diagnosis.catalogue.entry import title
from identification.diagnosis.fit.intervals import estimates
from identification.diagnosis.fit.joint import Joint
from identification.diagnosis.fit.start import NEAR_FLOOR
from identification.diagnosis.fit.within_limits import infeasible
from identification.diagnosis.result import Effect, Estimate, Location, Map, Rival, Verdict
from identification.diagnosis.rows.equations import Equation
from identification.diagnosis.score.locate import location, maps, placed
from identification.diagnosis.score.significance import (
    EXCESS,
    EXCESS_OF_ONE,
    LEVEL,
    NOISE,
    most_of_one,
)
from identification.diagnosis.selection.comparison import REJECTED, Contender, Round, probability
from identification.diagnosis.selection.search import Search
from identification.diagnosis.verdict.hysteretic import remembered
from identification.diagnosis.verdict.one_direction import one_way
from identification.diagnosis.verdict.wording import finding
from identification.model.units import parameter_unit
from identification.prepare import drive_channel
from identification.recording import Bench

ADEQUATE = 0.70
"""Share of the mismatch's power beyond the noise that the effects must explain together; with less
the verdict is outside the catalogue.
"""
MOST = 0.5
"""The same share where some effects were dropped because they do not reduce the error on unused
recordings.
"""
WHOLE = 0.95
"""The same, below which what is left may not go by a coordinate that no name has.

In simulated trials, right effects that leave more than 1.5 times the noise explained at least 95.9
%, and springs that were identified in place of a memory of travel 76 to 89 %.
"""
SUREST = 0.99
"""Most confidence in any name."""
UNFINISHED = 0.8
"""Most confidence in a name beside which the test says that more is missing: in 16 such simulated
trials 13 first names were right.
"""
FAINT_MOST = 0.9
FAINT = 1.0 + (EXCESS - 1.0) / (1.0 - FAINT_MOST)
"""Mean square of a mismatch over the noise's up to which a name gets no more confidence than that:
the rest of it may be something else and still pass for noise
(:data:`identification.diagnosis.selection.removal.EXCESS`).
"""
UNLIKELY = 0.05
"""Confidence in a rival that fits as well, with a parameter beyond what is plausible."""


@dataclass(frozen=True)
class _Excess:
    """Power of an equation's whitened mismatch before and after, over its rows."""

    equation: str
    before: float
    after: float

    @property
    def explained(self) -> float:
        """Share of what is beyond the noise that is explained."""
        beyond = max(self.before - 1.0, 1e-12)
        return min(1.0, max(0.0, (self.before - max(self.after, 1.0)) / beyond))


def _excess(found: Search) -> list[_Excess]:
    stack = found.baseline.stack
    out = []
    for equation in found.baseline.equations:
        rows = stack.part(equation.name)
        before, after = (
            float(np.mean(j.residual[rows] ** 2)) for j in (found.baseline, found.final)
        )
        out.append(_Excess(equation.name, before, after))
    return out


def judged(
    found: Search, rng: np.random.Generator, searched: Search | None = None
) -> tuple[Verdict, Location | None, tuple[Map, ...]]:
    """Return the verdict, where the mismatch is, and its maps.

    Args:
        found: The search with its fits within their limits and the effects that were kept.
        rng: Random generator for the bands of the maps.
        searched: The search before effects were dropped; None if it is the same. Both must explain
            enough of the mismatch.
    """
    searched = searched or found
    stack = found.baseline.stack
    main = _main_equation(found)
    rows = stack.part(main.name)
    before, after = (main.sigma * j.residual[rows] for j in (found.baseline, found.final))
    drawn = maps(stack, main, before, after, rng)
    where = location(main, drawn[0], before) if drawn else None
    if found.p_value > LEVEL:
        return Verdict.NOTHING_MISSING, None, drawn
    # A breakaway is one number for a rest, and its noise that of an instant within a sample: it
    # judges no model.
    judges = [e for e in _excess(found) if e.equation != "breakaway"]
    least = NOISE if found.final.effects else EXCESS
    if not _beyond(found.baseline, judges, least):
        return Verdict.NOTHING_MISSING, None, drawn
    fewer = len(found.final.effects) < len(searched.final.effects)
    if (
        not found.final.effects
        or _short(searched)
        or (fewer and _short(found, MOST))
        or one_way(found.final)
        or infeasible(searched.final)
        or _remembered(searched)
    ):
        return Verdict.OUTSIDE_CATALOGUE, where, drawn
    open_rivals = any(_open(r) for r in found.rounds)
    return (Verdict.AMBIGUOUS if open_rivals else Verdict.NAMED), where, drawn


def too_little(found: Search, verdict: Verdict, rng: np.random.Generator) -> tuple[str, ...]:
    """Say what effects of the catalogue explain a part of a mismatch that has no name, or one way
    of motion only.
    """
    if verdict is not Verdict.OUTSIDE_CATALOGUE or not found.final.effects:
        return ()
    lopsided = one_way(found.final)
    if lopsided:
        return tuple(
            f"{title(n)} would explain it, were it not another one way than the other"
            for n in lopsided
        )
    if infeasible(found.final):
        return ()
    share = next(e.explained for e in _excess(found) if e.equation == _main_equation(found).name)
    words = "; and ".join(e.statement for e in effects_of(found, rng))
    return (
        f"{100.0 * share:.0f} % of what is beyond the noise, too little for a name, would be "
        f"explained if {words}",
    )


def _short(found: Search, share: float = ADEQUATE) -> bool:
    """Whether names explain less than a share of what is beyond the noise."""
    judges = [e for e in _excess(found) if e.equation != "breakaway"]
    worst = max(judges, key=lambda e: (e.before - 1.0) * _rows(found, e.equation))
    equation = next(e for e in found.final.equations if e.name == worst.equation)
    left = worst.after > NEAR_FLOOR or most_of_one(found.final, equation) > EXCESS_OF_ONE
    return worst.explained < share and left


def _beyond(joint: Joint, judges: Sequence[_Excess], least: float) -> bool:
    """Whether the nominal model leaves more than noise in any equation.

    A pattern within the noise is no mismatch that anybody could look for.

    Args:
        joint: Fit of the nominal model.
        judges: Its equations.
        least: Ratio of the mean-square mismatch to the noise's from which it counts.
    """
    equations = {e.name: e for e in joint.equations}
    return any(
        e.before > least or most_of_one(joint, equations[e.equation]) > EXCESS_OF_ONE
        for e in judges
    )


def _remembered(found: Search) -> bool:
    """Whether names leave a share of the torque's mismatch that no right name does, and it goes by
    travel.
    """
    torque = next(e for e in _excess(found) if e.equation == "torque")
    return torque.explained < WHOLE and remembered(found.final)


def _rows(found: Search, equation: str) -> int:
    rows = found.baseline.stack.part(equation)
    return int(rows.stop - rows.start)


def _main_equation(found: Search) -> Equation:
    """Return the equation whose mismatch the final model takes away most of; the torque's where
    there is none.
    """
    if found.p_value > LEVEL:
        return found.baseline.equations[0]
    stack = found.baseline.stack

    def taken(equation: Equation) -> float:
        rows = stack.part(equation.name)
        return float(
            np.sum(found.baseline.residual[rows] ** 2) - np.sum(found.final.residual[rows] ** 2)
        )

    if found.final.effects:
        return max(found.baseline.equations, key=taken)
    # A breakaway judges no model, however sure its pattern is.
    judges = [e for e in found.baseline.equations if e.name != "breakaway"]
    loudest = found.loudest.split(" ")[0]
    named = [e for e in judges if e.name == loudest]
    return named[0] if named else max(judges, key=lambda e: _beyond_noise(found.baseline, e))


def _beyond_noise(joint: Joint, equation: Equation) -> float:
    """Return the sum of whitened squares that a fit leaves of an equation beyond the noise."""
    rows = joint.residual[joint.stack.part(equation.name)]
    return float(rows @ rows) - len(rows)


def _open(taken: Round) -> tuple[str, ...]:
    """Return rivals that the data cannot reject."""
    return tuple(r.name for r in taken.rivals if r.preference < REJECTED)


def effects_of(found: Search, rng: np.random.Generator) -> tuple[Effect, ...]:
    """Return every effect that was kept, with its parameters, rivals and confidence.

    In the order in which the search came upon them, each having explained most of what was left
    then: what another took the place of since stands last in the fit.

    Args:
        found: The search.
        rng: Of the bands of the maps.
    """
    sizes = estimates(found.final)
    places = {e.term.name: k for k, e in enumerate(found.final.effects)}
    excess = {e.equation: e for e in _excess(found)}
    return tuple(
        _effect(found, places[r.name], sizes[places[r.name]], r, excess, rng)
        for r in found.rounds
        if r.name in places
    )


def own_bench(found: Search) -> Bench:
    """Return the bench that was diagnosed."""
    return found.baseline.equations[0].views[0].recording.bench


def _effect(
    found: Search,
    k: int,
    sizes: Mapping[str, Estimate],
    taken: Round,
    excess: Mapping[str, _Excess],
    rng: np.random.Generator,
) -> Effect:
    entry = ENTRIES[taken.name]
    motion, amperes = own_bench(found).motion, found.baseline.equations[0].unit == "A"
    units = {q.name: parameter_unit(motion, q.name, q.unit, amperes) for q in entry.parameters}
    parameters = {n: replace(e, unit=units.get(n, "")) for n, e in sizes.items()}
    stack = found.baseline.stack
    own = max(
        (e for e in found.baseline.equations if e.name in found.final.effects[k].term.columns),
        key=lambda e: excess[e.name].before * len(e.residual),
    )
    rows = stack.part(own.name)
    before, after = (own.sigma * j.residual[rows] for j in (found.baseline, found.final))
    drawn = maps(stack, own, before, after, rng)
    where = location(own, placed(drawn, entry.coordinate.split(":")[0]), before)
    place = found.final.effects[k].term.place
    if place is not None:
        index = round(found.final.effects[k].shape[place])
        where = replace(
            where, recordings=(own.views[[v.index for v in own.views].index(index)].recording.name,)
        )
    open_names = _open(taken)
    quality = max(excess[own.name].explained, 1.0 if excess[own.name].after < NEAR_FLOOR else 0.0)
    confidence = confidence_of(taken, quality, found.p_after, excess[own.name].before)
    rivals = tuple(
        Rival(
            r.name,
            min(1.0 - probability(r.preference), UNLIKELY if r.beyond else 0.5),
            _why_not(r),
        )
        for r in taken.rivals
    )
    return Effect(
        name=taken.name,
        alias_group=(taken.name, *open_names),
        confidence=confidence,
        statement=finding(
            entry,
            parameters,
            where.recordings,
            drive_channel(found.baseline.equations[0].views[0].recording),
        ),
        assumption_broken=entry.assumption,
        where=where,
        parameters=parameters,
        rivals=rivals,
        separating_experiment=entry.experiment,
    )


def confidence_of(taken: Round, quality: float, p_after: float, before: float) -> float:
    """Return the confidence in a name: over its rivals, by how much it explains, and whether more
    is missing after all.

    Args:
        taken: With its rivals.
        quality: Share of the mismatch beyond the noise that is explained in its main equation.
        p_after: Of the test that anything more is missing.
        before: Mean square of that equation's mismatch over the noise's without any name.
    """
    over = [
        max(probability(r.preference), 1.0 - UNLIKELY if r.beyond else 0.0) for r in taken.rivals
    ]
    most = UNFINISHED if p_after <= LEVEL else FAINT_MOST if before < FAINT else SUREST
    return min(most, min([SUREST, *over]) * (0.5 + 0.5 * quality))


def _why_not(rival: Contender) -> str:
    """Say why a rival was not taken; empty where it might as well have been."""
    if rival.preference >= REJECTED:
        return f"its error is larger by {rival.preference:.1f} standard errors"
    return f"it fits as well, but only with {rival.beyond}" if rival.beyond else ""
