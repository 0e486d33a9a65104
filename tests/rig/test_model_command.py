"""``rig model``: the model of a result in other tools computes what the program does."""

import csv
import json
import math
import re
import shutil
import subprocess
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import identification as lr
from identification.effects import GAS, MOTION
from identification.effects.effect import Effect
from identification.export.c import EVERY
from identification.export.fmu import fmu_texts
from identification.export.machine import INPUTS, Machine
from identification.export.mjcf import ANGLES, SPEEDS, Grid, fitted, grid_of
from identification.model.parameters import pack
from identification.recording import Bench
from identification.simulation.closed_loop import OPEN_LOOP, Inputs, simulate
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.results.model import (
    FORMATS,
    SIMULATION,
    Model,
    binary_place,
    exported,
    name_of,
    read_model,
)
from rig.results.model import MOTION as MOTION_FILE

PARAMETERS = {
    "J": 0.2, "Mc": 6.8, "Ms": 12.0, "omega_sf": 0.056, "sigma_2": 5.3, "mu_c": 0.052,
    "mu_s": 0.086, "omega_sL": 0.033, "mu_2": 0.032,
}  # fmt: skip
CONSTANTS = {
    "torque_constant": 0.03,
    "back_emf_constant": 0.026,
    "resistance": 1.56,
    "inductance": 1e-3,
    "gear_ratio": 100.0,
    "moment_arm": 0.095,
}
PLAUSIBLE = {
    "quadratic_drag": {"coefficient_Nms2_rad2": 3.0},
    "gear_mesh_ripple": {"amplitude_rad": 1e-3, "per_turn": 23.0},
    "asymmetric_viscous": {"coefficient_Nms_rad": -1.0},
    "asymmetric_coulomb": {"torque_Nm": 2.0},
    "friction_play": {"gap_rad": 0.02, "friction_share": 0.5, "inertia_kgm2": 0.05},
    "encoder_ripple": {"amplitude_rad": 1e-3, "per_turn": 2.0},
    "position_dependent_friction": {"torque_Nm": 2.0},
    "constant_torque": {"torque_Nm": -2.0},
    "cogging": {"torque_Nm": 1.0, "per_motor_turn": 7.0},
}
"""Parameters that a machine can have; those of a range's middle drive some machines by themselves.
"""
WARNINGS = ("-std=c99", "-pedantic", "-O2", "-Wall", "-Wextra", "-Werror")
compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")


def values(effect: Effect, share: float = 0.3) -> dict[str, float]:
    given = {q.name: q.low + share * (q.high - q.low) for q in effect.parameters}
    return given | PLAUSIBLE.get(effect.name, {})


def result(folder: Path, effects: Sequence[Effect] = (), **changes: Any) -> Path:
    """Write the result file of a diagnosis."""
    found = [
        {
            "name": e.name,
            "where": {"recordings": ["a"]},
            "parameters": {
                n: {"value": v, "low": 0.9 * v, "high": 1.1 * v, "unit": ""}
                for n, v in values(e).items()
            },
        }
        for e in effects
    ]
    record = {
        "schema": "loadrig.diagnose/1",
        "motion": "rotary",
        "constants": CONSTANTS,
        "parameters": PARAMETERS,
        "alpha": 2.0,
        "effects": found,
        "ranges": {"angle": [-0.3, 0.4], "velocity": [-0.5, 0.5], "moment": [0.0, 95.0]},
        **changes,
    }
    folder.mkdir(exist_ok=True)
    (folder / "diagnose.json").write_text(json.dumps(record))
    return folder


def read(folder: Path, *effects: Effect) -> Model:
    return read_model(result(folder / "demo", effects))


def equations(model: Model) -> Machine:
    assert model.machine is not None
    return model.machine


def write(files: Any, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        data = content.encode() if isinstance(content, str) else content
        (folder / name).write_bytes(data)
    return folder


def run(arguments: Sequence[str]) -> int:
    return status(list(arguments))


def named(name: str) -> Effect:
    return next(e for e in MOTION if e.name == name)


def together(count: int) -> list[list[Effect]]:
    return [list(MOTION[k::count]) for k in range(count)]


@pytest.mark.parametrize("effects", together(8), ids=lambda e: e[0].name)
def test_effects_together_are_what_model_py_computes(effects: list[Effect], tmp_path: Path) -> None:
    model = read(tmp_path, *effects)
    found = exported(model, "c")
    assert set(found.checks) >= {"required", "drive", "motor_angle", "voltage"}
    assert max(v for k, v in found.checks.items() if not k.startswith("c.")) < 1e-11
    assert max(found.checks.values()) < 1e-6 or shutil.which("cc") is None
    left_out = {left.name for left in equations(model).left_out}
    assert left_out == {e.name for e in effects if e.not_simulated}


@pytest.mark.parametrize("first", [0, 1])
def test_the_order_of_effects_does_not_matter(first: int, tmp_path: Path) -> None:
    """Presliding gives the nominal values a stiffness, which the friction memory uses."""
    effects = [named("friction_memory"), named("presliding")]
    model = read(tmp_path, effects[first], effects[1 - first])
    assert max(exported(model, "python").checks.values()) < 1e-11


@pytest.mark.parametrize("effect", MOTION, ids=lambda e: e.name)
def test_every_effect_changes_the_equations_or_is_named(effect: Effect, tmp_path: Path) -> None:
    model, plain = read(tmp_path, effect), read(tmp_path)
    changed = {
        name
        for name in equations(model).outputs
        if equations(model).outputs[name] is not equations(plain).outputs[name]
    }
    whole = [left for left in equations(model).left_out if left.whole]
    assert bool(changed) is not bool(whole)
    for left in equations(model).left_out:
        assert (left.name, left.reason) == (effect.name, effect.not_simulated)
        assert set(left.parameters) >= {q.name for q in effect.parameters}


def test_effects_of_the_gas_generator_are_named() -> None:
    assert all(e.not_simulated for e in GAS)


def test_a_simulation_without_effects_is_that_of_the_fit(tmp_path: Path) -> None:
    found = exported(read(tmp_path), "python")
    text = found.files[SIMULATION]
    assert isinstance(text, str)
    rows = np.array([[float(x) for x in row] for row in list(csv.reader(text.splitlines()))[1:]])
    column = dict(zip(["time", *INPUTS, *EVERY], rows.T, strict=True))
    torque = 3.0 * column["current"]
    inputs = Inputs(
        column["time"],
        np.zeros(len(rows)),
        np.ones(len(rows)),
        # The simulation holds the input of the end of a step, that of the fit the one of its start.
        np.append(torque[1:], torque[-1]),
        0.095 * np.append(column["contact_force"][1:], column["contact_force"][-1]),
    )
    fit = simulate(pack(PARAMETERS, 2.0), OPEN_LOOP, inputs, 0.0, 0.0, 1e-6)
    step = column["time"][1]
    assert np.max(np.abs(column["velocity"] - fit.velocity)) < 0.01 * np.max(np.abs(fit.velocity))
    assert np.max(np.abs(column["angle"] - fit.angle)) < 0.01 * np.ptp(fit.angle)

    def rests(speed: Any) -> Any:
        # A reversal without rest may take one step at zero.
        still = np.r_[False, speed == 0.0, False]
        places = np.flatnonzero(still[1:] != still[:-1]).reshape(-1, 2)
        return step * places[np.diff(places).ravel() > 1].ravel()

    assert len(rests(fit.velocity)) >= 6
    assert rests(column["velocity"]) == pytest.approx(rests(fit.velocity), abs=1.01 * step)


def test_the_solution_converges_with_the_step(tmp_path: Path) -> None:
    """A stick-slip motion against a spring: half the step, half the error."""
    import importlib.util

    found = exported(read(tmp_path, named("return_spring"), named("presliding")), "python")
    write(found.files, tmp_path / "out")
    spec = importlib.util.spec_from_file_location("simulated", tmp_path / "out" / "simulate.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def end(step: float) -> float:
        model = module.Model()
        steps = round(0.08 / step)
        return float(
            [model.step(step, current=10.0 * math.sin(40.0 * step * k)) for k in range(1, steps)][
                -1
            ]["angle"]
        )

    exact = end(5e-6)
    coarse, fine = abs(end(1e-4) - exact), abs(end(5e-5) - exact)
    assert fine < 0.65 * coarse


@compiler
@pytest.mark.parametrize("effects", [(), ("backlash", "presliding", "winding_heating")])
def test_the_c_is_clean_c99(effects: Sequence[str], tmp_path: Path) -> None:
    found = exported(read(tmp_path, *map(named, effects)), "simulink").files
    folder = write(found, tmp_path / "out")
    (folder / "simstruc.h").write_text(SIMSTRUC)
    (folder / "cg_sfun.h").write_text("")
    header = (folder / "demo.h").read_text()
    assert "#define DEMO_ANGLE_LEAST (-0.3) /* rad */" in header
    assert ("DEMO_BACKLASH_GAP_RAD_LOW" in header) is ("backlash" in effects)
    for sources in (["demo.c", "test.c", "-o", "test"], ["-c", "demo_sfun.c", "-Wno-unused"]):
        subprocess.run(["cc", *WARNINGS, *sources, "-lm"], cwd=folder, check=True)
    subprocess.run(["./test"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
    # A wrong expected value fails.
    text = (folder / MOTION_FILE).read_text().splitlines()
    text[500] = text[500].rpartition(",")[0] + ",1000.0"
    (folder / MOTION_FILE).write_text("\n".join(text) + "\n")
    assert subprocess.run(["./test"], cwd=folder, stdout=subprocess.DEVNULL).returncode == 1


SIMSTRUC = """\
typedef struct S_ SimStruct;
typedef double real_T;
typedef int int_T;
typedef struct M_ mxArray;
int ssGetNumSFcnParams(SimStruct *), ssGetSFcnParamsCount(SimStruct *);
int ssSetNumInputPorts(SimStruct *, int), ssSetNumOutputPorts(SimStruct *, int);
void ssSetNumSFcnParams(SimStruct *, int), ssSetInputPortWidth(SimStruct *, int, int);
void ssSetInputPortRequiredContiguous(SimStruct *, int, int), ssSetNumPWork(SimStruct *, int);
void ssSetInputPortDirectFeedThrough(SimStruct *, int, int);
void ssSetOutputPortWidth(SimStruct *, int, int), ssSetNumSampleTimes(SimStruct *, int);
void ssSetSampleTime(SimStruct *, int, double), ssSetOffsetTime(SimStruct *, int, double);
double mxGetScalar(const mxArray *);
const mxArray *ssGetSFcnParam(SimStruct *, int);
void ssSetPWorkValue(SimStruct *, int, void *), *ssGetPWorkValue(SimStruct *, int);
void ssSetErrorStatus(SimStruct *, const char *);
real_T *ssGetOutputPortRealSignal(SimStruct *, int);
const real_T *ssGetInputPortRealSignal(SimStruct *, int);
"""
"""Declarations of Simulink's header that the S-function uses."""


@compiler
@pytest.mark.parametrize("version", [2, 3])
def test_the_fmu_has_sources_and_a_binary(version: int, tmp_path: Path) -> None:
    found = exported(read(tmp_path, named("presliding")), "fmu", version)
    folder = write(found.files, tmp_path / "out")
    with zipfile.ZipFile(folder / "demo.fmu") as archive:
        archive.extractall(folder / "fmu")
        names = archive.namelist()
    assert {"modelDescription.xml", "sources/fmu.c", "sources/demo.c"} <= set(names)
    assert [n for n in names if n.startswith("binaries/") and n.endswith("/demo.so")]
    assert f'fmiVersion="{version}.0"' in (folder / "fmu" / "modelDescription.xml").read_text()
    subprocess.run(
        ["cc", *WARNINGS, "-fPIC", "-shared", "demo.c", "fmu.c", "-o", "x.so", "-lm"],
        cwd=folder / "fmu" / "sources",
        check=True,
    )


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("demo", "demo"), ("Test", "m_Test"), ("fmu", "m_fmu"), ("initial", "m_initial"),
        ("Angle", "m_Angle"), ("3 rd", "m_3_rd"), ("--", "m_model"),
    ],
)  # fmt: skip
def test_no_model_has_the_name_of_another_file_or_a_keyword(folder: str, name: str) -> None:
    assert name_of(folder) == name


@compiler
@pytest.mark.parametrize("folder", ["test", "fmu"])
def test_a_folder_may_have_the_name_of_a_file_of_the_export(folder: str, tmp_path: Path) -> None:
    model = read_model(result(tmp_path / folder))
    found = exported(model, "c")
    assert {f"m_{folder}.c", "test.c"} < set(found.files)
    assert "c.test_motion.required" in found.checks
    sources = fmu_texts(equations(model), 3)
    assert f"m_{folder}_step(" in sources[f"sources/m_{folder}.c"]
    modelica = exported(model, "modelica").files
    assert modelica[f"m_{folder}.mo"] != modelica["test.mo"]


@compiler
def test_c_that_does_not_compile_is_an_error(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("rig.results.model._COMPILE", ("-std=none",))
    with pytest.raises(InputError):
        exported(read(tmp_path), "c")
    monkeypatch.setattr(shutil, "which", lambda _: None)
    found = exported(read(tmp_path), "c")
    assert len(found.notes) == 1
    assert not [k for k in found.checks if k.startswith("c.")]


@pytest.mark.parametrize(
    ("system", "kind", "fmi", "place"),
    [
        ("Linux", "x86_64", 2, "binaries/linux64/x.so"),
        ("Linux", "aarch64", 3, "binaries/aarch64-linux/x.so"),
        ("Darwin", "arm64", 3, "binaries/aarch64-darwin/x.dylib"),
        ("Darwin", "x86_64", 2, "binaries/darwin64/x.dylib"),
        ("Windows", "AMD64", 2, "binaries/win64/x.dll"),
        ("Windows", "AMD64", 3, "binaries/x86_64-windows/x.dll"),
        ("Linux", "aarch64", 2, None),
    ],
)
def test_a_binary_lies_where_fmi_wants_it(system, kind, fmi, place, monkeypatch):
    monkeypatch.setattr("platform.system", lambda: system)
    monkeypatch.setattr("platform.machine", lambda: kind)
    assert binary_place("x", fmi) == place


@compiler
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.filterwarnings("ignore")
def test_the_fmu_runs_in_fmpy(version: int, tmp_path: Path) -> None:
    fmpy = pytest.importorskip("fmpy")
    validation = pytest.importorskip("fmpy.validation")
    found = exported(read(tmp_path, named("presliding")), "fmu", version)
    folder = write(found.files, tmp_path / "out")
    path = str(folder / "demo.fmu")
    assert validation.validate_fmu(path) == []
    table = np.genfromtxt(folder / SIMULATION, delimiter=",", names=True)
    kind = np.dtype([("time", float), *((n, float) for n in INPUTS)])
    held = np.zeros(len(table), dtype=kind)
    held["time"] = table["time"]
    for name in INPUTS:  # the test files have the input of the step that ends at a time
        held[name] = np.append(table[name][1:], table[name][-1])
    step = table["time"][1]
    out = fmpy.simulate_fmu(
        path,
        stop_time=float(table["time"][-1]),
        step_size=step,
        output_interval=step,
        input=held,
        output=["angle", "velocity", "drive"],
    )
    for name in ("angle", "velocity", "drive"):
        size = np.max(np.abs(table[name]))
        assert out[name][1:] == pytest.approx(table[name][1:], abs=1e-6 * size)


@pytest.mark.proof
@pytest.mark.parametrize("effects", [(), ("dwell_static_friction", "cogging"), ("presliding",)])
def test_rumoca_computes_the_same(effects: Sequence[str], tmp_path: Path) -> None:
    rumoca = pytest.importorskip("rumoca")
    found = exported(read(tmp_path, *map(named, effects)), "modelica").files
    model = rumoca.Session().loads(f"{found['demo.mo']}\n{found['test.mo']}", model="test")
    text = found[SIMULATION]
    assert isinstance(text, str)
    table = np.genfromtxt(text.splitlines(), delimiter=",", names=True)
    step = float(table["time"][1])
    run = model.simulate(t=(0.0, float(table["time"][-1])), dt=step)
    time, series = np.asarray(run.time), run.to_dict()["data"]
    places = np.searchsorted(time, table["time"][1:-1] + 0.5 * step) - 1
    for name in ("angle", "velocity", "drive"):
        size = np.max(np.abs(table[name]))
        assert np.asarray(series[name])[places] == pytest.approx(table[name][1:-1], abs=1e-6 * size)


@compiler
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.filterwarnings("ignore")
def test_an_fmu_has_its_outputs_from_the_start(version: int, tmp_path: Path) -> None:
    fmpy = pytest.importorskip("fmpy")
    found = exported(read(tmp_path, named("cogging")), "fmu", version)
    folder = write(found.files, tmp_path / "out")
    held = np.array([(0.0, 2.0)], dtype=[("time", float), ("current", float)])
    out = fmpy.simulate_fmu(
        str(folder / "demo.fmu"),
        stop_time=1e-3,
        step_size=1e-3,
        input=held,
        start_values={"start_angle": 0.1},
        output=["angle", "motor_angle", "drive", "voltage"],
    )
    phase = values(named("cogging"))["phase_rad"]
    assert (out["angle"][0], out["motor_angle"][0]) == pytest.approx((0.1, 10.0))
    assert out["drive"][0] == pytest.approx(6.0 + math.sin(70.0 + phase))
    assert out["voltage"][0] == pytest.approx(2.0 * 1.56)


@pytest.mark.proof
def test_modelica_divides_a_long_step_and_has_its_outputs_from_the_start(tmp_path: Path) -> None:
    rumoca = pytest.importorskip("rumoca")
    model = read(tmp_path, named("cogging"))
    found = exported(model, "modelica").files
    text = found[SIMULATION]
    assert isinstance(text, str)
    table = np.genfromtxt(text.splitlines(), delimiter=",", names=True)
    step, end = float(table["time"][1]), float(table["time"][-1])

    def run(**given: float) -> Any:
        machine = found["demo.mo"]
        for name, value in given.items():
            machine = re.sub(rf"(Real {name}\(.*?\)) = [^\s;]+", rf"\1 = {value!r}", machine)
        made = rumoca.Session().loads(f"{machine}\n{found['test.mo']}", model="test")
        done = made.simulate(t=(0.0, end), dt=0.5 * step)
        return np.asarray(done.time), done.to_dict()["data"]

    time, long = run(interval=3.0 * step)
    places = np.searchsorted(time, table["time"][1:-1] + 0.5 * step) - 1
    size = np.max(np.abs(table["angle"]))
    assert np.asarray(long["angle"])[places] == pytest.approx(table["angle"][1:-1], abs=1e-6 * size)
    _, begun = run(start_angle=0.1)
    phase = values(named("cogging"))["phase_rad"]
    assert (begun["angle"][0], begun["motor_angle"][0]) == pytest.approx((0.1, 10.0))
    assert begun["drive"][0] == pytest.approx(math.sin(70.0 + phase))


@pytest.mark.parametrize("name", [None, "gravity_imbalance", "return_spring", "quadratic_drag"])
def test_mujoco_has_the_torque_within_the_printed_error(name: str | None, tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    effects = [] if name is None else [named(name)]
    model = read(tmp_path, *effects)
    m, files = equations(model), exported(model, "mjcf").files
    grid = grid_of(m)
    wanted = m.steady(*grid)
    for file in ("plain.xml", "dcmotor.xml"):
        text = files[file]
        assert isinstance(text, str)
        printed = re.search(r"Error of the torque:\s+(\S+) N m rms", text)
        assert printed
        joint = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(joint)
        found = []
        for speed, angle in zip(*grid, strict=True):
            data.qpos[0], data.qvel[0], data.qacc[0] = angle, speed, 0.0
            data.act[:] = data.ctrl[:] = 0.0
            if joint.na:  # the deflection of the LuGre friction in steady motion
                stiffness, level = joint.actuator_dynprm[0][5], joint.actuator_biasprm[0][3:6]
                motor = 100.0 * speed
                steady = level[0] + (level[1] - level[0]) * math.exp(-((motor / level[2]) ** 2))
                data.act[0] = math.copysign(steady / stiffness, speed)
            mujoco.mj_inverse(joint, data)
            torque = data.qfrc_inverse[0]
            if joint.na:
                mujoco.mj_fwdActuation(joint, data)
                back_emf = (joint.actuator_gainprm[0][1] * 100.0) ** 2 / 1.56 * speed
                torque = torque - data.qfrc_actuator[0] - back_emf
            found.append(torque)
        error = float(np.sqrt(np.mean((np.array(found) - wanted) ** 2)))
        assert error <= float(printed[1]) * 1.01 + 1e-3 * float(np.max(np.abs(wanted)))
        if name == "quadratic_drag":
            assert "quadratic_drag: " in text


@pytest.mark.parametrize("torque", [-2.0, 0.7, 1.3, 2.0, 3.1])
def test_a_constant_torque_is_a_weight_and_no_spring_without_stiffness(torque: float) -> None:
    speed = np.linspace(-0.5, 0.5, 2 * SPEEDS)
    grid = Grid(*(g.ravel() for g in np.meshgrid(speed, np.linspace(-0.3, 0.4, ANGLES))))
    found = fitted(torque + 6.0 * np.sign(grid.speed), grid)
    assert found.spring == (0.0, 0.0)
    assert found.weight[0] > 0.9 * abs(torque)
    assert np.max(np.abs(found.error)) < 0.1 * abs(torque)


@pytest.mark.parametrize("kind", ["yaml", *FORMATS])
def test_every_format_is_written_from_the_command_line(kind, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    folder = result(tmp_path / "demo", [named("transport_delay"), named("cogging")])
    arguments = ["model", str(folder), "--format", kind, "--json", "record.json"]
    assert run(arguments) == 0
    record = json.loads((tmp_path / "record.json").read_text())
    assert record["files"]
    assert all((tmp_path / f"demo_{kind}" / name).stat().st_size for name in record["files"])
    if kind != "yaml":
        assert [e["name"] for e in record["not_simulated"]] == ["transport_delay"]
    assert run(arguments) == 2  # the files exist already
    assert "exists already" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "place"),
    [({"constants": None}, "constants"), ({"parameters": {"Mc": 1.0}}, "parameters.J")],
)
def test_a_result_without_what_a_model_needs(changes, place, tmp_path):
    with pytest.raises(InputError) as error:
        exported(read_model(result(tmp_path / "demo", **changes)), "c")
    assert f"diagnose.json: {place}" in str(error.value)


def test_a_model_that_runs_away_is_refused(tmp_path: Path) -> None:
    folder = result(tmp_path / "demo", [named("quadratic_drag")])
    record = json.loads((folder / "diagnose.json").read_text())
    record["effects"][0]["parameters"]["coefficient_Nms2_rad2"]["value"] = -60.0
    (folder / "diagnose.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match="quadratic_drag"):
        exported(read_model(folder), "c")


def test_a_linear_bench_has_linear_units(tmp_path: Path) -> None:
    model = read_model(result(tmp_path / "demo", [named("return_spring")], motion="linear"))
    header = exported(model, "c").files["demo.h"]
    assert isinstance(header, str)
    assert "double J; /* kg */" in header
    assert "double angle; /* m:" in header
    assert model.bench == Bench(motion="linear", **CONSTANTS)


@pytest.mark.parametrize("unit", ["N m", "A"])
def test_a_bench_without_a_torque_constant_has_the_unit_of_the_fit(unit: str, tmp_path) -> None:
    """Of a torque channel, or of the current."""
    folder = result(
        tmp_path / "demo",
        [named("constant_torque")],
        constants={**CONSTANTS, "torque_constant": None},
        fit={"equation": "torque", "unit": unit},
    )
    model = read_model(folder)
    found = {q.name: q.unit for q in equations(model).parameters}
    assert found["Mc"] == found["constant_torque_torque_Nm"] == unit
    assert found["J"] == ("kg m^2" if unit == "N m" else "A s^2/rad")
    assert {equations(model).unit_of(n) for n in ("required", "drive", "load_torque")} == {unit}
    header = exported(model, "c").files["demo.h"]
    assert f"double required; /* {unit}:" in header
    written = yaml.safe_load(exported(model, "yaml").files["demo.yaml"])
    assert written["parameters"]["Mc"]["unit"] == unit
    files = exported(model, "mjcf").files
    assert 'gear="1"' in files["plain.xml"]
    assert "Error of the torque: " in files["plain.xml"]
    assert f" {unit} rms" in files["plain.xml"]
    assert set(files) == {"plain.xml"}


def test_the_yaml_has_the_curve_and_a_simulation_reads_it(tmp_path: Path) -> None:
    curve = {
        **{"equation": "torque", "coordinate": "angle", "unit": "rad", "residual_unit": "N m"},
        **{"grid": [-1.0, 1.0], "value": [0.7, 0.7], "against_motion": False},
    }
    model = read_model(result(tmp_path / "demo", curve=curve))
    written = yaml.safe_load(exported(model, "yaml").files["demo.yaml"])
    assert written["curve"] == curve
    time = np.arange(2000) / 500.0
    motion = lr.Recording(time, 0.3 * np.sin(2.0 * time))
    with_curve, plain = (
        lr.simulate(given, motion, draws=0).torque
        for given in (written, {n: v for n, v in written.items() if n != "curve"})
    )
    moving = np.isfinite(plain)
    assert (with_curve - plain)[moving] == pytest.approx(np.full(np.sum(moving), 0.7))
    with pytest.raises(lr.RecordingError, match="curve"):
        lr.simulate({**written, "curve": {"grid": [0.0]}}, motion, draws=0)


def test_the_yaml_has_the_unit_of_what_no_equation_uses(tmp_path: Path) -> None:
    model = read_model(
        result(
            tmp_path / "demo",
            [named(n) for n in ("time_skew", "wrong_weight", "encoder_slip", "cogging")],
            parameters={**PARAMETERS, "R": 1.5, "Ke": 0.026, "J_r": 0.1},
        )
    )
    assert [note.partition(":")[0] for note in model.notes] == ["J_r"]
    written = yaml.safe_load(exported(model, "yaml").files["demo.yaml"])
    units = {n: e["unit"] for n, e in written["parameters"].items()}
    assert (units["R"], units["Ke"], units["J_r"], units["mu_c"]) == (
        *("ohm", "V s/rad", "kg m^2"),
        "1",
    )
    units = {f"{e}.{n}": q["unit"] for e, own in written["effects"].items() for n, q in own.items()}
    assert units["time_skew.time_s"] == "s"
    assert units["wrong_weight.mass_kg"] == "kg"
    assert units["encoder_slip.angle_rad"] == "rad"
    assert units["cogging.per_motor_turn"] == "1/turn"
    assert units["wrong_weight.recording"] == "1"


def test_angles_of_the_motor_and_phases_are_in_rad_on_a_linear_bench(tmp_path: Path) -> None:
    model = read_model(result(tmp_path / "demo", [named("cogging")], motion="linear"))
    m = equations(model)
    assert m.unit_of("motor_angle") == "rad"
    header = exported(model, "simulink").files
    assert "double motor_angle; /* rad:" in header["demo.h"]
    assert "#define DEMO_COGGING_PHASE_RAD_LOW" in header["demo.h"]
    line = next(x for x in header["demo.h"].splitlines() if "COGGING_PHASE_RAD_LOW" in x)
    assert line.endswith("/* rad */")
    assert "motor_angle (rad)" in header["demo_sfun.c"]
    description = fmu_texts(m, 3)["modelDescription.xml"]
    for name, unit in (("motor_angle", "rad"), ("cogging_phase_rad", "rad"), ("angle", "m")):
        (line,) = (x for x in description.splitlines() if f'name="{name}"' in x)
        assert f'unit="{unit}"' in line
    modelica = exported(model, "modelica").files["demo.mo"]
    for name, unit in (("motor_angle", "rad"), ("cogging_phase_rad", "rad"), ("angle", "m")):
        (line,) = (x for x in modelica.splitlines() if re.search(rf" Real {name}\(", x))
        assert f'unit = "{unit}"' in line
    plain = exported(model, "mjcf").files["plain.xml"]
    assert " rad" not in plain.split("-->")[0]
    assert " N m" not in plain.split("-->")[0]


@compiler
@pytest.mark.proof
@pytest.mark.parametrize("effect", MOTION, ids=lambda e: e.name)
def test_twenty_draws_of_every_effect_agree(effect: Effect, tmp_path: Path) -> None:
    rng = np.random.default_rng(58)
    for _ in range(20):
        given = {
            q.name: float(rng.uniform(q.low, q.low + 0.4 * (q.high - q.low)))
            for q in effect.parameters
        }
        for q, n in zip(effect.forms, effect.forms.values(), strict=True):
            key = effect.nonlinear[q] if q < len(effect.nonlinear) else None
            if isinstance(key, str):
                given[key] = float(rng.choice(n))
        given |= {
            n: v * float(rng.uniform(0.7, 1.3)) for n, v in PLAUSIBLE.get(effect.name, {}).items()
        }
        folder = result(tmp_path / "demo", [effect])
        record = json.loads((folder / "diagnose.json").read_text())
        for name, value in given.items():
            record["effects"][0]["parameters"][name]["value"] = value
        (folder / "diagnose.json").write_text(json.dumps(record))
        checks = exported(read_model(folder), "c").checks
        assert max(checks.values()) < 1e-6, given


@compiler
@pytest.mark.proof
def test_a_step_takes_at_most_a_microsecond(tmp_path: Path) -> None:
    effects = [named(n) for n in ("presliding", "cogging", "gravity_imbalance")]
    folder = write(exported(read(tmp_path, *effects), "c").files, tmp_path / "out")
    (folder / "time.c").write_text(TIMED)
    command = ["cc", "-std=c99", "-O2", "time.c", "demo.c", "-o", "time", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    runs = [
        subprocess.run(["./time"], cwd=folder, check=True, capture_output=True, text=True).stdout
        for _ in range(3)
    ]
    assert min(map(float, runs)) <= 1e-6


TIMED = """\
#include "demo.h"
#include <math.h>
#include <stdio.h>
#include <time.h>

int main(void)
{
    const int steps = 300000;
    demo_model m;
    demo_inputs u = {0};
    demo_outputs y;
    clock_t start;
    demo_defaults(&m);
    start = clock();
    for (int k = 0; k < steps; k++) {
        u.current = 12.0 * sin(1e-4 * k);
        if (demo_step(&m, m.largest_step, &u, &y))
            return 1;
    }
    printf("%g", (double)(clock() - start) / CLOCKS_PER_SEC / steps);
    return 0;
}
"""
