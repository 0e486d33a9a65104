"""Output of ``rig identify --plan``: a planned experiment as a document for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import yaml

from identification.design.simulated import Intervals
from rig.common.provenance import finite, utc_now, versions
from rig.common.tables import number, percent
from rig.config.sequence import Sequence, StageSection
from rig.results.design.experiment import Experiment
from rig.results.document import Document as Page, Note, Section, Table

PROPOSAL_FILE = "proposal.yaml"


def proposal_text(experiment: Experiment, bench: str) -> str:
    """Return the sequence file of a proposal; a comment states its purpose."""
    determined = intervals_words(experiment.proposal.proposed)
    head = (
        f"# Proposed by `rig identify --plan` in place of {experiment.sequence.name}, bench "
        f"{bench}, seed {experiment.seed}.\n"
        f"# Nominal: {experiment.nominal_source}.\n# {determined}.\n"
    )
    return head + yaml.safe_dump(
        plain_sequence(experiment.proposed), sort_keys=False, allow_unicode=True
    )


def plain_sequence(sequence: Sequence) -> dict[str, Any]:
    """Return a sequence as the mapping of its file; most keys with default values are omitted."""
    given: dict[str, Any] = sequence.model_dump(mode="json", exclude_defaults=True)
    return {"sequence": sequence.sequence, **given}


def intervals_words(found: Intervals) -> str:
    """Return a message on the number of determined parameters and on the least accurate
    parameter.
    """
    open_names = [n for n, w in found.half_widths.items() if not math.isfinite(w)]
    if open_names:
        return f"does not determine {', '.join(open_names)}"
    return (
        f"determines all {len(found.half_widths)}; the weakest is {found.weakest}, to "
        f"{percent(100.0 * found.worst)}"
    )


def plan_document(experiment: Experiment) -> Page:
    """Return the parameters that the given and the proposed sequence determine, and the stages of
    the proposal.
    """
    title = f"Experiment in place of {experiment.sequence.name}"
    return Page(title, "", tuple(_summary(experiment)))


def _summary(experiment: Experiment) -> Iterator[Section]:
    now, then = experiment.proposal.present, experiment.proposal.proposed
    sequence, proposed = experiment.sequence.name, experiment.proposed.name
    head = (
        "90 % interval over the value, half width, from simulated replicates of the nominal model:"
    )
    yield Section("", (Note(head),))
    yield Section("", (_widths(experiment),))
    lines = (
        f"{sequence}: {intervals_words(now)}",
        f"{proposed}: {intervals_words(then)}",
        _advice(experiment),
    )
    yield Section("", tuple(map(Note, lines)))
    yield Section("", (_stage_table(experiment),))
    last = (
        f"nominal: {experiment.nominal_source}; current noise {experiment.current_noise_A:.3g} A "
        f"rms; {_drive(experiment)}; {experiment.proposal.judged} excitations judged, "
        f"{experiment.proposal.identified} experiments simulated and "
        f"identified, in {experiment.seconds:.1f} s"
    )
    yield Section("", (Note(last),))


def _widths(experiment: Experiment) -> Table:
    now, then = experiment.proposal.present, experiment.proposal.proposed
    names = (experiment.sequence.name, experiment.proposed.name)
    rows = tuple(
        (
            n,
            number(experiment.nominal.values[n]),
            _width(now, n),
            _width(then, n),
            _gain(now, then, n),
        )
        for n in now.half_widths
    )
    return Table(("parameter", "nominal", *names, "times tighter"), rows, (1, 2, 3, 4))


def _stage_table(experiment: Experiment) -> Table:
    rows = tuple(
        (stage.name, f"{stage.weight_kg:g}", f"{stage.duration_s:g}", excitation_words(stage))
        for stage in experiment.proposed.stages
    )
    return Table(("stage", "kg", "s", "excitation"), rows, (1, 2))


def _advice(experiment: Experiment) -> str:
    """Return the purpose of the proposal, or a statement that no proposal was better than the given
    sequence.
    """
    aim = f"aimed at {experiment.proposal.weakest}, so far the least accurate parameter"
    if experiment.proposal.proposed == experiment.proposal.present:
        return (
            f"{aim}: no other experiment had narrower intervals when it was simulated and "
            "identified, so the given sequence is proposed unchanged; with another --seed, other "
            "experiments are tried"
        )
    return (
        f"{aim}; if another parameter gets a wider interval, run both sequences and "
        "identify both runs together"
    )


def _drive(experiment: Experiment) -> str:
    loop = experiment.nominal.loop
    if loop is None:
        return "a stiff drive loop is assumed"
    return f"drive loop as recorded: velocity gain {loop.velocity_gain:.3g} N m s/rad"


def _width(found: Intervals, name: str) -> str:
    width = found.half_widths[name]
    return percent(100.0 * width) if math.isfinite(width) else "not determined"


def _gain(now: Intervals, then: Intervals, name: str) -> str:
    ratio = now.half_widths[name] / then.half_widths[name]
    return f"{ratio:.2g}" if math.isfinite(ratio) else "-"


def excitation_words(stage: StageSection) -> str:
    """Return a description of the excitation of a stage: sines or ramps."""
    if stage.ramp is not None:
        ramp = stage.ramp
        return (
            f"{ramp.times} times {ramp.travel_deg:g} deg out and back at {ramp.speed_deg_s:g} deg/s"
        )
    return ", ".join(f"{t.amplitude_deg:g} deg at {t.frequency_Hz:g} Hz" for t in stage.tones)


PLAN_SCHEMA = "loadrig.plan/1"
RESULT_FILE = "plan.json"


def plan_record(experiment: Experiment, bench: str) -> dict[str, Any]:
    """Return the record of ``rig identify --plan --json``."""
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
        "present": _intervals_record(experiment.sequence, experiment.proposal.present),
        "proposed": _intervals_record(experiment.proposed, experiment.proposal.proposed),
        "fisher_half_widths": {
            n: finite(w) for n, w in experiment.proposal.predicted.half_widths.items()
        },
        "judged": experiment.proposal.judged,
        "rehearsed": experiment.proposal.identified,
    }


def _intervals_record(sequence: Sequence, found: Intervals) -> dict[str, Any]:
    return {
        "sequence": plain_sequence(sequence),
        "relative_half_widths": {name: finite(width) for name, width in found.half_widths.items()},
        "weakest": found.weakest,
    }
