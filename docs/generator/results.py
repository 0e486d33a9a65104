"""Page of the result files' fields: the table ``results.txt``, held against the code that writes
them.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from keys import table

from drivers.interfaces import Identity, ServoLimits
from identification.diagnosis import result as diagnosis
from identification.estimate.fleet import Fleet, Odd, Population, Value
from identification.estimate.paper_method import Contender
from identification.estimate.simulated_ladder import Constant
from identification.numerics.arrays import RANGED
from identification.numerics.spread import Scatter, Spread
from identification.result import (
    Convergence,
    Fit,
    KnownConstant,
    MeasuredNoise,
    Parameter,
    Prior,
    Profile,
    Resampled,
    Starts,
    Tradeoff,
)
from identification.simulation.frequency_response import Margins, Wanted
from rig.cli.authoring.schema import meanings
from rig.commissioning.record import Measured
from rig.control.readings import Readings
from rig.fault_injection.inject import Finding
from rig.planning.predicted_load import PredictedPeak
from rig.results.acceptance.evidence import Check
from rig.results.catalogue.compare import Figure, RunFigures
from rig.results.catalogue.study import Studied, Study
from rig.results.response.tuning import Written
from rig.runs.catalogue.entry import Head
from rig.runs.run_record import PartRecord, RunRecord, SegmentRecord, StageRecord
from rig.sources.look import Clock, Column, Look

TABLE = Path(__file__).with_suffix(".txt")
_PROVENANCE = "Every result file"
WRITERS: Mapping[str, tuple[str, ...]] = {
    _PROVENANCE: ("rig.common.provenance:Provenance.record",),
    "rig identify: identify.json": (
        "identification.result:Identification.to_dict",
        "rig.results.identify.identify:ladder_record",
        "rig.results.identify.identify:simulated_record",
        "rig.results.identify.identify:transfer_record",
        "rig.results.identify.identify:outcome_record",
    ),
    "rig identify of several units: fleet.json": ("rig.results.fleet:fleet_record",),
    "rig identify --plan: plan file": ("rig.results.identify.plan:plan_record",),
    "rig diagnose: diagnose.json": (
        "identification.diagnosis.result:Diagnosis.to_dict",
        "rig.results.diagnose.model_file:diagnosis_record",
    ),
    "rig diagnose --observable": ("rig.results.diagnose.document:Seen.record",),
    "rig investigate: investigate.json": (
        "rig.investigate.page:investigation_record",
        "rig.investigate.investigation:Investigation._next",
    ),
    "rig simulate: simulate.json": (
        "rig.results.identify.simulate:simulation_record",
        "rig.results.identify.simulate:Simulation.errors",
    ),
    "rig check --json": (
        "rig.cli.commands.bench:examine",
        "rig.wiring.off:Proof.record",
        "rig.config.bench:calibration_records",
    ),
    "rig run --dry-run --json": (
        "rig.results.run.dry_run:dry_run_record",
        "rig.results.run.dry_run:acceptance_record",
    ),
    "rig commission: commission.json": (
        "rig.cli.commands.commission:commission_record",
        "rig.commissioning.commission:Commissioning.record",
        "rig.commissioning.record:StepRecord.record",
        "rig.control.motion_proof:Change.record",
        "rig.wiring.teardown:SafeState.record",
    ),
    "rig jog --json": ("rig.cli.commands.bench:_record", "rig.wiring.teardown:SafeState.record"),
    "rig off --json": ("rig.control.off:Off.record", "rig.wiring.teardown:SafeState.record"),
    "rig run --faults: faults.json": (),
    "rig effects --json": ("rig.results.diagnose.document:effects_record",),
    "rig look --json": ("rig.cli.commands.look:look_record",),
    "rig response: response.json": (
        "rig.results.response.measure:response_record",
        "rig.results.response.measure:_polar",
        "rig.results.response.measure:gains_record",
    ),
    "rig tune: tune.json": (
        "rig.results.response.tuning:tune_record",
        "rig.results.response.tuning:step_figures",
        "rig.results.response.measure:gains_record",
        "rig.cli.commands.response:_step",
    ),
    "rig runs list --json": ("rig.results.catalogue.listing:listing_record",),
    "rig runs show --json": ("rig.results.catalogue.listing:show_record",),
    "rig runs compare --json": ("rig.results.catalogue.compare:compare_record",),
    "rig runs trend --json": (
        "rig.results.catalogue.compare:trend_record",
        "rig.results.catalogue.compare:course_record",
    ),
    "rig runs study --json": (
        "rig.results.catalogue.study:study_record",
        "rig.results.catalogue.study:studies",
    ),
    "rig runs accept: acceptance.json": ("rig.results.acceptance.certificate:acceptance_record",),
    "rig paper: paper.json": (
        "rig.results.paper.tables:paper_record",
        "rig.results.paper.tables:_entry",
    ),
    "rig prove --investigate: prove.json": (
        "rig.investigate.proof:figures",
        "rig.investigate.proof:proof_record",
        "rig.investigate.proof:row_of",
    ),
    "rig prove: prove.json": (
        "rig.results.prove.score:proof_record",
        "rig.results.prove.score:score",
        "rig.results.prove.score:rate",
        "rig.results.prove.score:location_f1",
        "rig.results.prove.score:middle",
        "rig.results.prove.score:names_given",
        "rig.results.prove.score:reliability",
        "rig.results.prove.score:_parts",
        "rig.results.prove.run:_row",
        "rig.results.prove.score:row_of",
        "rig.results.prove.score:_hits",
        "rig.results.prove.score:_parameters",
        "rig.results.prove.score:_nominal",
        "rig.results.prove.score:_held_out",
        "rig.results.prove.score:located",
    ),
}
"""Section of the table to the functions whose dictionaries are written."""
_RECORDS: Mapping[str, tuple[type, ...]] = {
    "rig identify: identify.json": (
        *(Convergence, Fit, KnownConstant, MeasuredNoise, Parameter, Prior, Profile, Resampled),
        *(Starts, Tradeoff, Constant, Contender, Spread),
    ),
    "rig diagnose: diagnose.json": (
        *(diagnosis.Curve, diagnosis.Estimate, diagnosis.Fit, diagnosis.IdentifiedEffect),
        *(
            diagnosis.Location,
            diagnosis.Rival,
            diagnosis.Shift,
            diagnosis.Step,
            diagnosis.Diagnosis,
            Spread,
        ),
    ),
    "rig identify of several units: fleet.json": (Fleet, Odd, Population, Value),
    "rig commission: commission.json": (Measured,),
    "rig check --json": (Identity, Readings, ServoLimits),
    "rig run --dry-run --json": (PredictedPeak,),
    "rig tune: tune.json": (Margins, Wanted, Written),
    "rig runs list --json": (Head,),
    "rig runs accept: acceptance.json": (Check,),
    "rig runs compare --json": (Figure, RunFigures),
    "rig runs study --json": (Scatter, Studied, Study),
    "rig run --faults: faults.json": (Finding,),
    "rig look --json": (Look, Clock, Column),
}
"""Section to the records that are written field by field."""
_INTERNAL = frozenset({"transmission", "voltage", "right"}) | frozenset(
    {
        "absolute",
        "cost_history",
        "excess",
        "guesses",
        "parameter_history",
        "prior",
        "turn",
        *diagnosis.NOT_WRITTEN,
    }
)
"""Keys of dictionaries that stay inside these functions, and fields that records leave out."""
_COMPUTED: Mapping[str, frozenset[str]] = {
    "rig response: response.json": frozenset({"low", "high", "open_position", "open_speed"}),
    "rig runs list --json": frozenset({"run"}),
    "rig runs compare --json": frozenset({"low", "high"}),
    "rig diagnose: diagnose.json": frozenset(RANGED),
    "rig identify: identify.json": frozenset(
        {
            *RANGED,
            *("corrections", "compared", "ladder", "simulated_ladder", "transfer"),
            *("comparison", "partial"),
        }
    ),
    "rig simulate: simulate.json": frozenset({"fit", "validate"}),
    "rig investigate: investigate.json": frozenset(
        {
            *("run", "sequence", "reason", "seconds", "weight_changes", "state", "purpose"),
            *("predicted_sha256", "band_held", "error_rms", "floor_rms", "verdict"),
        }
    ),
    "rig prove --investigate: prove.json": frozenset(
        {
            *("right", "wrong", "open", "missed", "right_all", "wrong_all", "open_all"),
            *("missed_all", "repeated_right", "repeated_wrong", "repeated_open"),
            *("repeated_missed", "experiments_to_name", "minutes_to_name"),
        }
    ),
    "rig check --json": frozenset({"servo", "encoder", "pressure", "limits", "difference_rad"}),
    "rig run --faults: faults.json": frozenset({"faults"}),
}
"""Keys that are not written as literals in these functions."""
_INTRO = """\
Result files are JSON in SI units. `NAME` stands for a key that depends on the result, such as a
parameter or a recording; `[]` stands for each item of a list. Values that JSON does not have
(infinite, not a number) are `null`.

On a linear bench read m for rad and N for N m."""


def sections() -> dict[str, list[tuple[str, str, str]]]:
    """Return the table: section to path, unit and meaning of each field."""
    found: dict[str, list[tuple[str, str, str]]] = {}
    rows: list[tuple[str, str, str]] = []
    for line in TABLE.read_text(encoding="utf-8").splitlines():
        if line.startswith("== "):
            rows = found.setdefault(line[3:], [])
        elif line and not line.startswith("#"):
            path, unit, text = (cell.strip() for cell in line.split("|", 2))
            rows.append((path, unit, text))
    return found


def written_keys(place: str) -> set[str]:
    """Return the text keys of all dictionaries in a function, ``module:name`` or
    ``module:class.name``.
    """
    module, _, name = place.partition(":")
    found: object = importlib.import_module(module)
    for part in name.split("."):
        found = getattr(found, part)
    assert callable(found)
    tree = ast.parse(textwrap.dedent(inspect.getsource(found)))
    dicts = [node for node in ast.walk(tree) if isinstance(node, ast.Dict)]
    return {
        key.value
        for d in dicts
        for key in d.keys
        if isinstance(key, ast.Constant) and isinstance(key.value, str)
    }


def problems() -> Iterator[str]:
    """Yield every field that is written and not in the table, or in the table and not written."""
    table_of = sections()
    common = written_keys(WRITERS[_PROVENANCE][0])
    for section, places in WRITERS.items():
        written = {key for place in places for key in written_keys(place)}
        written |= {
            f.name for record in _RECORDS.get(section, ()) for f in dataclasses.fields(record)
        }
        described = {part for path, _, _ in table_of[section] for part in _parts(path)}
        skipped = set() if section == _PROVENANCE else common | {"file"}
        unknown = written - described - skipped - _INTERNAL
        yield from (f"{section}: {key} is written and not described" for key in sorted(unknown))
        gone = described - written - _COMPUTED.get(section, frozenset()) - {"", "NAME"}
        yield from (f"{section}: {key} is described and not written" for key in sorted(gone))
    for section in table_of.keys() ^ WRITERS.keys():
        yield f"{section}: a section of results.txt or of WRITERS alone"


def _parts(path: str) -> Iterable[str]:
    return re.split(r"[.,\[\]\s]+", path)


def page() -> str:
    """Return the page.

    Raises:
        KeyError: A field is not described.
    """
    if wrong := list(problems()):
        raise KeyError("; ".join(wrong))
    parts = ["# Result files", _INTRO]
    for section, rows in sections().items():
        parts.append(f"## {section}")
        parts.append(
            table(
                ("field", "unit", "meaning"),
                [(f"`{p}`".replace(", ", "`, `"), u, t) for p, u, t in rows],
            )
        )
    parts += [
        "## rig run: run.json",
        "The file states the progress of a run, and is replaced as a whole at every change.",
    ]
    for record, path in (
        (RunRecord, ""),
        (StageRecord, "stages[]"),
        (SegmentRecord, "segments[]"),
        (PartRecord, "parts[]"),
    ):
        known = meanings(record)
        rows = [
            (
                f"`{path + '.' if path else ''}{field.name}`",
                known[field.name].unit,
                known[field.name].text,
            )
            for field in dataclasses.fields(record)
        ]
        parts.append(table(("field", "unit", "meaning"), rows))
    return "\n\n".join(parts) + "\n"
