"""Which effect to try beside those already named, where one equation's mismatch would drown
another's.

Encoders see a gap a thousand times more sharply than the current sees friction. What a regressor
that only resembles its physics leaves in the one equation is then far more, in squares, than all
that is missing in the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from identification.diagnosis.joint import Joint
from identification.diagnosis.kept import FURTHER_SHARE, hopeless, judging, left_beyond_noise
from identification.diagnosis.stack import Candidate
from identification.diagnosis.terms.term import Term

FINALISTS = 4
"""Effects that are fitted jointly before one of them is taken."""
RIVAL_SHARE = 0.3
"""Score over the best one's, below which an effect is no finalist."""


def groups(
    baseline: Joint,
    joint: Joint,
    terms: Mapping[str, Term],
    ranked: Sequence[Candidate],
    missing: Callable[[str], bool],
) -> Iterator[list[Candidate]]:
    """Yield finalists, to be tried one group after another until one of them is taken.

    The first effect is the one that explains most. Of further ones those come first that explain,
    of what is left beyond the noise where they show, the share that makes one more name. None
    counts that shows only where nothing is missing, or that could not be kept.

    Args:
        baseline: The nominal model.
        joint: With the effects so far.
        terms: Of the candidates, by name.
        ranked: The best candidate of each effect, best first.
        missing: Whether anything is missing in an equation of this name.
    """
    if not joint.effects:
        yield _finalists(ranked)
        return
    seen = {e.name for e in joint.equations if missing(e.name)}
    shown = [
        c
        for c in ranked
        if any(name in seen for name in judging(joint, terms[c.name]))
        and not hopeless(baseline, joint, terms[c.name], c)
    ]
    telling = [
        c for c in shown if c.gain >= FURTHER_SHARE * left_beyond_noise(joint, terms[c.name])
    ]
    first = _finalists(telling)
    yield first
    rest = [c for c in shown if c not in first]
    yield _finalists(rest)


def _finalists(ranked: Sequence[Candidate]) -> list[Candidate]:
    return [c for c in ranked if c.score > RIVAL_SHARE * ranked[0].score][:FINALISTS]
