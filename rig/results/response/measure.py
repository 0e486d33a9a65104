"""``rig response``: evaluates the run of an excitation; its record and its document."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from drivers.canopen.motion import LoopGains, derived
from identification.model.friction import system_friction
from identification.numerics.arrays import Array, finite, plain
from identification.plots.response import Curve, bode, nyquist
from identification.simulation import frequency_response as numerics
from identification.simulation.frequency_response import (
    Complex,
    Estimate,
    Fitted,
    Gains,
    NoResponseError,
    OpenLoop,
    Spectra,
)
from rig.common.errors import InputError
from rig.common.places import read_json
from rig.common.provenance import Provenance
from rig.common.tables import interval, number, percent
from rig.config.bench import Bench
from rig.config.canopen import ServoSection
from rig.config.configuration import Document as File
from rig.planning.predicted_load import FrictionModel
from rig.results.document import (
    Document,
    Note,
    Paragraph,
    Picture,
    Section,
    Table,
    Verdict,
    columns,
    provenance_section,
)
from rig.results.response.excitation import LARGE, QUIET, SMALL, Excitation
from rig.runs.run import load_run

RESULT_FILE, RESPONSE_SCHEMA = "response.json", "loadrig.response/1"
FITTED_SHARE: Final = 1.0 / 8.0  # highest frequency of the fitted gains, as a share of the cycle
BENT: Final = 4.0  # standard errors between two amplitudes that count as a difference
GAIN_ERROR, CUT_ERROR = 3.0, 12.0
"""Relative errors of a fitted position gain, and of the cut-off of the speed filter, over the
relative torque that the gains leave, at 90 %; found on simulated benches.
"""
GAIN_UNITS: Final = {
    "position": "1/s",
    "speed": "N m s/rad",
    "reset": "1/s",
    "ahead": "1",
    "delay_s": "s",
    "filter_Hz": "Hz",
}
Host = Literal["", "speed", "torque"]


@dataclass(frozen=True)
class LoopPlace:
    """Where the position loop of a bench is closed: in the drive, or by the host that commands a
    speed or a torque; and its gains as far as the bench file states them.
    """

    host: Host
    stated: Gains | None
    step_rad: float

    @property
    def words(self) -> str:
        """Place of the loop, for the reader."""
        return f"in this program, which commands a {self.host}" if self.host else "in the drive"


def loop_place(document: File[Bench]) -> LoopPlace:
    """Return where the position loop of a bench is closed.

    Raises:
        InputError: The drive moves by ramps of its own (mode `pp`).
    """
    bench = document.value
    servo, step = bench.servo, 0.0
    mode = "csp"
    if isinstance(servo, ServoSection):
        mode = servo.commanded(servo.device_data(document.path.parent))
        step = 2.0 * math.pi / (servo.counts_per_motor_turn * bench.machine.gear_ratio)
    if mode == "pp":
        text = "in mode pp the drive moves by its own ramps and has no response; use csp, csv, cst"
        raise InputError(document.problem(("servo",), text))
    if mode != "csp":
        assert isinstance(servo, ServoSection)
        loop = servo.position_loop
        given = LoopGains(
            loop.position_gain_1_s or 0.0, loop.speed_gain_N_m_s_rad or 0.0, loop.reset_1_s or 0.0
        )
        torque = mode == "cst"
        found = derived(bench.cycle_s, (loop.inertia_kg_m2 or 0.0) if torque else None, given)
        gains = Gains(found.position_1_s, found.speed_N_m_s_rad, found.reset_1_s, 1.0)
        return LoopPlace("torque" if torque else "speed", gains, step)
    if bench.mock is None or not bench.simulated:
        return LoopPlace("", None, step)
    known = bench.mock.loops
    cascade = known.velocity_gain_N_m_s_rad
    if cascade is None:
        return LoopPlace("", Gains(known.position_gain), step)
    gains = Gains(
        known.position_gain,
        cascade,
        known.velocity_integral_1_s,
        known.velocity_feedforward,
        filter_Hz=known.velocity_filter_Hz,
    )
    return LoopPlace("", gains, step)


@dataclass(frozen=True)
class Response:
    """A measured response."""

    bench: str  # name of the bench
    place: LoopPlace  # where the position loop is closed
    seen: Spectra  # spectra of all windows with tones
    fitted: Fitted  # gains; misfit 0 where they are those of the host
    loops: Mapping[str, OpenLoop]  # the open loops on their certain lines
    margins: Mapping[str, Mapping[str, Estimate]]  # margins with intervals, by loop
    background: Array  # amplitude of the angle without tones over that with them, (f,)
    differ: Array  # standard errors between the two amplitudes, (f,)
    # Open loops with the plant of the nominal model, linear at the speed of the carrier.
    model: Mapping[str, OpenLoop]
    inertia: float  # inertia of that plant, kg m^2
    damping: float  # damping of that plant, N m s/rad
    friction: FrictionModel  # where these constants come from, and the Coulomb friction
    ripple_N_m: float  # rms of the torque's changes from sample to sample with the tones
    provenance: Provenance


def linear_plant(friction: FrictionModel, speed_rad_s: float) -> tuple[float, float]:
    """Return inertia and slope of the friction without load at a speed: the nominal model,
    linearised where the joint does not reverse.
    """
    ends = speed_rad_s * np.array([0.99, 1.01])
    low, high = system_friction(ends, friction.values, friction.alpha)
    return friction.values["J"], float(high - low) / float(ends[1] - ends[0])


def evaluate(
    document: File[Bench], folder: Path, made: Excitation, friction: FrictionModel, seed: int
) -> Response:
    """Evaluate the run of an excitation.

    Raises:
        InputError: The recording does not contain a usable response.
    """
    started = time.perf_counter()
    bench, place = document.value, loop_place(document)
    dataset = load_run(folder)
    recorded = {r.name.partition("[")[0]: r for r in dataset.recordings}
    step, lines = place.step_rad, made.frequency_Hz
    try:
        parts = {
            name: numerics.spectra([recorded[name]], lines, made.windows[name], step, place.host)
            for name in (SMALL, LARGE)
            if name in recorded
        }
        if place.host and place.stated is not None:
            fitted = Fitted(place.stated, 0.0, False)
        else:
            tones = [recorded[name] for name in parts]
            highest = FITTED_SHARE * bench.cycle_Hz
            fitted = numerics.fit_gains(tones, highest, step, place.stated)
            parts = {
                name: numerics.without_images(part, fitted.gains, bench.cycle_s)
                for name, part in parts.items()
            }
        small, large = parts.get(SMALL, parts[LARGE]), parts[LARGE]
        seen = small.together(large) if SMALL in parts else large
        loops = numerics.loops(seen, fitted.gains)
        if "position" not in loops:
            raise NoResponseError("the noise hides the position loop on nearly all lines")
    except NoResponseError as error:
        raise InputError(f"{folder}: {error}") from error
    quiet = np.zeros(len(lines))
    if QUIET in recorded:
        noise = numerics.background(recorded[QUIET], lines, made.windows[QUIET])
        quiet = noise / (np.abs(large.mean().angle[0]) * large.amplitude_rad)
    speed = 0.85 * made.carrier_rad_s
    inertia, damping = linear_plant(friction, speed)
    plant = numerics.rigid_plant(lines, inertia, damping)
    model = {
        name: OpenLoop(loops[name].frequency_Hz, loop.response[at])
        for name, loop in numerics.with_plant(seen, fitted.gains, plant).items()
        if name in loops
        for at in [np.isin(lines, loops[name].frequency_Hz)]
    }
    return Response(
        bench.name,
        place,
        seen,
        fitted,
        loops,
        margins_of(seen, fitted, loops),
        quiet,
        numerics.bent(small, large) if SMALL in parts else np.zeros(len(lines)),
        model,
        inertia,
        damping,
        friction,
        numerics.ripple(recorded[LARGE], made.windows[LARGE]),
        Provenance.of(seed, dataset.recordings, time.perf_counter() - started, folder),
    )


def margins_of(
    seen: Spectra, fitted: Fitted, loops: Mapping[str, OpenLoop]
) -> dict[str, dict[str, Estimate]]:
    """Return the margins of open loops with intervals: from the scatter over the windows, and from
    the errors of the fitted gains, which grow with the torque that the gains leave.
    """
    found: dict[str, dict[str, Estimate]] = {}
    gains = fitted.gains
    others = [
        dataclasses.replace(gains, position=gains.position * (1.0 + GAIN_ERROR * fitted.misfit)),
        dataclasses.replace(gains, filter_Hz=gains.filter_Hz / (1.0 + CUT_ERROR * fitted.misfit)),
    ]
    for name, loop in loops.items():
        part = seen.only(np.isin(seen.frequency_Hz, loop.frequency_Hz))

        def compute(
            one: Spectra, with_gains: Gains = gains, name: str = name, loop: OpenLoop = loop
        ) -> dict[str, float | None]:
            exact = numerics.loops(one.mean(), with_gains)[name]
            return numerics.margins(dataclasses.replace(exact, error=loop.error)).values()

        found[name] = {}
        moved = [compute(part, other) for other in others] if fitted.misfit else []
        for key, (value, low, high) in numerics.with_intervals(part, compute).items():
            # The interval also contains the independent changes of the gains.
            if value is not None and low is not None and high is not None:
                offs = (other - value for m in moved if (other := m[key]) is not None)
                half = math.hypot(0.5 * (high - low), *offs)
                low, high = value - half, value + half
            found[name][key] = Estimate(value, low, high)
    return found


def response_record(found: Response) -> dict[str, Any]:
    """Return the record of ``rig response --json``."""
    seen = found.seen
    one = seen.mean()
    loops = numerics.loops(one, found.fitted.gains)
    curves = {"plant": one.plant, "closed": one.closed}
    curves |= {f"open_{name}": loop.response for name, loop in loops.items()}
    certain = {name: loop.frequency_Hz for name, loop in found.loops.items()}
    lines = [
        {
            "frequency_Hz": float(f),
            "amplitude_deg": math.degrees(float(seen.amplitude_rad[k])),
            "coherence": float(seen.coherence()[k]),
            "background": float(found.background[k]),
            "amplitudes_differ": float(found.differ[k]),
            "certain": [name for name, at in certain.items() if f in at],
            **{name: _polar(values[k]) for name, values in curves.items()},
        }
        for k, f in enumerate(seen.frequency_Hz)
    ]
    return {
        **found.provenance.record(RESPONSE_SCHEMA),
        "bench": found.bench,
        "loop_closed_by": found.place.host or "drive",
        "gains": gains_record(found.fitted.gains),
        "gains_misfit": found.fitted.misfit,
        "gains_alike": found.fitted.alike,
        "ripple_N_m": found.ripple_N_m,
        "margins": {
            name: {
                **{key: value._asdict() for key, value in each.items()},
                "highest_line_Hz": float(found.loops[name].frequency_Hz[-1]),
            }
            for name, each in found.margins.items()
        },
        "model": {
            "source": found.friction.source,
            "inertia_kg_m2": found.inertia,
            "damping_N_m_s_rad": found.damping,
            "margins": {n: numerics.margins(loop).values() for n, loop in found.model.items()},
        },
        "lines": lines,
        "spectra": spectra_record(seen),
    }


def _polar(value: complex) -> dict[str, float]:
    return {
        "gain_dB": 20.0 * math.log10(abs(value)),
        "phase_deg": math.degrees(math.atan2(value.imag, value.real)),
    }


def gains_record(gains: Gains) -> dict[str, Any]:
    """Return gains by name with their units."""
    return {n: {"value": finite(v), "unit": GAIN_UNITS[n]} for n, v in asdict(gains).items()}


def spectra_record(seen: Spectra) -> dict[str, Any]:
    """Return the amplitudes in each window, real and imaginary, for a later design of gains."""
    record: dict[str, Any] = {}
    for name, values in vars(seen).items():
        parts = np.stack([values.real, values.imag]) if np.iscomplexobj(values) else values
        record[name] = plain(parts.tolist())
    return record


def read_response(path: Path) -> tuple[Spectra, Gains, float | None]:
    """Return spectra, gains and ripple of the torque (N m; None in an old result) of a result of
    ``rig response``.

    Raises:
        InputError: The file is not such a result.
    """
    record = read_json(path)
    try:
        if record["schema"] != RESPONSE_SCHEMA:
            raise ValueError(f"schema {record['schema']}")
        arrays: dict[str, Any] = {}
        for name, values in record["spectra"].items():
            array = np.array(values, dtype=np.float64)
            arrays[name] = array[0] + 1j * array[1] if array.ndim == 3 else array
        given = {name: entry["value"] for name, entry in record["gains"].items()}
        known = {name: math.inf if v is None else float(v) for name, v in given.items()}
        ripple = record.get("ripple_N_m")
        return Spectra(**arrays), Gains(**known), None if ripple is None else float(ripple)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(f"{path}: not a result of `rig response` ({error})") from error


def require_response_of(path: Path, document: File[Bench], place: LoopPlace) -> None:
    """Require that a result of ``rig response`` was measured with this bench, the same place of its
    position loop, and, of a loop that the program closes, the present gains.

    Raises:
        InputError: The result is of another bench, place or set of gains.
    """
    record = read_json(path)
    gains: dict[str, Any] = {}
    if place.host and place.stated is not None:
        gains = {name: entry["value"] for name, entry in gains_record(place.stated).items()}
    here: dict[str, Any] = {"bench": document.value.name, "loop_closed_by": place.host or "drive"}
    there = {name: record.get(name) for name in here}
    there |= {name: record["gains"][name]["value"] for name in gains}
    other = [
        f"{name} {value} in place of {expected}"
        for name, expected in (here | gains).items()
        if (value := there[name]) != expected
    ]
    if other:
        raise InputError(
            f"{path}: not a response of {document.path}: {', '.join(other)}; run `rig response` "
            "with this bench"
        )


MARGIN_HEADER: Final = (
    "open loop",
    "phase margin, deg",
    "90 % interval",
    "crossover, Hz",
    "gain margin, dB",
    "90 % interval",
    "at, Hz",
    "highest line, Hz",
)


def gains_table(columns: Mapping[str, Gains]) -> Table:
    """Return a table of gains, a column of values for each set."""
    first = next(iter(columns.values()))
    names = [n for n, v in asdict(first).items() if math.isfinite(v) and (n != "delay_s" or v)]
    rows = []
    for name in names:
        unit = GAIN_UNITS[name]
        if name == "position" and not first.speed and not first.ahead:
            unit = "N m/rad"
        values = (number(getattr(gains, name), 4) for gains in columns.values())
        rows.append((name.partition("_")[0], *values, unit))
    return Table(("gain", *columns, "unit"), tuple(rows), tuple(range(1, len(columns) + 1)))


def response_document(found: Response) -> Document:
    """Return a measured response as a document."""

    def ends(estimate: Estimate) -> str:
        return interval(estimate.low, estimate.high)

    table = columns(
        [(name, each, found.loops[name]) for name, each in found.margins.items()],
        tuple(range(1, 8)),
        (MARGIN_HEADER[0], lambda m: m[0]),
        (MARGIN_HEADER[1], lambda m: number(m[1]["phase_deg"].value, 4)),
        (MARGIN_HEADER[2], lambda m: ends(m[1]["phase_deg"])),
        (MARGIN_HEADER[3], lambda m: number(m[1]["crossover_Hz"].value, 4)),
        (MARGIN_HEADER[4], lambda m: number(m[1]["gain_dB"].value, 4)),
        (MARGIN_HEADER[5], lambda m: ends(m[1]["gain_dB"])),
        (MARGIN_HEADER[6], lambda m: number(m[1]["phase_crossing_Hz"].value, 4)),
        (MARGIN_HEADER[7], lambda m: number(float(m[2].frequency_Hz[-1]), 3)),
    )
    position = found.margins["position"]["phase_deg"].value
    headline = "No crossover of the position loop among the lines"
    if position is not None:
        headline = f"Phase margin of the position loop: {position:.0f} deg"
    verdict = Verdict(headline, f"The loop is closed {found.place.words}.", "good")
    summary = [
        Section("", (verdict, table, *map(Note, _remarks(found)))),
        Section("Gains", (gains_table({"measured": found.fitted.gains}),)),
    ]
    if found.model:
        rows = tuple(
            (name, *(number(v, 4) for v in numerics.margins(loop).values().values()))
            for name, loop in found.model.items()
        )
        header = ("the model predicts", *(MARGIN_HEADER[k] for k in (1, 3, 4, 6)))
        summary.append(Section("", (Table(header, rows, (1, 2, 3, 4)),)))
    seen = found.seen
    one, coherence = seen.mean(), seen.coherence()
    lines = columns(
        range(len(seen.frequency_Hz)),
        tuple(range(6)),
        ("Hz", lambda k: number(float(seen.frequency_Hz[k]), 4)),
        ("tone, deg", lambda k: number(math.degrees(float(seen.amplitude_rad[k])), 3)),
        ("coherence", lambda k: number(float(coherence[k]), 4)),
        ("without tones", lambda k: percent(100.0 * float(found.background[k]))),
        ("plant, dB", lambda k: number(20.0 * math.log10(abs(one.plant[k])), 4)),
        ("differ, sigma", lambda k: number(float(found.differ[k]), 2)),
    )
    return Document(
        f"Frequency response of {found.bench}",
        f"{len(seen.frequency_Hz)} lines, {seen.windows} windows",
        tuple(summary),
        (
            *summary,
            Section("Response", tuple(_pictures(found))),
            Section("Lines", (lines,)),
            provenance_section(found.provenance),
        ),
    )


def _remarks(found: Response) -> Iterator[str]:
    """Yield what the reader must know of this response."""
    if found.fitted.alike and found.place.stated is None:
        yield (
            "the drive feeds the whole rate of the command forward: position gain and reset look "
            "alike from outside; the greater one is taken for the position gain"
        )
    far = found.differ > BENT
    if np.any(far):
        at = ", ".join(f"{f:.3g}" for f in found.seen.frequency_Hz[far])
        yield f"the plant differs between the two amplitudes at {at} Hz: it is not linear there"
    level = found.friction.values["Mc"]
    tone = float(np.median(found.seen.amplitude_rad * np.abs(found.seen.s)))
    damping = float(numerics.describing_damping(level, np.array([tone]))[0])
    yield (
        "these are the loops of a joint that moves on. Around rest Coulomb friction acts as a "
        f"damping that falls with the amplitude: {damping:.3g} N m s/rad at {tone:.2g} rad/s "
        f"(describing function, {level:.3g} N m)"
    )


def _pictures(found: Response) -> Iterator[Paragraph | Picture]:
    one, f = found.seen.mean(), found.seen.frequency_Hz
    model: Complex = numerics.rigid_plant(f, found.inertia, found.damping)
    yield Paragraph(
        f"Model: {found.inertia:.4g} kg m^2 and {found.damping:.4g} N m s/rad, from "
        f"{found.friction.source}."
    )
    curves = [Curve("plant", f, one.plant), Curve("model", f, model, False)]
    made = bode(curves, " over rad/(N m)")
    yield Picture.of("plant", "Plant, from torque to the angle of the motor", made)
    drawn = [Curve(n, loop.frequency_Hz, loop.response) for n, loop in found.loops.items()]
    drawn += [
        Curve(f"{n}, model", loop.frequency_Hz, loop.response, False)
        for n, loop in found.model.items()
    ]
    drawn.append(Curve("closed", f, one.closed))
    yield Picture.of("loops", "Open loops and closed position loop", bode(drawn, ""), lead=True)
    yield Picture.of("nyquist", "Nyquist plot of the open loops", nyquist(found.loops))
