"""Files of a diagnosis next to its report: the corrected model in up to three formats, and the
experiment that splits an alias group.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from identification.diagnosis.gas import PRESSURE
from identification.diagnosis.result import Diagnosis, Verdict
from identification.recording import Bench as Constants
from rig.common.errors import InputError
from rig.common.places import source_name
from rig.config.bench import Bench
from rig.results.diagnose.diagnose import Outcome
from rig.results.diagnose.model_bench import BENCH_FILE, base_bench, bench_text, model_bench
from rig.results.diagnose.model_export import PYTHON_FILE, YAML_FILE, python_text, yaml_text
from rig.results.diagnose.model_file import model_of
from rig.results.diagnose.separate import separating_sequence

SEQUENCE_FILE = "split.yaml"
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
    """Return the corrected model in all formats, and the experiment that splits an alias group."""
    if outcome.diagnosis.fit.equation == PRESSURE:
        use = "the corrected gas generator, as a block of a campaign file"
        text = _gas_text(outcome.diagnosis, outcome.dataset.recordings[0].bench)
        return Exports((Export(GAS_FILE, use, text),), ())
    base = base_bench(source)
    files, notes = _models(source_name(source), base, outcome, record)
    if outcome.diagnosis.verdict is Verdict.AMBIGUOUS:
        splitting = _splitting(base, outcome.diagnosis)
        if splitting is not None:
            files.append(splitting)
        else:
            notes.append(
                "no sequence splits this group; the experiment needs a manual change of the bench"
            )
    return Exports(tuple(files), tuple(notes))


def _models(
    name: str, base: Mapping[str, Any], outcome: Outcome, record: Mapping[str, Any]
) -> tuple[list[Export], list[str]]:
    """Return the corrected model in all possible formats, and why others are not possible."""
    files: list[Export] = []
    recordings = outcome.dataset.recordings
    first = recordings[0]
    try:
        model = model_of(record, [r.name for r in recordings], "the corrected model")
        files.append(Export(YAML_FILE, "the corrected model", yaml_text(model, first)))
        use = "the corrected model as plain Python functions; needs only numpy"
        files.append(Export(PYTHON_FILE, use, python_text(model, first, name)))
        bench, left_out = model_bench(base, model, first.bench)
        use = f"the corrected model as a simulated bench: rig run SEQUENCE --bench {BENCH_FILE}"
        files.append(Export(BENCH_FILE, use, bench_text(bench, left_out)))
    except InputError as error:
        return files, list(error.problems)
    return files, list(left_out)


def _splitting(base: Mapping[str, Any], found: Diagnosis) -> Export | None:
    """Return the sequence that splits the first alias group that a sequence can split."""
    limits = Bench.model_validate_json(json.dumps(base), strict=True)
    for effect in found.effects:
        group = effect.alias_group
        sequence = separating_sequence(group, limits) if len(group) > 1 else None
        if sequence is not None:
            use = (
                f"distinguishes {', '.join(group)}: rig run {SEQUENCE_FILE}, then diagnose the old "
                "and the new recordings together"
            )
            return Export(SEQUENCE_FILE, use, sequence)
    return None


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
