"""The proof of investigations, with a stand-in for the investigation."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from identification.diagnosis.result import Verdict
from rig.cli.entry import BAD_INPUT, status
from rig.common.places import read_json
from rig.common.provenance import Provenance
from rig.config.bench import load_bench
from rig.investigate import proof
from rig.investigate.investigation import Experiment, State
from rig.investigate.proof import SimulatedInvestigation
from rig.results.document import text
from rig.results.prove.draw import OUTSIDE_SIZES, assignment, draw
from rig.results.prove.engine import Processes
from rig.results.prove.score import rate


def quiet(*_: Any) -> None:
    """Show nothing."""


@pytest.mark.parametrize("name", [*proof.ON_A_BENCH[:3], *list(OUTSIDE_SIZES)[:2]])
def test_a_drawn_machine_is_simulated_and_nothing_of_it_is_in_the_bench(name, tmp_path):
    drawn = draw("one", [name], (1, 2)).machine
    bench = load_bench("practical")
    machine = proof.machine_on(bench.value, drawn)
    one = SimulatedInvestigation(bench, tmp_path, State({}, 0), machine)
    assert machine.effects.keys() == {name}
    assert machine.joint.Mc_N_m == drawn.joint.Mc_N_m != bench.value.mock.joint.Mc_N_m
    assert machine.warming_K == drawn.warming_K
    assert one.bench.document.value.mock.effects == {}


def test_machines_are_sealed_investigated_and_scored_and_a_row_is_not_computed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[SimulatedInvestigation] = []

    def run(self: SimulatedInvestigation) -> Any:
        ran.append(self)
        self._first()
        assert all(map(self._moved, self.state.experiments))
        return SimpleNamespace(diagnosis=verdict), None

    verdict = SimpleNamespace(verdict=Verdict.NOTHING_MISSING, effects=())
    monkeypatch.setattr(SimulatedInvestigation, "run", run)
    monkeypatch.setattr(proof, "judge_recordings", lambda *_: SimpleNamespace(diagnosis=verdict))
    monkeypatch.setattr(SimulatedInvestigation, "strength", lambda _: 5.0)
    begun = proof.begin(tmp_path, 2, 4)
    rows = proof.work(begun, Processes(1), quiet)
    assert [(r["kind"], r["state"], r["repeated"]) for r in rows] == [
        ("one", "missed", "missed")
    ] * 2
    assert [r["sha256"] for r in rows] == [s.digest for s in begun.rigs]
    assert [len(one.state.experiments) for one in ran] == [1, 1]
    ran.clear()
    assert proof.work(proof.begin(tmp_path, 2, 4), Processes(1), quiet) == rows
    assert ran == []
    found = proof.figures(rows)
    assert found["missed"] == found["missed_all"] == rate(2, 2)
    assert found["alarms"]["of"] == found["outside"]["of"] == 0
    assert read_json(tmp_path / "rows" / "rig-0001.json") == rows[0]
    provenance = Provenance.of(4, (), 0.0, tmp_path / "proof.json")
    shown = text(proof.proof_document(proof.proof_record(rows, provenance), provenance))
    assert all("+".join(r["effects"]) in shown for r in rows)
    drawn = [kind for kind, _ in assignment(34, 4, proof.SHARES, proof.ON_A_BENCH)]
    assert {kind: drawn.count(kind) for kind in drawn} == {"one": 27, "nothing": 4, "outside": 3}


@pytest.mark.parametrize(
    ("kind", "verdict", "named", "state"),
    [
        ("one", "named", ["backlash"], "right"),
        ("one", "named", ["cogging"], "wrong"),
        ("one", "named", ["backlash", "cogging"], "wrong"),
        ("one", "ambiguous", ["backlash"], "open"),
        ("one", "outside_catalogue", [], "open"),
        ("one", "nothing_missing", [], "missed"),
        ("nothing", "nothing_missing", [], "right"),
        ("nothing", "ambiguous", ["backlash"], "open"),
        ("outside", "outside_catalogue", [], "right"),
        ("outside", "named", ["backlash"], "wrong"),
    ],
)
def test_the_states(kind: str, verdict: str, named: list[str], state: str) -> None:
    assert proof.state_of(kind, ["backlash"], verdict, named) == state


def test_the_name_costs_what_was_spent_until_the_verdict_did_not_change_any_more() -> None:
    said = ("ambiguous", "named", "ambiguous", "named", "named")
    state = State({}, 0)
    state.experiments = [Experiment("", "", "", 60.0, 0, "done", "cover", verdict=v) for v in said]
    truth = {"rig": 1, "kind": "one", "effects": {"backlash": {}}}
    row = proof.row_of(truth, 9.0, state, ("named", ["backlash"]), ("named", ["cogging"]), "")
    assert row["to_name"] == [4, 4.0]
    for experiment, likeliest in zip(state.experiments, "babba", strict=True):
        experiment.odds = {"a": 0.4, "b": 0.3} | {likeliest: 0.6}
    row = proof.row_of(truth, 9.0, state, ("named", ["backlash"]), ("named", ["cogging"]), "")
    assert row["to_name"] == [5, 5.0], "named before, but not this effect"
    assert row["repeated"] == "wrong"


def test_what_contradicts_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        status(
            ["prove", "--investigate", "--seal", str(tmp_path / "s"), "--out", str(tmp_path / "o")]
        )
        == BAD_INPUT
    )
    assert "--investigate" in capsys.readouterr().err
