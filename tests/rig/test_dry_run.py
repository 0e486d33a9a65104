"""`rig run --dry-run`: what it predicts, from which values, and with which exit status it ends."""

import json
import os
import re
from pathlib import Path
from typing import Any

import pytest

from identification.model.parameters import NOMINAL
from rig.cli.entry import status
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.planning.plan import make_plan
from rig.planning.predicted_load import PredictedLoad, friction_model, of_another_bench
from rig.results.run.dry_run import PROMPT_S
from rig.runs.run import bench_constants
from rig.runs.run_file import read_record

from .benches import variant

SEQUENCE = """\
sequence: 1
name: one
stages:
  - {{name: empty, stage: unloaded, tones: [{{amplitude_deg: 5, frequency_Hz: 2}}],
     duration_s: 0.5, ramp_in_s: 0.1,
     ramp_out_s: 0.1, settle_s: 0.05}}
  - {{name: heavy, stage: loaded, weight_kg: 10, tones: [{{amplitude_deg: 5, frequency_Hz: 2}}],
     duration_s: 0.5,
     ramp_in_s: 0.1, ramp_out_s: 0.1, settle_s: 0.05}}
limits: {{torque_N_m: {torque}}}
"""


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("one.yaml").write_text(SEQUENCE.format(torque=75))


def dry(*arguments: str) -> tuple[int, dict[str, Any]]:
    code = status(["run", "one.yaml", "--dry-run", "--json", "dry.json", *arguments])
    return code, json.loads(Path("dry.json").read_text()) if code < 2 else {}


def result(path: Path, **changes: Any) -> Path:
    raw = {
        "schema": "loadrig.identify/1",
        "motion": "rotary",
        "alpha": 2.0,
        "parameters": {
            name: {"value": value, "low": value, "high": value}
            for name, value in {**NOMINAL, **changes}.items()
        },
    }
    path.write_text(json.dumps(raw))
    return path


def heavy(record: dict[str, Any]) -> float:
    return max(row["torque_N_m"] for row in record["predicted"] if row["stage"] == "heavy")


@pytest.mark.parametrize("measured", [True, False])
@pytest.mark.parametrize(
    ("share", "found"), [(1.26, ""), (1.24, "warning"), (1.01, "warning"), (0.99, "problem")]
)
def test_a_limit_is_a_problem_only_where_the_friction_was_measured(share, found, measured):
    arguments = ("--identification", str(result(Path("known.json")))) if measured else ()
    peak = heavy(dry(*arguments, "--no-first-pass")[1])
    Path("one.yaml").write_text(SEQUENCE.format(torque=round(peak * share, 6)))
    code, record = dry(*arguments, "--no-first-pass")
    kind = "warning" if found and not measured else found
    assert code == (1 if kind == "problem" else 0)
    assert record["good"] is (code == 0)
    for each in ("warning", "problem"):
        texts = record[f"{each}s"]
        assert len(texts) == (each == kind)
        assert all(re.search(rf"heavy: .*torque {peak:.4g} N m \(limit", t) for t in texts)
    if kind == "warning":
        assert ("the paper's friction" in record["warnings"][0]) is not measured


@pytest.mark.parametrize(
    ("removed", "problems", "warnings"),
    [([], 2, 0), (["mu_s"], 1, 1), (["Ms"], 0, 2), (["omega_sf"], 2, 0)],
)
def test_a_stage_whose_friction_is_the_paper_s_is_only_warned_of(removed, problems, warnings):
    path = Path("part.json")
    raw = json.loads(result(path).read_text())
    for name in removed:
        raw["parameters"][name]["value"] = None
    path.write_text(json.dumps(raw))
    Path("one.yaml").write_text(SEQUENCE.format(torque=5))
    model = friction_model(bench_constants(load_bench("practical").value), path)
    bench = load_bench("practical")
    plan = make_plan(load_sequence("one.yaml"), bench, False)
    computed = PredictedLoad.of(plan, bench.value, model)
    for found, stages in ((computed.problems, problems), (computed.warnings, warnings)):
        assert sum(text.count("torque ") for text in found) == stages
    assert len(computed.warnings) == bool(warnings)  # one remedy, one message


@pytest.mark.parametrize(("arguments", "prompts"), [((), 2), (("--yes",), 0)])
def test_the_duration_counts_the_prompts_that_somebody_has_to_answer(arguments, prompts):
    record = dry(*arguments)[1]
    assert record["prompts"] == prompts
    assert record["under_power_s"] == pytest.approx(2 * (0.5 + 0.05 + 0.1))
    assert record["duration_s"] == pytest.approx(
        record["under_power_s"] + record["moves_s"] + prompts * PROMPT_S, abs=1e-9
    )


@pytest.mark.parametrize("option", ["--identification", "--feedforward"])
def test_what_is_named_is_used(option: str) -> None:
    plain = heavy(dry()[1])
    path = result(Path("known.json"), mu_s=0.172)
    code, record = dry(option, str(path))
    assert code == 0
    assert record["identified"] is True
    assert heavy(record) > plain + 2.0


def test_an_identification_without_a_load_does_not_fit_the_weight_check(capsys):
    path = Path("open.json")
    raw = json.loads(result(path).read_text())
    raw["parameters"]["mu_c"]["value"] = None
    path.write_text(json.dumps(raw))
    assert dry("--identification", str(path))[0] == 2
    assert "parameters.mu_c: not identified; the weight check needs" in capsys.readouterr().err


def test_the_newest_identification_of_the_same_bench_is_found(tmp_path, capsys):
    bench = load_bench("practical")
    constants = bench_constants(bench.value)
    assert not friction_model(constants).measured
    assert status(["run", "one.yaml", "--yes", "--out", "runs/old"]) == 0
    other = variant(
        tmp_path,
        (
            "moment_arm_m: 0.095\n  lever_ratio: 10\n  gravity_m_s2: 9.80665\nbus",
            "moment_arm_m: 0.1\n  lever_ratio: 10\n  gravity_m_s2: 9.80665\nbus",
        ),
    )
    assert status(["run", "one.yaml", "--yes", "--bench", str(other), "--out", "runs/other"]) == 0
    assert not friction_model(constants).measured
    result(Path("runs/old/identify.json"), J=0.3)
    result(Path("runs/other/identify.json"), J=0.4)
    Path("runs/none").mkdir()
    result(Path("runs/none/identify.json"), J=0.5)
    for age, name in enumerate(("none", "other", "old")):
        os.utime(f"runs/{name}/identify.json", (1e9 - age, 1e9 - age))
    model = friction_model(constants)
    assert (model.measured, model.values["J"]) == (True, 0.3)
    assert "runs/old/identify.json" in model.source
    assert friction_model(bench_constants(load_bench(other).value)).values["J"] == 0.4
    assert friction_model(constants, result(Path("named.json"), J=0.6)).values["J"] == 0.6
    assert of_another_bench(Path("runs/old/identify.json"), constants) is None
    assert of_another_bench(Path("named.json"), constants) is None
    capsys.readouterr()
    assert dry("--identification", "runs/other/identify.json")[0] == 0
    assert "other constants (moment_arm 0.1, here 0.095)" in capsys.readouterr().err
    assert dry("--feedforward", "runs/old/identify.json")[0] == 0
    assert "other constants" not in capsys.readouterr().err


@pytest.mark.parametrize(("share", "code"), [(1.3, 0), (0.99, 2)])
def test_a_run_is_refused_whose_measured_friction_exceeds_a_limit(share, code, capsys):
    known = ("--identification", str(result(Path("known.json"))), "--no-first-pass")
    peak = heavy(dry(*known)[1])
    Path("one.yaml").write_text(SEQUENCE.format(torque=round(peak * share, 6)))
    capsys.readouterr()
    assert status(["run", "one.yaml", "--yes", "--out", "out", *known]) == code
    assert Path("out").exists() is (code == 0)
    if code:
        (line,) = capsys.readouterr().err.splitlines()
        assert re.match(r"one\.yaml:7:\d+: stages\[1\]\.name: heavy: .*: torque ", line)
        assert "; predicted from the identification known.json (got" in line


FIRST = """\
sequence: 1
name: first
first_pass: {amplitude: 0.1, limit_share: SHARE}
stages:
  - {name: heavy, stage: loaded, weight_kg: 33, tones: [{amplitude_deg: 20, frequency_Hz: 0.5}],
     duration_s: 2, settle_s: 0.05}
"""


@pytest.mark.parametrize(("share", "code"), [(0.5, 1), (0.9, 0)])
def test_a_first_pass_above_its_limit_is_warned_of_and_its_trip_names_the_prediction(
    share: float, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("one.yaml").write_text(FIRST.replace("SHARE", str(share)))
    assert (
        status(["run", "one.yaml", "--bench", "practical_serial", "--yes", "--out", "out"]) == code
    )
    told = capsys.readouterr().err
    record = read_record(Path("out"))
    warning = "current 12.88 A (limit 11.25 A)"
    assert (warning in told) is bool(code)
    assert any(warning in text for text in record.warnings) is bool(code)
    if code:
        assert (record.trip["check"], record.trip["limit"]) == ("motor current", 11.25)
        assert record.trip["predicted"] == pytest.approx(12.88, abs=0.01)
        before, _, after = told.partition("\ntripped: ")
        assert warning in before
        assert "first: the plan predicts a peak of 12.88 A, which is above this limit" in after
        assert "jamming" not in told
