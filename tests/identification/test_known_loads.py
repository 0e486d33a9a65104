"""Loads that pull the same way at every angle: a hoisted mass, a known constant torque."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from identification.diagnosis.unexplained import unrecorded_effects
from identification.diagnosis.within_limits import views_and_fit
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.export.model import CorrectedModel, predictions
from identification.filter.segments import motion
from identification.prepare import prepare
from identification.recording import (
    Bench,
    Dataset,
    Hoist,
    Model,
    Pendulum,
    Recording,
)
from identification.views.view import views

from .synthetic import TRUTH, sine

G = 9.80665


def lifting(hoist: Hoist, drag_N_m: float = 0.0) -> Recording:
    """A sine under a mass that the drive lifts on the way forward, and a constant drag."""
    bare = sine()
    w = 2.0 * np.pi * 0.2
    acceleration = -0.35 * w**2 * np.sin(w * bare.time)
    torque = bare.channels["torque"] + hoist.mass * G * hoist.radius + drag_N_m
    torque = torque + hoist.mass * hoist.radius**2 * acceleration
    return replace(
        bare,
        channels={**bare.channels, "torque": torque},
        hoist=hoist,
        constant_torque=-drag_N_m,
    )


@pytest.mark.parametrize("radius", [0.4, -0.4])
def test_a_known_load_leaves_the_torque_of_the_bare_joint(radius: float) -> None:
    loaded, bare = lifting(Hoist(3.0, radius), 2.5), sine()
    found, wanted = prepare(loaded, 40.0), prepare(bare, 40.0)
    assert found.torque == pytest.approx(wanted.torque, abs=2e-3)
    lifted = found.drive_torque - wanted.drive_torque
    assert np.mean(lifted) == pytest.approx(3.0 * G * radius + 2.5, abs=0.2)
    seen, plain = views([loaded], 25.0)[0], views([bare], 25.0)[0]
    assert seen.low_pass(seen.torque) == pytest.approx(plain.low_pass(plain.torque), abs=5e-3)
    assert seen.hanging == pytest.approx(np.full(len(seen.time), -3.0 * G * radius - 2.5))


@pytest.mark.parametrize("pendulum", [None, Pendulum(3.0, 0.4, 0.2)])
def test_a_predicted_torque_leaves_known_loads_to_themselves(pendulum: Pendulum | None) -> None:
    recording = lifting(Hoist(3.0, 0.4)) if pendulum is None else sine(pendulum=pendulum)
    model = CorrectedModel(TRUTH)
    (predicted,) = predictions(views([recording], 25.0)[0], model)
    assert np.max(np.abs(predicted.measured[np.isfinite(predicted.measured)])) > 10.0
    assert np.std(predicted.error) < 0.1
    assert abs(np.mean(predicted.error)) < 0.01


def test_the_likelihood_takes_the_hoisted_mass(
    practical_pair: tuple[Recording, Recording],
) -> None:
    bare = motion(practical_pair[0])
    hung = motion(replace(practical_pair[0], hoist=Hoist(2.0, 0.3), constant_torque=0.5))
    assert hung.extra_inertia == pytest.approx(2.0 * 0.3**2)
    assert bare.torque - hung.torque == pytest.approx(
        np.full(len(bare.torque), 2.0 * G * 0.3 - 0.5)
    )


@pytest.mark.parametrize(
    ("load", "borne"),
    [
        ({}, False),
        ({"hoist": Hoist(3.0, 0.4)}, True),
        ({"constant_torque": 2.0}, True),
        ({"hoist": Hoist(3.0), "constant_torque": 3.0 * G}, False),
    ],
)
def test_friction_may_grow_with_any_torque_that_the_joint_bears(
    load: dict[str, Any], borne: bool
) -> None:
    here, joint = views_and_fit(Dataset((replace(sine(), **load),), Model()), 25.0)
    term = next(t for t in MOTION if t.name == "load_dependent_friction")
    assert bool(term.shapes(Context(here, joint.nominal))) is borne


@pytest.mark.parametrize(
    ("bench", "kept"),
    [
        (Bench(), {"cogging", "gravity_imbalance"}),
        (Bench("linear", gear_ratio=628.3), {"cogging"}),
        (Bench("linear"), set()),
    ],
)
def test_a_carriage_has_no_angle_and_a_screw_has_the_motors(bench: Bench, kept: set[str]) -> None:
    recording = replace(sine(), bench=bench)
    excluded, _ = unrecorded_effects([recording], views([recording], 25.0))
    assert {"cogging", "gravity_imbalance"} - excluded == kept
