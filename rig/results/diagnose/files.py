"""What a diagnosis leaves beside its report: the corrected model in three forms, and the experiment
that decides.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from identification.diagnosis.result import Verdict
from rig.common.errors import InputError
from rig.common.input_files import source_name
from rig.common.places import write_text
from rig.config.bench import Bench
from rig.results.diagnose.diagnose import Outcome
from rig.results.diagnose.gas_model_file import GAS_FILE, gas_text, of_gas
from rig.results.diagnose.model_bench import BENCH_FILE, base_bench, bench_text, model_bench
from rig.results.diagnose.model_export import PYTHON_FILE, YAML_FILE, python_text, yaml_text
from rig.results.diagnose.model_file import model_of
from rig.results.diagnose.separate import separating_sequence

SEQUENCE_FILE = "split.yaml"


@dataclass(frozen=True)
class Beside:
    """Files beside the report.

    Attributes:
        files: Name to what it is for.
        notes: What could not be written, and why.
    """

    files: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def write_beside(folder: Path, source: Path, outcome: Outcome, record: Mapping[str, Any]) -> Beside:
    """Write the corrected model as YAML, Python and simulated bench, and the experiment that splits
    an alias group.

    Args:
        folder: Where to; made already.
        source: Run folder or campaign file that was diagnosed.
        outcome: What was found.
        record: Its JSON.

    Raises:
        OSError: The folder cannot be written.
    """
    if of_gas(outcome.diagnosis):
        write_text(
            folder / GAS_FILE, gas_text(outcome.diagnosis, outcome.dataset.recordings[0].bench)
        )
        return Beside(
            ((GAS_FILE, "the corrected gas generator, as a block of a campaign file"),), ()
        )
    texts: list[tuple[str, str, str]] = []
    notes: list[str] = []
    recordings = outcome.dataset.recordings
    names = [r.name for r in recordings]
    base = base_bench(source)
    try:
        model = model_of(record, names, "the corrected model")
        name = source_name(source)
        texts.append((YAML_FILE, "the corrected model", yaml_text(model, recordings[0])))
        use = "the corrected model as plain Python functions; needs numpy alone"
        texts.append((PYTHON_FILE, use, python_text(model, recordings[0], name)))
        bench, left_out = model_bench(base, model, recordings[0].bench)
        use = f"the corrected model as a simulated bench: rig run SEQUENCE --bench {BENCH_FILE}"
        texts.append((BENCH_FILE, use, bench_text(bench, left_out)))
        notes += left_out
    except InputError as error:
        notes += error.problems
    if outcome.diagnosis.verdict is Verdict.AMBIGUOUS:
        limits = Bench.model_validate_json(json.dumps(base), strict=True)
        for effect in outcome.diagnosis.effects:
            sequence = (
                separating_sequence(effect.alias_group, limits)
                if len(effect.alias_group) > 1
                else None
            )
            if sequence is not None:
                use = (
                    f"splits {', '.join(effect.alias_group)}: rig run {SEQUENCE_FILE}, then "
                    f"diagnose both together"
                )
                texts.append((SEQUENCE_FILE, use, sequence))
                break
        else:
            notes.append("no sequence splits this group; the experiment needs a hand on the bench")
    for file, _, content in texts:
        write_text(folder / file, content)
    return Beside(tuple((file, use) for file, use, _ in texts), tuple(notes))
