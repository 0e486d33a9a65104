"""``rig tune``: proposed gains, the step they are expected to give, and how they are written."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from identification.numerics.arrays import Array, plain
from identification.plots.response import Curve, bode, steps
from identification.simulation import frequency_response as numerics
from identification.simulation.frequency_response import (
    Gains,
    Margins,
    OpenLoop,
    Proposal,
    Spectra,
    Wanted,
)
from rig.common.errors import InputError
from rig.common.provenance import Provenance
from rig.common.tables import number
from rig.common.yaml_tree import parse
from rig.config.bench import Bench
from rig.config.configuration import Document as File
from rig.planning.predicted_load import FrictionModel
from rig.results.diagnose.model_bench import bench_text
from rig.results.document import (
    Document,
    Note,
    Picture,
    Section,
    Table,
    Verdict,
    provenance_section,
)
from rig.results.response.excitation import CYCLES_PER_PERIOD
from rig.results.response.measure import (
    MARGIN_HEADER,
    LoopPlace,
    gains_record,
    gains_table,
    linear_plant,
)

RESULT_FILE, TUNE_SCHEMA = "tune.json", "loadrig.tune/1"
RAMP: Final = (0.5, 1.0)
"""Steps from the old gains to the new ones, as shares of the way on a logarithmic scale."""
LOST_DEG: Final = 15.0
"""Phase margin below the expected one at which a step of the ramp has failed."""
RIPPLE: Final = 3.0
"""Factor on the ripple of the torque, beside that on the gain of the speed loop (without one, of
the position loop), that counts as an oscillation.
"""
_BAND: Final = 0.02  # band around the final value of a settled step
_SPEED_RAD_S: Final = 0.2  # speed at which the friction of a model is linear
_KEYS: Final[Mapping[str, Mapping[str, str]]] = {
    "host": {
        "position": "position_gain_1_s",
        "speed": "speed_gain_N_m_s_rad",
        "reset": "reset_1_s",
    },
    "drive": {
        "position": "position_gain",
        "speed": "velocity_gain_N_m_s_rad",
        "reset": "velocity_integral_1_s",
    },
}


@dataclass
class Written:
    """What came of the gains that were tried: ``state`` is `written`, or `restored` after the first
    step that failed, for the reason ``why``.
    """

    state: str = "restored"
    why: str = ""
    steps: list[dict[str, Any]] = field(default_factory=list)
    file: str | None = None


@dataclass(frozen=True)
class Tuning:
    """Proposed gains."""

    bench: str  # name of the bench
    place: LoopPlace  # where the position loop is closed
    source: str  # what the gains follow from, for the reader
    seen: Spectra
    old: Gains  # present gains
    before: Mapping[str, Margins]  # their margins, by loop
    wanted: Wanted  # the wanted margins
    proposal: Proposal  # the proposed gains and their margins
    written: Written | None  # what came of them, or None if they were not tried
    provenance: Provenance

    @property
    def good(self) -> bool:
        """Whether the gains have the wanted margins and, if they were tried, were kept."""
        tried = self.written is None or self.written.state == "written"
        return tried and not self.proposal.problem

    def loop(self, new: bool) -> OpenLoop:
        """Return the open position loop with the new or the old gains."""
        gains = self.proposal.gains if new else self.old
        return numerics.with_gains(self.seen, self.old, gains)["position"]

    @property
    def step(self) -> tuple[Array, Array]:
        """Time and unit step of the new closed position loop without feed-forward."""
        loop = self.loop(True)
        at = numerics.margins(loop).crossover_Hz or float(loop.frequency_Hz[0])
        time = np.linspace(0.0, 2.5 / at, 400)
        return time, numerics.step_response(loop, time)


def modelled(
    document: File[Bench], place: LoopPlace, friction: FrictionModel
) -> tuple[Spectra, Gains]:
    """Return the spectra that the model of an identification would give, without a run.

    Raises:
        InputError: The bench file does not state the gains, or the speed loop is in the drive.
    """
    gains = place.stated
    if gains is None or place.host == "speed":
        raise InputError(
            f"{document.path}: the gains of this drive are not known before a measurement; use a "
            "result of `rig response`, or no --result"
        )
    inertia, damping = linear_plant(friction, _SPEED_RAD_S)
    bench = document.value
    top = bench.cycle_Hz / CYCLES_PER_PERIOD
    lines = np.geomspace(1e-3 * top, top, 60)
    late = 0.0
    if place.host:
        # The angle is a cycle old; the torque is held for a cycle.
        late, gains = bench.cycle_s, dataclasses.replace(gains, delay_s=0.5 * bench.cycle_s)
    plant = numerics.rigid_plant(lines, inertia, damping)
    return numerics.modelled(lines, gains, plant, late), gains


def keys_of(document: File[Bench], place: LoopPlace) -> tuple[tuple[str, ...], Mapping[str, str]]:
    """Return the section of the bench file with the gains, and the keys of the gains.

    Raises:
        InputError: The gains are in a real drive, which this program does not change.
    """
    if place.host:
        return ("servo", "position_loop"), _KEYS["host"]
    if document.value.simulated:
        return ("mock", "loops"), _KEYS["drive"]
    raise InputError(
        f"{document.path}: the gains are in the drive, which this program does not change: run "
        "without --write, set the gains that are printed with the maker's tool, and run "
        "`rig response` again"
    )


def with_gains(document: File[Bench], place: LoopPlace, old: Gains, new: Gains) -> str:
    """Return the text of the bench file with other gains. Gains of the file change by the ratio of
    the new gains to the old ones, as these were measured; a reset of 0 becomes the new one.
    """
    section, keys = keys_of(document, place)
    tree, _ = parse(document.path.read_text(encoding="utf-8-sig"))
    bench: Any = tree.plain()
    below = bench
    for name in section:
        below[name] = dict(below.get(name) or {})
        below = below[name]
    assert place.stated is not None
    for name, key in keys.items():
        before, after = getattr(old, name), getattr(new, name)
        stated = getattr(place.stated, name)
        if before and stated:
            below[key] = float(f"{stated * after / before:.6g}")
        elif after and name == "reset" and place.stated.speed:
            below[key] = float(f"{after:.6g}")
    return bench_text(bench, ["gains by `rig tune`"])


def between(old: Gains, new: Gains, share: float) -> Gains:
    """Return gains on the way from old to new ones, on a logarithmic scale."""
    found = {}
    for name in ("position", "speed", "reset"):
        before, after = getattr(old, name), getattr(new, name)
        found[name] = before ** (1.0 - share) * after**share if before > 0.0 < after else after
    return dataclasses.replace(new, **found)


def tune_record(found: Tuning) -> dict[str, Any]:
    """Return the record of ``rig tune --json``."""
    return {
        **found.provenance.record(TUNE_SCHEMA),
        "bench": found.bench,
        "loop_closed_by": found.place.host or "drive",
        "source": found.source,
        "wanted": asdict(found.wanted),
        "gains": {
            "old": gains_record(found.old),
            "proposed": gains_record(found.proposal.gains),
        },
        "margins": {
            "old": {name: asdict(m) for name, m in found.before.items()},
            "proposed": {name: asdict(m) for name, m in found.proposal.margins.items()},
        },
        "step": step_figures(*found.step),
        "problem": found.proposal.problem,
        "written": None if found.written is None else plain(found.written),
    }


def step_figures(time: Array, step: Array) -> dict[str, float | None]:
    """Return rise time from 10 to 90 %, overshoot, and time until the step stays within 2 %."""
    first = [np.flatnonzero(step >= level) for level in (0.1, 0.9)]
    outside = np.flatnonzero(np.abs(step - 1.0) > _BAND)
    settled = len(outside) == 0 or outside[-1] + 1 < len(time)
    return {
        "rise_s": float(time[first[1][0]] - time[first[0][0]]) if len(first[1]) else None,
        "overshoot_percent": max(100.0 * (float(np.max(step)) - 1.0), 0.0),
        "settling_s": float(time[outside[-1] + 1]) if settled and len(outside) else None,
    }


def tune_document(found: Tuning, document: File[Bench]) -> Document:
    """Return proposed gains as a document."""
    proposal, written = found.proposal, found.written
    said = f"They follow from {found.source}."
    verdict = Verdict("The proposed gains have the wanted margins", said, "good")
    if problem := proposal.problem:
        verdict = Verdict("The wanted margins or bandwidth are not reached", problem, "open")
    gains = gains_table({"old": found.old, "proposed": proposal.gains})
    rows = [
        (when, name, *(number(v, 4) for v in m.values().values()), number(m.highest_Hz, 3))
        for when, each in (("old", found.before), ("proposed", proposal.margins))
        for name, m in each.items()
    ]
    header = ("gains", *(MARGIN_HEADER[k] for k in (0, 1, 3, 4, 6, 7)))
    margins = Table(header, tuple(rows), (2, 3, 4, 5, 6))
    time, after = found.step
    figures = (
        f"{name.rpartition('_')[0]} {number(value, 3)} {name.rpartition('_')[2]}"
        for name, value in step_figures(time, after).items()
    )
    step = Note(f"expected step without feed-forward: {', '.join(figures)}")
    fate = Note("nothing was written")
    if written is not None:
        state = f"{written.state}: {written.why}" if written.why else written.state
        fate = Note(state, "plain" if written.state == "written" else "warning")
    summary = [Section("", (verdict, gains, margins, step, fate))]
    if not found.place.host:
        table = _tool_table(document.value, proposal.gains)
        summary.append(Section("For the drive's own tool", (table,)))
    loops = {"old": found.loop(False), "proposed": found.loop(True)}
    drawn = steps(time, {"old": numerics.step_response(loops["old"], time), "proposed": after})
    curves = [Curve(name, loop.frequency_Hz, loop.response) for name, loop in loops.items()]
    pictures = (
        Picture.of("step", "Expected step of the position loop", drawn, lead=True),
        Picture.of("open_loop", "Open position loop", bode(curves, "")),
    )
    return Document(
        f"Gains for {found.bench}",
        f"{found.wanted.phase_deg:g} deg, {found.wanted.gain_dB:g} dB",
        tuple(summary),
        (*summary, Section("Response", pictures), provenance_section(found.provenance)),
    )


def _tool_table(bench: Bench, gains: Gains) -> Table:
    """Return the gains in the units of drives' tools: a cascade at the joint, the cascade per turn
    of the motor (ODrive), a PID controller of the torque, and of the current at the motor (EPOS4).
    """
    gear = bench.machine.gear_ratio
    per_ampere = bench.machine.torque_constant_N_m_A * gear
    kp, kv, ki = gains.position, gains.speed, gains.reset
    pid = {"P": kv * (kp + ki), "I": kv * kp * ki, "D": kv} if kv else {"P": kp}
    units = {"P": "rad", "I": "(rad s)", "D": "(rad/s)"}
    rows = []
    if kv:
        turn = kv * 2.0 * math.pi / gear**2
        rows += [
            ("cascade, per motor turn", "position", number(kp, 4), "(turn/s)/turn"),
            ("cascade, per motor turn", "speed", number(turn, 4), "N m/(turn/s)"),
            ("cascade, per motor turn", "integral", number(turn * ki, 4), "N m/turn"),
        ]
    for words, factor, unit in (
        ("controller of the joint's torque", 1.0, "N m/"),
        ("controller of the motor's current", 1.0 / (gear * per_ampere), "A/"),
    ):
        rows += [(words, n, number(v * factor, 4), unit + units[n]) for n, v in pid.items()]
    return Table(("form", "gain", "value", "unit"), tuple(rows), (2,))
