"""How two fits are compared, and effects that these recordings do not distinguish."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.comparison import Contender, Round, advantage, preference, simplest
from identification.diagnosis.held_out import with_indistinct_effects
from identification.diagnosis.joint import Added, Joint
from identification.diagnosis.search import Search
from identification.effects import MOTION
from identification.effects.motor import change_at_zero

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


@pytest.mark.parametrize(
    ("name", "kept", "alias"),
    [
        ("presliding", "motor_angle", ("compliance", "coupling_hysteresis")),
        ("presliding", "angle", ()),
        ("asymmetric_coulomb", "motor_angle", ()),
    ],
)
def test_a_spring_in_the_friction_and_a_twisted_shaft_are_alike_to_the_motors_encoder(
    name: str, kept: str, alias: tuple[str, ...]
) -> None:
    dropped = {"motor_angle", "angle"} - {kept}
    recordings = [
        replace(r, channels={k: v for k, v in r.channels.items() if k not in dropped})
        for r in honest()
    ]
    joint = nominal_fit(recordings)
    shape = (5e3,) if name == "presliding" else ()
    final = replace(joint, effects=(Added(TERM[name], shape, (1.0,)),))
    tested = Contender("stribeck_shape", joint, 4.0, "")
    found = Search(joint, final, (Round(name, (tested,)),), 1e-3, 1.0, "", ())
    (taken,) = with_indistinct_effects(found, ()).rounds
    assert tuple(r.name for r in taken.rivals) == ("stribeck_shape", *alias)
    assert all(r.preference == 0.0 for r in taken.rivals if r.name in alias)


@pytest.mark.parametrize(("samples", "alike"), [(2.0, False), (0.5, True)])
def test_a_brush_drop_within_one_sample_may_be_a_dead_time(samples: float, alike: bool) -> None:
    """Reached over as much current as changes within this number of samples."""
    joint = nominal_fit(honest())
    views = joint.equations[0].views
    greatest_A = float(np.max(np.abs(views[0].recording.channels["current"])))
    shape = (samples * change_at_zero(views) / greatest_A, 0.0, greatest_A)
    final = replace(joint, effects=(Added(TERM["brush_drop"], shape, (0.5,)),))
    found = Search(joint, final, (Round("brush_drop", ()),), 1e-3, 1.0, "", ())
    (taken,) = with_indistinct_effects(found, ()).rounds
    assert [r.name for r in taken.rivals] == ["inverter_dead_time"] * alike
