"""The loop with fast stand-ins for diagnosis and design: its order, its stop rule, its state on
disk, and what a kill at any moment leaves.
"""

import dataclasses
import json
import math
import shlex
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import click
import numpy as np
import pytest

from identification.design.separation import REJECTED, Hypothesis, Weighed
from identification.diagnosis.result import (
    Diagnosis,
    Fit,
    IdentifiedEffect,
    Location,
    Rival,
    Verdict,
)
from identification.recording import Dataset, Recording
from rig.cli.commands.investigate import _runner
from rig.cli.entry import BAD_INPUT, STOPPED, status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.investigate import investigation as loop
from rig.investigate.choice import Choice
from rig.investigate.confirmation import Confirmation, Prediction
from rig.investigate.experiments import as_document, family
from rig.investigate.investigation import (
    LEAST_HELD,
    MOST_COVERS,
    MOST_REFUTED,
    VAIN,
    Experiment,
    Investigation,
    State,
    load_state,
)
from rig.results.run.go_on import NOT_READ_BACK
from rig.runs.run_file import read_record

Z = np.zeros(3)


class Killed(BaseException):
    """The program dies."""


def weighed(
    preference: float, name: str = "cogging", outside: float = 0.01, only: str = ""
) -> Weighed:
    share = 1.0 if preference < 1.0 else 0.001
    view = SimpleNamespace(index=7, recording=SimpleNamespace(name=f"{only}/a"))
    effect = SimpleNamespace(term=SimpleNamespace(place=1), shape=(0.3, 7.0))
    joint = cast(
        Any,
        SimpleNamespace(residual=np.ones(3), effects=[effect] if only else [], views=[view]),
    )
    return Weighed(
        (
            Hypothesis((name,), joint, 0.0, 1.0),
            Hypothesis(("torque_ripple",), joint, preference, share),
            Hypothesis((), joint, math.inf, 1e-6),
        ),
        outside,
    )


@dataclass
class World:
    """A bench whose experiments each separate by a sigma more, and a program that may be killed."""

    folder: Path
    per_run: float = 1.6
    verdict: Verdict = Verdict.NAMED
    kill_at: int = -1
    trips: bool = False
    indistinct: bool = False
    selected: str = ""
    only: str = ""
    empty: tuple[str, ...] = ()
    held: tuple[float, ...] = ()
    unmoved: tuple[str, ...] = ()
    moments: int = 0
    outside: Callable[[int], float] = lambda _: 0.01
    ran: list[str] = field(default_factory=list)
    avoided: list[Any] = field(default_factory=list)
    said: list[str] = field(default_factory=list)

    def moment(self) -> None:
        self.moments += 1
        if self.moments == self.kill_at:
            raise Killed

    def judge(self, folders: list[Path], *_: Any) -> Any:
        """``folders``: what the stand-in of :func:`read_runs` returns."""
        self.moment()
        preference = self.per_run * (len(folders) - 1)
        fit = SimpleNamespace(bandwidth_Hz=25.0)
        effects = [SimpleNamespace(name=self.selected)] if self.selected else []
        diagnosis = SimpleNamespace(verdict=self.verdict, fit=fit, effects=effects)
        outcome = SimpleNamespace(diagnosis=diagnosis)
        return SimpleNamespace(
            outcome=outcome,
            diagnosis=diagnosis,
            weighed=weighed(preference, outside=self.outside(len(folders)), only=self.only),
            found=None,
        )

    def propose(self, *arguments: Any) -> Any:
        self.moment()
        *_, number, _progress, _left_s, avoided, cover, _given_up = arguments
        self.avoided.append(avoided)
        if self.indistinct and not cover:
            return Choice(None, {("cogging", "torque_ripple"): 0.2})
        parts = family(load_bench("practical").value, np.random.default_rng(0))[:1]
        proposal = SimpleNamespace(
            purpose="cover" if cover else "separate",
            reason="separates cogging from torque ripple by 7.0 sigma",
            seconds=100.0,
            weight_changes=1,
            apart={} if cover else {("cogging", "torque_ripple"): 7.0},
            sequence=as_document(f"experiment-{number}", parts),
            repeats="",
        )
        return Choice(cast(Any, proposal), {})

    def carry_out(self, sequence: Path, folder: Path) -> None:
        load_sequence(sequence)
        self.moment()
        folder.mkdir()
        self.write(folder, "running")
        self.ran.append(folder.name)
        self.moment()
        self.write(folder, "tripped" if self.trips and "separate" in folder.name else "done")
        self.moment()

    def write(self, folder: Path, state: str) -> None:
        (folder / "run.json").write_text(json.dumps(state))

    def predict(self, *_: Any) -> Prediction:
        self.moment()
        parts = family(load_bench("practical").value, np.random.default_rng(0))[:1]
        sequence = as_document("confirm", parts).value
        return Prediction(sequence, {"floor_rms": 0.1, "recordings": []}, 60.0, 0)

    def compare(self, *_: Any) -> Confirmation:
        share, self.held = (self.held[0], self.held[1:]) if self.held else (0.9, ())
        return Confirmation(share, 0.11, 0.1, 3, 4, {"a": (Z, Z, Z, Z)})

    def begin(self, state: State) -> Investigation:
        bench = load_bench("practical")
        return Investigation(
            bench, self.folder, state, self.carry_out, self.said.append, lambda *_: None
        )


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    made = World(tmp_path)

    def record(folder: Path) -> Any:
        found = json.loads((folder / "run.json").read_text())
        stage = SimpleNamespace(name="wide-slow-unloaded", state=found)
        segments = [] if folder.name in made.unmoved else [stage]
        return SimpleNamespace(state=found, stages=[stage], segments=segments)

    def read(folders: list[Path]) -> list[Path]:
        if not [f for f in folders if f.name not in made.empty]:
            raise InputError("no run to investigate")
        return folders

    monkeypatch.setattr(loop, "read_runs", read)
    monkeypatch.setattr(loop, "judge_recordings", made.judge)
    monkeypatch.setattr(loop, "propose", made.propose)
    monkeypatch.setattr(loop, "predict", made.predict)
    monkeypatch.setattr(loop, "read_record", record)
    monkeypatch.setattr(loop, "load_run", lambda _: None)
    monkeypatch.setattr(loop, "compare", made.compare)
    return made


def new(**more: Any) -> State:
    return State({"file": "bench.yaml", "sha256": "0"}, 0, first="figure10", **more)


def purposes(state: State) -> list[str]:
    return [e.purpose for e in state.experiments]


def test_it_separates_until_every_rival_is_rejected_then_confirms(world: World) -> None:
    state = new()
    _, confirmed = world.begin(state).run()
    assert purposes(state) == ["first", "separate", "separate", "cover", "confirm"]
    assert "rejected" in state.ended
    assert state.cannot_separate == []
    assert confirmed is not None
    assert state.confirmation["band_held"] == 0.9
    digest = state.confirmation["predicted_sha256"]
    assert any(digest in line for line in world.said)
    assert asdict(load_state(world.folder)) == json.loads(json.dumps(asdict(state)))


def test_the_odds_after_each_experiment_are_kept_and_the_sealed_one_is_in_no_fit(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, seen = new(), list[list[str]]()
    plain = world.judge
    monkeypatch.setattr(
        loop, "judge_recordings", lambda f, *m: (seen.append([p.name for p in f]), plain(f, *m))[1]
    )
    world.begin(state).run()
    assert all(e.odds for e in state.experiments if e.purpose != "confirm")
    assert not any("confirm" in name for names in seen for name in names)


def test_what_no_experiment_separates_is_ambiguous_and_says_what_would(world: World) -> None:
    world.indistinct, world.per_run = True, 0.0
    state = new()
    world.begin(state).run()
    assert [pair["names"] for pair in state.cannot_separate] == [["cogging", "torque_ripple"]]
    assert state.cannot_separate[0]["needs"]
    assert "0.2" in state.cannot_separate[0]["why"]
    assert "separate" not in purposes(state)


def test_a_selection_that_is_not_the_most_likely_one_is_told(world: World) -> None:
    world.per_run, world.selected = 9.0, "backlash"
    state = new()
    world.begin(state).run()
    assert all(name in state.ended for name in ("cogging", "backlash"))


def test_a_pair_is_given_up_after_two_experiments_in_vain(world: World) -> None:
    world.per_run = 0.0
    state = new()
    world.begin(state).run()
    assert purposes(state).count("separate") == VAIN
    assert str(VAIN) in state.cannot_separate[0]["why"]


def test_an_experiment_that_never_moved_is_not_in_vain(world: World) -> None:
    world.per_run, world.unmoved = 0.0, ("02-separate",)
    state = new()
    world.begin(state).run()
    unmoved, moved = (
        [e for e in state.experiments if (e.run in world.unmoved) is first]
        for first in (True, False)
    )
    assert [e.odds for e in unmoved] == [{}]
    assert [e.purpose for e in moved].count("separate") == VAIN


def test_a_failed_prediction_makes_no_pair_one_in_vain() -> None:
    e = [loop.Experiment("", "", "", 0.0, 0, "done", levels={"a": 0, "b": 1}) for _ in range(4)]
    for each in e[1:3]:
        each.expected = {loop.joined("a", "b"): 3.0}
    e[3].purpose = "refute"
    assert new(experiments=e[:3]).given_up("a", "b")
    assert not new(experiments=e).given_up("a", "b")


def test_a_budget_that_is_too_short_is_the_reason(world: World) -> None:
    patched = Choice(None, {}, late=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "propose", lambda *_: patched)
        state = new(budget_min=30.0)
        world.begin(state).run()
    assert "left of the budget" in state.ended
    assert {each["why"] for each in state.cannot_separate} == {state.ended}


@pytest.mark.parametrize(("only", "repeats"), [("01-first", ["01-first"]), ("a run", [])])
def test_an_effect_of_one_recording_alone_is_looked_for_in_a_repetition(
    world: World, only: str, repeats: list[str]
) -> None:
    world.only, world.per_run = only, 9.0
    state = new()
    world.begin(state).run()
    assert [e.repeats for e in state.experiments if e.purpose == "repeat"] == repeats
    first, *others = state.experiments
    for e in others:
        if e.purpose == "repeat":
            stages = [load_sequence(world.folder / x.sequence).value.stages for x in (e, first)]
            assert stages[0] == stages[1]
            assert e.seconds == first.seconds


@pytest.mark.parametrize(("failed", "kept"), [(1, 1), (MOST_REFUTED + 1, MOST_REFUTED)])
def test_a_prediction_that_fails_is_evidence_and_the_investigation_goes_on(
    world: World, failed: int, kept: int
) -> None:
    world.held = (LEAST_HELD - 0.1,) * failed
    state = new()
    world.begin(state).run()
    assert purposes(state).count("refute") == len(state.refuted) == kept
    assert purposes(state)[-1] == "confirm"
    assert state.confirmation["band_held"] == (0.9 if failed == kept else LEAST_HELD - 0.1)
    assert len({*world.folder.glob("prediction*.json")}) == kept + 1


@pytest.mark.parametrize(
    ("verdict", "moves", "covers"),
    [
        (Verdict.NAMED, False, 1),
        (Verdict.NOTHING_MISSING, False, VAIN),
        (Verdict.NAMED, True, MOST_COVERS),
    ],
)
def test_experiments_that_cover_go_on_while_they_show_something(
    world: World, verdict: Verdict, moves: bool, covers: int
) -> None:
    world.verdict, world.per_run = verdict, 9.0
    world.outside = (lambda runs: runs % 2) if moves else (lambda _: 0.01)
    state = new()
    world.begin(state).run()
    assert purposes(state).count("cover") == covers


def test_a_budget_ends_it(world: World) -> None:
    world.per_run = 0.1
    state = new(budget_min=8.0)
    world.begin(state).run()
    assert "budget" in state.ended
    assert state.bench_seconds < 60.0 * 8.0 + 200.0
    assert state.cannot_separate


def test_a_part_that_tripped_counts_and_is_avoided(world: World) -> None:
    world.trips = True
    state = new()
    world.begin(state).run()
    assert [e.state for e in state.experiments if e.purpose == "separate"] == ["tripped"] * 2
    assert "wide-slow-unloaded" in world.avoided[-1]


def test_killed_at_any_moment_nothing_is_lost_or_run_twice(world: World) -> None:
    world.begin(new()).run()
    moments, whole = world.moments, world.ran
    ends = []
    for k in range(1, moments + 1):
        folder = world.folder / f"killed-{k}"
        folder.mkdir()
        killed = World(folder, kill_at=k)
        loop_of = {name: getattr(killed, name) for name in ("propose", "predict")}
        loop_of["judge_recordings"] = killed.judge
        with pytest.MonkeyPatch.context() as patch:
            for name, stand_in in loop_of.items():
                patch.setattr(loop, name, stand_in)
            state = new()
            with pytest.raises(Killed):
                killed.begin(state).run()
            saved = load_state(folder) if (folder / loop.STATE_FILE).exists() else new()
            killed.kill_at = -1
            killed.begin(saved).run()
        assert len(killed.ran) == len(set(killed.ran)), k
        assert {e.run for e in saved.experiments} == set(killed.ran), k
        ends.append((saved.ended, purposes(saved)))
    assert {end for end, _ in ends} == {ends[0][0]}
    assert {p.count("confirm") for _, p in ends} == {1}
    assert all(len(p) == len(whole) for _, p in ends)


@pytest.mark.parametrize("empty", [False, True])
def test_a_first_run_that_tripped_is_used_and_repeated_only_if_it_recorded_nothing(
    world: World, empty: bool
) -> None:
    state = new()
    state.experiments = [Experiment("01-first", "01-first.yaml", "", 100.0, 0, purpose="first")]
    (world.folder / "01-first").mkdir()
    world.write(world.folder / "01-first", "tripped")
    world.empty = ("01-first",) if empty else ()
    world.begin(state).run()
    assert purposes(state).count("first") == 1 + empty
    assert state.experiments[0].state == "tripped"


@pytest.mark.parametrize("more", [{"budget_min": 9.0}, {"trips": True}])
def test_a_recording_is_not_repeated_beyond_the_budget_nor_after_a_trip(
    world: World, more: dict[str, Any]
) -> None:
    world.per_run, world.only = 9.0, "01-first"
    state = new(budget_min=more.get("budget_min"))
    state.experiments = [
        Experiment("01-first", "01-first.yaml", "", 400.0, 0, purpose="first", state="done")
    ]
    (world.folder / "01-first").mkdir()
    world.write(world.folder / "01-first", "done")
    if more.get("trips"):
        state.experiments[0].state = "tripped"
    world.begin(state).run()
    assert "repeat" not in purposes(state)


def test_a_pair_is_tried_again_after_a_prediction_that_failed(world: World) -> None:
    world.indistinct, world.per_run, world.held = True, 0.0, (LEAST_HELD - 0.1,)
    state, covers = new(), list[bool]()
    plain = world.propose

    def propose(*arguments: Any) -> Any:
        covers.append(arguments[-2])
        return plain(*arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "propose", propose)
        world.begin(state).run()
    assert covers.count(False) == 2, "once before the failure, once after it"


def test_runs_of_equal_folder_names_keep_their_recordings_apart(tmp_path: Path) -> None:
    names = [tmp_path / each / "01-first" for each in "ab"]
    recorded = SimpleNamespace(created="2026-11-30T00:00:00+00:00", simulated=True, realtime=False)
    one = Recording(np.arange(4.0), np.zeros(4), np.zeros(4), name="a")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "read_record", lambda _: recorded)
        patch.setattr(loop, "load_run", lambda *_, **__: Dataset((one,)))
        found = loop.read_runs(names)
    assert len({r.name for r in found.recordings}) == 2
    assert len({r.session for r in found.recordings}) == 2


def test_a_prediction_that_was_changed_is_refused(world: World) -> None:
    state = new()
    world.begin(state).run()
    path = world.folder / "prediction.json"
    path.write_text(path.read_text().replace("0.1", "0.2", 1))
    with pytest.raises(InputError, match="sealed"):
        world.begin(state).run()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--question", "coging"), "cogging"),
        (("figure10", "slow_ramp"), "slow_ramp"),
        (("nowhere",), "nowhere"),
        (("--resume",), loop.STATE_FILE),
        (("--resume", "--question", "cogging"), "--question"),
        (("--resume", "figure10"), "leave"),
        (("--confirm", "missing.json"), "missing.json"),
    ],
)
def test_bad_input(arguments, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert status(["investigate", *arguments, "--out", "o"]) == BAD_INPUT
    assert said in capsys.readouterr().err
    assert not (tmp_path / "o" / loop.STATE_FILE).exists()


@pytest.mark.parametrize("off", [None, True, False])
def test_ctrl_c_between_runs_tells_the_drive_and_the_command_that_goes_on(
    off: bool | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "the folder"

    def stopped(one: Investigation) -> None:
        if off is not None:
            one.state.experiments = [Experiment("01-first", "01-first.yaml", "", 0.0, 0)]
            (folder / "01-first").mkdir(exist_ok=True)
            (folder / "01-first" / "run.json").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(Investigation, "run", stopped)
    monkeypatch.setattr(loop, "read_record", lambda _: SimpleNamespace(de_energised=off))
    words = ["investigate", "--bench", "practical", "--yes", "--out", str(folder)]
    for _ in range(2):
        assert status(words) == STOPPED
        told = capsys.readouterr().err.splitlines()
        assert (NOT_READ_BACK in told[-2]) is (off is False)
        assert ("01-first" in told[-2]) is (off is not None)
        words = shlex.split(told[-1].partition("go on with: rig ")[2])
    assert "--resume" in words
    assert "--yes" in words


@pytest.mark.parametrize(
    ("preference", "verdict", "group"),
    [
        (0.5, Verdict.AMBIGUOUS, ("cogging", "torque_ripple")),
        (REJECTED, Verdict.NAMED, ("cogging",)),
    ],
)
def test_verdict_rivals_and_confidence_follow_from_one_level(
    preference: float, verdict: Verdict, group: tuple[str, ...]
) -> None:
    """Whatever the diagnosis alone said."""
    where = Location("motor angle", "rad", (), 0.9, ())
    own = Rival("torque_ripple", 0.4, "the error is larger by 9.9 standard errors")
    effect = IdentifiedEffect("cogging", ("cogging",), 0.7, "cogs", "", where, {}, (own,), "")
    fit = Fit("torque", "N m", 25.0, 2.0, 1.0, 1.0)
    diagnosis = Diagnosis(Verdict.AMBIGUOUS, "", (effect,), fit, (fit,), {}, {}, 0.001)
    hypotheses = weighed(preference)
    found = loop.concluded_from(diagnosis, hypotheses)
    assert found.verdict is verdict
    assert found.effects[0].alias_group == group
    assert found.effects[0].confidence == hypotheses.odds["cogging"]
    (rival,) = found.effects[0].rivals
    assert rival.confidence == hypotheses.odds["torque_ripple"]
    assert ("2.3" in rival.why_not) is (verdict is Verdict.NAMED)
    nothing = dataclasses.replace(diagnosis, verdict=Verdict.NOTHING_MISSING, effects=())
    assert loop.concluded_from(nothing, hypotheses) is nothing
    part = dataclasses.replace(diagnosis, verdict=Verdict.OUTSIDE_CATALOGUE)
    assert loop.concluded_from(part, hypotheses) is part


def test_an_experiment_is_run_by_the_command_of_a_run(tmp_path):
    sequence = tmp_path / "short.yaml"
    stage = (
        "{name: a, stage: unloaded, tones: [{amplitude_deg: 5, frequency_Hz: 1}], duration_s: 3}"
    )
    sequence.write_text(f"sequence: 1\nname: short\nstages: [{stage}]\n")
    silent = SimpleNamespace(close=lambda: None)
    with click.Context(click.Command("investigate")):
        _runner(load_bench("practical"), new(), True, None, silent)(sequence, tmp_path / "run")
    assert read_record(tmp_path / "run").state == "done"
