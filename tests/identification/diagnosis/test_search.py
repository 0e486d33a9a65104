"""The test by sign flips holds its level on noise that is correlated within blocks; how effects are
added and kept.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from identification.diagnosis.comparison import implausible
from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.held_out import validation_rms
from identification.diagnosis.joint import Added, fit, identifiable
from identification.diagnosis.removal import needed_share
from identification.diagnosis.result import Verdict
from identification.diagnosis.significance import DRAWS, flipped_statistics, sign_flip_p_value
from identification.diagnosis.stack import Candidate, log_surprise, wald_statistic
from identification.diagnosis.within_limits import fit_from_estimate, views_and_fit
from identification.effects import MOTION
from identification.effects.effect import Context
from identification.recording import Bench, Dataset, Model, Recording
from identification.views.view import one_clock, views

from .benches import campaign, honest, nominal_fit

BLOCKS, ROWS, CANDIDATES, STUDIES = 40, 25, 20, 100


def scored(regressor: np.ndarray, residual: np.ndarray) -> Candidate:
    unit = regressor / np.linalg.norm(regressor)
    sums = (unit * residual).reshape(BLOCKS, ROWS).sum(axis=1)[:, None]
    score = sums.sum(axis=0)
    weights = (unit**2).reshape(BLOCKS, ROWS).sum(axis=1)[:, None, None]
    gain = float(score @ score)
    return Candidate(
        "any",
        (),
        score,
        gain,
        1.0,
        wald_statistic(score, sums - weights @ score),
        sums,
        weights,
        gain,
    )


def study(rng: np.random.Generator, hidden: float) -> float:
    level = np.repeat(rng.standard_normal(BLOCKS), ROWS)
    residual = rng.standard_normal(BLOCKS * ROWS) + 0.7 * level
    regressors = np.repeat(rng.standard_normal((CANDIDATES, BLOCKS)), ROWS, axis=1)
    residual = residual + hidden * regressors[0]
    return sign_flip_p_value([scored(r, residual) for r in regressors], BLOCKS, rng)


@pytest.mark.parametrize("degrees", [1, 2, 3])
@pytest.mark.parametrize("alike", [1.0, 3e-4])
def test_flips_give_what_flipped_blocks_would(degrees: int, alike: float) -> None:
    rng = np.random.default_rng(degrees)
    columns = rng.standard_normal((BLOCKS, ROWS, degrees))
    columns[:, :, 1:] = columns[:, :, :1] + alike * columns[:, :, 1:]
    residual = rng.standard_normal((BLOCKS, ROWS))
    sums = np.einsum("bij,bi->bj", columns, residual)
    weights = np.einsum("bij,bik->bjk", columns, columns) / (BLOCKS * ROWS)
    flips = rng.choice((-1.0, 1.0), size=(20, BLOCKS))
    expected = [wald_statistic(f @ sums, f[:, None] * sums - weights @ (f @ sums)) for f in flips]
    candidate = Candidate("any", (), np.zeros(degrees), 1.0, 1.0, 1.0, sums, weights, 1.0)
    assert flipped_statistics(candidate, flips) == pytest.approx(expected, rel=1e-6)


def test_the_flips_of_all_candidates_count_however_many_numbers_they_have() -> None:
    rng = np.random.default_rng(11)
    candidates = []
    for degrees, size in ((1, 0.3), (2, 0.4), (1, 0.2), (2, 0.1)):
        columns, residual = (
            rng.standard_normal((BLOCKS, ROWS, degrees)),
            rng.standard_normal((BLOCKS, ROWS)),
        )
        sums = np.einsum("bij,bi->bj", columns, residual + size * columns[:, :, 0])
        weights = np.einsum("bij,bik->bjk", columns, columns) / (BLOCKS * ROWS)
        found = wald_statistic(sums.sum(axis=0), sums - weights @ sums.sum(axis=0))
        candidates.append(
            Candidate("any", (), np.zeros(degrees), 1.0, 1.0, 0.02 * found, sums, weights, 1.0)
        )
    flips = np.random.default_rng(12).choice((-1.0, 1.0), size=(DRAWS, BLOCKS))
    drawn = np.max(
        [log_surprise(flipped_statistics(c, flips), c.blocks.shape[1]) for c in candidates], axis=0
    )
    beyond = int(np.sum(drawn >= max(c.surprise for c in candidates)))
    assert 0 < beyond < DRAWS
    assert sign_flip_p_value(candidates, BLOCKS, np.random.default_rng(12)) == (1 + beyond) / (
        1 + DRAWS
    )


def test_false_alarms_come_as_often_as_said() -> None:
    rng = np.random.default_rng(5)
    alarms = sum(study(rng, 0.0) <= 0.05 for _ in range(STUDIES))
    assert alarms <= 10, "more than 10 % at a level of 5 %"


def test_an_effect_is_seen() -> None:
    rng = np.random.default_rng(6)
    assert sum(study(rng, 0.8) <= 0.01 for _ in range(20)) >= 18


def test_a_gap_is_followed_from_wherever_a_recording_begins_in_it() -> None:
    """A recording that begins on a flank, and takes seconds to leave it, is explained as well as
    any other.
    """
    gap = 0.004
    recordings = campaign({"backlash": {"gap_rad": gap}}, 8, 6.0)
    joint = nominal_fit(recordings[:3])
    rows = joint.stack.part("transmission")
    term = next(t for t in MOTION if t.name == "backlash")
    after = fit(
        joint.equations[0].views,
        "N m",
        joint.nominal,
        (Added(term, (0.003, 0.0, 0.0, 0.1), (1.0,)),),
        joint,
    )
    assert after.effects[0].shape[0] == pytest.approx(gap, rel=0.03)
    assert np.mean(joint.residual[rows] ** 2) > 1e4
    assert np.mean(after.residual[rows] ** 2) < 10.0


def test_friction_that_falls_is_found_from_an_estimate_without_a_fall() -> None:
    recordings = campaign({"presliding": {"stiffness_Nm_rad": 2e4}}, 9, 8.0)
    flat = nominal_fit(recordings)
    values = {
        **flat.nominal.values,
        "Ms": flat.nominal.values["Mc"],
        "mu_s": flat.nominal.values["mu_c"],
    }
    absent = {"Ms", "mu_s", "omega_sf", "omega_sL"}
    stuck = replace(flat.nominal, values=values, free=tuple(n for n in values if n not in absent))
    here = flat.equations[0].views
    begun = fit_from_estimate(here, "N m", stuck, Model())
    assert begun.cost < 0.9 * fit(here, "N m", stuck).cost
    assert begun.nominal.values["Ms"] > 1.1 * begun.nominal.values["Mc"]
    assert stuck.flat
    assert not begun.nominal.flat
    raised = stuck.raised(0.05, {"Ms"})
    assert raised.values["Ms"] == values["Ms"], "what is fixed stays"
    assert "Ms" not in raised.free
    assert raised.values["mu_s"] > raised.values["mu_c"]


def test_two_effects_are_named_and_a_look_alike_of_the_first_is_taken_out_again() -> None:
    """The gap is worth a thousand times the drag, and is seen by other encoders."""
    both = {"backlash": {"gap_rad": 0.002}, "asymmetric_coulomb": {"torque_Nm": 0.6}}
    found = diagnose(Dataset(campaign(both, 10), Model()))
    assert found.verdict is Verdict.NAMED
    assert {e.name for e in found.effects} == set(both)


@pytest.mark.parametrize(("others", "needed"), [(0.1, 0.4), (0.005, 0.8), (0.0005, math.inf)])
def test_what_one_more_name_must_explain(others: float, needed: float) -> None:
    assert needed_share(others) == needed


@pytest.mark.parametrize(
    ("motion", "rest", "said"), [("linear", 3.1, "rest_m = 3.1"), ("rotary", 3.1, "")]
)
def test_a_spring_of_a_slide_rests_within_a_few_travels_of_it(
    motion: Literal["linear", "rotary"], rest: float, said: str
) -> None:
    """One that rests further away is a constant force; of an angle the range is a turn, whatever
    the travel.
    """
    recording = campaign({}, 3, 6.0)[0]
    recording = replace(recording, bench=replace(recording.bench, motion=motion))
    joint = nominal_fit([recording])
    spring = next(t for t in MOTION if t.name == "return_spring")
    found = implausible(replace(joint, effects=(Added(spring, (), (2.0, 2.0 * rest)),)))
    assert found.startswith(said)
    assert bool(found) == bool(said)
    near = replace(joint, effects=(Added(spring, (), (2.0, 0.2)),))
    assert implausible(near) == ""


@pytest.mark.parametrize(("mass_kg", "said"), [(30.6, "inertia_kgm2 = 15"), (1.0, "")])
def test_the_inertia_of_a_load_is_plausible_for_the_weights_of_the_bench(
    mass_kg: float, said: str
) -> None:
    """It is stated for the reference mass: of lighter weights little inertia is a large value."""
    recordings = [
        replace(r, weight_mass=mass_kg) if r.weight_mass == 30.6 else r
        for r in honest()
        if r.weight_mass in (0.0, 30.6)
    ]
    joint = nominal_fit(recordings)
    inertia = next(t for t in MOTION if t.name == "load_inertia")
    found = implausible(replace(joint, effects=(Added(inertia, (), (15.0,)),)))
    assert found.startswith(said)
    assert bool(found) == bool(said)


@pytest.mark.parametrize(("heavier", "said"), [(1.0, "inertia_kgm2 = 15"), (10.0, "")])
def test_the_inertia_of_a_load_is_plausible_for_the_inertia_of_the_machine(
    heavier: float, said: str
) -> None:
    """A fast machine has little torque and travel for its inertia."""
    joint = nominal_fit(honest())
    values = {**joint.nominal.values, "J": heavier * joint.nominal.values["J"]}
    inertia = next(t for t in MOTION if t.name == "load_inertia")
    machine = replace(
        joint,
        nominal=replace(joint.nominal, values=values),
        effects=(Added(inertia, (), (15.0,)),),
    )
    found = implausible(machine)
    assert found.startswith(said)
    assert bool(found) == bool(said)


def test_friction_under_a_load_may_be_declared_before_any_load_is_known() -> None:
    """It begins at nothing, and is fitted as soon as an effect gives the gear something to bear."""
    recordings = tuple(r for r in campaign({}, 3, 6.0) if r.stage == "unloaded")
    dataset = Dataset(
        recordings, Model(terms=("load_dependent_friction",), friction="stribeck_load_dependent")
    )
    _, first = views_and_fit(dataset, 25.0)
    assert {"mu_gc", "mu_gs"} <= set(first.nominal.free)
    assert first.nominal.values["mu_gc"] == first.nominal.values["mu_gs"] == 0.0
    assert not identifiable(first, "mu_gc")
    assert identifiable(first, "Mc")
    plain = views_and_fit(replace(dataset, model=Model()), 25.0)[1]
    assert first.cost == pytest.approx(plain.cost, rel=0.02)


def test_once_a_turn_of_the_joint_is_a_weight_and_no_cogging() -> None:
    cogging = next(t for t in MOTION if t.name == "cogging")
    joint = nominal_fit(campaign({}, 3, 6.0)[:1])
    geared = Context(joint.equations[0].views, joint.nominal)
    direct = tuple(replace(v, recording=replace(v.recording, bench=Bench())) for v in geared.views)
    assert (1.0,) in cogging.shapes(geared)
    assert (1.0,) not in cogging.shapes(replace(geared, views=direct))
    assert (7.0,) in cogging.shapes(replace(geared, views=direct))


def test_nothing_is_said_of_recordings_set_aside_that_hardly_move() -> None:
    recordings = campaign({}, 3, 6.0)
    still = {
        n: np.full_like(c, c[0]) if "angle" in n else c for n, c in recordings[0].channels.items()
    }
    aside = views([replace(recordings[0], channels=still)], 25.0)
    assert "torque" not in validation_rms(nominal_fit(recordings[:2]), aside)


@pytest.mark.proof
def test_recordings_of_speed_alone_share_no_origin_of_their_angles() -> None:
    """Each has a phase of its own, and a place says nothing."""
    shared = campaign({"cogging": {"torque_Nm": 1.5, "per_motor_turn": 7.0, "phase_rad": 0.3}}, 3)
    turned = tuple(only_speed(r) for r in shared if r.role == "fit")
    found = diagnose(Dataset(turned, Model()), rng=np.random.default_rng(0))
    assert [e.name for e in found.effects] == ["cogging"]
    assert found.effects[0].parameters["per_motor_turn"].value == 7.0
    assert found.effects[0].parameters["torque_Nm"].value == pytest.approx(1.5, rel=0.1)
    assert any("is counted from its first sample" in w for w in found.warnings)


def only_speed(recording: Recording) -> Recording:
    channels = dict(recording.channels)
    angle = channels.pop("motor_angle") / recording.bench.gear_ratio
    channels.pop("angle")
    channels["velocity"] = np.gradient(angle, channels["time"])
    return replace(recording, channels=channels)


def begun_late(recording: Recording, late_s: float) -> Recording:
    """Return a recording without its first seconds, of which nothing is known."""
    time = recording.channels["time"]
    kept = time - time[0] >= late_s
    channels = {n: c[kept] for n, c in recording.channels.items()}
    channels["time"] = channels["time"] - channels["time"][0]
    return replace(recording, channels=channels)


@pytest.mark.proof
def test_recordings_that_have_no_clock_in_common_each_began_cold() -> None:
    """One that is set aside may have begun warm."""
    hidden = campaign({"coulomb_drift": {"rate_Nm_s": 0.03}}, 3, 6.0)
    assert one_clock(hidden)
    found = diagnose(Dataset(hidden, Model()), rng=np.random.default_rng(0))
    assert [e.name for e in found.effects] == ["coulomb_drift"]
    drift = {"coulomb_drift": {"rate_Nm_s": 0.12, "time_s": 5.0}}
    apart = tuple(
        replace(
            campaign(drift, 3 + k, 6.0)[0],
            name=f"r{k}",
            role="validate" if k == 3 else "fit",
        )
        for k in range(4)
    )
    apart = (*apart[:-1], begun_late(apart[-1], 2.0))
    assert not one_clock(apart)
    found = diagnose(Dataset(apart, Model()), rng=np.random.default_rng(0))
    assert [e.name for e in found.effects] == ["coulomb_drift"]
    assert found.effects[0].parameters["rate_Nm_s"].value == pytest.approx(0.12, rel=0.15)
    assert found.effects[0].parameters["time_s"].value == pytest.approx(5.0, rel=0.3)
    assert any("no common clock" in w for w in found.warnings)


@pytest.mark.parametrize("other", [pytest.param(0.0, marks=pytest.mark.proof), -0.3])
def test_end_stops_are_found_at_one_end_of_the_travel_or_at_both(other: float) -> None:
    stop = {"angle_rad": 0.28, "stiffness_Nm_rad": 60.0, "other_rad": other}
    found = diagnose(
        Dataset(campaign({"end_stop": stop}, 8, 8.0), Model()), rng=np.random.default_rng(0)
    )
    assert [e.name for e in found.effects] == ["end_stop"]
    sizes = found.effects[0].parameters
    assert sizes["angle_rad"].value == pytest.approx(0.28, abs=0.01)
    assert sizes["other_rad"].value == pytest.approx(other, abs=0.01)
    assert sizes["stiffness_Nm_rad"].value == pytest.approx(60.0, rel=0.1)
    assert ("at the other end" in found.statement) == (other < 0.0)
