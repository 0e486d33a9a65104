"""Output of ``rig identify --plan``: a planned experiment as a document for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator

from identification.design.simulated import Intervals
from rig.common.tables import number, percent
from rig.config.sequence import StageSection
from rig.results.design.experiment import Experiment
from rig.results.design.proposal import intervals_words
from rig.results.document import Document, Note, Section, Table


def plan_document(experiment: Experiment) -> Document:
    """Return the parameters that the given and the proposed sequence determine, and the stages of
    the proposal.
    """
    title = f"Experiment in place of {experiment.sequence.name}"
    return Document(title, "", tuple(_summary(experiment)))


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
    yield Section("", (_stages(experiment),))
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


def _stages(experiment: Experiment) -> Table:
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
