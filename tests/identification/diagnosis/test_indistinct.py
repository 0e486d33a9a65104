"""Effects that these recordings do not distinguish, whatever fits better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.comparison import Contender, Round
from identification.diagnosis.held_out import with_indistinct_effects
from identification.diagnosis.joint import Added
from identification.diagnosis.search import Search
from identification.effects import MOTION
from identification.effects.motor import change_at_zero

from .benches import honest, nominal_fit

TERM = {t.name: t for t in MOTION}


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


@pytest.mark.parametrize(
    ("swing_A", "offset_A", "expected_A"), [(3.0, 0.0, 6.0), (3.0, 4.0, 0.0), (0.0, 5.0, 0.0)]
)
def test_the_change_of_a_current_at_zero_is_that_of_one_sample(
    swing_A: float, offset_A: float, expected_A: float
) -> None:
    (view, *_) = nominal_fit(honest()).equations[0].views
    square = np.where(np.arange(len(view.time)) % 20 < 10, -swing_A, swing_A)
    swung = replace(view, current=offset_A + square)
    assert change_at_zero([swung]) == expected_A


def test_noise_of_a_current_around_zero_is_no_passage() -> None:
    """The joint rests for 100 samples in each passage; the noise changes sign many times there, by
    a fifth of what the current changes in motion.
    """
    (view, *_) = nominal_fit(honest()).equations[0].views
    wave = 10.0 * np.sin(2.0 * np.pi * np.arange(400) / 400.0)
    half = np.zeros(100)
    rested = np.concatenate((half, wave[:200], half, wave[200:]))
    current = np.resize(rested, len(view.time))
    noise = 0.02 * np.random.default_rng(0).standard_normal(len(current))
    expected_A = 10.0 * 2.0 * np.pi / 400.0
    for with_noise in (current, current + noise):
        found = change_at_zero([replace(view, current=with_noise)])
        assert found == pytest.approx(expected_A, rel=0.4)
