"""What ``rig identify --plan`` leaves behind: text, a sequence that runs, a result file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import yaml

from identification.design.pinning import Pinned
from rig.common.errors import InputError
from rig.common.places import write_json, write_text
from rig.common.provenance import utc_now, versions
from rig.common.result_files import finite
from rig.common.tables import number, percent, table
from rig.config.sequence import Sequence, StageSection
from rig.results.design.experiment import Experiment

PLAN_SCHEMA = "loadrig.plan/1"
PROPOSAL_FILE, PLAN_FILE = "proposal.yaml", "plan.json"


def text(experiment: Experiment) -> str:
    """Return what is pinned now and would be, and the stages of the proposal, for the terminal."""
    now, then = experiment.proposal.present, experiment.proposal.pinned
    rows = [
        [
            n,
            number(experiment.nominal.values[n]),
            _width(now, n),
            _width(then, n),
            _gain(now, then, n),
        ]
        for n in now.half_widths
    ]
    header = [
        "parameter",
        "nominal",
        experiment.sequence.name,
        experiment.proposed.name,
        "times tighter",
    ]
    lines = [
        "90 % interval over the value, half width, from a rehearsal on the nominal model:",
        "",
        table(header, rows, (1, 2, 3, 4)),
        "",
        f"{experiment.sequence.name}: {_words(now)}",
        f"{experiment.proposed.name}: {_words(then)}",
        _advice(experiment),
        "",
        table(
            ["stage", "kg", "s", "excitation"],
            [_stage(s) for s in experiment.proposed.stages],
            (1, 2),
        ),
        "",
        f"nominal: {experiment.nominal_source}; current noise {experiment.current_noise_A:.3g} A "
        f"rms; "
        f"{_drive(experiment)}; {experiment.proposal.judged} excitations judged, "
        f"{experiment.proposal.rehearsed} experiments rehearsed, in {experiment.seconds:.1f} s",
    ]
    return "\n".join(lines)


def _advice(experiment: Experiment) -> str:
    """Say what the proposal is for; or that nothing better bore a rehearsal, and it is the sequence
    as it was.
    """
    aim = f"aimed at {experiment.proposal.weakest}, which is pinned worst now"
    if experiment.proposal.pinned == experiment.proposal.present:
        return (
            f"{aim}: no experiment that promises more bore its rehearsal, so the sequence is "
            f"proposed as it is; "
            "another --seed tries others"
        )
    return f"{aim}; where another parameter comes out wider, run both and identify them together"


def write(folder: Path, experiment: Experiment, bench: str, json_file: Path | None) -> Path:
    """Write proposal and result file into ``folder``, and the result once more where asked; return
    the proposal.

    Raises:
        InputError: A place cannot be written.
    """
    proposal = folder / PROPOSAL_FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(proposal, _yaml(experiment, bench))
        for path in filter(None, (folder / PLAN_FILE, json_file)):
            write_json(path, _record(experiment, bench))
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written: {error.strerror}; give --out or --json another place"
        ) from error
    return proposal


def _yaml(experiment: Experiment, bench: str) -> str:
    worst = experiment.proposal.pinned
    head = (
        f"# Proposed by `rig identify --plan` in place of {experiment.sequence.name}, bench "
        f"{bench}, "
        f"seed {experiment.seed}.\n# Nominal: {experiment.nominal_source}.\n# {_words(worst)}.\n"
    )
    return head + yaml.safe_dump(_plain(experiment.proposed), sort_keys=False, allow_unicode=True)


def _plain(sequence: Sequence) -> dict[str, Any]:
    """Return a sequence as its file states it; what is at its default is left out, but for what a
    reader looks for.
    """
    plain: dict[str, Any] = sequence.model_dump(mode="json", exclude_defaults=True)
    return {"sequence": sequence.sequence, **plain}


def _record(experiment: Experiment, bench: str) -> dict[str, Any]:
    used = versions()
    return {
        "schema": PLAN_SCHEMA,
        "version": used["loadrig"],
        "versions": dict(used),
        "created": utc_now().isoformat(timespec="seconds"),
        "seconds": experiment.seconds,
        "seed": experiment.seed,
        "bench": bench,
        "nominal": {"source": experiment.nominal_source, "values": dict(experiment.nominal.values)},
        "current_noise_A": experiment.current_noise_A,
        "aimed_at": experiment.proposal.weakest,
        "present": _pinned_record(experiment.sequence, experiment.proposal.present),
        "proposed": _pinned_record(experiment.proposed, experiment.proposal.pinned),
        "fisher_half_widths": {
            n: finite(w) for n, w in experiment.proposal.promised.half_widths.items()
        },
        "judged": experiment.proposal.judged,
        "rehearsed": experiment.proposal.rehearsed,
    }


def _pinned_record(sequence: Sequence, found: Pinned) -> dict[str, Any]:
    return {
        "sequence": _plain(sequence),
        "relative_half_widths": {name: finite(width) for name, width in found.half_widths.items()},
        "weakest": found.weakest,
    }


def _words(found: Pinned) -> str:
    open_names = [n for n, w in found.half_widths.items() if not math.isfinite(w)]
    if open_names:
        return f"says nothing of {', '.join(open_names)}"
    return (
        f"pins all {len(found.half_widths)}; the weakest is {found.weakest}, to "
        f"{percent(100.0 * found.worst)}"
    )


def _drive(experiment: Experiment) -> str:
    loop = experiment.nominal.loop
    if loop is None:
        return "a stiff drive loop is assumed"
    return f"drive loop as recorded: velocity gain {loop.velocity_gain:.3g} N m s/rad"


def _width(found: Pinned, name: str) -> str:
    width = found.half_widths[name]
    return percent(100.0 * width) if math.isfinite(width) else "not pinned"


def _gain(now: Pinned, then: Pinned, name: str) -> str:
    ratio = now.half_widths[name] / then.half_widths[name]
    return f"{ratio:.2g}" if math.isfinite(ratio) else "-"


def _stage(stage: StageSection) -> list[str]:
    return [stage.name, f"{stage.weight_kg:g}", f"{stage.duration_s:g}", excitation_words(stage)]


def excitation_words(stage: StageSection) -> str:
    """Return what a stage commands, in words: sines, or ramps."""
    if stage.ramp is not None:
        ramp = stage.ramp
        return (
            f"{ramp.times} times {ramp.travel_deg:g} deg there and back at "
            f"{ramp.speed_deg_s:g} deg/s"
        )
    return ", ".join(f"{t.amplitude_deg:g} deg at {t.frequency_Hz:g} Hz" for t in stage.tones)
