"""Effects of one's own from the command line: check, diagnosis, export, simulation, injection."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from identification.effects.model import CorrectedModel
from identification.export.python import python_text
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.results.diagnose.document import check_effects
from rig.results.diagnose.model_bench import base_bench, model_bench
from rig.results.diagnose.model_file import model_of
from rig.results.diagnose.own_effects import OwnFile, read_effects
from rig.results.model import exported, read_model
from rig.runs.run import load_run
from rig.wiring.connect import connect
from tests.rig.test_model_bench import record, run
from tests.rig.test_model_command import result as model_result
from tests.rig.test_model_export import (
    ACCELERATION,
    ANGLE,
    CURRENT,
    PARAMETERS,
    RECORDING,
    TIME,
    VELOCITY,
    imported,
)

SIX = Path(__file__).parents[2] / "benchmarks" / "six_effects.py"
HEAD = "import math\nimport numpy as np\nfrom identification.effects.own import effect\n"
COPY = """
@effect(c=("N m s^2/rad^2", 0.0, 9.0))
def same_drag(s, p):
    return p.c * s.velocity * np.abs(s.velocity)

@effect(c=("N m s/rad", 0.0, 9.0))
def more_viscous(s, p):
    return p.c * s.velocity
"""


def mine(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(HEAD + text)
    return path


@pytest.fixture(scope="module")
def six() -> OwnFile:
    return read_effects(SIX)


def test_the_exported_file_computes_an_effect_of_ones_own(six: OwnFile, tmp_path: Path) -> None:
    effects = {
        e.name: {q.name: q.low + 0.3 * (q.high - q.low) for q in e.parameters} for e in six.effects
    }
    model = CorrectedModel(PARAMETERS, 2.0, effects, catalogue=six.catalogue)
    module = imported(python_text(model, RECORDING, "bench"), tmp_path)
    given = {"contact_force": 2000.0, "current": CURRENT}
    s = module.signals(module.M, TIME, ANGLE, VELOCITY, ACCELERATION, **given)
    assert module.torque(s) == pytest.approx(model.torque(s), rel=1e-9, abs=1e-9)
    plain = CorrectedModel(PARAMETERS, 2.0)
    assert np.max(np.abs(module.torque(s) - plain.torque(s))) > 1.0
    assert "from identification" not in (tmp_path / "model.py").read_text()


def test_the_exported_file_has_what_the_function_uses(tmp_path: Path) -> None:
    text = """
from math import pi as half_turn, sin
FLOOR = 1e-3

def smooth(w):
    return w / np.sqrt(w**2 + FLOOR**2)

@effect(
    a=("N m", 0.0, 5.0), w=("rad/s", 0.01, 1.0)
)
def crafted(s, p):
    return p.a * smooth(s.velocity / p.w) * sin(half_turn / 4) * math.sqrt(2.0)
"""
    own = read_effects(mine(tmp_path, text))
    model = CorrectedModel(PARAMETERS, 2.0, {"crafted": {"a": 2.0, "w": 0.1}}, None, own.catalogue)
    module = imported(python_text(model, RECORDING, "bench"), tmp_path)
    s = module.signals(module.M, TIME, ANGLE, VELOCITY, ACCELERATION)
    assert module.torque(s) == pytest.approx(model.torque(s), rel=1e-12, abs=1e-12)


def test_what_the_exported_file_cannot_contain_is_named(tmp_path: Path) -> None:
    text = """
TABLE = np.array([0.0, 1.0])

@effect(a=("N m", 0.0, 5.0))
def tabled(s, p):
    return p.a * np.interp(np.abs(s.velocity), TABLE, TABLE) * s.direction
"""
    own = read_effects(mine(tmp_path, text))
    model = CorrectedModel(PARAMETERS, 2.0, {"tabled": {"a": 2.0}}, None, own.catalogue)
    module = imported(python_text(model, RECORDING, "bench"), tmp_path)
    s = module.signals(module.M, TIME, ANGLE, VELOCITY, ACCELERATION)
    assert module.torque(s) == pytest.approx(model.torque(s), rel=1e-12, abs=1e-12)
    own = read_effects(mine(tmp_path, text.replace("np.array([0.0, 1.0])", "[0.0, 1.0]")))
    model = CorrectedModel(PARAMETERS, 2.0, {"tabled": {"a": 2.0}}, None, own.catalogue)
    with pytest.raises(ValueError, match=r"mine\.py: tabled uses TABLE, which is a list"):
        python_text(model, RECORDING, "bench")


def test_the_model_for_other_tools_has_effects_of_ones_own(six: OwnFile, tmp_path: Path) -> None:
    made = read_model(model_result(tmp_path / "demo", six.effects), six)
    assert made.machine is not None
    assert made.machine.left_out == ()
    kinds = ("c", "python") if shutil.which("cc") else ("python",)
    assert all(max(exported(made, kind).checks.values()) < 1e-6 for kind in kinds)


def test_what_other_tools_cannot_have_is_named_with_its_size(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = """
@effect(a=("N m s/rad", 0.0, 5.0))
def of_all_samples(s, p):
    return p.a * (s.velocity - np.mean(s.velocity))

@effect(a=("N m", 0.0, 5.0), w=("rad/s", 0.1, 1.0))
def without_a_form(s, p):
    return p.a * np.arctan(s.velocity / p.w)
"""
    path = mine(tmp_path, text)
    own, result = read_effects(path), tmp_path / "m.json"
    folder = model_result(tmp_path / "demo", own.effects, **own.record)
    given = ["model", str(folder), "--effects", str(path), "--json", str(result)]
    assert status([*given, "--format", "modelica", "--out", str(tmp_path / "a")]) == 0
    left = json.loads(result.read_text())["not_simulated"]
    assert [e["name"] for e in left] == ["of_all_samples", "without_a_form"]
    assert left[0]["parameters"] == {"a": 1.5}
    assert status([*given, "--format", "yaml", "--out", str(tmp_path / "b")]) == 0
    written = yaml.safe_load((tmp_path / "b" / "demo.yaml").read_text())
    assert {*written["effects"]} == {"of_all_samples", "without_a_form"}
    assert status(given[:2]) == 2
    assert "--effects" in capsys.readouterr().err


def test_the_command_checks_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = tmp_path / "check.json"
    assert status(["effects", "--check", str(SIX), "--json", str(result)]) == 0
    found = json.loads(result.read_text())
    assert [e["problems"] for e in found["effects"]] == [[]] * 6
    assert found["effects_file"]["file"] == str(SIX)
    text = '@effect(c=("N m", 0, 9))\ndef drag(s, p):\n    return p.c * s.velocity\n'
    assert status(["effects", "--check", str(mine(tmp_path, text))]) == 1
    assert "units: torque" in capsys.readouterr().out
    broken = mine(tmp_path, text.replace("s.velocity", "s.speed"))
    assert status(["effects", "--check", str(broken)]) == 2
    assert f"{broken}:6: drag: AttributeError" in capsys.readouterr().err
    assert status(["effects", "--check", str(mine(tmp_path, "x = 1\n"))]) == 2
    assert status(["effects", "--check", str(tmp_path / "absent.py")]) == 2
    assert status(["effects", "backlash", "--check", str(SIX)]) == 2
    assert status(["effects", "--on", str(SIX)]) == 2


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("-p.c * speed", "sign:"),
        ("p.c * speed * abs(speed)", "units:"),
        ("p.cc * speed", "the parameters are c"),
        ("p.c * speed / angle / 0.0", "ZeroDivisionError"),
        ("p.c * speed * math.inf", "returns"),
        ("p.c * speed", ""),
    ],
)
def test_the_check_tries_the_function_that_injects(body: str, words: str, tmp_path: Path) -> None:
    text = f"""
@effect(c=("N m s/rad", 0.0, 5.0))
def drag(s, p):
    return p.c * s.velocity

def inject_drag(angle, speed, motor_torque, load, state, dt, p):
    return {body}
"""
    (found,) = check_effects(read_effects(mine(tmp_path, text)), None)
    assert [words in p and "mine.py:9: inject_drag" in p for p in found.problems] == [True] * bool(
        words
    )
    other = text.replace("state, dt, p", "p")
    (found,) = check_effects(read_effects(mine(tmp_path, other)), None)
    assert "it is called as" in found.problems[0]


def test_a_wrong_name_of_a_parameter_lists_those_there_are(tmp_path: Path) -> None:
    text = (
        '@effect(c=("N m", 0, 9), b=("", 0, 1))\ndef drag(s, p):\n    return p.cc * s.direction\n'
    )
    with pytest.raises(InputError, match="the parameters are c, b"):
        read_effects(mine(tmp_path, text))


def test_another_diagnosis_does_not_see_the_effects(tmp_path: Path) -> None:
    found = [read_effects(mine(tmp_path, COPY)), read_effects(SIX)]
    names = [{e.name for e in own.effects} for own in found]
    assert not names[0] & names[1]
    assert [own.catalogue.keys() & (names[0] | names[1]) for own in found] == names


def test_a_result_names_the_file_of_its_effects(six: OwnFile) -> None:
    made = record({"root_drag": {"c": 2.0}}, **six.record)
    model = model_of(made, ["a"], "found.json", six.catalogue)
    assert model.effects == {"root_drag": {"c": 2.0}}
    with pytest.raises(InputError, match=r"root_drag .*six_effects.py .*--effects"):
        model_of(made, ["a"], "found.json")


@pytest.fixture(scope="module")
def injected(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("injected")
    bench = base_bench(folder)
    bench["mock"] |= {"effects": {"root_drag": {"c": 6.0}}, "effects_file": str(SIX)}
    return run(folder, "hidden", bench), bench


def test_a_bench_file_injects_an_effect_of_ones_own(injected, six):
    folder, bench = injected
    (hidden,) = load_run(folder).recordings
    bench["mock"]["effects"] = {}
    (plain,) = load_run(run(folder.parent, "plain", bench)).recordings
    torque = [
        r.bench.ampere_torque
        * np.mean(r.channels["current"] * np.sign(np.gradient(r.channels["angle"])))
        for r in (hidden, plain)
    ]
    assert 0.3 < torque[0] - torque[1] < 6.0
    assert b"effects_file" not in b"".join(p.read_bytes() for p in folder.glob("*.yaml"))


def test_the_corrected_bench_injects_it_again(injected, six):
    folder, _ = injected
    (recording,) = load_run(folder).recordings
    model = model_of(record({"root_drag": {"c": 6.0}}), ["a"], "r", six.catalogue)
    bench, notes = model_bench(base_bench(folder), model, recording.bench, six)
    assert notes == []
    assert bench["mock"]["effects_file"] == str(SIX)
    without, notes = model_bench(base_bench(folder), model, recording.bench)
    assert "effects_file" not in without["mock"]
    assert "root_drag is left out" in notes[0]


@pytest.mark.parametrize(
    ("text", "effects", "words"),
    [
        (None, {}, "cannot be read"),
        ("def inject_drag(:\n", {}, "mine.py:1: SyntaxError"),
        ("def inject_drag(*given): ...\n", {"drug": {}}, "no such effect"),
        (
            "def inject_drag(*given):\n    return 1 / 0\n",
            {"drag": {}},
            "mine.py:2: ZeroDivisionError",
        ),
    ],
)
def test_a_wrong_file_of_a_bench_has_its_place(text, effects, words, tmp_path):
    if text is not None:
        (tmp_path / "mine.py").write_text(text)
    bench = base_bench(tmp_path)
    bench["mock"] |= {"effects": effects, "effects_file": "mine.py"}
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(bench))
    with pytest.raises(InputError, match=words) as refused, connect(load_bench(path), 0, False):
        pass
    assert str(refused.value).startswith(f"{path}:")
    assert "mock.effects" in str(refused.value)


def test_a_check_on_recordings_finds_what_they_cannot_show(injected, tmp_path):
    folder, _ = injected
    same, viscous = check_effects(read_effects(mine(tmp_path, COPY)), folder)
    assert [p.partition(":")[0] for p in same.problems] == ["copies quadratic_drag"]
    assert same.record()["correlations"]["quadratic_drag"] > 0.995
    assert [p.partition(":")[0] for p in viscous.problems] == ["degenerate"]
    assert viscous.record()["correlations"]["nominal"] == 1.0
