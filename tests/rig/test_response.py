"""`rig response` and `rig tune` as the user runs them, on simulated benches."""

import dataclasses
import io
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from identification.simulation import frequency_response as fr
from identification.simulation.frequency_response import Gains
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.sequence import excitation as targets
from rig.planning.plan import make_plan
from rig.planning.predicted_load import friction_model
from rig.results.response import tuning
from rig.results.response.excitation import LARGE, QUIET, SMALL, excitation
from rig.results.response.measure import gains_record, loop_place, read_response
from rig.runs.run import bench_constants

from ..long.response import Truth, dense
from .benches import variant

FAST = (("cycle_Hz: 1000", "cycle_Hz: 200"), ("cycle_s: 0.001", "cycle_s: 0.005"))
"""A fifth of the cycles of the practical bench, in a fraction of its time."""


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of one measured response, with its bench."""
    folder = tmp_path_factory.mktemp("response")
    slow = (("position_gain: 60", "position_gain: 25"), ("integral_1_s: 60", "integral_1_s: 8"))
    speed = (("N_m_s_rad: 120", "N_m_s_rad: 25"),)
    bench = variant(folder, *FAST, *slow, *speed, count=1)
    words = ["response", str(bench), "--yes", "--out", str(folder / "out")]
    assert status([*words, "--json", str(folder / "response.json")]) == 0
    return folder


def read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text())


def test_the_result_holds_margins_gains_and_lines(measured: Path) -> None:
    record = read(measured / "response.json")
    assert record["schema"] == "loadrig.response/1"
    assert record == read(measured / "out" / "response.json")
    position = record["margins"]["position"]
    phase = position["phase_deg"]
    true = dense(Truth(measured / "bench.yaml", 0.21))["position"]["phase"]
    assert true is not None
    assert phase["value"] == pytest.approx(true[0], abs=3.0)
    assert position["crossover_Hz"]["value"] == pytest.approx(true[1], rel=0.1)
    assert phase["low"] < phase["value"] < phase["high"]
    gains = {name: entry["value"] for name, entry in record["gains"].items()}
    assert gains["position"] == pytest.approx(25.0, rel=0.05)
    assert gains["speed"] == pytest.approx(25.0, rel=0.05)
    assert gains["ahead"] == pytest.approx(1.0, abs=0.05)
    line = record["lines"][4]
    assert line["coherence"] > 0.99
    assert {"plant", "closed", "open_position", "open_speed", "background"} <= line.keys()
    assert record["model"]["margins"]["position"]["phase_deg"] == pytest.approx(
        phase["value"], abs=5.0
    )
    for name in ("report.html", "figures/loops.png", "figures/nyquist.png", "run/run.json"):
        assert (measured / "out" / name).exists()


def test_gains_are_tuned_from_a_result_without_a_run(measured: Path, tmp_path: Path) -> None:
    words = ["tune", str(measured / "bench.yaml"), "--result", str(measured / "response.json")]
    found = tmp_path / "tune.json"
    assert status([*words, "--out", str(tmp_path), "--json", str(found)]) == 0
    record = read(found)
    assert record["schema"] == "loadrig.tune/1"
    assert record["written"] is None
    assert not record["problem"]
    for margins in record["margins"]["proposed"].values():
        assert margins["phase_deg"] >= 60.0
    new, old = (record["gains"][k]["position"]["value"] for k in ("proposed", "old"))
    assert new > 1.5 * old
    assert record["step"]["overshoot_percent"] < 30.0
    assert not (tmp_path / "run").exists()
    # A bandwidth beyond the margins is a bad verdict.
    assert status([*words, "--out", str(tmp_path), "--bandwidth", "50"]) == 1
    assert read(tmp_path / "tune.json")["problem"]


def test_a_result_of_another_kind_is_bad_input(measured: Path, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.json"
    for text in ("{}", '{"schema": "loadrig.response/1"}', "[1]"):
        wrong.write_text(text)
        words = ["tune", str(measured / "bench.yaml"), "--result", str(wrong)]
        assert status([*words, "--out", str(tmp_path / "out")]) == 2


def test_spectra_survive_the_file(measured: Path) -> None:
    seen, gains, _ = read_response(measured / "response.json")
    assert seen.windows >= 4
    assert np.isfinite(seen.plant).all()
    assert gains.speed > 0.0


@pytest.mark.parametrize("bench", ["practical", "odrive_can", "practical_serial"])
def test_the_excitation_is_within_the_limits(bench: str) -> None:
    document = load_bench(bench)
    made = excitation(document.value, friction_model(bench_constants(document.value)), 0)
    assert [stage.name for stage in made.sequence.stages] == [QUIET, SMALL, LARGE]
    stage = made.sequence.stages[2]
    command = targets(stage, document.value.cycle_s)
    speed = np.diff(command) / document.value.cycle_s
    for begin, end in made.windows[LARGE]:
        first, last = (round(at / document.value.cycle_s) for at in (begin, end))
        inside = speed[first:last]
        # The command does not reverse in a window.
        assert inside.min() * inside.max() > 0.0
    assert np.abs(speed).max() < np.radians(document.value.limits.speed_deg_s)


def test_the_same_seed_gives_the_same_sequence() -> None:
    bench = load_bench("practical").value
    model = friction_model(bench_constants(bench))
    first, again, other = (excitation(bench, model, seed).text for seed in (3, 3, 4))
    assert first == again != other


def test_a_stage_without_permission_keeps_twenty_cycles_per_period(tmp_path: Path) -> None:
    from rig.config.sequence import load_sequence

    text = """sequence: 1
name: fast
stages:
  - {name: a, stage: unloaded, tones: [{amplitude_deg: 0.01, frequency_Hz: 100}], duration_s: 3MORE}
"""
    path = tmp_path / "fast.yaml"
    path.write_text(text.replace("MORE", ""))
    with pytest.raises(InputError, match="cycles per period"):
        make_plan(load_sequence(path), load_bench("practical"))
    path.write_text(text.replace("MORE", ", cycles_per_period: 10"))
    assert make_plan(load_sequence(path), load_bench("practical")).stages


def test_set_points_have_no_response(tmp_path: Path) -> None:
    bench = variant(tmp_path, ("servo: {", "servo: {mode: pp, "))
    assert status(["response", str(bench), "--yes", "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


def test_too_little_travel_is_refused_before_any_motion(tmp_path: Path) -> None:
    ends = (("angle_min_deg: -30", "angle_min_deg: -0.5"), ("max_deg: 30", "max_deg: 0.5"))
    bench = variant(tmp_path, *ends, count=1)
    assert status(["response", str(bench), "--yes", "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


def test_nothing_moves_without_consent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    out = tmp_path / "out"
    assert status(["response", "practical", "--out", str(out)]) == 3
    assert read(out / "run" / "run.json")["segments"] == []
    assert not (out / "response.json").exists()


def test_a_tripped_limit_ends_the_measurement(tmp_path: Path) -> None:
    bench = variant(tmp_path, ("disagreement_deg: 1", "disagreement_deg: 0.0005"))
    out = tmp_path / "out"
    assert status(["response", str(bench), "--yes", "--out", str(out)]) == 1
    assert read(out / "run" / "run.json")["state"] == "tripped"
    assert not (out / "response.json").exists()


REAL = ("interface: mock", "interface: socketcand, channel: can0")


def test_the_gains_of_a_real_drive_are_not_written(tmp_path: Path) -> None:
    bench = variant(tmp_path, REAL)
    assert status(["tune", str(bench), "--yes", "--write", "--out", str(tmp_path / "out")]) == 2
    assert not (tmp_path / "out").exists()


HOST = "servo: {mode: cst, position_loop: {inertia_kg_m2: 0.2, drive_limits_speed: true}, "


def test_gains_of_the_program_are_in_the_bench_file(tmp_path: Path) -> None:
    document = load_bench(variant(tmp_path, ("servo: {", HOST)))
    place = loop_place(document)
    assert place.host == "torque"
    assert place.stated is not None
    old = place.stated
    new = Gains(2.0 * old.position, 0.5 * old.speed, old.reset, 1.0)
    text = tuning.with_gains(document, place, old, new)
    path = tmp_path / "tuned.yaml"
    path.write_text(text)
    stated = loop_place(load_bench(path)).stated
    assert stated is not None
    assert stated.position == pytest.approx(2.0 * old.position, rel=1e-5)
    assert stated.speed == pytest.approx(0.5 * old.speed, rel=1e-5)
    half = tuning.between(old, new, 0.5)
    assert half.position == pytest.approx(2.0**0.5 * old.position)


def test_a_reset_of_zero_becomes_the_new_one(tmp_path: Path) -> None:
    document = load_bench(variant(tmp_path, ("integral_1_s: 60", "integral_1_s: 0"), count=1))
    place = loop_place(document)
    assert place.stated is not None
    assert place.stated.reset == 0.0
    new = dataclasses.replace(place.stated, reset=12.0)
    path = tmp_path / "tuned.yaml"
    path.write_text(tuning.with_gains(document, place, place.stated, new))
    assert loop_place(load_bench(path)).stated == new


def test_a_response_of_another_bench_place_or_gains_is_refused(
    measured: Path, tmp_path: Path
) -> None:
    def tuned(bench: Path, result: Path) -> int:
        words = ["tune", str(bench), "--result", str(result), "--out", str(tmp_path / "out")]
        return status(words)

    record = read(measured / "response.json")
    result = tmp_path / "response.json"
    for change in ({"bench": "another"}, {"loop_closed_by": "torque"}):
        result.write_text(json.dumps(record | change))
        assert tuned(measured / "bench.yaml", result) == 2
    # The gains of a loop that this program closes are those of the bench file.
    host = variant(tmp_path, ("servo: {", HOST))
    stated = loop_place(load_bench(host)).stated
    assert stated is not None
    for gains, refused in ((stated, False), (dataclasses.replace(stated, position=9.0), True)):
        held = {"loop_closed_by": "torque", "gains": gains_record(gains)}
        result.write_text(json.dumps(record | held))
        assert (tuned(host, result) == 2) is refused


@pytest.mark.parametrize("old", [Gains(25.0), Gains(25.0, 30.0)])
def test_a_grown_ripple_is_an_oscillation_with_and_without_a_speed_gain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: Gains
) -> None:
    from rig.cli.commands import response

    bench = load_bench(variant(tmp_path))
    seen = fr.modelled(np.geomspace(0.5, 200.0, 24), old, np.full(24, 1.0 + 0.0j))
    new = dataclasses.replace(old, position=2.0 * old.position, speed=2.0 * old.speed)
    phase = 60.0
    monkeypatch.setattr(fr, "margins", lambda loop: SimpleNamespace(phase_deg=phase))
    margin = {"position": {"phase_deg": fr.Estimate(phase, None, None)}}
    found = SimpleNamespace(seen=seen, old=old)

    def why(ripple: float) -> str:
        measured = SimpleNamespace(margins=margin, ripple_N_m=ripple)
        monkeypatch.setattr(response, "_measure", lambda *_, **__: (0, measured))
        arguments = (tmp_path / "tuned.yaml", bench.path.read_text(), found, new, tmp_path)
        return response._step(bench, *arguments, 0.1, {}, tuning.Written())

    limit = 2.0 * tuning.RIPPLE * 0.1
    assert not why(0.99 * limit)
    assert why(1.01 * limit)


def test_an_identified_model_tunes_a_host_without_a_run(tmp_path: Path) -> None:
    bench = variant(tmp_path, ("servo: {", HOST))
    result = tmp_path / "identify.json"
    value = {"low": 0.0, "high": 1.0, "unit": "", "identifiable": True, "at_bound": False}
    names = {"J": 0.2, "Mc": 6.8, "Ms": 12.0, "omega_sf": 0.05, "sigma_2": 5.3}
    parameters = {name: {**value, "value": v} for name, v in names.items()}
    record = {"schema": "loadrig.identify/1", "parameters": parameters}
    record |= {"motion": "rotary", "alpha": 2.0}
    result.write_text(json.dumps(record))
    words = ["tune", str(bench), "--result", str(result), "--out", str(tmp_path / "out")]
    assert status(words) == 0
    found = read(tmp_path / "out" / "tune.json")
    assert found["margins"]["proposed"]["position"]["phase_deg"] >= 60.0
    # In csv the speed loop is in the drive, and a model does not know it.
    speed = variant(tmp_path, ("servo: {", "servo: {mode: csv, "))
    assert status(["tune", str(speed), "--result", str(result), "--out", str(tmp_path / "b")]) == 2


def test_tried_gains_are_written_or_the_old_ones_remain(measured: Path, tmp_path: Path) -> None:
    bench, result = tmp_path / "bench.yaml", str(measured / "response.json")
    bench.write_text((measured / "bench.yaml").read_text())
    words = ["tune", str(bench), "--result", result, "--yes", "--write"]
    assert status([*words, "--out", str(tmp_path / "good")]) == 0
    record = read(tmp_path / "good" / "tune.json")["written"]
    assert record["state"] == "written"
    assert len(record["steps"]) == len(tuning.RAMP)
    tuned = tmp_path / "bench.tuned.yaml"
    proposed = read(tmp_path / "good" / "tune.json")["gains"]
    factor = proposed["proposed"]["position"]["value"] / proposed["old"]["position"]["value"]
    mock = load_bench(tuned).value.mock
    assert mock is not None
    assert mock.loops.position_gain == pytest.approx(25.0 * factor, rel=1e-4)
    # An existing file is not overwritten.
    assert status([*words, "--out", str(tmp_path / "again")]) == 2
    # A drive whose speed filter has become slow loses its margin at the first step.
    tuned.unlink()
    bench.write_text(bench.read_text().replace("filter_Hz: 400", "filter_Hz: 3"))
    before = bench.read_text()
    assert status([*words, "--out", str(tmp_path / "bad")]) == 1
    failed = read(tmp_path / "bad" / "tune.json")["written"]
    assert failed["state"] == "restored"
    assert failed["file"] is None
    assert not tuned.exists()
    assert bench.read_text() == before
