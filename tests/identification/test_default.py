"""The default method from end to end: recovery, refusals, lost samples, pieces."""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from identification.estimate import default
from identification.estimate.default import free_names, identify, solve_stages
from identification.estimate.equation_error import averaging
from identification.estimate.paper_method import identify_paper
from identification.estimate.refinement import equation_noise, refine_recordings, refusal
from identification.estimate.searches import MOST_ERROR, refine_stages
from identification.filter.likelihood import torque_noise
from identification.filter.segments import motion
from identification.prepare import evened, prepare, resting
from identification.recording import Array, Dataset, Model, Recording, RecordingError
from identification.result import Identification
from identification.signals import quantum

from .diagnosis.benches import campaign
from .practical import beginning, logged, simulated, with_ripple
from .synthetic import SYSTEM, TRUTH, sine

TRUTH_SYSTEM = {name: TRUTH[name] for name in SYSTEM}


FEW_S, FEWER_S = 10.0, 5.0
"""Four reversals, and two: where physics is missing every start is followed to its end, and the
time goes with the length.
"""


def equation_error(result: Identification, *recordings: Recording) -> dict[str, float]:
    prepared = [prepare(r, result.fit.bandwidth_Hz) for r in recordings]
    return solve_stages(prepared, [], Model(), lambda _stage, _share: None)[0]


def test_practical_bench_within_tenths_of_a_percent(practical_result: Identification) -> None:
    result = practical_result
    methods = [s.method for s in result.stages]
    assert methods == ["variable projection", "variable projection", "prediction error"]
    assert result.warnings == ()
    assert result.stages[-1].cost == pytest.approx(1.0, abs=0.1)  # innovations of unit size
    for name, value in TRUTH.items():
        p = result.parameters[name]
        limit = {"omega_sL": 0.03, "J": 0.008}.get(name, 0.004)
        assert p.value == pytest.approx(value, rel=limit), name
        half = 0.5 * (p.high - p.low)
        assert half < 0.05 * value, name
        assert abs(p.value - value) < 3.0 * half, name


@pytest.mark.proof
def test_a_rise_of_load_friction_that_the_bandwidth_hides_is_found_in_the_breakaways(
    practical_pair: tuple[Recording, Recording],
) -> None:
    prepared = [prepare(r, 40.0) for r in practical_pair]
    values, _ = solve_stages(prepared[:1], prepared[1:], Model(), lambda _stage, _share: None)
    flat = {**values, "mu_s": values["mu_c"], "omega_sL": 1.0}
    refined = refine_recordings(practical_pair, flat, free_names(flat, Model()), Model())
    assert not isinstance(refined, str)
    assert refined.values["mu_s"] == pytest.approx(TRUTH["mu_s"], rel=0.004)
    assert refined.values["omega_sL"] == pytest.approx(TRUTH["omega_sL"], rel=0.03)


@pytest.mark.parametrize(
    ("names", "loaded"), [(("Ms",), False), (("mu_s", "omega_sL"), True)], ids=["Ms", "mu_s"]
)
def test_fixed_values_are_held_through_the_refinement(practical_pair, names, loaded):
    recordings = tuple(beginning(r, FEW_S) for r in practical_pair[: 1 + loaded])
    result = identify(Dataset(recordings, Model(fixed={n: TRUTH[n] for n in names})))
    assert result.stages[-1].method == "prediction error"
    for name, found in result.values.items():
        assert found == pytest.approx(TRUTH[name], rel=1e-12 if name in names else 0.008), name


def test_hidden_ripple_leaves_the_values_of_the_equation_error(practical_pair):
    """A torque over the angle as cogging makes it, which no nominal parameter can represent."""
    recording = with_ripple(beginning(practical_pair[0], FEWER_S), 1.0, 120.0)
    result = identify(Dataset((recording,)))
    (warning,) = result.warnings
    assert "torque noise" in warning
    # There is no joint fit, and no fit with correlated noise.
    assert result.stages[-1].evaluations < 500
    plain = equation_error(result, recording)
    assert result.values == {name: plain[name] for name in result.values}


def test_the_equation_error_shows_missing_physics_before_any_search(practical_pair):
    recording = beginning(practical_pair[0], FEWER_S)
    noises = []
    for made in (recording, with_ripple(recording, 1.0, 120.0)):
        prepared = [prepare(made, 40.0)]
        values = solve_stages(prepared, [], Model(), lambda _stage, _share: None)[0]
        noises.append(equation_noise(prepared, values, 2.0))
    scatter = torque_noise([m for m in [motion(recording)] if m is not None])
    assert noises[0] < scatter
    assert noises[1] > 2.0 * scatter
    assert equation_noise([], {}, 2.0) == 0.0


@pytest.mark.proof
def test_torque_noise_is_told_from_scatter(practical_pair: tuple[Recording, Recording]) -> None:
    recording = beginning(practical_pair[0], FEWER_S)
    right, wrong = (
        refine_stages([m], [], TRUTH_SYSTEM, Model())
        for r in (recording, with_ripple(recording, 0.3, 40.0))
        if (m := motion(r)) is not None
    )
    assert right.noise.torque < right.torque_scatter
    assert wrong.noise.torque > 3.0 * wrong.torque_scatter
    assert abs(right.whiteness) < 0.1
    assert "torque noise" in refusal(wrong, 1.0, 1.0)
    for accepted in ((1.0, 1.0), (1.0, 1.2), (1.0, MOST_ERROR)):
        assert refusal(right, *accepted) == ""
    for change, after, key in (
        ({"whiteness": 0.2}, 1.0, "correlation of +0.20"),
        ({"likelihood_drop": 20.0}, 1.0, "deviance +20,"),
        ({}, 1.4, "equation error from 1 to 1.4"),
        ({"whiteness": math.nan}, 1.0, "not finite"),
        ({"values": {**right.values, "J": math.nan}}, 1.0, "not finite"),
    ):
        assert key in refusal(replace(right, **change), 1.0, after)  # type: ignore[arg-type]


def test_validation_is_scored_and_never_fitted(practical_pair: tuple[Recording, Recording]) -> None:
    fitted = beginning(practical_pair[0], FEW_S)
    other = beginning(logged(simulated(3, 0.0), 0.0, name="other"), FEW_S)
    heard: list[tuple[str, float]] = []
    alone = identify(Dataset((fitted,)), progress=lambda *step: heard.append(step))
    scored = identify(Dataset((fitted, replace(other, role="validate"))))
    assert (heard[0], heard[-1]) == (("unloaded", 0.0), ("joint", 1.0))
    assert scored.values == alone.values
    assert scored.fit.train_rms == alone.fit.train_rms
    assert scored.fit.validate_rms == scored.fits_by_recording["other"].train_rms
    assert scored.fit.validate_rms == pytest.approx(scored.fit.train_rms, rel=0.2)


def test_a_recording_without_breakaways_leaves_the_others_their_refinement(practical_pair):
    moving = replace(beginning(practical_pair[0], FEW_S), name="moving")
    inside = (moving.time > 1.0) & (moving.time < 1.4)
    cut = {name: values[inside] for name, values in moving.channels.items()}
    short = replace(moving, name="short", channels=cut)
    alone, both = (identify(Dataset(given)) for given in ((moving,), (moving, short)))
    assert both.noise is not None
    assert any(w.startswith("short: ") for w in both.warnings)
    for name, value in alone.values.items():
        assert both.values[name] == pytest.approx(value, rel=0.01)


def test_exact_channels_are_not_refined() -> None:
    result = identify(Dataset((sine(),)), bandwidth_Hz=500.0, profile=True, draws=20)
    assert [s.method for s in result.stages] == ["variable projection"]
    assert result.values == pytest.approx(TRUTH_SYSTEM, rel=1e-6)
    assert (result.profiles, result.resampled) == ((), ())
    assert ["encoder" in w or "bootstrap" in w for w in result.warnings] == [True, True]


def test_without_inertia_to_start_from_nothing_is_refined(practical_pair):
    recording = practical_pair[0]
    acceleration = np.gradient(np.gradient(recording.channels["motor_angle"], 1e-3), 1e-3) / 100.0
    smooth = np.convolve(acceleration, np.ones(51) / 51.0, mode="same")
    current = recording.channels["current"] - 0.3 * smooth / 3.0  # takes away more than J domega/dt
    channels = {**recording.channels, "current": current}
    result = identify(Dataset((replace(recording, channels=channels),)))
    assert "inertia" in result.warnings[0]
    assert result.parameters["J"].at_bound


def changed(**channels: np.ndarray | None) -> Recording:
    merged = {**sine().channels, **channels}
    return replace(sine(), channels={k: v for k, v in merged.items() if v is not None})


STILL = changed(angle=np.full(5000, 0.1), velocity=None)
IDLE = changed(torque=np.zeros(5000))
SHAKEN = changed(
    angle=np.clip(0.02 * np.sin(2.0 * np.pi * 20.0 * sine().time), -0.01, 0.01), velocity=None
)


@pytest.mark.parametrize(
    ("recording", "method", "key"),
    [
        (sine(weight=30.6), identify, "fix Mc, Ms, omega_sf, sigma_2, J"),
        (sine(role="validate"), identify, "'fit'"),
        (STILL, identify, "sine: .* 0 samples are in motion"),
        (STILL, identify_paper, "sine: .* 0 samples are in motion"),
        (IDLE, identify, "torque is zero"),
        (IDLE, identify_paper, "torque is zero"),
        (SHAKEN, partial(identify, bandwidth_Hz=20.0), r"reverses \d+(\.\d)? times per second"),
    ],
)
def test_what_cannot_be_fitted_is_refused_with_what_is_missing(recording, method, key):
    with pytest.raises(RecordingError, match=key):
        method(Dataset((recording,)), rng=np.random.default_rng(0))


@pytest.fixture
def short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(default, "PIECE_SAMPLES", 7000)


@pytest.mark.usefixtures("short_pieces")
def test_pieces_join_up_and_are_cut_at_rest(practical_pair: tuple[Recording, Recording]) -> None:
    for recording in practical_pair:
        parts = default.pieces(recording)
        assert len(parts) > 1
        for name, values in recording.channels.items():
            assert np.array_equal(np.concatenate([p.channels[name] for p in parts]), values)
            assert all(np.shares_memory(p.channels[name], values) for p in parts)
        still = resting(recording.channels["motor_angle"])
        cuts = np.cumsum([len(p.time) for p in parts])[:-1]
        assert np.all(still[cuts])


@pytest.mark.usefixtures("short_pieces")
def test_pieces_give_what_the_whole_gives(practical_pair, practical_result):
    whole, parts = practical_result, identify(Dataset(practical_pair), in_pieces=True)
    assert parts.warnings == ()
    assert [s.method for s in parts.stages] == [s.method for s in whole.stages]
    for name, p in whole.parameters.items():
        q = parts.parameters[name]
        assert p.value is not None
        assert p.low is not None
        assert p.high is not None
        if name == "J":  # found on the first pieces alone
            assert abs(q.value - p.value) < 0.5 * (q.high - q.low)
            continue
        # Two estimates of one value: least squares beside the inertia on the whole, instruments on
        # the pieces.
        assert abs(q.value - p.value) < 0.5 * (p.high - p.low), name
        assert 0.6 < (q.high - q.low) / (p.high - p.low) < 1.7, name
    assert list(parts.fits_by_recording) == ["unloaded", "loaded"]


@pytest.mark.usefixtures("short_pieces")
def test_recordings_that_cannot_be_refined_keep_the_equation_error() -> None:
    dataset = Dataset((sine(duration=20.0),))
    parts = identify(dataset, bandwidth_Hz=500.0, in_pieces=True)
    assert "a quantised encoder" in parts.warnings[0]
    assert parts.values == pytest.approx({n: TRUTH[n] for n in SYSTEM}, rel=1e-6)


def test_the_path_follows_the_length(practical_pair, monkeypatch):
    taken: list[bool] = []
    monkeypatch.setattr(default, "identify", lambda _, in_pieces, rng: taken.append(in_pieces))
    dataset = Dataset(practical_pair[:1])
    default.identify_any_length(dataset)
    monkeypatch.setattr(default, "LONG_SAMPLES", 1000)
    default.identify_any_length(dataset)
    aside = Dataset((replace(practical_pair[0], role="validate"),))
    default.identify_any_length(aside)
    assert taken == [False, True, False]


STEP = 1e-4


def recording(time: Array) -> Recording:
    angle = np.floor(0.3 * np.sin(3.0 * time) / STEP) * STEP
    return Recording(time, angle, torque=np.cos(3.0 * time), name="r")


def lost(whole: Recording, share: float, seed: int, hole: slice | None = None) -> Recording:
    keep = np.random.default_rng(seed).uniform(size=len(whole.time)) > share
    keep[0] = True
    if hole is not None:
        keep[hole] = False
    return replace(whole, channels={name: values[keep] for name, values in whole.channels.items()})


def test_even_recordings_are_left_alone() -> None:
    whole = recording(1e-3 * np.arange(5000))
    found = evened(whole)
    assert found[0] is whole
    assert not found[1].any()


@pytest.mark.parametrize("ppm", [0.0, 37.0, -80.0])
def test_lost_samples_are_filled_and_the_others_kept(ppm: float) -> None:
    true = 1e-3 * (1.0 + 1e-6 * ppm) * np.arange(30_000)
    whole = recording(np.round(true, 6))
    found = evened(lost(whole, 0.02, 1))
    assert found is not None
    even, holes = found
    assert not holes.any()
    assert even.time == pytest.approx(true, abs=2e-6)
    here = np.isin(np.arange(30_000), np.searchsorted(whole.time, lost(whole, 0.02, 1).time))
    assert np.array_equal(even.channels["torque"][here], whole.channels["torque"][here])
    assert np.max(np.abs(even.channels["angle"] - whole.channels["angle"])) < 1.5 * STEP
    assert quantum(even.channels["angle"]) == pytest.approx(STEP)


def test_long_holes_are_marked_and_their_stretch_is_left_out(practical_pair):
    whole = practical_pair[0]
    holed = lost(whole, 0.0, 0, slice(7000, 7060))
    found = evened(holed)
    assert np.array_equal(np.flatnonzero(found[1]), np.arange(7000, 7060))
    before, after = motion(whole), motion(holed)
    assert len(after.table) == len(before.table) - 1


def test_what_is_uneven_throughout_is_refused() -> None:
    rng = np.random.default_rng(0)
    assert evened(recording(np.cumsum(1e-3 * rng.uniform(0.5, 1.5, 3000)))) is None
    assert evened(lost(recording(1e-3 * np.arange(5000)), 0.3, 2)) is None


@pytest.mark.proof
def test_lost_cycles_no_longer_cost_the_rise_of_load_friction(practical_pair):
    pair = [lost(r, 0.01, k) for k, r in enumerate(practical_pair)]
    prepared = [prepare(r, 40.0) for r in pair]
    before, _ = solve_stages(prepared[:1], prepared[1:], Model(), lambda _stage, _share: None)
    assert abs(before["mu_s"] / TRUTH["mu_s"] - 1.0) > 0.5
    result = identify(Dataset(tuple(pair)))
    assert result.warnings == ()
    for name, value in TRUTH.items():
        limit = {"omega_sL": 0.03, "J": 0.01}.get(name, 0.004)
        assert result.values[name] == pytest.approx(value, rel=limit), name


@pytest.mark.parametrize("stated", [True, False])
def test_whether_a_current_is_a_mean_is_seen_in_the_recordings(stated: bool) -> None:
    """The drive of the bench sends means over its period."""
    recordings = [
        r if stated else replace(r, averaged=r.averaged - {"current"}) for r in campaign({}, 5, 8.0)
    ]
    prepared = [prepare(r, 40.0) for r in recordings]
    values, _ = solve_stages(*default.by_load(prepared), Model(), lambda *_: None)
    found = averaging(prepared, values, free_names(values, Model()), 2.0)
    assert len(found) == (not stated)
    assert all("state `average: true`" in words for words in found)


def test_samples_at_instants_are_not_doubted_and_called_means_they_are() -> None:
    moving = [prepare(sine(frequency=f, duration=8.0), 40.0) for f in (0.5, 1.5)]
    values, _ = solve_stages(moving, [], Model(), lambda *_: None)
    names = free_names(values, Model())
    assert averaging(moving, values, names, 2.0) == ()
    called = [prepare(replace(p.recording, averaged=frozenset({"torque"})), 40.0) for p in moving]
    (words,) = averaging(called, values, names, 2.0)
    assert "`torque`: by the recordings its samples are values at its time" in words
    assert "state `average: false`" in words
