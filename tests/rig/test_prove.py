"""The proof's machinery, with made-up diagnoses: sealed before, opened after, scored."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from rig.cli.entry import status
from rig.common.errors import InputError
from rig.results.prove import run as proving
from rig.results.prove.draw import assignment
from rig.results.prove.engine import Processes
from rig.results.prove.judge import Judgement
from rig.results.prove.score import confusion, rate, row_of, score
from rig.results.prove.truth import seal_truth, unseal

SEED, ENGINE = 3, Processes(1)
CAMPAIGN = """campaign: 1
bench: {motion: rotary, torque_constant: 0.1}
recordings: [{file: a.csv, channels: {time: t, angle: q, current: i}}]
"""


def no_progress(what: str, share: float) -> None:
    pass


PLACE = {"coordinate": "travel since reversal", "recordings": ["a", "d"]}


def effect(
    name: str,
    confidence: float = 0.95,
    group: tuple[str, ...] = (),
    rivals: Mapping[str, float] = {},
    **parameters: Any,
) -> dict[str, Any]:
    rest = {"confidence": confidence, "parameters": parameters, "where": PLACE}
    rest["rivals"] = [{"name": n, "confidence": c, "why_not": ""} for n, c in rivals.items()]
    return {"name": name, "alias_group": list(group), **rest}


def diagnosed(
    *effects: dict[str, Any], verdict: str = "named", after: float = 0.2
) -> dict[str, Any]:
    validated = {"validate_baseline_rms": 1.0, "validate_final_rms": after}
    fit = {"equation": "transmission", **validated, "noise_floor_rms": 0.1}
    torque = {**fit, "equation": "torque", **dict.fromkeys(validated)}
    return {
        "verdict": verdict,
        "effects": list(effects),
        "fit": fit,
        "fits": [fit, torque],
        "location": PLACE,
        "parameter_shift": {"Mc": {"before": 7.7, "after": 7.0, "unit": "N m"}},
        "p_value": 0.001,
    }


def truth(kind: str, **effects: dict[str, float]) -> dict[str, Any]:
    return {"rig": 1, "kind": kind, "effects": effects, "parameters": {"Mc": 7.0}}


RECORDINGS = tuple("abcdefghijkm")


def judged(diagnosis: Mapping[str, Any]) -> Judgement:
    return Judgement(diagnosis, 1.0)


def scored(
    kind: str, diagnosis: Mapping[str, Any], strength: float = 5.0, **effects: dict[str, float]
) -> dict[str, Any]:
    return row_of(
        truth(kind, **effects),
        {"current": strength, "angle": 0.1},
        judged(diagnosis),
        None,
        "digest",
        recordings=RECORDINGS,
    )


def test_rates_count_what_the_constants_cannot_absorb_beside_what_is_strong() -> None:
    def row(left: float, diagnosis: Mapping[str, Any]) -> dict[str, Any]:
        told = judged(diagnosis)._replace(
            left={"torque": 0.1 * (1.0 + left**2) ** 0.5, "voltage": 0.01}
        )
        floor = {"torque": 0.1, "voltage": 0.01}
        return row_of(truth("one", backlash=GAP), {"current": 9.0}, told, None, "digest", floor)

    rows = [row(0.5, NOTHING), row(40.0, diagnosed(effect("backlash")))]
    assert [r["left"] for r in rows] == pytest.approx([0.5, 40.0])
    assert rows[1]["left_by_equation"]["voltage"] == 0.0
    found = score(rows)
    assert (found["top1"]["n"], found["top1"]["of"]) == (1, 2)
    assert (found["top1_left"]["n"], found["top1_left"]["of"]) == (1, 1)
    assert found["absorbed"] == [1]
    assert scored("one", NOTHING, backlash=GAP)["left"] is None, "unknown without a reference"


GAP = {"gap_rad": 0.01}
NOTHING = diagnosed(verdict="nothing_missing")


def test_a_name_counts_only_where_it_stands_first() -> None:
    right = scored("one", diagnosed(effect("backlash"), effect("compliance", 0.3)), backlash=GAP)
    second = scored("one", diagnosed(effect("compliance"), effect("backlash")), backlash=GAP)
    aliased = scored(
        "one", diagnosed(effect("compliance", group=("compliance", "backlash"))), backlash=GAP
    )
    missed = scored("one", NOTHING, backlash=GAP)
    assert [(r["top1"], r["alias"], r["alarm"]) for r in (right, second, aliased, missed)] == [
        (True, True, True),
        (False, False, True),
        (False, True, True),
        (False, False, False),
    ]
    assert right["strength"] == 5.0


def test_a_confident_name_outside_the_catalogue_is_kept_account_of() -> None:
    rows = [
        scored("outside", diagnosed(verdict="outside_catalogue"), x_bursts={"torque_Nm": 1.0}),
        scored("outside", diagnosed(effect("cogging", 0.91)), x_bursts={"torque_Nm": 1.0}),
        scored("outside", diagnosed(effect("cogging", 0.6)), x_bursts={"torque_Nm": 1.0}),
    ]
    assert score(rows)["outside"] == {**rate(1, 3), "named_confidently": 1}
    assert rows[0]["top1"] is None


def gain(source: Path, names: Sequence[str]) -> dict[str, Any]:
    """Return what the true structures gain on recordings that were set aside."""
    rms = {"baseline_rms": 1.0, "oracle_rms": 0.2, "noise_rms": 0.1}
    return {"equation": "transmission", **rms}


def test_the_place_is_held_against_the_catalogue() -> None:
    def parts(*recordings: str) -> dict[str, Any]:
        return {**lost, "location": {**PLACE, "recordings": list(recordings)}}

    lost = diagnosed(verdict="outside_catalogue")
    slip = {"angle_rad": 0.01, "at_s": 5.0}
    cases = {
        "exact": (diagnosed(effect("compliance")), "backlash", GAP),
        "like": (lost, "friction_memory", {"time_s": 0.01}),
        "elsewhere": (diagnosed(effect("cogging")), "cogging", {"torque_Nm": 1.0}),
        "its recording": (lost, "encoder_slip", {**slip, "recording": 4.0}),
        "another one": (lost, "encoder_slip", {**slip, "recording": 2.0}),
        "its parts": (parts("d[1]", "d[2]", "a"), "encoder_slip", {**slip, "recording": 4.0}),
        "parts of three": (
            parts("d[1]", "a[1]", "b"),
            "encoder_slip",
            {**slip, "recording": 4.0},
        ),
    }
    places = {
        case: scored("one", said, **{name: true})["location"]
        for case, (said, name, true) in cases.items()
    }
    assert {case: (p["equation"], p["coordinate"], p["place"]) for case, p in places.items()} == {
        "exact": (True, True, True),
        "like": (False, False, True),
        "elsewhere": (False, False, False),
        "its recording": (True, False, True),
        "another one": (True, False, False),
        "its parts": (True, False, True),
        "parts of three": (True, False, False),
    }
    missed = scored("one", NOTHING, backlash=GAP)
    assert missed["location"]["found"] is None
    skewed = diagnosed(effect("time_skew"))
    in_torque = {**skewed, "fit": {**skewed["fit"], "equation": "torque"}}
    with_voltage = {**in_torque, "fits": [*in_torque["fits"], {"equation": "voltage"}]}
    for said, right in ((in_torque, True), (with_voltage, False)):
        assert scored("one", said, time_skew={"time_s": 0.01})["location"]["equation"] is right
    assert score([missed])["location"]["place"]["of"] == 0


@pytest.mark.parametrize(("true", "inside"), [(3.1, True), (-3.18, True), (0.1, False)])
def test_an_angle_is_compared_in_the_turn_of_its_estimate(true: float, inside: bool) -> None:
    estimate = {"value": -3.12, "low": -3.22, "high": -3.02}
    found = effect("cogging", phase_rad=estimate, torque_Nm=estimate)
    row = scored("one", diagnosed(found), cogging={"phase_rad": true, "torque_Nm": true})
    assert row["parameters"]["cogging.phase_rad"]["inside"] is inside
    assert row["parameters"]["cogging.torque_Nm"]["inside"] is (true == -3.18)


def test_the_probability_given_to_the_truth_is_that_of_a_name_or_of_a_rival() -> None:
    split = diagnosed(effect("compliance", 0.6, rivals={"backlash": 0.4, "cogging": 0.1}))
    sure, two = diagnosed(effect("backlash", 0.9)), {"cogging": {}, "backlash": GAP}
    rows = [
        scored("one", split, backlash=GAP),
        scored("one", sure, backlash=GAP),
        scored("one", NOTHING, backlash=GAP),
        scored("one", sure, 0.5, backlash=GAP),
        scored("two", split, **two),
        scored("nothing", split),
    ]
    assert [row["probability"] for row in rows] == pytest.approx([0.4, 0.9, 0.0, 0.9, 0.25, None])
    found = score(rows)["probability"]
    assert (found["share"], found["of"]) == (pytest.approx(1.3 / 3), 3), "strong single effects"
    assert found["low"] < rate(2, 3)["low"]
    assert found["high"] < rate(2, 3)["high"]


def test_f1_of_the_location_counts_wrong_places_misses_and_false_alarms() -> None:
    there, elsewhere = diagnosed(effect("backlash")), diagnosed(effect("cogging"))
    one = [
        scored("one", there, backlash=GAP),
        scored("one", there, backlash=GAP),
        scored("one", elsewhere, cogging={"torque_Nm": 1.0}),
        scored("one", NOTHING, backlash=GAP),
    ]
    nothing = [scored("nothing", elsewhere), scored("nothing", NOTHING)]
    found = score([*one, *nothing])["location_f1"]
    assert (found["precision"], found["recall"]) == (rate(2, 4), rate(2, 4))
    assert found["f1"] == pytest.approx(0.5)
    assert found["low"] == pytest.approx(rate(2, 4)["low"])
    assert score(one)["location_f1"]["f1"] == pytest.approx(2 * (2 / 3) * 0.5 / (2 / 3 + 0.5))
    assert score([one[3]])["location_f1"]["f1"] == 0.0


def test_clopper_pearson() -> None:
    """Values of the closed forms at the ends, and of a table in between."""
    assert rate(0, 200)["high"] == pytest.approx(1.0 - 0.025 ** (1 / 200))
    assert rate(200, 200)["low"] == pytest.approx(0.025 ** (1 / 200))
    assert rate(3, 200)["low"] == pytest.approx(0.0031, abs=1e-4)
    assert rate(3, 200)["high"] == pytest.approx(0.0432, abs=1e-4)
    assert rate(0, 0)["share"] is None


def test_the_confusion_splits_the_rigs() -> None:
    rows = [
        scored("one", NOTHING, 0.5, backlash=GAP),
        scored("one", diagnosed(effect("compliance")), 2.0, backlash=GAP),
        scored("one", diagnosed(effect("backlash")), 50.0, backlash=GAP),
    ]
    assert confusion(rows) == {"backlash": {"backlash": 1, "compliance": 1, "nothing_missing": 1}}
    assert score(rows)["top1"] == rate(1, 1)
    assert score(rows)["top1_all"] == rate(1, 3)


def clairvoyant(source: Path, seed: int) -> Judgement:
    """Name what is hidden, as no diagnosis could: the draws repeat with their seed."""
    assert source.is_file()
    assert seed != SEED  # or the draws could be repeated
    kind, names = assignment(3, SEED)[int(source.parent.name.removeprefix("rig-")) - 1]
    verdict = {"nothing": "nothing_missing", "outside": "outside_catalogue"}.get(kind, "named")
    said = diagnosed(*(effect(name) for name in names if kind in ("one", "two")), verdict=verdict)
    return judged(said)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have rigs of which nothing but a campaign file is simulated."""

    def seal(task: proving.Task, seed: int) -> proving.Made:
        effects = {name: {} for name in task.assigned[1]}
        with proving.making(task.number) as where:
            where.campaign.parent.mkdir(parents=True)
            where.campaign.write_text(CAMPAIGN)
            strength = {"current": 4.0} if effects else {}
            truth = {"effects": effects, "strength": strength}
            return proving.made(seal_truth(where, where.name, truth, task.salt))

    monkeypatch.setattr(proving, "_seal", seal)
    monkeypatch.setattr("rig.results.prove.judge.oracle_of", gain)


@pytest.mark.usefixtures("quick")
def test_a_proof_from_the_command_line(tmp_path, monkeypatch, capsys):
    opened: list[str] = []
    diagnosing: list[str] = []

    def judge(source: Path, seed: int) -> Judgement:
        diagnosing.append(capsys.readouterr().out)
        assert not opened
        return clairvoyant(source, seed)

    monkeypatch.setattr(
        proving, "unseal", lambda path, digest: opened.append(path.name) or unseal(path, digest)
    )
    monkeypatch.setattr("rig.results.prove.judge.judge", judge)
    out = tmp_path / "proof"
    result_file = tmp_path / "p.json"
    arguments = ["prove", "--rigs", "3", "--seed", str(SEED), "--out", str(out)]
    arguments += ["--json", str(result_file)]
    assert status(arguments) == 0
    seals = json.loads((out / "proof.json").read_text())["seals"]
    assert all(digest in diagnosing[0] for digest in seals.values()), "before any diagnosis"
    result = json.loads(result_file.read_text())
    assert result["schema"] == "loadrig.prove/4"
    assert sum(result["counts"].values()) == 3
    assert result["top1"]["n"] == result["top1"]["of"] > 0
    assert result["oracle_fraction"] == {"median": 1.0, "of": result["counts"]["one"]}
    assert {row["sha256"] for row in result["rigs"]} == set(seals.values())
    assert "named first" in (out / "report.html").read_text()

    (out / "judgements" / "rig-0002.json").unlink()
    capsys.readouterr()
    diagnosing.clear()
    opened.clear()
    assert status(arguments) == 0
    assert len(diagnosing) == 1  # the others were kept
    again = json.loads(result_file.read_text())
    assert [r["effects"] for r in again["rigs"]] == [r["effects"] for r in result["rigs"]]
    assert status([*arguments[:2], "4", *arguments[3:]]) == 2
    assert "with other settings" in capsys.readouterr().err


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    "content", ["", "[]", '{"settings": {}}', '{"settings": {}, "seals": {"x": 1}}', "\0"]
)
def test_a_damaged_proof_is_not_gone_on_with(tmp_path, capsys, content):
    (tmp_path / "proof.json").write_text(content)
    assert status(["prove", "--rigs", "1", "--out", str(tmp_path)]) == 2
    assert str(tmp_path / "proof.json") in capsys.readouterr().err


@pytest.mark.usefixtures("quick")
def test_trials_of_other_settings_are_not_mixed(tmp_path: Path) -> None:
    home = tmp_path / "trials"
    first = proving.seal_own(home, 2, SEED, ENGINE, no_progress)
    assert proving.seal_own(home, 2, SEED, ENGINE, no_progress) == first
    for rigs, seed in ((3, SEED), (2, SEED + 1)):
        with pytest.raises(InputError):
            proving.seal_own(home, rigs, seed, ENGINE, no_progress)
    # A digest of the settings in the list that is sent away would show the seed.
    assert json.loads((home / proving.SETTINGS_FILE).read_text()) == {"rigs": 2, "seed": SEED}
    assert Path(proving.SETTINGS_FILE).name not in (home / proving.SUMS_FILE).read_text()
    (home / proving.SETTINGS_FILE).unlink()
    with pytest.raises(InputError):
        proving.seal_own(home, 2, SEED, ENGINE, no_progress)


@pytest.mark.usefixtures("quick")
def test_a_truth_changed_between_seal_and_score_stops_the_proof(tmp_path: Path) -> None:
    proving.seal_own(tmp_path / "trials", 3, SEED, ENGINE, no_progress)
    proof = proving.begin_from(tmp_path, 3, SEED, tmp_path / "trials")
    proving.diagnose_all(proof, clairvoyant, ENGINE, no_progress)
    path = proof.rigs[0].truth
    path.write_text(path.read_text().replace('"rig": "rig-0001"', '"rig": 9'))
    with pytest.raises(InputError, match="the truth was changed"):
        proving.score_all(proof, gain, lambda path: {}, ENGINE, no_progress)
    assert not proof.file("rows", proof.rigs[0]).exists()
