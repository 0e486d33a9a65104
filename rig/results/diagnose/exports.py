"""Files beside a diagnosis: the corrected model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from identification.diagnosis.gas import PRESSURE
from identification.diagnosis.result import Diagnosis, Verdict
from identification.effects.model import CorrectedModel
from identification.export.python import python_text
from identification.numerics.arrays import plain
from identification.recording import Bench as Constants
from identification.recording import Recording
from rig.common.errors import InputError
from rig.common.places import source_name
from rig.results.diagnose.diagnose import RESULT_FILE, Outcome
from rig.results.diagnose.document import diagnose_document
from rig.results.diagnose.model_bench import BENCH_FILE, base_bench, bench_text, model_bench
from rig.results.diagnose.model_file import model_of
from rig.results.document import PAGE_FILE, Document, write_page, write_record, write_texts
from rig.results.measured import facts_of

YAML_FILE, PYTHON_FILE = "model.yaml", "model.py"


def yaml_text(model: CorrectedModel, recording: Recording) -> str:
    """Return parameters, constants of the bench, effects and curve as YAML, SI."""
    record: dict[str, Any] = {
        "model": 1,
        "parameters": {name: float(value) for name, value in model.parameters.items()},
        "alpha": float(model.alpha),
        "constants": {
            k: v
            for k, v in model.numbers(recording).items()
            if k not in model.parameters and k != "alpha"
        },
        "effects": {
            name: {k: float(v) for k, v in given.items()} for name, given in model.effects.items()
        },
    }
    if model.curve is not None:
        record["curve"] = plain(model.curve)
    return "# Corrected model, SI units, at the joint after the gear.\n" + yaml.safe_dump(
        record, sort_keys=False
    )


GAS_FILE = "gas_generator.yaml"
_KEYS = {
    "a": "burning_coefficient",
    "n": "pressure_exponent",
    "C_r": "characteristic_velocity",
    "V_0": "free_volume",
}
"""Keys in a campaign file by the names of the fitted constants."""
_VALVE_KEYS = {"d": "hole_diameter", "D": "opening_diameter", "b": "plate_width"}


class Export(NamedTuple):
    """One file: name, purpose and text."""

    name: str
    use: str
    text: str


class Exports(NamedTuple):
    """Files next to the report, with notes on files that are incomplete or could not be made."""

    files: tuple[Export, ...]
    notes: tuple[str, ...]


def exports(source: Path, outcome: Outcome, record: Mapping[str, Any]) -> Exports:
    """Return the corrected model in all formats."""
    if outcome.diagnosis.fit.equation == PRESSURE:
        use = "the corrected gas generator, as a block of a campaign file"
        text = _gas_text(outcome.diagnosis, outcome.dataset.recordings[0].bench)
        return Exports((Export(GAS_FILE, use, text),), ())
    base = base_bench(source)
    files, notes = _models(source_name(source), base, outcome, record)
    if outcome.diagnosis.verdict is Verdict.AMBIGUOUS:
        notes.append("`rig design` proposes the experiment that distinguishes this group")
    return Exports(tuple(files), tuple(notes))


def write_diagnosis(
    source: Path, outcome: Outcome, folder: Path, json_file: Path | None = None
) -> tuple[dict[str, Any], Document, Exports]:
    """Write result file, corrected model and page of a diagnosis into a folder; return the record,
    the document, and the files beside it.
    """
    record = outcome.record()
    write_record(record, folder / RESULT_FILE, json_file)
    beside = exports(source, outcome, record)
    write_texts({file.name: file.text for file in beside.files}, folder)
    document = diagnose_document(source_name(source), outcome, beside, facts_of(source))
    write_page(document, folder / PAGE_FILE)
    return record, document, beside


def _models(
    name: str, base: Mapping[str, Any], outcome: Outcome, record: Mapping[str, Any]
) -> tuple[list[Export], list[str]]:
    """Return the corrected model in all possible formats, and why others are not possible."""
    files: list[Export] = []
    notes: list[str] = []
    recordings = outcome.dataset.recordings
    first = recordings[0]
    try:
        names = [r.name for r in recordings]
        model = model_of(record, names, "the corrected model", outcome.own.catalogue)
        files.append(Export(YAML_FILE, "the corrected model", yaml_text(model, first)))
        use = "the corrected model as plain Python functions; needs only numpy"
        try:
            files.append(Export(PYTHON_FILE, use, python_text(model, first, name)))
        except ValueError as error:  # a function of the user's own uses what text cannot contain
            notes.append(f"{PYTHON_FILE} is not written: {error}")
        bench, left_out = model_bench(base, model, first.bench, outcome.own)
        use = f"the corrected model as a simulated bench: rig run SEQUENCE --bench {BENCH_FILE}"
        files.append(Export(BENCH_FILE, use, bench_text(bench, left_out)))
    except InputError as error:
        return files, [*notes, *error.problems]
    return files, [*notes, *left_out]


def _gas_text(found: Diagnosis, bench: Constants) -> str:
    """Return the corrected gas generator as YAML, a block of a campaign file."""
    g = bench.gas_generator
    assert g is not None
    block = {
        "propellant_density": g.rho_b,
        "grain_diameter": g.D_P,
        **{key: float(found.parameters[name]) for name, key in _KEYS.items()},
        "heat_ratio": g.gamma,
        "back_pressure": g.p_c0,
        "valve": {key: float(found.parameters[name]) for name, key in _VALVE_KEYS.items()},
    }
    effects: Mapping[str, Any] = {
        e.name: {n: float(v.value) for n, v in e.parameters.items()} for e in found.effects
    }
    return (
        "# Corrected constants, for `bench:` of a campaign; free_volume is the mean over the "
        "recordings.\n"
        + yaml.safe_dump({"gas_generator": block}, sort_keys=False)
        + "# Effects that eq. 2 to 8 do not contain; `rig effects NAME` prints the equations "
        "of each.\n" + yaml.safe_dump({"effects": effects}, sort_keys=False)
    )
