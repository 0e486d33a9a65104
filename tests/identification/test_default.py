"""The default method from end to end: recovery, refusals, bookkeeping."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate import searches
from identification.estimate.default import free_names, identify, solve_stages
from identification.estimate.paper_method import identify_paper
from identification.estimate.parameter_table import typical_error
from identification.estimate.refinement import refine_recordings, refusal
from identification.estimate.searches import innovation_statistics, refine_stages
from identification.filter.likelihood import Point
from identification.filter.segments import motion
from identification.numerics.compiled import both
from identification.prepare import prepare
from identification.recording import Dataset, Model, Recording, RecordingError
from identification.result import AcceptanceLimits, Identification

from .practical import beginning, logged, simulated, with_ripple
from .synthetic import TRUTH, sine

SYSTEM = ("Mc", "Ms", "omega_sf", "sigma_2", "J")
TRUTH_SYSTEM = {name: TRUTH[name] for name in SYSTEM}


FEW_S, FEWER_S = 10.0, 5.0
"""Four reversals, and two: where physics is missing every start is followed to its end, and the
time goes with the length.
"""


def equation_error(result: Identification, *recordings: Recording) -> dict[str, float]:
    prepared = [prepare(r, result.fit.bandwidth_Hz) for r in recordings]
    return solve_stages(prepared, [], Model(), lambda _stage, _share: None)[0]


def test_practical_bench_within_tenths_of_a_percent(practical_result: Identification) -> None:
    assert [s.method for s in practical_result.stages] == ["variable projection"] * 2 + [
        "prediction error"
    ]
    assert practical_result.warnings == ()
    found = practical_result.values()
    for name, value in TRUTH.items():
        limit = {"omega_sL": 0.03, "J": 0.008}.get(name, 0.004)
        assert found[name] == pytest.approx(value, rel=limit), name


def test_innovations_of_the_practical_bench_are_of_unit_size(
    practical_result: Identification,
) -> None:
    assert practical_result.stages[-1].cost == pytest.approx(1.0, abs=0.1)


def test_one_thread_finds_what_two_find(
    practical_pair: tuple[Recording, Recording], practical_result: Identification
) -> None:
    # Inside a call the second thread is taken.
    alone, _ = both(lambda: identify(Dataset(practical_pair)), lambda: None)
    assert alone.values() == practical_result.values()
    assert alone.evaluations == practical_result.evaluations
    for name, parameter in alone.parameters.items():
        assert parameter == practical_result.parameters[name]


def test_where_the_starts_ended_is_kept(practical_result: Identification) -> None:
    searches, loaded = practical_result.starts
    assert (searches.stage, loaded.stage) == ("unloaded", "loaded")
    assert searches.ends[-1] <= searches.reached
    assert (
        len(loaded.ends) == 3 + 4 + 2
    )  # of the grid, and far from and near to the best of their ends
    assert 1 <= loaded.best <= 9
    assert min(loaded.ends) < loaded.reached


def test_friction_at_a_speed_is_pinned_better_than_its_parts(
    practical_result: Identification,
) -> None:
    pairs = {t.names: t for t in practical_result.tradeoffs}
    assert "only their sum at 0.3" in pairs["Mc", "sigma_2"].statement
    assert practical_result.least_pinned.startswith("least determined is omega_sL alone")


def test_intervals_are_narrow_and_near_the_truth(practical_result: Identification) -> None:
    for name, value in TRUTH.items():
        parameter = practical_result.parameters[name]
        assert parameter.low is not None
        assert parameter.high is not None
        half = 0.5 * (parameter.high - parameter.low)
        assert half < 0.05 * value, name
        assert abs(0.5 * (parameter.high + parameter.low) - value) < 3.0 * half, name


def test_result_holds_every_signal_and_adds_up(practical_result: Identification) -> None:
    assert [t.recording for t in practical_result.traces] == ["unloaded", "loaded"]
    assert practical_result.evaluations == sum(s.evaluations for s in practical_result.stages)
    errors = [(t.torque - t.torque_model)[t.used] for t in practical_result.traces]
    rms = np.sqrt(np.mean(np.concatenate(errors) ** 2))
    assert practical_result.fit.train_rms == pytest.approx(rms)
    assert practical_result.fit.validate_rms is None


@pytest.mark.parametrize(
    ("names", "loaded"),
    [
        (("J",), False),
        (("Ms",), False),
        (("Mc", "omega_sf"), False),
        (SYSTEM, True),
        (("mu_s", "omega_sL"), True),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, tuple) else "",
)
def test_fixed_values_are_held_through_the_refinement(
    practical_pair: tuple[Recording, Recording], names: tuple[str, ...], loaded: bool
) -> None:
    recordings = tuple(beginning(r, FEW_S) for r in practical_pair[: 1 + loaded])
    result = identify(Dataset(recordings, Model(fixed={n: TRUTH[n] for n in names})))
    assert result.stages[-1].method == "prediction error"
    for name, found in result.values().items():
        limit = 1e-12 if name in names else 0.008
        assert found == pytest.approx(TRUTH[name], rel=limit), name


@pytest.mark.proof
def test_a_rise_of_load_friction_that_the_bandwidth_hides_is_found_in_the_breakaways(
    practical_pair: tuple[Recording, Recording],
) -> None:
    """As over a serial line at 500 cycles/s, where the equation error at 20 Hz ends with mu_s at
    mu_c.
    """
    prepared = [prepare(r, 40.0) for r in practical_pair]
    values, _ = solve_stages(prepared[:1], prepared[1:], Model(), lambda _stage, _share: None)
    flat = {**values, "mu_s": values["mu_c"], "omega_sL": 1.0}
    refined = refine_recordings(practical_pair, flat, free_names(flat, Model()), Model())
    assert not isinstance(refined, str)
    assert refined.values["mu_s"] == pytest.approx(TRUTH["mu_s"], rel=0.004)
    assert refined.values["omega_sL"] == pytest.approx(TRUTH["omega_sL"], rel=0.03)


def test_everything_fixed_is_only_scored(practical_pair: tuple[Recording, Recording]) -> None:
    result = identify(Dataset(practical_pair[:1], Model(fixed=TRUTH_SYSTEM)))
    assert result.values() == pytest.approx(TRUTH_SYSTEM)
    assert "every parameter is fixed" in result.warnings[0]
    assert result.fit.train_relative < 0.01


@pytest.mark.parametrize(("amplitude", "seconds"), [(0.3, FEW_S), (1.0, FEWER_S)])
def test_hidden_ripple_leaves_the_values_of_the_equation_error(
    practical_pair: tuple[Recording, Recording], amplitude: float, seconds: float
) -> None:
    """A torque over the angle as cogging makes it, which no nominal parameter can take."""
    recording = with_ripple(beginning(practical_pair[0], seconds), amplitude, 120.0)
    result = identify(Dataset((recording,)))
    (warning,) = result.warnings
    assert "values are those of the equation error at" in warning
    assert "the torque noise by the prediction errors" in warning
    plain = equation_error(result, recording)
    assert result.values() == {name: plain[name] for name in result.values()}


@pytest.mark.proof
def test_strong_hidden_ripple_does_not_break_the_search(
    practical_pair: tuple[Recording, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    solved_from, begun = searches._solved_from, []

    def tried(start: Point, *given: object) -> object:
        begun.append((start.filter.evaluations, start.vector[searches.INERTIA]))
        return solved_from(start, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(searches, "_solved_from", tried)
    recording = with_ripple(beginning(practical_pair[0], FEWER_S), 2.0, 40.0)
    result = identify(Dataset((recording,)))
    assert "physics that the model lacks" in result.warnings[0]
    # The search tries other inertias than the equation error's, and ends although none solves the
    # equations.
    passes, inertias = zip(*begun, strict=True)
    assert len(set(inertias)) > 3
    assert max(passes) < searches.MOST_PASSES
    plain = equation_error(result, recording)
    assert result.values() == {name: plain[name] for name in result.values()}


def test_far_inertias_are_tried_where_no_near_one_solves_the_equations(
    practical_pair: tuple[Recording, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    inertias = []

    def unsolved(start: Point, *_given: object) -> searches.Solved:
        inertias.append(start.vector[searches.INERTIA])
        return searches.Solved(2.0 * searches.SOLVED, start)

    monkeypatch.setattr(searches, "_solved_from", unsolved)
    identify(Dataset((beginning(practical_pair[0], FEWER_S),)))
    for share in searches._FAR:
        assert np.any(np.isclose(inertias, share * inertias[0]))


def test_a_fit_whose_passes_are_used_up_starts_no_further_search(
    practical_pair: tuple[Recording, Recording], monkeypatch: pytest.MonkeyPatch
) -> None:
    begun = []

    def unsolved(start: Point, *_given: object) -> searches.Solved:
        begun.append(start)
        return searches.Solved(2.0 * searches.SOLVED, start)

    monkeypatch.setattr(searches, "_solved_from", unsolved)
    monkeypatch.setattr(searches, "MOST_PASSES", 1)
    identify(Dataset((beginning(practical_pair[0], FEWER_S),)))
    assert len(begun) == 1


def test_a_recording_without_breakaways_leaves_the_others_their_refinement(
    practical_pair: tuple[Recording, Recording],
) -> None:
    moving = replace(beginning(practical_pair[0], FEW_S), name="moving")
    seconds = moving.channels["time"]
    inside = (seconds > 1.0) & (seconds < 1.4)
    cut = {name: values[inside] for name, values in moving.channels.items()}
    short = replace(moving, name="short", channels=cut)
    alone, both = (identify(Dataset(given)) for given in ((moving,), (moving, short)))
    assert both.noise is not None
    assert any(w.startswith("short: used by the equation error only") for w in both.warnings)
    for name, value in alone.values().items():
        assert both.values()[name] == pytest.approx(value, rel=0.01)


@pytest.mark.proof
def test_torque_noise_is_told_from_scatter(practical_pair: tuple[Recording, Recording]) -> None:
    recording = beginning(practical_pair[0], FEWER_S)
    clean, rippled = (motion(r) for r in (recording, with_ripple(recording, 0.3, 40.0)))
    assert clean is not None
    assert rippled is not None
    right, wrong = (refine_stages([m], [], TRUTH_SYSTEM, Model()) for m in (clean, rippled))
    assert right.noise.torque < right.torque_scatter
    assert wrong.noise.torque > 3.0 * wrong.torque_scatter
    assert abs(right.whiteness) < 0.1
    assert refusal(right, 1.0, 1.0) == ""
    assert "the torque noise by the prediction errors" in refusal(wrong, 1.0, 1.0)
    assert "a correlation of +0.20 (limit" in refusal(replace(right, whiteness=0.2), 1.0, 1.0)
    assert "at a lower likelihood than it starts (change of the deviance +20," in refusal(
        replace(right, likelihood_drop=20.0), 1.0, 1.0
    )
    assert refusal(right, 1.0, 1.2) == ""
    assert "raise the equation error from 1 to 1.4" in refusal(right, 1.0, 1.4)
    assert refusal(right, 1.0, 1.4, AcceptanceLimits(error_ratio=1.5)) == ""
    for lost in (
        replace(right, whiteness=math.nan),
        replace(right, values={**right.values, "J": math.nan}),
    ):
        assert "not finite" in refusal(lost, 1.0, 1.0)


def test_a_slip_that_is_lost_is_no_missing_physics(
    practical_pair: tuple[Recording, Recording],
) -> None:
    """Twenty samples of 62 deviations, as of bench 29199, made neighbours correlate by 0.6; of all
    samples they do.
    """
    moving = motion(beginning(practical_pair[0], FEW_S))
    assert moving is not None
    joint = refine_stages([moving], [], TRUTH_SYSTEM, Model()).joint
    residual = joint.weighted().residuals(joint.origin())
    k = np.arange(len(residual))
    slip = np.where((k >= 3000) & (k < 3020), 62.0, 0.0)
    rms, whiteness = innovation_statistics(residual + slip, joint.breakaways)
    assert abs(whiteness) < 0.1
    assert rms == pytest.approx(1.0, abs=0.1)
    wave = 2.0 * np.sin(k / 30.0)
    assert innovation_statistics(residual + wave, joint.breakaways)[1] > 0.4


def test_the_typical_error_does_not_follow_the_recording_that_fits_worst(
    practical_pair: tuple[Recording, Recording],
) -> None:
    prepared = [prepare(r, 40.0) for r in practical_pair]
    wrong = {**TRUTH, "mu_c": 1.1 * TRUTH["mu_c"]}
    grown = typical_error(prepared, wrong, 2.0) / typical_error(prepared, TRUTH, 2.0)
    alone = typical_error(prepared[1:], wrong, 2.0) / typical_error(prepared[1:], TRUTH, 2.0)
    assert grown == pytest.approx(math.sqrt(alone))
    assert alone > 1.3
    shorter = replace(
        prepared[1], used=prepared[1].used & (np.arange(len(prepared[1].used)) % 2 == 0)
    )
    halved = [typical_error([prepared[0], shorter], v, 2.0) for v in (wrong, TRUTH)]
    assert halved[0] / halved[1] == pytest.approx(grown, rel=0.01)


def test_exact_channels_are_not_refined() -> None:
    result = identify(Dataset((sine(),)), bandwidth_Hz=500.0)
    assert [s.method for s in result.stages] == ["variable projection"]
    (warning,) = result.warnings
    assert "a quantised encoder" in warning
    assert result.values() == pytest.approx({name: TRUTH[name] for name in SYSTEM}, rel=1e-6)


def test_without_inertia_to_start_from_nothing_is_refined(
    practical_pair: tuple[Recording, Recording],
) -> None:
    recording = practical_pair[0]
    acceleration = np.gradient(np.gradient(recording.channels["motor_angle"], 1e-3), 1e-3) / 100.0
    smooth = np.convolve(acceleration, np.ones(51) / 51.0, mode="same")
    current = recording.channels["current"] - 0.3 * smooth / 3.0  # takes away more than J domega/dt
    result = identify(
        Dataset((replace(recording, channels={**recording.channels, "current": current}),))
    )
    assert "finds no inertia above 0" in result.warnings[0]
    assert result.parameters["J"].at_bound


def test_validation_is_scored_and_never_fitted(practical_pair: tuple[Recording, Recording]) -> None:
    searches = beginning(practical_pair[0], FEW_S)
    longer = logged(simulated(3, 0.0), 0.0, name="other")
    other = replace(beginning(longer, FEW_S), role="validate")
    heard: list[str] = []
    alone = identify(Dataset((searches,)), progress=lambda stage, _share: heard.append(stage))
    scored = identify(Dataset((searches, other)))
    assert {"unloaded fit, recordings: 1", "joint fit, recordings: 1"} <= set(heard)
    assert scored.values() == alone.values()
    assert scored.fit.train_rms == alone.fit.train_rms
    assert scored.fit.validate_rms == scored.fits_by_recording["other"].train_rms
    assert scored.fit.validate_rms == pytest.approx(scored.fit.train_rms, rel=0.2)


def test_progress_is_told() -> None:
    heard: list[tuple[str, float]] = []
    identify(Dataset((sine(),)), progress=lambda stage, share: heard.append((stage, share)))
    assert heard[0] == ("unloaded", 0.0)
    assert ("unloaded", 1.0) in heard
    assert heard[-1] == ("joint", 1.0)


def test_loaded_alone_is_refused_with_what_is_missing() -> None:
    with pytest.raises(
        RecordingError, match=r"record an unloaded stage, or fix Mc, Ms, omega_sf, sigma_2, J"
    ):
        identify(Dataset((sine(weight=30.6),)))


def test_loaded_alone_with_the_system_fixed() -> None:
    result = identify(Dataset((sine(weight=30.6),), Model(fixed=TRUTH_SYSTEM)), bandwidth_Hz=500.0)
    for name in ("mu_c", "mu_s", "omega_sL", "mu_2"):
        assert result.values()[name] == pytest.approx(TRUTH[name], rel=1e-6)


def test_nothing_to_fit_is_refused() -> None:
    with pytest.raises(RecordingError, match="no recording has role 'fit'"):
        identify(Dataset((sine(role="validate"),)))


@pytest.mark.parametrize("method", [identify, identify_paper])
def test_a_stage_at_rest_is_refused(method: Callable[..., Identification]) -> None:
    still = sine()
    still = replace(still, channels={**still.channels, "angle": np.full(len(still.time), 0.1)})
    still = replace(
        still,
        channels={k: v for k, v in still.channels.items() if k not in ("velocity", "motor_angle")},
    )
    with pytest.raises(
        RecordingError, match=r"sine: .* 0 samples are in motion; a fit needs at least 40 samples"
    ):
        method(Dataset((still,)), rng=np.random.default_rng(0))


def test_motion_that_rests_in_every_window_of_the_filter_is_refused_with_its_reversals() -> None:
    shaken = sine()
    angle = np.clip(0.02 * np.sin(2.0 * np.pi * 20.0 * shaken.time), -0.01, 0.01)
    channels = {"time": shaken.time, "angle": angle, "torque": shaken.channels["torque"]}
    with pytest.raises(RecordingError, match=r"reverses \d+(\.\d)? times per second"):
        identify(Dataset((replace(shaken, channels=channels),)), bandwidth_Hz=20.0)


@pytest.mark.parametrize("method", [identify, identify_paper])
def test_a_drive_without_torque_is_refused(method: Callable[..., Identification]) -> None:
    idle = sine()
    idle = replace(idle, channels={**idle.channels, "torque": np.zeros(len(idle.time))})
    with pytest.raises(
        RecordingError, match="sine: the drive's torque is zero at all samples in motion"
    ):
        method(Dataset((idle,)), rng=np.random.default_rng(0))


def test_the_paper_method_takes_no_bandwidth_from_recordings_set_aside() -> None:
    fitted, aside = sine(name="fitted"), sine(name="aside", rate=250.0)
    alone = identify_paper(Dataset((fitted,)), rng=np.random.default_rng(0), generations=2)
    both = identify_paper(
        Dataset((fitted, replace(aside, role="validate"))),
        rng=np.random.default_rng(0),
        generations=2,
    )
    assert both.fit.bandwidth_Hz == alone.fit.bandwidth_Hz
    assert both.values() == alone.values()
