"""How effects are searched, added and kept; a gap and a loop are told apart by their crossing."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identification.diagnosis import diagnose as diagnosing
from identification.diagnosis.comparison import Round
from identification.diagnosis.crossing import crossing_torque, gap_or_loop
from identification.diagnosis.diagnose import diagnose
from identification.diagnosis.held_out import DROPPED
from identification.diagnosis.joint import Added, Joint, fit
from identification.diagnosis.removal import needed_share
from identification.diagnosis.result import Step, Verdict
from identification.diagnosis.rules import RULES
from identification.diagnosis.significance import flipped_statistics, sign_flip_p_value
from identification.diagnosis.stack import Candidate, wald_statistic
from identification.effects import EFFECTS, MOTION
from identification.recording import Dataset, Model, Recording, RecordingError
from identification.views.nominal import Nominal
from identification.views.view import View, one_clock, views

from .benches import FEW, campaign, nominal_fit

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


def test_false_alarms_come_as_often_as_said() -> None:
    rng = np.random.default_rng(5)
    alarms = sum(study(rng, 0.0) <= 0.05 for _ in range(STUDIES))
    assert alarms <= 10, "more than 10 % at a level of 5 %"


def test_an_effect_is_seen() -> None:
    rng = np.random.default_rng(6)
    assert sum(study(rng, 0.8) <= 0.01 for _ in range(20)) >= 18


def test_two_effects_are_named_and_a_look_alike_of_the_first_is_taken_out_again() -> None:
    """The gap is worth a thousand times the drag, and is seen by other encoders."""
    both = {"backlash": {"gap_rad": 0.002}, "asymmetric_coulomb": {"torque_Nm": 0.6}}
    found = diagnose(Dataset(campaign(both, 10, 8.0, FEW), Model()))
    # A constant torque is one with the asymmetry, whatever the motion.
    assert found.verdict is Verdict.AMBIGUOUS
    groups = {e.name: e.alias_group[1:] for e in found.effects}
    assert groups == {"backlash": (), "asymmetric_coulomb": ("constant_torque",)}


@pytest.mark.parametrize(("others", "needed"), [(0.1, 0.4), (0.005, 0.8), (0.0005, math.inf)])
def test_what_one_more_name_must_explain(others: float, needed: float) -> None:
    assert needed_share(others) == needed


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
    assert found.effects[0].confidence > 0.5
    drift = {"coulomb_drift": {"rate_Nm_s": 0.12, "time_s": 5.0}}
    apart = tuple(
        replace(campaign(drift, 3 + k, 6.0)[0], name=f"r{k}", role="validate" if k == 3 else "fit")
        for k in range(4)
    )
    apart = (*apart[:-1], begun_late(apart[-1], 2.0))
    assert not one_clock(apart)
    found = diagnose(Dataset(apart, Model()), rng=np.random.default_rng(0))
    assert [e.name for e in found.effects] == ["coulomb_drift"]
    assert found.effects[0].parameters["rate_Nm_s"].value == pytest.approx(0.12, rel=0.15)
    assert found.effects[0].parameters["time_s"].value == pytest.approx(5.0, rel=0.3)
    assert found.effects[0].confidence <= 0.5
    assert any("no common clock" in w for w in found.warnings)


@pytest.mark.proof
@pytest.mark.parametrize("other", [0.0, -0.3])
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
    assert found.statement.count(" deg (") == 1 + (other < 0.0)


OUTSIDE, NAMED = Verdict.OUTSIDE_CATALOGUE, Verdict.NAMED


def term(name: str) -> Any:
    return SimpleNamespace(name=name)


EVERY = [term(name) for name in "abcd"]


class Scripted:
    """Searches with given verdicts and dropped effects; keeps the effects each was given."""

    def __init__(self, script: Sequence[tuple[Verdict, str]], final: Verdict) -> None:
        self.script, self.final = list(script), final
        self.asked: list[tuple[str, bool]] = []

    def __call__(self, _task: object, terms: Sequence[Any], thorough: bool = False) -> Any:
        names = "".join(t.name for t in terms)
        self.asked.append((names, thorough))
        verdict, dropped = (self.final, "") if thorough else self.script.pop(0)
        steps = [Step(DROPPED, name, 1.0, 0.0, "") for name in dropped]
        found = SimpleNamespace(steps=steps, tag=(names, thorough))
        made = SimpleNamespace(found=found, judged=SimpleNamespace(verdict=verdict))
        made._replace = lambda judged: SimpleNamespace(found=found, verdict=judged)
        return made


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Any:
    def searched(
        script: Sequence[tuple[Verdict, str]], final: Verdict = OUTSIDE, nearly_all: bool = True
    ) -> tuple[Any, list[tuple[str, bool]]]:
        scripted = Scripted(script, final)
        monkeypatch.setattr(diagnosing, "_outcome", scripted)
        monkeypatch.setattr(diagnosing, "explains_nearly_all", lambda _found: nearly_all)
        monkeypatch.setattr(diagnosing, "without_unlogged", lambda judged, _found: judged)
        task: Any = None
        counted: Any = diagnosing._searches(task, EVERY)
        return counted.found.tag, scripted.asked

    return searched


@pytest.mark.parametrize(
    ("script", "options", "counted", "asked"),
    [
        *(
            ([(verdict, "a")], {}, ("abcd", False), ["abcd"])
            for verdict in (NAMED, Verdict.AMBIGUOUS, Verdict.NOTHING_MISSING)
        ),
        ([(OUTSIDE, "b"), (NAMED, "")], {}, ("acd", False), ["abcd", "acd"]),
        ([(OUTSIDE, "b"), (Verdict.NOTHING_MISSING, "")], {}, ("abcd", False), ["abcd", "acd"]),
        ([(OUTSIDE, n) for n in "abc"], {}, ("abcd", False), ["abcd", "bcd", "cd"]),
        ([(OUTSIDE, "")], {"final": NAMED}, ("abcd", True), ["abcd"]),
        ([(OUTSIDE, "")], {"final": NAMED, "nearly_all": False}, ("abcd", False), ["abcd"]),
        ([(OUTSIDE, "")], {"final": Verdict.NOTHING_MISSING}, ("abcd", False), ["abcd"]),
    ],
)
def test_dropped_effects_take_no_part_in_the_next_search_and_only_a_name_replaces_the_first(
    run: Any, script: Any, options: Any, counted: Any, asked: list[str]
) -> None:
    found, searches = run(script, **options)
    assert found == counted
    assert [names for names, thorough in searches if not thorough] == asked


@pytest.mark.parametrize("moves", [True, False])
def test_a_valve_that_hardly_moves_is_judged_by_the_motor(monkeypatch, moves):
    """A gap is found; the valve's own motion may then be too little for a fit."""
    sides: list[tuple[str, bool]] = []
    gap = SimpleNamespace(term=EFFECTS["backlash"])

    def search(start: Any, _terms: Any, *rest: Any) -> Any:
        sides.append((start.views, rest[-1].until_flexible))
        return SimpleNamespace(final=SimpleNamespace(effects=[gap]), side=start.views)

    def fit(*_: Any) -> Any:
        if not moves:
            raise RecordingError("no sample is in steady motion")
        return SimpleNamespace(views="valve")

    for name, replaced in (("search", search), ("fit_from_estimate", fit)):
        monkeypatch.setattr(diagnosing, name, replaced)
    monkeypatch.setattr(diagnosing, "views", lambda *_: "valve")
    dataset = SimpleNamespace(part=lambda _role: [], model=SimpleNamespace(fixed=()), recordings=())
    first = SimpleNamespace(nominal=None, views="motor", unit="N m")
    task: Any = SimpleNamespace(dataset=dataset, first=first, rng=None, bandwidth=25.0)
    task.report = lambda *_: None
    here, found, flexible = diagnosing._search_sides(task, MOTION, False)
    side = "valve" if moves else "motor"
    assert (here, found.side, flexible) == (side, side, moves)
    assert sides == [("motor", True), (side, False)]


HALF_RAD, CLOSES_N_M = 0.003, 3.0
ROTOR_KG_M2 = 0.1
TERM = {t.name: t for t in MOTION}


@lru_cache
def recordings(name: str) -> tuple[Recording, ...]:
    effects = {
        "backlash": {"gap_rad": 2.0 * HALF_RAD},
        "coupling_hysteresis": {"deflection_rad": HALF_RAD, "torque_Nm": CLOSES_N_M},
    }
    return campaign({name: effects[name]}, 11, 8.0)


@lru_cache
def nominal(name: str) -> Nominal:
    return nominal_fit(recordings(name)).nominal


def valve_side(name: str) -> tuple[View, ...]:
    return views([r for r in recordings(name) if r.role == "fit"], 25.0, True)


def test_a_gap_is_crossed_without_torque() -> None:
    seen = crossing_torque(valve_side("backlash"), nominal("backlash"), 2.0 * HALF_RAD, ROTOR_KG_M2)
    assert seen.share < 0.5 * RULES.loop_share


def test_a_loop_closes_with_its_torque() -> None:
    seen = crossing_torque(
        valve_side("coupling_hysteresis"),
        nominal("coupling_hysteresis"),
        2.0 * HALF_RAD,
        ROTOR_KG_M2,
    )
    assert seen.torque == pytest.approx(CLOSES_N_M, rel=0.03)


@pytest.mark.parametrize(
    "name", [pytest.param("backlash", marks=pytest.mark.proof), "coupling_hysteresis"]
)
def test_each_is_named_and_the_other_rejected(name: str) -> None:
    found = diagnose(Dataset(recordings(name), Model()))
    assert found.verdict is Verdict.NAMED
    assert [e.name for e in found.effects] == [name]
    assert [
        r.why_not != ""
        for r in found.effects[0].rivals
        if r.name in ("backlash", "coupling_hysteresis")
    ] == [True]
    if name == "coupling_hysteresis":
        closing = found.effects[0].parameters["torque_Nm"]
        assert closing.low < CLOSES_N_M < closing.high < 1.3 * CLOSES_N_M


@pytest.mark.parametrize(("name", "told"), [("backlash", True), ("coupling_hysteresis", False)])
def test_what_is_crossed_too_fast_to_see_is_a_gap_where_its_loop_closes_without_torque(name, told):
    """A loop that the angles give some torque stays open to both."""
    gap = 1e-4
    here = valve_side(name)
    assert crossing_torque(here, nominal(name), gap, ROTOR_KG_M2) is None
    start = nominal_fit(recordings(name))
    baseline = fit(here, "N m", start.nominal)
    own = Added(TERM["backlash"], (gap, 0.0, 0.0, ROTOR_KG_M2), (1.0,))
    named = Joint(baseline.nominal, (own,), baseline.equations, baseline.residual, baseline.stack)
    _, rounds = gap_or_loop(baseline, named, [Round("backlash", ())], MOTION, [])
    (rival,) = rounds[0].rivals
    assert rival.name == "coupling_hysteresis"
    assert (rival.preference > RULES.rejected) == told
    assert told or rival.preference == 0.0
