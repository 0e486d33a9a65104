"""How two fits are compared: by what they leave, and by their numbers of parameters."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.comparison import advantage, preference, simplest
from identification.diagnosis.joint import Added, Joint
from identification.effects import MOTION

from .benches import honest, nominal_fit

TERM = {t.name: t for t in MOTION}
DEAD_TIME = Added(TERM["inverter_dead_time"], (0.01, 0.0, 1.0), (1.0,))
STOP = Added(TERM["end_stop"], (0.0, 0.2, 0.3), (1.0,))
"""Effects with two fitted parameters and with three."""


def left(effect: Added, worse: float) -> Joint:
    """Return a fit with an effect whose squares exceed the noise by ``worse``, unevenly from block
    to block.
    """
    joint = nominal_fit(honest())
    block = joint.stack.block
    uneven = np.where(block % 2 == 0, 1.5, 0.5)
    rows = np.sqrt(1.0 + uneven * worse / np.sum(uneven))
    return replace(joint, residual=rows, effects=(effect,))


def log_rows() -> float:
    return math.log(len(left(STOP, 0.0).residual))


def test_fits_with_equally_many_parameters_are_compared_by_what_they_leave() -> None:
    better, worse = left(STOP, 1.0), left(STOP, 30.0)
    assert preference(better, worse) == advantage(better, worse) > 1.0
    assert preference(worse, better) == -preference(better, worse)


@pytest.mark.parametrize(("gain", "sure"), [(0.5, False), (8.0, True)])
def test_a_parameter_more_must_explain_more_than_chance(gain: float, sure: bool) -> None:
    """In units of log n, Schwarz's price of a parameter."""
    richer, simple = left(STOP, 0.0), left(DEAD_TIME, gain * log_rows())
    assert advantage(richer, simple) > 0.0
    if sure:
        assert 0.0 < preference(richer, simple) < advantage(richer, simple)
    else:
        assert preference(richer, simple) == 0.0
    assert simplest([richer, simple], [3, 2]) == (0 if sure else 1)


def test_a_simpler_fit_is_not_surer_than_what_it_leaves() -> None:
    """The price of the other fit's parameter is no evidence against it."""
    simple, richer = left(DEAD_TIME, 0.0), left(STOP, 5.0)
    assert preference(simple, richer) == advantage(simple, richer)


def test_the_best_of_three_fits_is_the_one_with_the_best_corrected_criterion() -> None:
    """The worst of three is not taken because it has the fewest parameters and the best fit, to
    which it is compared, has the most.
    """
    two = Added(TERM["cogging"], (7.0,), (1.0, 1.0))
    most = replace(left(STOP, 0.0), effects=(STOP, DEAD_TIME))
    middle = left(two, 1.9 * log_rows())
    fewest = left(Added(TERM["asymmetric_coulomb"], (), (1.0,)), 8.0 * log_rows())
    assert simplest([most, middle, fewest], [5, 3, 1]) == 1
