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
from identification.effects.model import CorrectedModel, predictions
from identification.filter.segments import motion
from identification.prepare import prepare
from identification.recording import (
    Array,
    Bench,
    Controller,
    Dataset,
    Hoist,
    Model,
    Pendulum,
    Recording,
)
from identification.simulate.closed_loop import (
    OPEN_LOOP,
    Inputs,
    body_of,
    inputs_of,
    loop_of,
    simulate,
)
from identification.views.view import one_clock, run_starts, views

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
    assert bare is not None
    assert hung is not None
    assert hung.extra_inertia == pytest.approx(2.0 * 0.3**2)
    assert bare.torque - hung.torque == pytest.approx(
        np.full(len(bare.torque), 2.0 * G * 0.3 - 0.5)
    )


def test_a_free_joint_falls_as_the_mass_pulls() -> None:
    time = np.linspace(0.0, 0.5, 501)
    none = np.zeros(501)
    r = Recording("falls", {"time": time, "angle": none}, Bench(), hoist=Hoist(2.0, 0.1))
    body = body_of({"J": 0.03}, r, 2.0)
    out = simulate(body, OPEN_LOOP, Inputs(time, none, none + 1.0, none, none), 0.0, 0.0)
    assert out.velocity == pytest.approx(-2.0 * G * 0.1 / (0.03 + 0.02) * time, abs=1e-9)


def test_the_gear_bears_the_hoisted_mass() -> None:
    """At rest the joint holds as much as friction that grows with the load allows."""
    time = np.linspace(0.0, 1.0, 1001)
    none = np.zeros(1001)
    r = Recording(
        "held",
        {"time": time, "angle": none, "command": none},
        Bench(),
        hoist=Hoist(2.0, 0.1),
        controller=Controller("torque", 1e-6),
    )
    assert r.controller is not None
    held, slips = (
        simulate(
            body_of({"J": 0.1, "mu_gc": mu, "mu_gs": mu}, r, 2.0),
            loop_of(r.controller, r),
            inputs_of(r),
            0.0,
            0.0,
        )
        for mu in (1.01, 0.9)
    )
    assert np.all(held.velocity == 0.0)
    assert slips.velocity[-1] < -0.1


def stamped(first: float, start: float | None) -> Recording:
    time: Array = first + np.arange(1000) * 0.01
    return Recording("r", {"time": time, "angle": time, "torque": time}, Bench(), start=start)


def test_a_declared_start_sets_the_clock_whatever_the_stamps_say() -> None:
    late, early = stamped(0.0, 600.0), stamped(0.0, 0.0)
    assert one_clock([late, early])
    assert run_starts([late, early]) == [600.0, 0.0]
    unknown = [stamped(0.0, None), stamped(0.0, None)]
    assert not one_clock(unknown)
    assert run_starts(unknown) == [0.0, 0.0]
    assert views([late, early], 10.0)[0].run_time[0] == pytest.approx(600.0)


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
