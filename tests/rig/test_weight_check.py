"""The weight check: friction against the confirmed mass."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.control.operator import AutomaticOperator
from rig.planning.reference import Reference, load_reference, moment_per_kg
from rig.runs.mcap.reader import read_run
from rig.runs.run import bench_constants, read_record
from rig.runs.run_record import Verdict
from rig.weighing.weight_check import (
    FrictionLevel,
    LoadedLevel,
    friction_level,
    judged,
    suspects,
    tolerance_kg,
    weigh,
)

BENCH = bench_constants(load_bench("practical").value)
TRUE = {
    "Mc": 6.825,
    "Ms": 12.025,
    "omega_sf": 0.0557,
    "sigma_2": 5.3462,
    "mu_c": 0.052,
    "mu_s": 0.086,
    "omega_sL": 0.0326,
    "mu_2": 0.032,
}
REFERENCE = Reference(TRUE, dict.fromkeys(TRUE, 1e-4), 2.0, moment_per_kg(BENCH), "known.json")
PERIOD_S = 0.001


def level(
    mass_kg: float, amplitude: float = 0.3, seconds: float = 5.0, extra: float = 0.0
) -> FrictionLevel:
    """Measure a sine under the true friction of a mass, inertia included, without noise."""
    t = np.arange(0.0, seconds, PERIOD_S)
    rate = 0.4 * np.pi
    angle, between = (
        amplitude * np.sin(rate * t),
        amplitude * rate * np.cos(rate * (t - 0.5 * PERIOD_S)),
    )
    speed = np.abs(between)
    friction = REFERENCE.unloaded(speed) + mass_kg * REFERENCE.per_kg(speed) + extra
    torque = np.sign(between) * friction - 0.204 * amplitude * rate**2 * np.sin(
        rate * (t - 0.5 * PERIOD_S)
    )
    found = friction_level(angle, torque, PERIOD_S)
    assert found is not None
    return found


def item(name: str, label_kg: float, hung_kg: float | None = None) -> LoadedLevel:
    return LoadedLevel(name, label_kg, level(label_kg if hung_kg is None else hung_kg))


def write_result(path: Path, **changes: object) -> Path:
    parameters = {
        name: {"value": value, "low": value - 1e-4, "high": value + 1e-4}
        for name, value in TRUE.items()
    }
    raw = {
        "schema": "loadrig.identify/1",
        "motion": "rotary",
        "alpha": 2.0,
        "parameters": parameters,
    }
    path.write_text(json.dumps({**raw, **changes}))
    return path


@pytest.mark.parametrize("amplitude", [0.035, 0.3])
def test_friction_is_measured_by_work(amplitude: float) -> None:
    found = level(30.0, amplitude)
    seen = found.path > 0.02 * found.path.sum()
    expected = REFERENCE.unloaded(found.speed[seen]) + 30.0 * REFERENCE.per_kg(found.speed[seen])
    np.testing.assert_allclose(found.torque[seen], expected, rtol=0.02)
    assert found.path.sum() == pytest.approx(4 * amplitude, rel=0.05)


@pytest.mark.parametrize("label", [0.0, 5.0, 30.6])
def test_the_right_weight_is_right(label: float) -> None:
    found = weigh(item("a", label), REFERENCE, ())
    assert found.verdict is Verdict.RIGHT
    assert found.measured_kg == pytest.approx(label, abs=0.01 * label + 0.01)


@pytest.mark.parametrize(
    ("share", "verdict"), [(0.07, Verdict.RIGHT), (0.08, Verdict.WRONG), (0.15, Verdict.WRONG)]
)
@pytest.mark.parametrize("side", [1, -1])
def test_both_sides_of_the_tolerance(share: float, verdict: Verdict, side: int) -> None:
    assert weigh(item("a", 20.0, 20.0 * (1 + side * share)), REFERENCE, ()).verdict is verdict


def test_a_forgotten_weight_on_the_empty_lever_is_found() -> None:
    assert tolerance_kg(0.0) == 1.0
    assert weigh(item("empty", 0.0, 0.9), REFERENCE, ()).verdict is Verdict.RIGHT
    found = weigh(item("empty", 0.0, 1.1), REFERENCE, ())
    assert found.verdict is Verdict.WRONG
    assert "rig resume" in found.message


@pytest.mark.parametrize("masses", [(0.0, 10.0), (0.0, 10.0, 20.0)])
def test_stages_of_two_masses_are_a_reference(masses: Sequence[float]) -> None:
    earlier = [item(f"s{mass:g}", mass) for mass in masses]
    assert weigh(item("new", 30.0), None, earlier).verdict is Verdict.RIGHT
    found = weigh(item("new", 30.0, 25.0), None, earlier)
    assert found.verdict is Verdict.WRONG
    assert found.measured_kg == pytest.approx(25.0, rel=0.02)


def test_speeds_that_a_light_stage_hardly_reached_do_not_decide_on_a_heavy_one() -> None:
    """The line through 0 and 5 kg is eight times as wrong at 40 kg as the level at 5 kg is."""
    light = level(5.0)
    last = int(np.flatnonzero(light.path)[-1])
    path, torque = light.path.copy(), light.torque.copy()
    path[last] *= 1e-3
    torque[last] -= 1.5
    off = LoadedLevel("light", 5.0, dataclasses.replace(light, path=path, torque=torque))
    assert suspects([item("empty", 0.0), off, item("heavy", 40.0)], None) == []
    assert {
        f.stage
        for f in suspects([item("empty", 0.0), off, item("heavy", 40.0, hung_kg=34.0)], None)
    } == {"light", "heavy"}


def test_friction_that_scatters_from_speed_to_speed_does_not_decide() -> None:
    stages = [item("empty", 0.0), item("a", 10.0), item("b", 20.0, 22.5)]
    assert {found.stage for found in suspects(stages, None)} == {"a", "b"}
    seen = np.flatnonzero(stages[2].level.path)
    torque = stages[2].level.torque.copy()
    torque[seen] += np.where(np.arange(len(seen)) % 2, 4.0, -4.0)
    loose = LoadedLevel("b", 20.0, dataclasses.replace(stages[2].level, torque=torque))
    assert suspects([*stages[:2], loose], None) == []
    found = weigh(loose, None, stages[:2])
    assert found.verdict is Verdict.UNCHECKED
    assert "uncertain by" in found.message


def test_a_stage_off_its_label_is_named() -> None:
    stages = [item("empty", 0.0), item("a", 10.0), item("b", 20.0, 26.0), item("c", 30.0)]
    (found,) = suspects(stages, None)
    assert found.stage == "b"
    assert found.measured_kg == pytest.approx(26.0, rel=0.02)
    assert "its friction is that of 26 kg, its label says 20 kg" in found.message


def test_nothing_is_named_where_all_agree_or_nothing_can_be_compared() -> None:
    assert suspects([item("empty", 0.0), item("a", 10.0), item("b", 20.0)], None) == []
    assert suspects([item("empty", 0.0), item("a", 10.0, 20.0)], None) == []


def test_all_weights_of_a_run_are_judged_only_by_three_masses() -> None:
    def verdicts(*items: LoadedLevel) -> dict[str, str]:
        with mock.patch("rig.weighing.weight_check._levels", return_value=list(items)):
            return {w.stage: w.verdict.value for w in judged(mock.Mock())}

    empty, a, b, c = item("empty", 0.0), item("a", 10.0), item("b", 20.0), item("c", 30.0)
    assert verdicts(empty, item("a", 10.0, 20.0), item("a2", 10.0, 20.0)) == {}
    assert verdicts(empty, a, b) == {"a": "right", "b": "right"}
    off = item("b", 20.0, 26.0)
    assert verdicts(empty, a, off, c) == {"a": "right", "b": "wrong", "c": "right"}
    torque = b.level.torque.copy()
    torque[np.flatnonzero(b.level.path)[::2]] += 8.0
    loose = LoadedLevel("b", 20.0, dataclasses.replace(b.level, torque=torque))
    assert verdicts(empty, a, loose)["b"] == "unchecked"


def test_a_result_file_is_read(tmp_path: Path) -> None:
    found = load_reference(write_result(tmp_path / "r.json"), BENCH)
    assert found.values == TRUE
    assert found.sigmas["Mc"] == pytest.approx(1e-4 / 1.6449)
    assert found.moment_per_kg == pytest.approx(10 * 9.80665 * 0.095)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "not JSON"),
        ('{"schema": "loadrig.run/1"}', "got 'loadrig.run/1'"),
        ('{"schema": "loadrig.identify/1", "motion": "linear"}', "must be of a rotary bench"),
    ],
)
def test_a_file_that_is_no_result(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "r.json"
    path.write_text(content)
    with pytest.raises(InputError, match=words):
        load_reference(path, BENCH)
    with pytest.raises(InputError, match="cannot be read"):
        load_reference(tmp_path / "none.json", BENCH)


STAGES = """\
sequence: 1
name: weights
first_pass: {duration_s: 4}
stages:
"""
STAGE = (
    "  - {{name: {name}, stage: {stage}, weight_kg: {mass}, duration_s: 4,\n"
    "     tones: [{{amplitude_deg: 20, frequency_Hz: 0.4}}]}}\n"
)


def sequence(path: Path, *masses: float, first_pass: bool = True) -> str:
    text = STAGES if first_pass else STAGES.replace("first_pass: {duration_s: 4}\n", "")
    for mass in masses:
        text += STAGE.format(name=f"m{mass:g}", stage="loaded" if mass else "unloaded", mass=mass)
    path.write_text(text)
    return str(path)


def run_hanging(wrong: dict[str, float], *arguments: str) -> int:
    """Run with an operator who confirms what is asked for and hangs something else."""

    def hangs(self: AutomaticOperator, stage: str, weight_kg: float) -> float:
        return wrong.get(stage, weight_kg)

    with mock.patch.object(AutomaticOperator, "hangs", hangs):
        return status(["run", *arguments, "--yes"])


def test_a_wrong_weight_is_refused_before_full_amplitude(tmp_path, capsys):
    known = str(write_result(tmp_path / "known.json"))
    path, out = sequence(tmp_path / "s.yaml", 0, 20), tmp_path / "out"
    assert run_hanging({"m20": 24.0}, path, "--identification", known, "--out", str(out)) == 1
    record = read_record(out)
    assert [w["verdict"] for w in record.weights] == ["right", "wrong"]
    assert record.weights[1]["measured_kg"] == pytest.approx(24.0, rel=0.05)
    assert (record.state, record.de_energised) == ("tripped", True)
    assert [stage.state for stage in record.stages] == ["done", "tripped"]
    log = read_run(out / "recording.mcap")
    assert set(np.unique(log.samples["segment"])) == {0, 1}
    assert [e["verdict"] for e in log.events if e["event"] == "weight check"] == ["right", "wrong"]
    assert "20 kg were confirmed" in capsys.readouterr().err
    # The right weight, and the run goes on.
    assert status(["resume", str(out), "--yes", "--identification", known]) == 0
    assert [w["verdict"] for w in read_record(out).weights] == ["right", "wrong", "right"]


@pytest.mark.usefixtures("undrawn")
def test_after_the_run_and_in_its_identification_the_stage_off_its_label_is_named(tmp_path):
    out, result = tmp_path / "out", tmp_path / "result.json"
    path = sequence(tmp_path / "s.yaml", 0, 10, 20, 30, first_pass=False)
    assert run_hanging({"m20": 25.0}, path, "--out", str(out)) == 1
    record = read_record(out)
    assert record.state == "done"
    assert [(w["stage"], w["verdict"]) for w in record.weights] == [("m20", "wrong")]
    options = ["--method", "paper", "--seed", "1", "--out", str(tmp_path / "page")]
    assert status(["identify", str(out), *options, "--json", str(result)]) == 0
    warnings = json.loads(result.read_text())["warnings"]
    assert any(words.startswith("stage m20: its friction is that of 2") for words in warnings)
