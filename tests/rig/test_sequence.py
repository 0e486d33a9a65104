"""Bench and sequence files: what they command, and every way of asking for too much."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.config.sequence import Ramp, StageSection, Tone, approach, excitation, load_sequence
from rig.planning.plan import Plan, make_plan

HEAD = "sequence: 1\nname: s\nstages:\n"
GOOD = "tones: [{amplitude_deg: 5, frequency_Hz: 1}], duration_s: 2"


def plan_of(path: Path, text: str, bench: str = "practical") -> Plan:
    path.write_text(text)
    return make_plan(load_sequence(path), load_bench(bench))


def problems_of(path: Path, text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        plan_of(path, text)
    return [problem.removeprefix(f"{path}:") for problem in caught.value.problems]


def test_figure10_is_the_papers_two_cases() -> None:
    plan = make_plan(load_sequence("figure10"), load_bench("practical"))
    first, second = plan.stages
    assert (first.weight_kg, first.contact_force_N) == (0.0, 0.0)
    assert second.contact_force_N == pytest.approx(3000, rel=1e-3)
    assert first.duration_s == second.duration_s == 20.0
    t = np.arange(1000, 19000) * 1e-3
    np.testing.assert_allclose(
        first.targets[1000:19000], math.radians(20) * np.sin(0.4 * math.pi * t), atol=1e-12
    )
    assert first.targets[0] == 0.0
    assert abs(first.targets[-1]) < 1e-6


def test_an_unknown_name_lists_the_near_ones() -> None:
    with pytest.raises(InputError, match="figure10"):
        resolve("figure1", "sequences")


def test_a_file_wins_over_a_packaged_name(tmp_path: Path) -> None:
    path = tmp_path / "figure10"
    path.write_text("x")
    assert resolve(path, "sequences") == path


stages = st.builds(
    StageSection,
    name=st.just("s"),
    stage=st.just("unloaded"),
    tones=st.lists(
        st.builds(
            Tone,
            amplitude_deg=st.floats(0.1, 20),
            frequency_Hz=st.floats(0.05, 5),
            phase_deg=st.floats(-180, 180),
        ),
        min_size=1,
        max_size=3,
    ).map(tuple),
    duration_s=st.just(4.0),
    ramp_in_s=st.floats(0.5, 2),
    ramp_out_s=st.floats(0.5, 2),
    center_deg=st.floats(-10, 10),
)


@settings(deadline=None)
@given(stages)
def test_an_excitation_starts_and_ends_at_rest_on_its_centre(stage: StageSection) -> None:
    targets = excitation(stage, 0.001)
    centre = math.radians(stage.center_deg)
    assert targets.shape == (4000,)
    assert targets[0] == pytest.approx(centre, abs=1e-12)
    assert targets[-1] == pytest.approx(centre, abs=1e-4)
    amplitude = sum(math.radians(tone.amplitude_deg) for tone in stage.tones)
    assert np.abs(targets - centre).max() <= amplitude + 1e-12
    assert abs(targets[1] - targets[0]) / 0.001 < 0.02


def test_a_ramp_that_goes_nowhere_stays() -> None:
    ramp = Ramp(travel_deg=0.0, speed_deg_s=1.0, rest_s=0.0, times=3)
    with np.errstate(all="raise"):
        assert np.all(
            excitation(StageSection(name="s", stage="unloaded", ramp=ramp, duration_s=1.0), 0.01)
            == 0.0
        )


@settings(deadline=None)
@given(
    st.floats(0.05, 10),
    st.floats(0.1, 20) | st.floats(-20, -0.1),
    st.floats(0, 2),
    st.integers(1, 3),
    st.floats(-5, 5),
    st.floats(0, 3),
)
def test_a_ramp_goes_there_and_back_at_its_speed(speed, travel, rest, times, center, left):
    ramp = Ramp(travel_deg=travel, speed_deg_s=speed, rest_s=rest, times=times)
    stage = StageSection(
        name="s",
        stage="unloaded",
        ramp=ramp,
        center_deg=center,
        duration_s=min(ramp.moving_s + left, 3600.0),
    )
    away = np.degrees(excitation(stage, 0.01)) - center
    assert away[0] == pytest.approx(0.0, abs=1e-9)
    assert away[-1] == pytest.approx(0.0, abs=0.016 * speed)
    assert away[np.argmax(np.abs(away))] == pytest.approx(travel, abs=0.011 * speed)
    steps = np.diff(away) / 0.01
    assert np.abs(steps).max() <= speed * (1 + 1e-6)
    assert np.count_nonzero(np.abs(steps) > 0.999 * speed) * 0.01 == pytest.approx(
        2 * times * abs(travel) / speed, abs=0.05 * times
    )


@settings(deadline=None)
@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.05, 2.0))
def test_an_approach_arrives_smoothly_within_its_speed(start, end, speed):
    path = np.concatenate([[start], approach(start, end, speed, 0.001)])
    assert path[-1] == pytest.approx(end, abs=1e-12) or len(path) == 1
    assert np.abs(np.diff(path)).max(initial=0.0) <= speed * 0.001 * (1 + 1e-9)
    assert len(path) > 1 or start == end


@pytest.mark.parametrize(
    ("stage", "expected"),
    [
        ("stage: loaded, weight_kg: 41, TONES", ["weight_kg: above", "4021 N"]),
        ("stage: unloaded, tones: [{amplitude_deg: 31, frequency_Hz: 0.2}], SPAN", ["31 deg"]),
        ("stage: unloaded, tones: [{amplitude_deg: 20, frequency_Hz: 2}], SPAN", ["251.3 deg/s"]),
        ("stage: unloaded, tones: [{amplitude_deg: 0.01, frequency_Hz: 60}], SPAN", ["50 Hz"]),
        ("stage: unloaded, TONES, ramp_in_s: 1.5", ["2.5 s is longer than duration_s 2 s"]),
        ("stage: unloaded, weight_kg: 3, TONES", ["an unloaded stage has no weight"]),
        ("stage: loaded, TONES", ["a loaded stage needs weight_kg above 0"]),
        ("stage: unloaded, SPAN", ["exactly one excitation"]),
        ("stage: unloaded, ramp: {travel_deg: 25, speed_deg_s: 2}, SPAN", ["ramp takes 26 s"]),
        (
            "stage: unloaded, ramp: {travel_deg: 1, speed_deg_s: 1}, SPAN, ramp_in_s: 1",
            ["ramp_in_s fade tones"],
        ),
        (
            "stage: unloaded, ramp: {travel_deg: -31, speed_deg_s: 125}, SPAN",
            ["ramp.travel_deg: the joint would go to -31 deg", "ramp.speed_deg_s: peak speed 125"],
        ),
    ],
)
def test_asking_for_too_much(tmp_path: Path, stage: str, expected: list[str]) -> None:
    stage = stage.replace("TONES", GOOD).replace("SPAN", "duration_s: 20")
    problems = problems_of(tmp_path / "s.yaml", f"{HEAD}  - {{name: a, {stage}}}\n")
    for words in expected:
        assert any(words in problem for problem in problems), problems
    assert all(problem.startswith("4:") for problem in problems)


def test_all_problems_at_once(tmp_path: Path) -> None:
    text = f"{HEAD}  - {{name: a, stage: loaded, weight_kg: 99, {GOOD}}}\n"
    text += (
        "  - {name: b, stage: unloaded, tones: [{amplitude_deg: 45, frequency_Hz: 3}], "
        "duration_s: 9}\n"
    )
    text += "limits: {speed_deg_s: 500}\n"
    problems = problems_of(tmp_path / "s.yaml", text)
    assert {problem.split(":")[0] for problem in problems} == {"4", "5", "6"}


def test_a_sequence_tightens_a_limit(tmp_path: Path) -> None:
    text = (
        f"{HEAD}  - {{name: a, stage: unloaded, {GOOD}}}\nlimits: {{speed_deg_s: 50, "
        f"angle_min_deg: -10}}\n"
    )
    plan = plan_of(tmp_path / "s.yaml", text)
    assert plan.limits.speed == pytest.approx(math.radians(50))
    assert plan.servo_limits.speed_rad_s == plan.limits.speed
    assert plan.limits.angle_min == pytest.approx(math.radians(-10))
    assert plan.limits.angle_max == pytest.approx(math.radians(30))


@pytest.mark.parametrize("limit", ["speed_deg_s: 121", "angle_min_deg: -31", "sample_age_ms: 6"])
def test_a_sequence_may_not_loosen_a_limit(tmp_path: Path, limit: str) -> None:
    text = f"{HEAD}  - {{name: a, stage: unloaded, {GOOD}}}\nlimits: {{{limit}}}\n"
    (problem,) = problems_of(tmp_path / "s.yaml", text)
    assert problem.startswith("5:")
    assert "may only tighten" in problem


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("cycle_Hz: 1000", "cycle_Hz: 300", "whole number of milliseconds"),
        ("angle_min_deg: -30", "angle_min_deg: 40", "must be below angle_max_deg"),
        ("    inertia_kg_m2: 0.204", "    inertia_kg_m2: -1", "joint.inertia_kg_m2 is -1"),
        ("    Mc_N_m: 6.825", "    Mc: 6.825", "Mc"),
    ],
)
def test_bad_benches(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "b.yaml"
    text = resolve("practical", "benches").read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_bench(path)
    assert any(words in problem for problem in caught.value.problems), caught.value.problems


@pytest.mark.parametrize(
    ("bitrate", "rate", "fits"),
    [(1_000_000, 1000, True), (500_000, 500, True), (500_000, 1000, False)],
)
def test_a_cycle_must_fit_the_bus(tmp_path: Path, bitrate: int, rate: int, fits: bool) -> None:
    path = tmp_path / "b.yaml"
    text = (
        resolve("practical", "benches")
        .read_text()
        .replace("bitrate: 1000000", f"bitrate: {bitrate}")
    )
    path.write_text(text.replace("cycle_Hz: 1000", f"cycle_Hz: {rate}"))
    if fits:
        assert load_bench(path).value.cycle_Hz == rate
        return
    line = next(n for n, line in enumerate(text.splitlines(), 1) if "bitrate" in line)
    with pytest.raises(
        InputError,
        match=rf":{line}:\d+: bus.bitrate: .* 133% of the bus, limit 80%; .*cycle_Hz to 500",
    ):
        load_bench(path)


def test_something_must_be_fitted(tmp_path: Path) -> None:
    aside = f"{HEAD}  - {{name: a, stage: unloaded, role: validate, {GOOD}}}\n"
    with pytest.raises(InputError, match="every stage has role validate"):
        plan_of(tmp_path / "s.yaml", aside)
    plan = plan_of(tmp_path / "s.yaml", f"{aside}  - {{name: b, stage: unloaded, {GOOD}}}\n")
    assert [stage.role for stage in plan.stages] == ["validate", "fit"]
