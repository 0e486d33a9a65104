"""The forward simulation, and loads that pull the same way at every angle."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from identification.diagnosis.unexplained import unrecorded_effects
from identification.diagnosis.within_limits import views_and_fit
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.effects.model import CorrectedModel, predictions
from identification.filter.segments import motion
from identification.model.parameters import NOMINAL
from identification.prepare import prepare
from identification.recording import (
    Bench,
    Controller,
    Dataset,
    Hoist,
    Model,
    Pendulum,
    Recording,
    RecordingError,
)
from identification.simulation.closed_loop import (
    OPEN_LOOP,
    Inputs,
    body_of,
    compare,
    inputs_of,
    loop_of,
    pooled,
    replay,
    simulate,
)
from identification.simulation.drive_loop import Loop, drive_loop, respond
from identification.views.view import views

from .synthetic import TRUTH, sine


def recording(
    pendulum: Pendulum | None = None, controller: Controller | None = None, **channels: np.ndarray
) -> Recording:
    time = channels.pop("time", np.linspace(0.0, 1.0, 1001))
    channels.setdefault("angle", np.zeros(len(time)))
    return Recording(time, channels=channels, name="made", pendulum=pendulum, controller=controller)


def test_a_supply_that_is_logged_slowly_is_interpolated() -> None:
    supply = np.full(1001, np.nan)
    supply[::100] = 12.0
    duty = Controller("duty", 2.0)
    made = recording(controller=duty, command=np.zeros(1001), supply_voltage=supply)
    assert np.array_equal(inputs_of(made).scale, np.full(1001, 12.0))
    with pytest.raises(RecordingError, match="supply_voltage"):
        inputs_of(
            recording(controller=duty, command=np.zeros(1001), supply_voltage=np.full(1001, np.nan))
        )


def test_a_feed_forward_is_in_the_unit_of_the_output() -> None:
    """A duty cycle that is fed forward is multiplied by the supply, as that of the gains is."""
    time = np.linspace(0.0, 0.1, 101)
    bench = Bench(torque_constant=0.5, back_emf_constant=0.5, resistance=4.0)
    channels = {"command": np.zeros(101), "supply_voltage": np.full(101, 12.0)}
    channels |= {"time": time, "angle": np.zeros(101), "feedforward": np.full(101, 0.25)}
    duty = Controller("duty", 1.0)
    made = Recording(name="made", channels=channels, bench=bench, controller=duty)
    assert replay(made, {"J": 0.01}, 2.0).torque[0] == pytest.approx(0.5 / 4.0 * 12.0 * 0.25)


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
    r = Recording(
        name="made", channels=channels, bench=bench, controller=Controller("duty", 1.0, limit=0.9)
    )
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
        loop_of(duty, recording().bench, recording().name)
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
        name="made",
        channels={**r.channels, "angle": truth.angle, "torque": truth.torque},
        bench=r.bench,
        controller=r.controller,
    )
    p = prepare(made, 20.0)
    free = {name: TRUTH[name] * (name == "J") for name in TRUTH}
    same, none = (compare(p, replay(made, values, 2.0)) for values in (TRUTH, free))
    assert same.angle_rms == 0.0
    assert same.torque_rms < 1e-12
    assert none.torque_rms == pytest.approx(TRUTH["Mc"], rel=0.5)
    assert pooled([same, none]).torque_rms == pytest.approx(none.torque_rms / math.sqrt(2.0))


G = 9.80665


def lifting(hoist: Hoist, drag_N_m: float = 0.0) -> Recording:
    """A sine under a mass that the drive lifts on the way forward, and a constant drag."""
    bare = sine()
    w = 2.0 * np.pi * 0.2
    acceleration = -0.35 * w**2 * np.sin(w * bare.time)
    torque = bare.channels["torque"] + hoist.mass * G * hoist.radius + drag_N_m
    torque = torque + hoist.mass * hoist.radius**2 * acceleration
    return replace(
        bare, channels={**bare.channels, "torque": torque}, hoist=hoist, constant_torque=-drag_N_m
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


def test_the_likelihood_takes_the_hoisted_mass(practical_pair):
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
def test_friction_may_grow_with_any_torque_that_the_joint_bears(load, borne):
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


PERIOD = 1e-3
STEP = 2.0 * np.pi / 409600.0
BENCH = Bench(torque_constant=0.03, gear_ratio=100.0, moment_arm=0.095)


def recorded(loop: Loop, late: int = 1, noise: float = 0.06, seed: int = 0) -> Recording:
    """Return 20 s at 20 deg and 0.2 Hz."""
    rng = np.random.default_rng(seed)
    count = 20000
    time = PERIOD * np.arange(count)
    command = math.radians(20.0) * np.sin(2.0 * np.pi * 0.2 * time) * np.minimum(time, 1.0)
    given = np.concatenate([np.zeros(late), command[: count - late]])
    out = respond(given, PERIOD, NOMINAL, 0.0, 2.0, loop, noise * rng.standard_normal(count))
    channels = {
        "time": time,
        "command": command,
        "motor_angle": BENCH.gear_ratio * np.floor(out.angle / STEP) * STEP,
        "current": out.torque / 3.0,
    }
    return Recording(name="run", channels=channels, bench=BENCH, averaged=frozenset({"current"}))


@pytest.mark.parametrize(
    ("velocity", "position", "integral"), [(120.0, 60.0, 60.0), (60.0, 25.0, 50.0)]
)
def test_the_gains_are_those_of_the_drive(velocity, position, integral):
    found = drive_loop(
        [recorded(Loop(position, velocity, integral, 400.0, 75.0, STEP))], 75.0, STEP
    )
    assert found.velocity_gain == pytest.approx(velocity, rel=0.08)
    assert found.position_gain + found.integral == pytest.approx(position + integral, rel=0.1)
    assert found.position_gain * found.integral == pytest.approx(position * integral, rel=0.1)


def test_the_drive_carries_a_known_weight() -> None:
    loop, steady, swing, zero = Loop(60.0, 120.0, 60.0, 400.0, 75.0), -2.0, 9.0, 0.1
    time = PERIOD * np.arange(8000)
    command = 0.3 * np.sin(np.pi * time) * np.minimum(time, 1.0)
    free, laden = (
        respond(command, PERIOD, NOMINAL, 0.0, 2.0, loop, known=known)
        for known in ((0.0, 0.0, 0.0), (steady, swing, zero))
    )
    carried = swing * np.sin(laden.angle - zero) - steady
    np.testing.assert_allclose(laden.angle, free.angle, atol=2e-3)
    moving = np.abs(np.gradient(command, PERIOD)) > 0.3
    np.testing.assert_allclose((laden.torque - free.torque)[moving], carried[moving], atol=0.3)


@pytest.mark.parametrize("lag", [0.0, 0.25e-3])
def test_how_late_the_torque_is_comes_from_the_delay(lag: float) -> None:
    found = drive_loop([recorded(Loop(60.0, 120.0, 60.0, 400.0, 75.0, STEP, lag))], 75.0, STEP)
    assert found.lag == pytest.approx(lag, abs=0.12e-3)


def test_what_is_no_such_loop_is_not_taken_for_one() -> None:
    recording = recorded(Loop(60.0, 120.0, 60.0, 400.0, 75.0, STEP))
    shuffled = np.random.default_rng(1).permutation(recording.channels["current"])
    other = replace(recording, channels={**recording.channels, "current": shuffled})
    assert drive_loop([other], 75.0, STEP) is None
    blind = replace(
        recording, channels={k: v for k, v in recording.channels.items() if k != "command"}
    )
    assert drive_loop([blind], 75.0, STEP) is None
    assert drive_loop([], 75.0, STEP) is None
