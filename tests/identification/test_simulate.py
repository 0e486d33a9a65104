"""The forward simulation against closed forms, a library's integrator, and itself at a finer
step.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate

from identification.prepare import prepare
from identification.recording import Bench, Controller, Pendulum, Recording, RecordingError
from identification.simulate.closed_loop import (
    OPEN_LOOP,
    Inputs,
    body_of,
    compare,
    inputs_of,
    loop_of,
    pooled,
    replay,
    simulate,
    with_friction,
)

from .synthetic import TRUTH


def recording(
    pendulum: Pendulum | None = None, controller: Controller | None = None, **channels: np.ndarray
) -> Recording:
    time = channels.pop("time", np.linspace(0.0, 1.0, 1001))
    channels.setdefault("angle", np.zeros(len(time)))
    return Recording(
        "made", {"time": time, **channels}, Bench(), pendulum=pendulum, controller=controller
    )


def inputs(
    time: np.ndarray, command: np.ndarray | None = None, added: np.ndarray | None = None
) -> Inputs:
    zero = np.zeros(len(time))
    return Inputs(
        time,
        zero if command is None else command,
        np.ones(len(time)),
        zero if added is None else added,
        zero,
    )


def test_coulomb_friction_stops_a_free_shaft_where_its_energy_says_and_holds_it_exactly() -> None:
    time = np.linspace(0.0, 1.0, 501)
    body = body_of({"J": 0.2, "Mc": 1.0}, recording(), 2.0)
    out = simulate(body, OPEN_LOOP, inputs(time), 0.1, 3.0)
    stop_s, way = 0.2 * 3.0 / 1.0, 0.2 * 9.0 / 2.0
    assert out.angle[-1] == pytest.approx(0.1 + way, abs=3.0 * 2.5e-4)
    moving = time < stop_s - 1e-9
    np.testing.assert_allclose(out.velocity[moving], 3.0 - 5.0 * time[moving], atol=1e-9)
    still = time > stop_s + 1e-3
    assert np.all(out.velocity[still] == 0.0)
    assert np.ptp(out.angle[still]) == 0.0


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_shaft_breaks_away_when_the_torque_passes_the_static_limit(side: float) -> None:
    time = np.linspace(0.0, 1.0, 2001)
    torque = side * 20.0 * time
    body = body_of(TRUTH, recording(), 2.0)
    out = simulate(body, OPEN_LOOP, inputs(time, added=torque), 0.0, 0.0)
    first = time[np.flatnonzero(out.velocity)[0]]
    assert first == pytest.approx(TRUTH["Ms"] / 20.0, abs=1.5e-3)
    assert np.all(side * out.velocity >= 0.0)


def test_without_friction_it_agrees_with_a_library_on_a_driven_pendulum() -> None:
    time = np.linspace(0.0, 3.0, 1501)
    command = 0.5 * np.sin(2.0 * time)
    pendulum = Pendulum(0.4, 0.1, 0.1)
    r = recording(pendulum, time=time, command=command)
    body = body_of({"J": 0.002, "sigma_2": 0.01}, r, 2.0)
    loop = np.array([1.5, 0.02, math.inf, 1.0, 0.005])

    def rate(t: float, state: np.ndarray) -> list[float]:
        angle, speed = state
        torque = 1.5 * (np.interp(t, time, command) - angle) - 0.02 * speed
        torque -= 0.4 * 9.80665 * 0.1 * math.sin(angle - 0.1) + 0.015 * speed
        return [speed, torque / (0.002 + 0.4 * 0.01)]

    truth = integrate.solve_ivp(
        rate, (0.0, 3.0), [0.2, -0.5], t_eval=time, rtol=1e-9, atol=1e-11, max_step=0.01
    )
    out = simulate(body, loop, inputs(time, command), 0.2, -0.5)
    assert np.max(np.abs(out.angle - truth.y[0])) < 2e-3 * 0.5
    finer = simulate(body, loop, inputs(time, command), 0.2, -0.5, 2.5e-5)
    assert np.max(np.abs(finer.angle - truth.y[0])) < 0.2 * np.max(np.abs(out.angle - truth.y[0]))


def test_the_controller_saturates_and_the_motor_brakes_itself() -> None:
    time = np.linspace(0.0, 5.0, 501)
    bench = Bench(torque_constant=0.5, back_emf_constant=0.5, resistance=4.0)
    channels = {
        "time": time,
        "angle": np.zeros(501),
        "command": np.full(501, 1e6),
        "supply_voltage": np.full(501, 6.0),
    }
    r = Recording("made", channels, bench, controller=Controller("duty", 1.0, limit=0.9))
    out = replay(r, {"J": 0.01}, 2.0)
    assert out.torque[0] == pytest.approx(0.5 / 4.0 * 6.0 * 0.9)
    assert out.velocity[-1] == pytest.approx(6.0 * 0.9 / 0.5, rel=1e-3)


def test_what_is_missing_is_named() -> None:
    with pytest.raises(RecordingError, match="`command` channel and the `controller`"):
        inputs_of(recording())
    duty = Controller("duty", 1.0)
    with pytest.raises(RecordingError, match="supply_voltage"):
        inputs_of(recording(controller=duty, command=np.zeros(1001)))
    with pytest.raises(RecordingError, match=r"bench\.resistance"):
        loop_of(duty, recording())
    with pytest.raises(RecordingError, match="inertia of 0"):
        body_of({"Mc": 1.0}, recording(), 2.0)


def test_scores_of_a_simulation_against_itself_and_against_one_without_friction() -> None:
    time = np.linspace(0.0, 5.0, 5001)
    r = recording(
        controller=Controller("torque", 4000.0, 100.0),
        time=time,
        command=0.35 * np.sin(0.4 * math.pi * time),
    )
    truth = replay(r, TRUTH, 2.0)
    made = Recording(
        "made",
        {**r.channels, "angle": truth.angle, "torque": truth.torque},
        r.bench,
        controller=r.controller,
    )
    p = prepare(made, 20.0)
    same, none = (
        compare(p, replay(made, with_friction(TRUTH, share), 2.0)) for share in (1.0, 0.0)
    )
    assert same.angle_rms == 0.0
    assert same.torque_rms < 1e-12
    assert none.torque_rms == pytest.approx(TRUTH["Mc"], rel=0.5)
    assert pooled([same, none]).torque_rms == pytest.approx(none.torque_rms / math.sqrt(2.0))
