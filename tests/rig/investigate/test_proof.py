"""The proof of investigations, with a stand-in for the investigation."""

from __future__ import annotations

import json
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
from rig.results.document import text
from rig.results.prove.draw import OUTSIDE_SIZES, assignment, draw
from rig.results.prove.engine import Processes


def quiet(*_: Any) -> None:
    """Show nothing."""


@pytest.mark.parametrize("name", [*proof.ON_A_BENCH[:3], *list(OUTSIDE_SIZES)[:2]])
def test_a_drawn_machine_is_a_bench_whose_file_hides_its_effects_in_the_simulation(
    name: str, tmp_path: Path
) -> None:
    machine = draw("one", [name], (1, 2)).machine
    file = tmp_path / "bench.yaml"
    file.write_text(proof.bench_text(machine))
    mock = load_bench(file).value.mock
    assert mock is not None
    assert mock.effects.keys() == {name}
    assert mock.joint.Mc_N_m == machine.joint.Mc_N_m


def test_machines_are_sealed_investigated_and_scored_and_a_row_is_not_computed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[list[str]] = []

    def command(words: list[str]) -> int:
        asked.append(words)
        if words[0] == "investigate":
            folder = Path(words[words.index("--out") + 1])
            folder.mkdir()
            each = {"seconds": 60.0, "purpose": "separate", "verdict": "ambiguous"}
            last = {**each, "verdict": "nothing_missing"}
            found = {
                "verdict": "nothing_missing",
                "effects": [],
                "experiments": [each, last, {**last, "purpose": "confirm"}],
                "bench_seconds": 180.0,
                "confirmation": {"band_held": 0.9},
            }
            (folder / "investigate.json").write_text(json.dumps(found))
        return 0

    verdict = SimpleNamespace(verdict=Verdict.NOTHING_MISSING, effects=())
    monkeypatch.setattr(proof, "judge_recordings", lambda *_: SimpleNamespace(diagnosis=verdict))
    for name in ("campaign", "reference_of"):
        monkeypatch.setattr(proof, name, lambda *_: [])
    monkeypatch.setattr(proof, "strength", lambda *_: {"current": 5.0})
    begun = proof.begin(tmp_path, 2, 4)
    rows = proof.work(begun, command, Processes(1), quiet)
    assert [(r["kind"], r["state"], r["repeated"]) for r in rows] == [
        ("one", "missed", "missed")
    ] * 2
    assert [r["sha256"] for r in rows] == [s.digest for s in begun.rigs]
    asked.clear()
    assert proof.work(proof.begin(tmp_path, 2, 4), command, Processes(1), quiet) == rows
    assert asked == []
    found = proof.figures(rows)
    assert found["missed"] == found["missed_all"] == proof.wilson(2, 2)
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
    experiments = [{"purpose": "cover", "seconds": 60.0, "verdict": v} for v in said]
    found = {"verdict": "named", "effects": [{"name": "backlash"}], "experiments": experiments}
    truth = {"rig": 1, "kind": "one", "effects": {"backlash": {}}}
    more = {"bench_seconds": 300.0, "confirmation": None}
    repeated = {"verdict": "named", "named": ["cogging"]}
    row = proof.row_of(truth, 9.0, {**found, **more}, repeated, "")
    assert row["to_name"] == [4, 4.0]
    assert row["repeated"] == "wrong"


def test_wilson() -> None:
    found = proof.wilson(8, 10)
    assert found["low"] == pytest.approx(0.4902, abs=1e-4)
    assert found["high"] == pytest.approx(0.9433, abs=1e-4)
    assert proof.wilson(0, 10)["low"] == 0.0


def test_what_contradicts_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        status(
            ["prove", "--investigate", "--seal", str(tmp_path / "s"), "--out", str(tmp_path / "o")]
        )
        == BAD_INPUT
    )
    assert "--investigate" in capsys.readouterr().err
