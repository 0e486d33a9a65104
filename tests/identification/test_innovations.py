"""The prediction-error filter against an independent Kalman filter, and where a recording moves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from identification.filter import kalman as kernel
from identification.filter.likelihood import Point, likeliest_noise
from identification.filter.segments import Motion, Noise, motion
from identification.model.parameters import INDEX, pack
from identification.recording import Model, Recording
from tests.identification.synthetic import TRUTH, dense

from .practical import simulated

INERTIA, VISCOUS, COULOMB = 0.2, 5.0, 2.0
STEP_S = 1e-3
TORQUE_NOISE, ANGLE_NOISE = 0.05, 4.4e-6


HIDDEN, HIDDEN_S = 0.3, 0.02
"""Correlated part of the torque's noise, N m rms, and its correlation time, s."""
WHITE = Noise(TORQUE_NOISE, ANGLE_NOISE)
CORRELATED = Noise(TORQUE_NOISE, ANGLE_NOISE, HIDDEN, HIDDEN_S)


def kalman(angle: np.ndarray, torque: np.ndarray, start: float, hidden: float) -> np.ndarray:
    """Normalised innovations of J domega/dt = u + d - Mc - sigma omega, exactly discretised, from
    rest at ``start``.

    d is a first-order process of ``hidden`` rms that is held over each period.
    """
    drift = np.array([[0.0, 1.0, 0.0], [0.0, -VISCOUS / INERTIA, 1.0 / INERTIA], [0.0, 0.0, 0.0]])
    diffusion = np.diag([0.0, TORQUE_NOISE**2 * STEP_S / INERTIA**2, 0.0])
    moves = linalg.expm(
        np.block([[drift, np.array([[0.0], [1.0 / INERTIA], [0.0]])], [np.zeros((1, 4))]]) * STEP_S
    )
    transition, gain = moves[:3, :3], moves[:3, 3]
    loan = linalg.expm(
        np.block([[-drift, diffusion], [np.zeros((3, 3)), drift.T]]) * STEP_S
    )  # Van Loan 1978
    process = loan[3:, 3:].T @ loan[:3, 3:]
    kept = np.exp(-STEP_S / HIDDEN_S)
    keep, shock = np.diag([1.0, 1.0, kept]), np.diag([0.0, 0.0, (1.0 - kept**2) * hidden**2])
    state, covariance = np.array([start, 0.0, 0.0]), np.diag([ANGLE_NOISE**2, 0.0, hidden**2])
    observe = np.array([1.0, 0.0, 0.0])
    out = np.empty(len(angle))
    for k, (seen, u) in enumerate(zip(angle, torque, strict=True)):
        state = transition @ keep @ state + gain * (u - COULOMB)
        covariance = transition @ (keep @ covariance @ keep + shock) @ transition.T + process
        variance = observe @ covariance @ observe + ANGLE_NOISE**2
        correction = covariance @ observe / variance
        error = seen - state[0]
        out[k] = error / np.sqrt(variance)
        state = state + correction * error
        covariance = (np.eye(3) - np.outer(correction, observe)) @ covariance
    return out


def run_kernel(
    angle: np.ndarray,
    torque: np.ndarray,
    side: float,
    steps: float,
    noise: Noise = WHITE,
    begin: float = 0.0,
    quantisation: float = 1e-30,
) -> np.ndarray:
    n = len(angle)
    p = pack({"Mc": COULOMB, "Ms": COULOMB, "sigma_2": VISCOUS, "J": INERTIA}, 2.0)
    time, zero = STEP_S * np.arange(n), np.zeros(n)
    signals = (side * angle, side * torque, zero, zero, np.full(n, steps), zero)
    samples = np.column_stack([time, time - STEP_S, *signals])[1:]
    segment = [0.0, n - 1.0, side, np.inf, side * angle[0], 0.0, quantisation]
    levels = np.array([noise.torque, noise.angle, noise.correlated, noise.correlation_s])
    found = np.zeros((3, n - 1))
    kernel.innovations(np.array([segment]), np.array([begin]), samples, levels, p, found)
    return side * found[kernel.ERROR] / found[kernel.DEVIATION]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("noise", [WHITE, CORRELATED], ids=["white", "correlated"])
def test_linear_case_is_the_kalman_filter(side: float, noise: Noise) -> None:
    rng = np.random.default_rng(3)
    n, fine = 2000, 20
    torque = 6.0 + np.sin(12.0 * STEP_S * np.arange(n))
    angle, speed, kept = np.zeros(n), 0.0, np.exp(-STEP_S / HIDDEN_S)
    hidden = noise.correlated * rng.normal()
    for k in range(1, n):
        hidden = kept * hidden + np.sqrt(1.0 - kept**2) * noise.correlated * rng.normal()
        push = torque[k] + TORQUE_NOISE * rng.normal() + hidden - COULOMB
        angle[k] = angle[k - 1]
        for _ in range(fine):
            speed += STEP_S / fine / INERTIA * (push - VISCOUS * speed)
            angle[k] += STEP_S / fine * speed
    angle += ANGLE_NOISE * rng.normal(size=n)
    expected = kalman(angle[1:], torque[1:], angle[0], noise.correlated)
    found = run_kernel(angle, torque, side, 8.0, noise)
    assert np.max(np.abs(found - expected)) < 0.02 * float(np.std(expected))
    assert np.std(found) == pytest.approx(1.0, abs=0.06)
    assert abs(np.mean(found[1:] * found[:-1])) < 0.08
    if noise is CORRELATED:
        as_white = run_kernel(angle, torque, side, 8.0)
        assert np.mean(as_white[1:] * as_white[:-1]) > 0.5 * np.mean(as_white**2)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_where_a_shaft_rests_is_known_to_a_step_however_often_it_is_read(side: float) -> None:
    rng = np.random.default_rng(4)
    step, rest, moving = 1e-5, 12, 3
    time = STEP_S * np.maximum(np.arange(rest + moving) - (rest - 1), 0)
    rate = VISCOUS / INERTIA
    unit = (time / rate - (1.0 - np.exp(-rate * time)) / rate**2) / INERTIA
    squares = {}
    for staying in (0.0, step**2 / 12.0):
        # The same variance, as noise of each reading or as quantisation.
        noise = Noise(1e-6) if staying else Noise(1e-6, step / np.sqrt(12.0))
        first = []
        for place, push in rng.uniform(
            (0.0, 20.0), (1.0, 28.0), (400, 2)
        ):  # 5 to 7 steps within the first period
            angle = step * (np.floor(place + push * unit / step) + 0.5)
            torque = np.where(time > 0.0, COULOMB + push, 0.0)
            first.append(
                run_kernel(
                    angle, torque, side, 8.0, noise, STEP_S * (rest - 1), max(staying, 1e-30)
                )[rest - 1]
            )
        squares[staying] = float(np.mean(np.square(first)))
    assert squares[step**2 / 12.0] == pytest.approx(1.0, abs=0.1)
    assert squares[0.0] > 1.6  # as if a dozen readings of one count were a dozen measurements


@pytest.fixture(scope="module")
def motions(practical_pair: tuple[Recording, Recording]) -> tuple[Motion, Motion]:
    unloaded, loaded = (motion(r) for r in practical_pair)
    assert loaded is not None
    return unloaded, loaded


def at_truth(*recordings: Motion, free: tuple[int, ...] = ()) -> Point:
    return Point.of(recordings, pack(TRUTH, 2.0), free, Model(), Noise(0.06))


@pytest.mark.parametrize("case", [0, 1], ids=["unloaded", "loaded"])
def test_innovations_are_white_and_of_unit_size_at_the_truth(motions, case):
    point = at_truth(motions[case])
    errors, deviations = point.run(likeliest_noise(point))
    found = errors / deviations
    clipped = found[
        np.abs(found) < 6.0
    ]  # the encoder's noise is uniform, friction at breakaway is steep
    assert len(clipped) > 0.995 * len(found)
    assert np.mean(clipped**2) == pytest.approx(1.0, abs=0.1)
    assert abs(np.mean(found[1:] * found[:-1]) / np.mean(found**2)) < 0.1


@pytest.mark.parametrize("noise", [Noise(0.06, 1e-6), Noise(0.05, 2e-6, 0.04, 0.01)], ids=str)
def test_a_lane_does_not_depend_on_the_others(motions: tuple[Motion, Motion], noise: Noise) -> None:
    free = tuple(INDEX.values())
    together = at_truth(*motions, free=free)
    alone = [at_truth(m, free=free) for m in motions]
    seeds = together._seeds(together.origin())
    for k in (0, 1):
        found = together.run(noise)[k]
        assert np.array_equal(found, np.concatenate([a.run(noise)[k] for a in alone]))
        slopes = [
            p.filter.sensitivities(p.vector, p.breakaway_times, noise, seeds)[k]
            for p in (together, *alone)
        ]
        assert np.array_equal(slopes[0], np.concatenate(slopes[1:]))


@pytest.mark.parametrize(
    ("case", "alpha", "noise"),
    [
        (0, 2.0, Noise(0.06)),
        (0, 1.4, Noise(0.05, 2e-6, 0.04, 0.01)),
        (1, 2.0, Noise(0.05, 2e-6, 0.04, 0.01)),
        (1, 1.4, Noise(0.06)),
    ],
)
def test_sensitivities_are_the_slopes_of_the_predictions(motions, case, alpha, noise):
    """Every column by central differences of its own, breakaway times included one by one."""
    names = ("Mc", "Ms", "omega_sf", "sigma_2", "J", "offset") + (
        ("mu_c", "mu_s", "omega_sL", "mu_2") if case else ()
    )
    free = tuple(INDEX[n] for n in names)
    short = first_segments(motions[case], 3)
    point = Point.of([short], pack({**TRUTH, "offset": 0.02}, alpha), free, Model(), noise)
    x = point.origin()
    errors, deviations = point.predictions(x)
    slopes, widening = (dense(found) for found in point.derivatives(x, errors, deviations))
    for k in range(len(x)):
        step = 1e-6 * max(abs(x[k]), 0.05) if k < len(names) else 1e-4
        up, down = x.copy(), x.copy()
        up[k] += step
        down[k] -= step
        (e1, d1), (e0, d0) = point.predictions(up), point.predictions(down)
        for found, column in (
            (slopes[:, k], (e1 - e0) / deviations / (2.0 * step)),
            (widening[:, k], np.log(d1 / d0) / (2.0 * step)),
        ):
            assert np.linalg.norm(found - column) <= 1e-4 * np.linalg.norm(column) + 1e-12, k


def first_segments(m: Motion, count: int) -> Motion:
    """Return a recording with its first segments only."""
    table, inside = m.table[:count].copy(), np.zeros(len(m.time), dtype=bool)
    for first, last in table[:, :2].astype(int):
        inside[first:last] = True
    return replace(m, table=table, seen=m.seen[:count], inside=inside)


@pytest.mark.parametrize("shift_ms", [-3.0, 0.5, 3.5])
def test_only_the_first_samples_feel_a_breakaway_time(practical_pair, shift_ms):
    motions = [m for m in map(motion, practical_pair) if m is not None]
    point = Point.of(motions, pack(TRUTH, 2.0), [], Model(), Noise(0.06))
    held, x = point.weighted(), point.origin()
    near = held.near_breakaways(x, held.residuals(x))
    assert len(near.heads.rows) < 0.5 * len(point.experiment.samples)
    there = x + shift_ms
    whole = held.residuals(x)
    whole[near.rows] = near.residuals(there)
    np.testing.assert_allclose(whole, held.residuals(there), atol=1e-4)
    assert np.max(np.abs(near.residuals(there) - near.here)) > 0.1


@pytest.fixture
def free(practical_pair: tuple[Recording, Recording]) -> Motion:
    return motion_of(practical_pair[0])


def motion_of(recording: Recording) -> Motion:
    found = motion(recording)
    assert found is not None
    return found


def test_the_steps_of_the_filter_do_not_depend_on_the_encoders_zero(
    practical_pair: tuple[Recording, Recording],
) -> None:
    here = practical_pair[0]
    angle = here.channels["motor_angle"]
    moved = [motion_of(swap(here, motor_angle=angle + turns)) for turns in (0.0, 20.0 * np.pi)]
    assert np.array_equal(moved[0].steps, moved[1].steps)
    assert np.mean(moved[0].steps) < np.max(moved[0].steps)


def test_a_recording_that_hardly_moves_has_segments(
    practical_pair: tuple[Recording, Recording],
) -> None:
    here, still = practical_pair[0], 2_000_000
    channels = {n: np.concatenate([v, np.full(still, v[-1])]) for n, v in here.channels.items()}
    channels["time"] = here.period * np.arange(len(here.time) + still)
    long = motion_of(Recording(channels=channels, bench=here.bench, averaged=here.averaged))
    assert len(long.table) == len(motion_of(here).table)


def drop(recording: Recording, *names: str) -> Recording:
    return replace(
        recording, channels={k: v for k, v in recording.channels.items() if k not in names}
    )


def swap(recording: Recording, **channels: np.ndarray) -> Recording:
    return replace(recording, channels={**recording.channels, **channels})


def test_stretches_lie_between_the_true_rests(practical_pair: tuple[Recording, Recording]) -> None:
    truth = simulated(10, 30.6)
    found = motion_of(practical_pair[1])
    assert len(found.table) >= 8
    for (first, last, side, rise), seen in zip(found.table, found.seen, strict=True):
        window = truth["velocity"][int(seen) : int(last)]
        assert np.all(side * window > 0.0)
        assert truth["velocity"][int(first) - 1] == 0.0
        assert rise > 0.0
        assert first <= seen < last


@pytest.mark.parametrize(("case", "weight"), [(0, 0.0), (1, 30.6)])
def test_static_crossing_is_when_the_shaft_broke_away(practical_pair, case, weight):
    truth = simulated(10 * case, weight)
    found = motion_of(practical_pair[case])
    static = 12.025 + 0.095 * 10.0 * weight * 9.80665 * 0.086
    crossings = found.static_crossing(static)
    for (first, _, _, _), when in zip(found.table, crossings, strict=True):
        moving = int(first) + int(np.flatnonzero(truth["velocity"][int(first) :])[0])
        assert when == pytest.approx(truth["time"][moving], abs=2e-3)


def test_the_speed_is_unsure_only_where_a_stretch_all_but_stops(practical_pair):
    recording = practical_pair[1]
    smooth = motion_of(recording)
    first, last, side, _ = smooth.table[3]
    k = int(0.5 * (first + last))
    assert not np.any(smooth.unsure[k - 50 : k + 50])
    channel = "motor_angle"
    angle = recording.channels[channel].copy()
    # Held for 6 samples, then on as before: too short a pause to count as rest.
    pause = side * (angle[k + 6] - angle[k])
    assert pause > 0.0
    angle[k + 6 :] -= side * pause
    angle[k : k + 6] = angle[k]
    found = motion_of(swap(recording, **{channel: angle}))
    marked = np.flatnonzero(found.unsure[k - 50 : k + 70]) + k - 50
    assert marked[0] >= k - 1
    assert marked[-1] <= k + 7
    assert len(marked) >= 5
    fastest = float(np.max(np.abs(simulated(10, 30.6)["velocity"])))
    assert found.unsure[k + 3] == pytest.approx((0.1 * fastest) ** 2, rel=0.1)


def test_no_stretches_without_an_encoder_a_torque_or_even_sampling(practical_pair):
    recording = practical_pair[0]
    exact = simulated(0, 0.0)["angle"] * 100.0
    jitter = recording.time + np.random.default_rng(0).uniform(0.0, 2e-4, len(recording.time))
    assert motion(recording) is not None
    assert motion(drop(recording, "motor_angle")) is None
    assert motion(drop(recording, "current")) is None
    assert motion(swap(recording, motor_angle=exact)) is None
    assert motion(swap(recording, time=jitter)) is None


def test_strokes_alike_are_those_of_one_motion_either_way(free: Motion) -> None:
    ends = np.isin(np.arange(len(free.table)), [0, len(free.table) - 1])
    assert np.array_equal(free.matching, ends[:, None] == ends)
