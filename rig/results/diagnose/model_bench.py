"""Converts a result file to a simulated bench, whose machine is the corrected model.

Effects and parameters have equal names in results and in bench files; only this module copies their
values from a result to a bench file.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from drivers.mock.plant.effects.pack import problems
from identification.effects.model import CorrectedModel
from identification.recording import Bench as Constants
from rig.common.errors import InputError
from rig.common.places import is_file
from rig.common.yaml_tree import parse
from rig.config.bench import Bench, load_bench
from rig.config.serial_bus import MOCK
from rig.results.diagnose.own_effects import NO_FILE, OwnFile
from rig.runs.mcap.reader import read_run
from rig.runs.recorded_inputs import JOINT_FIELDS
from rig.runs.run_record import BENCH_ATTACHMENT, RECORDING_FILE, RUN_FILE

BENCH_FILE = "bench.yaml"
_LOAD = ("mu_c", "mu_s", "mu_2")
_MOTOR = {
    "resistance_ohm": "resistance",
    "inductance_H": "inductance",
    "torque_constant_N_m_A": "torque_constant",
    "back_emf_constant_V_s_rad": "back_emf_constant",
    "gear_ratio": "gear_ratio",
}
_FITTED = {"R": "resistance_ohm", "Ke": "back_emf_constant_V_s_rad"}
"""Constants of the motor by the parameters that replace them."""
Tree = dict[str, Any]


def base_bench(source: Path) -> Tree:
    """Return the file of the bench on which a source was recorded, changed to the simulated bus, as
    plain data.

    Campaigns lack drive loops and limits; these come from the packaged practical bench.

    Raises:
        InputError: The run's bench cannot be read.
    """
    packaged = _plain(load_bench("practical").path.read_text(encoding="utf-8"))
    attached = None
    if is_file(source / RUN_FILE):
        attached = read_run(source / RECORDING_FILE).attachments.get(BENCH_ATTACHMENT)
    if attached is None:
        return packaged
    bench = _plain(attached.decode("utf-8"))
    if bench.get("bus", {}).get("interface", MOCK) != MOCK:
        bench |= {key: packaged[key] for key in ("bus", "servo", "encoder")}
    return {"mock": packaged["mock"], **bench}


def _plain(text: str) -> Tree:
    tree, _ = parse(text)
    plain = tree.plain()
    if not isinstance(plain, dict):
        raise InputError("the bench file in the recording is not a mapping")
    return plain


def model_bench(
    base: Mapping[str, Any], model: CorrectedModel, constants: Constants, own: OwnFile = NO_FILE
) -> tuple[Tree, list[str]]:
    """Return bench file data in which the model of a result is the simulated machine, and notes on
    the parts of the model that the machine cannot represent; effects of one's own are those that a
    function of their file injects.

    Raises:
        InputError: The result lacks values that a machine needs.
    """
    values = model.parameters
    notes = []
    missing = [n for n in ("J", "Mc", "Ms", "sigma_2") if n not in values]
    absent = [key for key, name in _MOTOR.items() if getattr(constants, name) is None]
    if missing or absent or constants.motion != "rotary":
        why = ", ".join([*missing, *absent]) or "rotary motion"
        raise InputError(
            f"a simulated bench needs {why}, which the result and its recordings do not contain"
        )
    bench = json.loads(json.dumps(base))
    mock = bench.setdefault("mock", {})
    joint = mock.setdefault("joint", {})
    joint.update(
        {JOINT_FIELDS[name]: value for name, value in values.items() if name in JOINT_FIELDS}
    )
    joint.update({JOINT_FIELDS[name]: 0.0 for name in _LOAD if name not in values})
    joint["alpha"] = model.alpha
    motor = {key: getattr(constants, name) for key, name in _MOTOR.items()}
    fitted = {key: values[name] for name, key in _FITTED.items() if name in values}
    mock["motor"] = {**mock.get("motor", {}), **motor, **fitted}
    bench["machine"] = {**bench["machine"], **motor}
    for section in (joint, bench["machine"]):
        section["lever_ratio"], section["gravity_m_s2"] = constants.lever_ratio, constants.gravity
        if constants.moment_arm is not None:
            section["moment_arm_m"] = constants.moment_arm
    for name, value in values.items():
        if value and name not in {**JOINT_FIELDS, **_FITTED}:
            notes.append(f"{name} = {value:.6g} is left out: the simulated machine has none")
    effects = dict(model.effects)
    mock.pop("effects_file", None)
    if own.path is not None and own.injects.keys() & effects.keys():
        mock["effects_file"] = str(own.path.resolve())
    for path, text in problems(effects, own=own.injects):
        notes.append(f"{path[0]} is left out of the simulated bench: {'.'.join(path)}: {text}")
        effects = {name: given for name, given in effects.items() if name != path[0]}
    mock["effects"] = effects
    if model.curve is not None:
        notes.append(
            "the empirical curve of the missing physics is left out of the simulated bench, "
            "which cannot contain a curve"
        )
    bench["name"] = f"{bench['name']}-corrected"
    return bench, notes


def bench_text(bench: Mapping[str, Any], notes: Sequence[str]) -> str:
    """Return the text of a bench file after a check against the schema.

    Raises:
        InputError: The corrected machine cannot be simulated.
    """
    try:
        Bench.model_validate_json(json.dumps(bench), strict=True)
    except ValueError as error:
        raise InputError(f"the corrected model cannot be simulated: {error}") from error
    head = [
        "# A simulated bench whose machine is the corrected model; run it with `rig run SEQUENCE "
        "--bench` this file."
    ]
    body = yaml.safe_dump(dict(bench), sort_keys=False, default_flow_style=False)
    return "\n".join([*head, *(f"# {note}" for note in notes)]) + "\n" + body
