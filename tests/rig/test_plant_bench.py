"""A bench file with a machine of one's own: what a run with it does, records and refuses."""

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from drivers.errors import CORRECT_MACHINE
from rig.cli.authoring.schema import json_schema
from rig.cli.entry import status
from rig.common.yaml_tree import parse
from rig.config.bench import load_bench
from rig.config.configuration import resolve
from rig.results.run.go_on import NEW_RUN
from rig.runs.mcap.reader import read_run
from rig.runs.recorded_inputs import truth_of
from rig.runs.run import load_run, read_record

from ..drivers.fmus import build_fmu
from .benches import stages, swing

NOMINAL = Path(__file__).parents[1] / "drivers" / "machines" / "nominal.py"
OWN = ("motor", "joint", "gas", "effects", "steps_per_loop")
SHORT = stages(swing("a"), swing("b", weight_kg=10))
NOMINAL_CLASS = {"python": "machine.py", "class": "Nominal"}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(SHORT)
    Path("benches").mkdir()
    shutil.copy(NOMINAL, "benches/machine.py")


def bench(plant: Any, source: str = "practical", **more: Any) -> Path:
    """Write a packaged bench with another machine."""
    # YAML of the program, in which `off` is a text.
    tree: Any = parse(resolve(source, "benches").read_text())[0].plain()
    mock = {k: v for k, v in (tree.get("mock") or {}).items() if k not in OWN}
    tree["mock"] = {**mock, "plant": plant, **more}
    path = Path("benches/mine.yaml")
    path.write_text(yaml.safe_dump(tree))
    return path


def run(*options: str) -> int:
    return status(
        ["run", "short.yaml", "--bench", "benches/mine.yaml", "--yes", "--out", "out", *options]
    )


def machine(body: str) -> None:
    """Write a machine that differs from the nominal one in its step."""
    text = (
        f"{NOMINAL.read_text()}\n\nclass Mine(Nominal):\n    steps = 0\n\n"
        "    def step(self, dt_s, voltage_V):\n        self.steps += 1\n"
    )
    Path("benches/machine.py").write_text(
        f"{text}        {body}\n        return super().step(dt_s, voltage_V)\n"
    )


def test_a_run_on_it_notes_the_file_and_keeps_it_out_of_the_recording() -> None:
    bench(NOMINAL_CLASS)
    assert run() == 0
    record = read_record(Path("out"))
    path = Path("benches/machine.py").resolve()
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    assert record.inputs["mock.plant"] == {"file": str(path), "sha256": digest}
    found = read_run(Path("out/recording.mcap"))
    assert found.metadata["sha256"]["mock.plant"] == digest
    attached = yaml.safe_load(found.attachments["bench.yaml"])
    assert "plant" not in attached["mock"]
    assert attached["machine"]["gear_ratio"] == 100
    assert truth_of(Path("out")) is None
    dataset = load_run(Path("out"))
    assert [r.weight_mass for r in dataset.recordings] == [0.0, 10.0]


@pytest.mark.parametrize("source", ["practical_serial", "practical_dbc", "odrive_can"])
def test_every_simulated_drive_can_drive_it(source: str) -> None:
    Path("short.yaml").write_text(SHORT.replace("frequency_Hz: 2", "frequency_Hz: 1"))
    bench(NOMINAL_CLASS, source)
    assert run() == 0
    assert "mock.plant" in read_record(Path("out")).inputs


def test_an_fmu_runs_on_the_bench() -> None:
    pytest.importorskip("fmpy")
    build_fmu(Path("benches/machine.fmu").resolve())
    bench({"fmu": "machine.fmu"})
    assert run() == 0
    assert read_record(Path("out")).inputs["mock.plant"]["file"].endswith("machine.fmu")


@pytest.mark.parametrize("source", ["practical", "practical_serial", "practical_dbc"])
def test_an_error_in_it_ends_the_run_with_the_drive_off_and_the_recording_kept(source, capsys):
    Path("short.yaml").write_text(SHORT.replace("frequency_Hz: 2", "frequency_Hz: 1"))
    machine("if self.steps > 25_000 and voltage_V > 1.0: 1 / 0")
    bench({"python": "machine.py", "class": "Mine"}, source)
    lines = Path("benches/machine.py").read_text().splitlines()
    line = next(n for n, text in enumerate(lines, 1) if "1 / 0" in text)
    assert run() == 4
    place = f"machine.py:{line}: step("
    told = capsys.readouterr().err
    assert place in told
    assert CORRECT_MACHINE in told
    assert NEW_RUN in told
    record = read_record(Path("out"))
    assert record.state == "failed"
    assert place in record.message
    assert "cable" not in record.message
    assert record.de_energised is True
    assert "ZeroDivisionError" in record.message
    assert len(read_run(Path("out/recording.mcap")).samples["time"]) > 20


def test_a_stopped_run_goes_on_with_the_same_file_only(capsys: pytest.CaptureFixture[str]) -> None:
    machine("if self.moment and __import__('pathlib').Path('stop').exists(): 1 / 0")
    bench({"python": "machine.py", "class": "Mine"})
    Path("stop").touch()
    assert run() == 4
    assert [s.state for s in read_record(Path("out")).stages] == ["done", "failed"]
    Path("stop").unlink()
    path = Path("benches/machine.py")
    text = path.read_text()
    path.write_text(f"{text}\n")
    assert status(["resume", "out", "--yes"]) == 2
    assert "machine.py: changed since out was run with this file" in capsys.readouterr().err
    path.write_text(text)
    assert status(["resume", "out", "--yes"]) == 0
    assert [s.state for s in read_record(Path("out")).stages] == ["done", "done"]


def test_only_commands_that_connect_run_its_code() -> None:
    path = Path("benches/machine.py")
    path.write_text(path.read_text() + "\nopen('ran', 'w').close()\n")
    bench(NOMINAL_CLASS)
    assert run("--dry-run") == 0
    assert not Path("ran").exists()
    assert status(["off", "benches/mine.yaml"]) == 0
    assert not Path("ran").exists()
    assert status(["check", "benches/mine.yaml", "--json", "found.json"]) == 0
    assert Path("ran").exists()
    files = [
        Path(entry["file"]).name for entry in json.loads(Path("found.json").read_text())["inputs"]
    ]
    assert "machine.py" in files


def _lacking() -> None:
    Path("benches/machine.py").unlink()


def _broken() -> None:
    Path("benches/machine.py").write_text("x = = 1\n")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [(_lacking, "machine.py: cannot be read"), (_broken, "machine.py:1: SyntaxError")],
)
def test_a_file_that_cannot_be_used_is_bad_input_with_its_place(spoil, words, capsys):
    bench(NOMINAL_CLASS)
    spoil()
    assert run() == 2
    shown = capsys.readouterr().err
    assert "benches/mine.yaml:" in shown
    assert "mock.plant" in shown
    assert words in shown
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("plant", "more", "place"),
    [
        ({"python": "machine.py"}, {}, "mock.plant.class"),
        ({"class": "Nominal"}, {}, "mock.plant.python"),
        ({"fmu": "a.fmu", "class": "Nominal"}, {}, "mock.plant.class"),
        ({"python": "machine.py", "class": "Nominal", "pyhton": "x"}, {}, "mock.plant.pyhton"),
        ({"python": 3, "class": "Nominal"}, {}, "mock.plant.python"),
        ("machine.py", {}, "mock.plant"),
        (NOMINAL_CLASS, {"joint": {"Mc_N_m": 3.0}}, "mock.joint"),
        (NOMINAL_CLASS, {"effects": {"backlash": {"gap_rad": 0.003}}}, "mock.effects"),
        (NOMINAL_CLASS, {"motor": {"gear_ratio": 50}}, "mock.motor"),
    ],
)
def test_a_wrong_section_is_refused_with_its_place(plant, more, place, capsys):
    path = bench(plant, **more)
    assert status(["check", str(path)]) == 2
    problems = capsys.readouterr().err.splitlines()
    assert any(f" {place}: " in line for line in problems), problems


def test_a_pressure_transmitter_has_nothing_to_measure(capsys: pytest.CaptureFixture[str]) -> None:
    path = bench(NOMINAL_CLASS, "practical_hot")
    assert status(["check", str(path)]) == 2
    assert "no gas generator" in capsys.readouterr().err


def test_a_mistake_in_the_own_machine_cannot_be_built_in(capsys):
    path = str(bench(NOMINAL_CLASS))
    assert status(["commission", path, "--yes", "--mistake", "ratio", "--out", "out"]) == 2
    assert "mock.plant" in capsys.readouterr().err


def test_what_the_drive_assumes_follows_from_the_bench() -> None:
    """Loops and motor of the drive are those that a bench without another machine would have."""
    tree = yaml.safe_load(bench(NOMINAL_CLASS).read_text())
    del tree["mock"]["loops"]
    tree["machine"] |= {"gear_ratio": 80, "inductance_H": 0.002}
    Path("mine.yaml").write_text(yaml.safe_dump(tree))
    del tree["mock"]["plant"]
    Path("own.yaml").write_text(yaml.safe_dump(tree))
    mine, own = (load_bench(name).value.mock for name in ("mine.yaml", "own.yaml"))
    assert (mine.motor, mine.loops, mine.sensing) == (own.motor, own.loops, own.sensing)
    assert mine.motor.gear_ratio == 80
    assert dict(mine.plant) == NOMINAL_CLASS


def test_the_schema_for_editors_knows_it() -> None:
    jsonschema = pytest.importorskip("jsonschema")
    part = json_schema("bench")["definitions"]["Machine"]["properties"]["plant"]
    for good in (NOMINAL_CLASS, {"fmu": "a.fmu"}, {}):
        jsonschema.validate(good, part)
    for bad in ({"python": "a.py"}, {"fmu": 1}, {"fmu": "a.fmu", "x": "y"}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(bad, part)


@pytest.mark.proof
def test_the_diagnosis_names_what_the_machine_conceals() -> None:
    bench({"python": "machine.py", "class": "Cogged"})
    words = ["figure10", "--bench", "benches/mine.yaml", "--yes", "--out", "out", "--seed", "4"]
    assert status(["run", *words]) == 0
    assert status(["diagnose", "out", "--json", "found.json", "--out", "report"]) == 0
    found = json.loads(Path("found.json").read_text())
    assert found["verdict"] == "named"
    assert [effect["name"] for effect in found["effects"]] == ["cogging"]
    (effect,) = found["effects"]
    assert effect["parameters"]["torque_Nm"]["value"] == pytest.approx(1.5, rel=0.05)
    assert effect["parameters"]["per_motor_turn"]["value"] == pytest.approx(4.0, rel=0.01)
    assert found["fit"]["final_rms"] < 1.2 * found["fit"]["noise_floor_rms"]
