"""Writes the model of a result for other tools, with test files, after a check against model.py."""

from __future__ import annotations

import csv
import importlib.util
import io
import math
import platform
import re
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import yaml

from identification.effects.model import CorrectedModel
from identification.effects.own import OwnEffect, sampled
from identification.export.c import EVERY, c_texts, s_function_text
from identification.export.fmu import fmu_texts
from identification.export.machine import INPUTS, Machine, machine
from identification.export.mjcf import mjcf_texts
from identification.export.modelica import NAMES, modelica_test, modelica_text
from identification.export.printed import simulation_text
from identification.export.python import python_text
from identification.model.parameters import UNITS_ROTARY, parameter_unit
from identification.numerics.arrays import plain
from identification.recording import Array, Bench, Recording
from rig.common.errors import InputError
from rig.common.places import is_file, is_folder
from rig.common.provenance import RESULT_FILE as IDENTIFY_FILE
from rig.results.diagnose.diagnose import RESULT_FILE as DIAGNOSE_FILE
from rig.results.diagnose.model_file import model_of, read_result
from rig.results.diagnose.own_effects import NO_FILE, OwnFile

SAMPLES = 1000
"""Number of samples of each test file."""
TOLERANCE = 1e-6
"""Greatest difference from model.py and from the expected outputs, relative to the greatest value.
"""
BEYOND_STATIC = 1.5
"""Greatest torque of the current in the test files, relative to static friction."""
MOTION, SIMULATION = "test_motion.csv", "test_simulation.csv"
PYTHON_FILE = "model.py"
_UNITS = {**UNITS_ROTARY, "R": "ohm", "Ke": "V s/rad", "J_r": "kg m^2"}
"""Units of the parameters on a rotary bench."""
_COMPILE = ("-std=c99", "-O2")
_TAKEN = frozenset({"fmu", "simstruc", *NAMES, *INPUTS, *EVERY})
"""Names that no model has, in small letters: those of other files, and those of Modelica."""


@dataclass(frozen=True)
class Model:
    """The model of a result file."""

    path: Path  # the result file
    name: str  # name in the exported files, an identifier
    corrected: CorrectedModel  # nominal parameters and effects
    bench: Bench  # constants of the bench
    machine: Machine | None  # equations; None without inertia, with which nothing can be simulated
    # Name of a parameter, or `effect.parameter`, to the ends of its interval.
    intervals: Mapping[str, tuple[float | None, float | None]]
    ranges: Mapping[str, tuple[float, float]]  # signal to its least and greatest value
    notes: tuple[str, ...]  # what the reader should know
    own: bool = True  # whether the equations contain effects of one's own
    amperes: bool = False  # whether torques are in amperes

    def without(self, effect: str) -> Machine:
        """Return the equations without one effect."""
        kept = {n: v for n, v in self.corrected.effects.items() if n != effect}
        plain = replace(self.corrected, effects=kept)
        given = self.name, plain, self.bench
        return machine(*given, {}, self.ranges, own=self.own, amperes=self.amperes)

    def checked(self) -> Model:
        """Return the model, without equations of effects of one's own if they are not those of
        model.py.
        """
        catalogue = self.corrected.catalogue
        own = any(isinstance(catalogue[name], OwnEffect) for name in self.corrected.effects)
        if not own or self.machine is None:
            return self
        try:
            tested(self, self.machine)
        except InputError:  # an export with these equations says so
            return self
        except (RuntimeError, ValueError):
            given = self.corrected, self.bench, self.intervals, self.ranges, self.machine.source
            made = machine(self.name, *given, own=False, amperes=self.amperes)
            return replace(self, machine=made, own=False)
        return self


@dataclass(frozen=True)
class Exported:
    """Files of an export, with what was checked: output to difference, relative."""

    files: Mapping[str, str | bytes]
    checks: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_model(given: Path, own: OwnFile = NO_FILE) -> Model:
    """Read the model of a result file, or of a folder with one, with the effects of a file of one's
    own.

    Raises:
        InputError: There is no result file, or the result lacks what a model needs.
    """
    path = given
    if is_folder(given):
        tried = [given / DIAGNOSE_FILE, given / "diagnosis" / DIAGNOSE_FILE, given / IDENTIFY_FILE]
        path = next((p for p in tried if is_file(p)), given)
        if path is given:
            raise InputError(
                f"{given}: has neither {DIAGNOSE_FILE} nor {IDENTIFY_FILE}; run rig identify or "
                "rig diagnose first, or name the file"
            )
    record = read_result(path)
    constants = record.get("constants")
    if not isinstance(constants, Mapping):
        raise InputError(
            f"{path}: constants: the file lacks the constants of the bench, as an earlier version "
            "wrote it; repeat rig identify or rig diagnose"
        )
    named = (e["where"]["recordings"] for e in record.get("effects", ()))
    recordings = list(dict.fromkeys(name for names in named for name in names))
    corrected = model_of(record, recordings, str(path), own.catalogue)
    try:
        bench = Bench(motion=record["motion"], **constants)
    except (TypeError, KeyError) as error:
        raise InputError(f"{path}: constants: {error}") from error
    ranges = {n: (float(low), float(high)) for n, (low, high) in record.get("ranges", {}).items()}
    if bench.moment_arm and "moment" in ranges:
        low, high = ranges.pop("moment")
        ranges["contact_force"] = low / bench.moment_arm, high / bench.moment_arm
    folder = path.resolve().parent
    folder = folder.parent if folder.name == "diagnosis" else folder
    name = name_of(folder.name)
    intervals = _intervals(record)
    made = None
    if corrected.parameters.get("J", 0.0) > 0.0:
        source = f"the model in {path.name} of {folder.name}"
        made = machine(
            name, corrected, bench, intervals, ranges, source, amperes=_in_amperes(record)
        )
    notes = tuple(
        f"{n}: the recordings do not determine this parameter; the fitted value is used"
        for n, entry in record.get("parameters", {}).items()
        if isinstance(entry, Mapping) and entry.get("value") is None and n in corrected.parameters
    )
    if corrected.parameters.get("J_r"):
        notes += ("J_r: left out, as motor and joint move as one body, of inertia J",)
    return Model(
        *(path, name, corrected, bench, made, intervals, ranges, notes),
        amperes=_in_amperes(record),
    ).checked()


def _in_amperes(record: Mapping[str, Any]) -> bool:
    """Whether the torque equation of a result is in amperes."""
    fits = [*record.get("fits", ()), record.get("fit", {})]
    return any(f.get("equation", "torque") == "torque" and f.get("unit") == "A" for f in fits)


def name_of(folder: str) -> str:
    """Return the name of the model of a folder: an identifier that no format has for anything else,
    in files nor in its language.
    """
    name = re.sub(r"\W", "_", folder, flags=re.ASCII).strip("_") or "model"
    free = name[0].isalpha() and name.lower() not in _TAKEN
    return name if free else f"m_{name}"


def _intervals(record: Mapping[str, Any]) -> dict[str, tuple[float | None, float | None]]:
    found = {
        name: (entry.get("low"), entry.get("high"))
        for name, entry in record.get("parameters", {}).items()
        if isinstance(entry, Mapping)
    }
    for effect in record.get("effects", ()):
        for name, entry in effect["parameters"].items():
            found[f"{effect['name']}.{name}"] = entry.get("low"), entry.get("high")
    return found


def exported(model: Model, kind: str, fmi: int = 3) -> Exported:
    """Return the files of an export, after a check against model.py.

    Args:
        model: The model.
        kind: One of :data:`FORMATS`.
        fmi: Version of FMI.

    Raises:
        InputError: The result lacks what the format needs.
    """
    if kind == "yaml":
        return Exported({f"{model.name}.yaml": _yaml(model)})
    if model.machine is None:
        raise InputError(
            f"{model.path}: parameters.J: must be above 0 for a simulation (got "
            f"{model.corrected.parameters.get('J', 0.0):g}); state J under model.fixed in the "
            "campaign and identify again, or choose --format yaml"
        )
    tests, checks = tested(model, model.machine)
    files, notes, more = FORMATS[kind](model, model.machine, tests, fmi)
    files = files if kind == "mjcf" else {**files, **tests}
    return Exported(files, {**checks, **more}, (*model.notes, *notes))


Made = tuple[Mapping[str, str | bytes], Sequence[str], Mapping[str, float]]
"""Files, notes and checks of a format."""


def _python(model: Model, m: Machine, tests: Mapping[str, str], _fmi: int) -> Made:
    return {PYTHON_FILE: _model_py(model), "simulate.py": simulation_text(m)}, (), {}


def _c(model: Model, m: Machine, tests: Mapping[str, str], _fmi: int) -> Made:
    texts = c_texts(m)
    notes, checks = _run({**texts, **tests}, m.name)
    return texts, notes, checks


def _simulink(model: Model, m: Machine, tests: Mapping[str, str], _fmi: int) -> Made:
    texts, notes, checks = _c(model, m, tests, _fmi)
    return {**texts, f"{m.name}_sfun.c": s_function_text(m)}, notes, checks


def _fmu(model: Model, m: Machine, tests: Mapping[str, str], fmi: int) -> Made:
    notes, checks = _run({**c_texts(m), **tests}, m.name)
    texts: dict[str, str | bytes] = dict(fmu_texts(m, fmi))
    with _written(texts) as folder:
        sources = [f"sources/{m.name}.c", "sources/fmu.c"]
        flags = ("-fPIC", "-shared", "-fvisibility=hidden", "-o", "binary")
        place, compiler = binary_place(m.name, fmi), shutil.which("cc")
        if place and compiler and not _compiled(compiler, folder, *sources, *flags):
            texts[place] = (folder / "binary").read_bytes()
        else:
            notes = [*notes, "the FMU contains the sources alone; no binary could be compiled"]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in sorted(texts.items()):
            archive.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return {f"{m.name}.fmu": stream.getvalue()}, notes, checks


def binary_place(name: str, fmi: int) -> str | None:
    """Return the place of this computer's binary in an FMU; None if FMI has none for it."""
    system, kind = platform.system().lower(), platform.machine().lower()
    kind = {"amd64": "x86_64", "arm64": "aarch64"}.get(kind, kind)
    ending = {"linux": "so", "darwin": "dylib", "windows": "dll"}.get(system)
    if ending is None or (fmi == 2 and kind != "x86_64"):
        return None
    short = "win64" if system == "windows" else f"{system}64"
    return f"binaries/{f'{kind}-{system}' if fmi == 3 else short}/{name}.{ending}"


def _modelica(model: Model, m: Machine, tests: Mapping[str, str], _fmi: int) -> Made:
    signal = _excitation(model, m)
    mass = signal.force / (model.bench.lever_ratio * model.bench.gravity)
    load = signal.force, mass
    text = modelica_test(m, signal.peak, signal.frequency, load, signal.loaded_from)
    note = "the Modelica text was not compiled; the test file is for a compiler of your choice"
    return {f"{m.name}.mo": modelica_text(m), "test.mo": text}, (note,), {}


def _mjcf(model: Model, m: Machine, _tests: Mapping[str, str], _fmi: int) -> Made:
    without = {name: model.without(name) for name in model.corrected.effects}
    values = {**model.corrected.parameters}
    bench = model.bench
    known = {
        "torque_constant": bench.torque_constant,
        "gear_ratio": bench.gear_ratio,
        "resistance": values.get("R", bench.resistance),
        "back_emf_constant": values.get("Ke", bench.back_emf_constant),
    }
    values |= {n: value for n, value in known.items() if value is not None}
    return mjcf_texts(m, without, values["J"], values), (), {}


FORMATS: Mapping[str, Callable[[Model, Machine, Mapping[str, str], int], Made]] = {
    "python": _python,
    "c": _c,
    "fmu": _fmu,
    "modelica": _modelica,
    "mjcf": _mjcf,
    "simulink": _simulink,
}
"""Formats with the equations; ``yaml`` has the numbers alone."""


def _model_py(model: Model) -> str:
    channels = {"time": np.array([0.0, 1.0])}
    empty = Recording(name="none", channels=channels, bench=model.bench)
    try:
        return python_text(model.corrected, empty, model.name)
    except ValueError as error:  # a function of one's own uses what text cannot contain
        raise InputError(f"{PYTHON_FILE} cannot be written: {error}") from error


def _yaml(model: Model) -> str:
    """Return parameters, constants and effects with units, intervals and ranges."""

    m = model.machine or machine(
        model.name,
        replace(model.corrected, parameters={**model.corrected.parameters, "J": 1.0}),
        *(model.bench, model.intervals, model.ranges),
        amperes=model.amperes,
    )
    units = {n: m.unit(u) for n, u in _UNITS.items()} | {
        f"{name}.{q.name}": parameter_unit(m.motion, q.name, q.unit, m.amperes) or "1"
        for name in model.corrected.effects
        for q in model.corrected.catalogue[name].parameters
    }

    def entry(key: str, value: float) -> dict[str, Any]:
        low, high = model.intervals.get(key, (None, None))
        ends = {} if low is None or high is None else {"low": float(low), "high": float(high)}
        return {"value": float(value), "unit": units.get(key, "1"), **ends}

    record = {
        "model": 2,
        "motion": model.bench.motion,
        "parameters": {n: entry(n, value) for n, value in model.corrected.parameters.items()},
        "alpha": float(model.corrected.alpha),
        "constants": {
            q.name: {"value": float(q.value), "unit": q.unit}
            for q in m.parameters
            if q.words == "constant of the bench"
        },
        "effects": {
            name: {key: entry(f"{name}.{key}", value) for key, value in given.items()}
            for name, given in model.corrected.effects.items()
        },
        **({} if model.corrected.curve is None else {"curve": plain(model.corrected.curve)}),
        "ranges": {n: [float(x) for x in ends] for n, ends in model.ranges.items()},
        "not_simulated": {left.name: left.reason for left in m.left_out},
    }
    return f"# {model.name}: SI units, at the joint after the gear.\n" + yaml.safe_dump(
        record, sort_keys=False
    )


@dataclass(frozen=True)
class _Excitation:
    """Inputs of the test: a sine of the current, and a contact force from a time on."""

    peak: float
    frequency: float
    force: float
    loaded_from: float


def _excitation(model: Model, m: Machine) -> _Excitation:
    value = {**model.corrected.parameters}.get
    force = m.ranges.get("contact_force", (0.0, 0.0))[1]
    arm = model.bench.moment_arm or 0.0
    static = max(value("Ms", 0.0), value("Mc", 0.0)) + value("mu_s", 0.0) * force * arm
    duration = SAMPLES * m.largest_step
    turning = value("J", 1.0) * (2.0 * math.pi * 3.0 / duration) * 0.1
    peak = BEYOND_STATIC * max(static, turning) / model.bench.ampere_torque
    return _Excitation(float(f"{peak:.6g}"), float(f"{3.0 / duration:.6g}"), force, 0.5 * duration)


def tested(model: Model, m: Machine) -> tuple[dict[str, str], dict[str, float]]:
    """Return the test files, and the differences of the equations from model.py.

    Raises:
        InputError: A simulation with these values diverges.
        RuntimeError: The equations differ from model.py.
    """
    lacking = {left.name for left in m.left_out if left.whole}
    kept = {n: v for n, v in model.corrected.effects.items() if n not in lacking}
    comparable = replace(model, corrected=replace(model.corrected, effects=kept))
    texts = {PYTHON_FILE: _model_py(comparable), "simulate.py": simulation_text(m)}
    with _written(texts) as folder:
        reference, simulate = (_imported(folder / name) for name in texts)
    signal = _excitation(model, m)
    step, forward = m.largest_step, simulate.Model()
    time = step * np.arange(SAMPLES)
    current = signal.peak * np.sin(2.0 * math.pi * signal.frequency * time)
    force = np.where(time > signal.loaded_from, signal.force, 0.0)
    mass = force / (model.bench.lever_ratio * model.bench.gravity)
    inputs = {
        "current": current,
        "contact_force": force,
        "load_torque": np.zeros(SAMPLES),
        "weight_mass": mass,
    }
    rows = []
    for k in range(SAMPLES):
        u = {n: float(s[k]) for n, s in inputs.items()}
        try:
            out = forward.step(step, **u) if k else dict.fromkeys(EVERY, 0.0)
        except (ValueError, OverflowError) as error:
            raise InputError(
                f"{model.path}: a simulation diverges {time[k]:.3g} s after its start with a "
                f"current of up to {signal.peak:g} A: no machine has these values of "
                f"{', '.join(model.corrected.effects) or 'the parameters'}; diagnose recordings "
                "that determine them better"
            ) from error
        rows.append([float(time[k]), *u.values(), *(out[n] for n in EVERY)])
    always = {n: np.full(SAMPLES, s[-1]) for n, s in inputs.items()} | {"current": current}
    always["load_torque"] = np.full(SAMPLES, 0.1 * signal.peak * model.bench.ampere_torque)
    motion, checks = _inverse(model, m, simulate.Model(), reference, always)
    worst = max(checks.values())
    if not worst <= TOLERANCE:
        raise RuntimeError(f"the equations differ from model.py by {worst:.3g}: {checks}")
    return {MOTION: _csv(motion), SIMULATION: _csv(rows)}, checks


def _inverse(
    model: Model, m: Machine, simulated: Any, reference: ModuleType, inputs: Mapping[str, Array]
) -> tuple[list[list[float]], dict[str, float]]:
    """Return rows of a motion with its outputs, and their differences from model.py.

    model.py has all samples of a recording; a simulation has those up to the present. Therefore
    differences over one step take the place of central differences in model.py, the value at the
    sample that of the mean over its period, the greatest step that before the first sample, and
    friction at the start is zero.
    """
    low, high = m.ranges.get("angle", (-0.3, 0.3))
    fastest = max(map(abs, m.ranges.get("velocity", (0.5,))))
    amplitude, middle = 0.5 * (high - low), 0.5 * (low + high)
    rate = min(fastest / amplitude if amplitude > 0.0 else 1.0, 50.0)
    step = 4.0 * math.pi / rate / SAMPLES
    time = step * np.arange(SAMPLES)
    # Two periods; the motion rests where it turns for the first time.
    rest = 0.25 * math.pi / rate
    phase = rate * (time - np.clip(time - 0.5 * math.pi / rate, 0.0, rest))
    resting = (time >= 0.5 * math.pi / rate) & (time <= 0.5 * math.pi / rate + rest)
    angle = middle + amplitude * np.sin(phase)
    velocity = np.where(resting, 0.0, amplitude * rate * np.cos(phase))
    acceleration = np.where(resting, 0.0, -amplitude * rate**2 * np.sin(phase))
    rows = []
    for k in range(SAMPLES):
        u = {n: float(s[k]) for n, s in inputs.items()}
        moved = float(angle[k]), float(velocity[k]), float(acceleration[k])
        out = simulated.inverse(step if k else m.largest_step, *moved, **u)
        rows.append([float(time[k]), *u.values(), *(out[n] for n in EVERY)])
    for name, here in (
        ("central_difference", lambda v, h: np.concatenate(([0.0], np.diff(v) / h))),
        ("initial_friction", lambda *_: 0.0),
        ("mean_over_sample", lambda view, zero, _, law: law(view.current - zero)),
        ("sampled", partial(sampled, first=m.largest_step)),
    ):
        setattr(reference, name, here)
    s = reference.signals(
        *(reference.M, time, angle, velocity, acceleration),
        contact_force=inputs["contact_force"],
        weight_mass=inputs["weight_mass"],
        current=inputs["current"],
        known=inputs["load_torque"],
    )
    s.voltage, s.rotor_acceleration = reference.winding_voltage(s), acceleration
    found = dict(zip(EVERY, np.array(rows)[:, 1 + len(INPUTS) :].T, strict=True))
    expected = {
        "required": reference.torque(s),
        "drive": reference.drive(s),
        "motor_angle": model.bench.gear_ratio * (angle + reference.twist(s)),
        "voltage": reference.voltage(s),
    }
    return rows, {
        name: float(np.max(np.abs(found[name] - series)) / max(np.max(np.abs(series)), 1e-12))
        for name, series in expected.items()
    }


def _csv(rows: Sequence[Sequence[float]]) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["time", *INPUTS, *EVERY])
    writer.writerows([[repr(float(x)) for x in row] for row in rows])
    return stream.getvalue()


@contextmanager
def _written(texts: Mapping[str, str | bytes]) -> Iterator[Path]:
    """Yield a temporary folder with files."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, content in texts.items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            data = content.encode() if isinstance(content, str) else content
            (folder / file).write_bytes(data)
        yield folder


def _compiled(compiler: str, folder: Path, *arguments: str) -> str:
    """Compile C; return the first line of the error, or an empty text."""
    done = subprocess.run(
        [compiler, *_COMPILE, *arguments, "-lm"], cwd=folder, capture_output=True, text=True
    )
    status = f"exit status {done.returncode}"
    return (done.stderr.strip() or status).splitlines()[0] if done.returncode else ""


def _run(texts: Mapping[str, str], name: str) -> tuple[list[str], dict[str, float]]:
    """Compile the C, and compare it with the test files.

    Raises:
        InputError: The compiler fails, or the simulation amplifies rounding errors.
        RuntimeError: The C differs from the test files.
    """
    compiler = shutil.which("cc")
    if compiler is None:
        return ["the C was not checked: this computer has no C compiler (cc)"], {}
    with _written(texts) as folder:
        if problem := _compiled(compiler, folder, f"{name}.c", "test.c", "-o", "test"):
            raise InputError(
                f"{name}: the C cannot be checked, as {compiler} does not compile it: {problem}; "
                "repair the compiler, or take it off the PATH to export without a check"
            )
        done = subprocess.run([folder / "test"], cwd=folder, capture_output=True, text=True)
    lines = [line.split() for line in done.stdout.splitlines()]
    found = {f"{file.removesuffix('.csv')}.{key}": float(value) for file, key, value in lines}
    if done.returncode:
        if all(v <= TOLERANCE for k, v in found.items() if k.startswith("test_motion")):
            raise InputError(
                f"{name}: rounding errors of the simulation grow to "
                f"{found.get('test_simulation.angle', math.nan):.2g} of the angle: no machine has "
                "these values of its effects; diagnose recordings that determine them better"
            )
        raise RuntimeError(f"the C differs from the test files: {found}")
    return [], {f"c.{key}": value for key, value in found.items()}


def _imported(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
