"""Campaigns sealed by someone else: plain files in, all diagnosed before any truth is opened."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from identification.recording import RecordingError
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.results.prove import run as judging
from rig.results.prove import simulate as simulating
from rig.results.prove.engine import Processes
from rig.results.prove.judge import Judgement
from rig.results.prove.run import SUMS_FILE, sealed_rigs, write_sums
from rig.results.prove.score import score
from rig.results.prove.truth import load_truth, unseal

ENGINE = Processes(1)
CAMPAIGN = """campaign: 1
bench: {motion: rotary, torque_constant: 0.1}
recordings:
  - {file: a.csv.gz, channels: {time: t, angle: q, current: i}}
  - {file: [b.csv, c.csv], channels: {time: t, angle: q, current: i}}
"""
FIT = dict.fromkeys(("validate_baseline_rms", "validate_final_rms", "noise_floor_rms"))
TRUTHS = {
    "bench_a": "truth: 1\n",
    "bench_b": "truth: 1\neffects: {backlash: {gap_rad: 0.01}}\nparameters: {Mc: 7}\n"
    "axes: {rate_Hz: 250}\n",
    "bench_c": '{"truth": 1, "effects": {"my_own": {}}, "outside": ["my_own"]}',
    "bench_d": "truth: 1\neffects: {cogging: {torque_Nm: 1}}\naxes: {rate_Hz: 1000}\n",
}


def no_progress(what: str, share: float) -> None:
    pass


def found(verdict: str, *named: str, confidence: float = 0.95, **values: Any) -> dict[str, Any]:
    where = {"coordinate": "travel since reversal", "recordings": ["b"]}
    rest = {"alias_group": [], "confidence": confidence, "parameters": values, "where": where}
    rest["rivals"] = []
    return {
        "verdict": verdict,
        "effects": [{"name": name, **rest} for name in named],
        "fit": {"equation": "transmission", **FIT},
        "fits": [],
        "location": where,
        "parameter_shift": {"Mc": {"before": 8.4, "after": 7.0, "unit": "N m"}},
        "p_value": 0.1,
    }


SAID: Mapping[str, dict[str, Any]] = {
    "bench_a": found("named", "compliance", confidence=0.6),
    "bench_b": found("named", "backlash", gap_rad={"value": 0.0101, "low": 0.009, "high": 0.012}),
    "bench_c": found("outside_catalogue"),
}


def judge(source: Path, seed: int) -> Judgement:
    """Say what the table has, refuse one rig and break down on another."""
    name = source.parent.name
    if name == "bench_d":
        raise InputError("a.csv: it does not move")
    if name == "bench_e":
        raise ZeroDivisionError("as a defect might")
    return Judgement(SAID[name], 1.0)


def no_oracle(source: Path, names: Sequence[str]) -> None:
    return None


def diagnosed(theirs: Path, out: Path, rigs: int = 600) -> judging.Proof:
    proof = judging.begin_from(out, rigs, 1, theirs)
    judging.diagnose_all(proof, judge, ENGINE, no_progress)
    return proof


def rows_of(proof: judging.Proof) -> list[dict[str, Any]]:
    return judging.score_all(proof, no_oracle, lambda path: {}, ENGINE, no_progress)


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    home = tmp_path / "theirs"
    (home / "sealed").mkdir(parents=True)
    for name, truth in TRUTHS.items():
        (home / name).mkdir()
        (home / name / "campaign.yaml").write_text(CAMPAIGN)
        suffix = "json" if truth.startswith("{") else "yaml"
        (home / "sealed" / f"{name}.{suffix}").write_text(truth)
    return home


def test_every_rig_is_diagnosed_before_the_first_truth_is_opened(theirs, tmp_path, monkeypatch):
    told: list[str] = []

    def heard(source: Path, seed: int) -> Judgement:
        told.append(source.parent.name)
        return judge(source, seed)

    monkeypatch.setattr(
        judging, "unseal", lambda path, digest: told.append("opened") or unseal(path, digest)
    )
    proof = judging.begin_from(tmp_path / "out", 600, 1, theirs)
    with pytest.raises(InputError, match="not diagnosed yet"):
        rows_of(proof)
    assert told == []
    judging.diagnose_all(proof, heard, ENGINE, no_progress)
    rows = rows_of(proof)
    assert told == [*TRUTHS, *["opened"] * 4]
    result = score(rows)
    assert result["counts"] == {"one": 2, "two": 0, "nothing": 1, "outside": 1, "unscored": 0}
    assert result["alarms"] == ["bench_a"]
    assert (result["refused"]["n"], result["right"]["n"], result["right"]["of"]) == (1, 2, 4)
    assert [(n["rig"], n["name"]) for n in result["wrong_names"]] == [("bench_a", "compliance")]
    assert [(b["from"], b["right"]["n"], b["right"]["of"]) for b in result["reliability"]] == [
        (0.6, 0, 1),
        (0.9, 1, 1),
    ]
    assert [(p["value"], p["right"]["n"]) for p in result["by_axis"]["rate_Hz"]] == [
        ("250.0", 1),
        ("1000.0", 0),
    ]
    assert rows[1]["parameters"]["backlash.gap_rad"]["inside"] is True
    assert rows[1]["nominal"]["Mc"]["before"] == pytest.approx(0.2)

    told.clear()
    (tmp_path / "out" / "judgements" / "bench_c.json").unlink()
    again = judging.begin_from(tmp_path / "out", 600, 1, theirs)
    judging.diagnose_all(again, heard, ENGINE, no_progress)
    assert told == ["bench_c"]


def test_a_breakdown_on_one_rig_is_a_result_and_the_others_go_on(theirs, tmp_path):
    (theirs / "bench_d").rename(theirs / "bench_e")
    (theirs / "sealed" / "bench_d.yaml").rename(theirs / "sealed" / "bench_e.yaml")
    row = rows_of(diagnosed(theirs, tmp_path / "out"))[-1]
    assert row["refused"] == "broke down: ZeroDivisionError: as a defect might"
    assert (row["verdict"], row["alarm"], row["top1"]) == ("refused", False, False)


def test_what_is_not_scored_counts_neither_way(theirs: Path, tmp_path: Path) -> None:
    (theirs / "sealed" / "bench_a.yaml").write_text(
        "truth: 1\neffects: {compliance: {}}\nnot_scored: [compliance]\n"
    )
    (theirs / "sealed" / "bench_b.yaml").write_text(
        "truth: 1\neffects: {backlash: {gap_rad: 0.5}}\nparameters: {Mc: 7}\n"
        "not_scored: [backlash.gap_rad, Mc]\n"
    )
    rows = rows_of(diagnosed(theirs, tmp_path / "out", 2))
    assert (rows[0]["kind"], rows[0]["alarm"], rows[0]["named"]) == ("unscored", False, [])
    assert rows[0]["excused"] == ["compliance"]
    assert (rows[1]["top1"], rows[1]["parameters"], rows[1]["nominal"]) == (True, {}, {})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("truth: 1\neffects: {backlsh: {}}\n", "not an effect of the catalogue"),
        ("truth: 1\neffects: {backlash: {gap: 1}}\n", "no parameter of backlash"),
        ("truth: 1\neffects: {cogging: {}}\noutside: [cogging]\n", "is an effect of the catalogue"),
        ("truth: 1\noutside: [mine]\n", "not among effects"),
        ("truth: 1\nnot_scored: [J]\n", "unknown name; state a nominal parameter"),
        ("truth: 2\n", "truth"),
        ("effects: {}\n", "truth"),
    ],
)
def test_a_truth_with_a_mistake_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        load_truth(path)


def test_changed_files_are_found_out(theirs: Path, tmp_path: Path) -> None:
    write_sums(theirs)
    assert len((theirs / SUMS_FILE).read_text().splitlines()) == 2 * len(TRUTHS)
    judging.begin_from(tmp_path / "out", 600, 1, theirs)
    (theirs / "bench_b" / "campaign.yaml").write_text(CAMPAIGN + "\n")
    with pytest.raises(InputError, match=r"SHA256SUMS:\d+: bench_b/campaign\.yaml: SHA-256"):
        judging.begin_from(tmp_path / "out", 600, 1, theirs)
    write_sums(theirs)
    (theirs / "sealed" / "bench_a.yaml").write_text("truth: 1\neffects: {cogging: {}}\n")
    (theirs / SUMS_FILE).unlink()
    with pytest.raises(InputError, match="bench_a are missing or were changed"):
        judging.begin_from(tmp_path / "out", 600, 1, theirs)


def test_a_truth_without_a_campaign_and_a_rig_with_two_truths_are_refused(theirs: Path) -> None:
    assert len(sealed_rigs(theirs)) == len(TRUTHS)
    (theirs / "sealed" / "bench_a.json").write_text('{"truth": 1}')
    (theirs / "sealed" / "bench_x.yaml").write_text("truth: 1\n")
    with pytest.raises(InputError) as caught:
        sealed_rigs(theirs)
    refused = [Path(problem.partition(": ")[0]).name for problem in caught.value.problems]
    assert refused == ["bench_a.yaml", "bench_x.yaml"]


def test_all_rigs_are_judged_unless_a_number_is_given(theirs: Path, tmp_path: Path) -> None:
    assert len(judging.begin_from(tmp_path / "all", None, 1, theirs).rigs) == len(TRUTHS)
    assert len(judging.begin_from(tmp_path / "two", 2, 1, theirs).rigs) == 2
    # The number is kept for the next call.
    judging.begin_from(tmp_path / "all", len(TRUTHS), 1, theirs)
    with pytest.raises(InputError):
        judging.begin_from(tmp_path / "all", 2, 1, theirs)


def test_the_command_judges_more_rigs_than_it_draws(theirs, tmp_path, monkeypatch):
    monkeypatch.setattr("rig.cli.commands.prove._TRIALS", 2)
    monkeypatch.setattr("rig.results.prove.judge.judge", judge)
    monkeypatch.setattr("rig.results.prove.judge.oracle_of", no_oracle)
    out = tmp_path / "out"
    assert status(["prove", "--from", str(theirs), "--out", str(out)]) == 0
    assert len(list((out / "rows").iterdir())) == len(TRUTHS)


def test_a_rig_that_cannot_be_read_or_fitted_does_not_end_the_proof(theirs, tmp_path):
    (theirs / "bench_d" / "campaign.yaml").write_text("no campaign")
    for name in ("a", "b"):
        (theirs / "sealed" / f"bench_{name}.reference").mkdir()
        (theirs / "sealed" / f"bench_{name}.reference" / "campaign.yaml").write_text(CAMPAIGN)

    def broken(source: Path, names: Sequence[str]) -> None:
        raise ZeroDivisionError

    def unreadable(source: Path) -> dict[str, float]:
        raise InputError("a.csv: no such file")

    proof = diagnosed(theirs, tmp_path / "out")
    rows = judging.score_all(proof, broken, unreadable, ENGINE, no_progress)
    assert [row["verdict"] for row in rows][3] == "refused"
    assert [row["oracle"] for row in rows] == [None] * len(TRUTHS)
    assert [row["left"] for row in rows] == [None] * len(TRUTHS)


def test_a_reference_that_cannot_be_fitted_has_no_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    def choose(dataset: object, bandwidth: object) -> None:
        raise RecordingError("too short")

    monkeypatch.setattr(simulating, "load_source", lambda campaign: None)
    monkeypatch.setattr(simulating, "choose", choose)
    assert simulating.floors_of(Path("campaign.yaml")) == {}


def test_files_of_one_name_have_the_names_that_a_diagnosis_gives(tmp_path: Path) -> None:
    for folder in ("x", "y"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "log.csv").write_text("t,q,i\n")
    path = tmp_path / "campaign.yaml"
    path.write_text(CAMPAIGN.replace("a.csv.gz", "x/log.csv").replace("[b.csv, c.csv]", "y/*.csv"))
    assert judging._recordings(path) == ["x/log", "y/log"]


def test_the_command_line_refuses_what_contradicts(tmp_path, theirs, capsys):
    (tmp_path / "empty").mkdir()
    for options, message in (
        (["--rigs", "1", "--seal", str(tmp_path / "x"), "--json", str(tmp_path / "j")], "--json"),
        (["--from", str(theirs), "--out", str(theirs)], SUMS_FILE),
        (["--from", str(theirs), "--seal", str(tmp_path / "x")], "give only one of these options"),
        (["--from", str(tmp_path / "empty"), "--out", str(tmp_path / "o")], "docs/guides/worlds"),
    ):
        assert status(["prove", *options]) == 2
        assert message in capsys.readouterr().err


def test_own_trials_are_sealed_as_others_are(tmp_path, capsys, monkeypatch):
    """Short recordings, as only the files are looked at."""
    from rig.results.prove import run

    def short(gravity: bool) -> Any:
        return tuple(e._replace(command=e.command[:400]) for e in plan(gravity))

    plan = run.experiments
    monkeypatch.setattr(run, "experiments", short)
    monkeypatch.setattr(run, "assignment", lambda rigs, seed: [("one", ("cogging",))] * rigs)
    home = tmp_path / "sealed-here"
    assert status(["prove", "--seal", str(home), "--rigs", "1", "--seed", "4"]) == 0
    (sealed,) = sealed_rigs(home)
    assert f"{sealed.name} sealed, SHA-256 {sealed.digest}" in capsys.readouterr().out
    truth = load_truth(sealed.truth)
    assert (truth.kind, list(truth.effects)) == ("one", ["cogging"])
    assert truth.strength["current"] > 0.0
    assert "cogging" not in sealed.campaign.read_text()
    assert sealed.reference.is_file()
    assert json.loads(sealed.truth.read_text())["parameters"].keys() >= {"J", "Mc"}
