"""Fig. 2 and 9: a low-speed ramp with soft gains, without and with friction feed-forward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from identification.plots import regulator
from identification.recording import Array, Dataset, Recording
from identification.signals import Tracking, track, tracking_error
from rig.common.tables import number
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.session import run_simulated
from rig.planning.feedforward import Feedforward
from rig.results.document import Picture, Table
from rig.results.paper.exhibit import Exhibit, Rows, columns

RAMP_BENCH, RAMP_SEQUENCE = "practical_soft", "slow_ramp"
_SPEED_SPAN_S = 0.02  # the plotted speed is a mean over this time
_THIN = 10  # the data files contain every tenth sample


@dataclass(frozen=True)
class RampStudy:
    """Ramps at low speed, unloaded and loaded, each without and with feed-forward."""

    plain: Dataset
    fed: Dataset


def run_ramps(scratch: Path, model: Feedforward, seed: int) -> RampStudy:
    """Run the ramps with soft gains, without and with feed-forward; the noise differs from that of
    the identification.
    """
    bench, sequence = load_bench(RAMP_BENCH), load_sequence(RAMP_SEQUENCE)
    return RampStudy(
        run_simulated(bench, sequence, seed + 1, scratch / "plain"),
        run_simulated(bench, sequence, seed + 1, scratch / "fed", model),
    )


def ramp_exhibits(study: RampStudy) -> list[Exhibit]:
    """Return Fig. 2 (angle and steady-state error, unloaded) and Fig. 9 (speed, unloaded and under
    3000 N).
    """
    plain, fed = study.plain.recordings, study.fed.recordings
    ramp = f"{RAMP_SEQUENCE} on {RAMP_BENCH}: 8 deg at 1 deg/s and back"
    fig_2 = Exhibit(
        "fig_2",
        "Fig. 2: low-speed ramp, stick-slip and steady-state error",
        "Angle against time while the regulator follows a low-speed ramp, gas generator not "
        "working: the valve waits, "
        "jumps and waits, and comes to rest with an error. The paper gives no speed and no gains.",
        (
            f"{ramp}, no weight. {_words('Without feed-forward', track(plain[0]))}",
            _words(
                "With the torque offset computed from parameters identified from a log of "
                "this bench",
                track(fed[0]),
            ),
        ),
        (Picture.of("fig_2", f"Fig. 2: {ramp}, no weight", _angle_figure(plain[0], fed[0])),),
        {"fig_2": _data(plain[0], fed[0])},
    )
    names = ("no weight", "30.6 kg (3000 N)")
    pairs = list(zip(plain, fed, strict=True))
    fig_9 = Exhibit(
        "fig_9",
        "Fig. 9: a position loop that should turn uniformly",
        "The regulator is commanded to move uniformly, but sticks and slips. For this reason the "
        "paper regards the conventional identification (eq. 14) as impossible for this regulator.",
        tuple(
            _words(f"{name}, {how}", track(recording))
            for name, pair in zip(names, pairs, strict=True)
            for how, recording in zip(("without feed-forward", "with it"), pair, strict=True)
        ),
        (
            Picture.of(
                "fig_9",
                "Fig. 9: joint speed on the same ramp, mean over 20 ms, without and with "
                "feed-forward",
                regulator.speeds(
                    [(name, *_speeds(*pair)) for name, pair in zip(names, pairs, strict=True)]
                ),
            ),
        ),
        {"fig_9": _speed_data(pairs)},
    )
    return [fig_2, fig_9]


def _words(what: str, t: Tracking) -> str:
    return (
        f"{what}: tracking error {1e3 * t.rms:.3g} mrad rms, {1e3 * t.largest:.3g} mrad at most; "
        f"at rest "
        f"{100.0 * t.waiting:.0f} % of the time in which the command moves; {1e3 * t.at_end:+.3g} "
        f"mrad off at the end; "
        f"{t.energy:.0f} J electrical."
    )


def _time(recording: Recording) -> Array:
    return np.asarray(recording.time - recording.time[0])


def _angle_figure(plain: Recording, fed: Recording) -> regulator.Figure:
    time = _time(plain)
    return regulator.tracking(
        time,
        plain.channels["command"],
        {"without feed-forward": plain.channels["angle"], "with it": fed.channels["angle"]},
        {"without feed-forward": tracking_error(plain), "with it": tracking_error(fed)},
    )


def _speeds(plain: Recording, fed: Recording) -> tuple[Array, Array, dict[str, Array]]:
    commanded = np.gradient(plain.channels["command"], plain.period)
    return _time(plain), commanded, {"without feed-forward": _speed(plain), "with it": _speed(fed)}


def _speed(recording: Recording) -> Array:
    n = round(_SPEED_SPAN_S / recording.period)
    padded = np.pad(recording.channels["angle"], (n // 2, n - n // 2), mode="edge")
    return np.asarray((padded[n:] - padded[:-n]) / (n * recording.period))


def _data(plain: Recording, fed: Recording) -> Rows:
    few = slice(None, None, _THIN)
    return columns(
        time_s=_time(plain)[few],
        command_rad=plain.channels["command"][few],
        angle_rad=plain.channels["angle"][few],
        angle_fed_rad=fed.channels["angle"][few],
        current_A=plain.channels["current"][few],
        current_fed_A=fed.channels["current"][few],
    )


def _speed_data(pairs: Sequence[tuple[Recording, Recording]]) -> Rows:
    few = slice(None, None, _THIN)
    first = pairs[0][0]
    named = {
        "time_s": _time(first)[few],
        "command_rad_s": np.gradient(first.channels["command"], first.period)[few],
    }
    for plain, fed in pairs:
        named[f"{plain.stage}_rad_s"] = _speed(plain)[few]
        named[f"{plain.stage}_fed_rad_s"] = _speed(fed)[few]
    return columns(**named)


SINE_BENCH, SINE_SEQUENCE = "practical", "figure10"
PERIOD_S = 5.0
FIRST_S = 2.0
CYCLES = 2
_SPAN = (FIRST_S, FIRST_S + CYCLES * PERIOD_S)
# the data file contains every tenth sample


def run_sines(scratch: Path, model: Feedforward, seed: int) -> tuple[Dataset, Dataset]:
    """Run the paper's two cases without and with feed-forward; the noise differs from that of the
    identification.
    """
    bench, sequence = load_bench(SINE_BENCH), load_sequence(SINE_SEQUENCE)
    plain = run_simulated(bench, sequence, seed + 1, scratch / "sine-plain")
    return plain, run_simulated(bench, sequence, seed + 1, scratch / "sine-fed", model)


def compensation_exhibit(plain: Dataset, fed: Dataset) -> Exhibit:
    """Return the tracking error of both cases over two whole cycles, and the energy of one
    cycle.
    """
    pairs = list(zip(plain.recordings, fed.recordings, strict=True))
    return Exhibit(
        "compensation",
        "Compensation: the sine of Case 1 and 2 before and after feed-forward, and its energy",
        "The paper states that friction raises control error and power consumption, and that "
        "the model is a starting point for compensation; it shows no compensation.",
        (
            f"{SINE_SEQUENCE} on {SINE_BENCH} with stiff gains, identified from a separate run: "
            "command less "
            f"joint encoder, and electrical energy, over {CYCLES} cycles.",
        ),
        (
            Picture.of(
                "compensation",
                "Tracking error of the 0.2 Hz sine without and with feed-forward",
                regulator.errors([_panel(*pair) for pair in pairs]),
            ),
        ),
        {"compensation": _sine_data(pairs)},
        _table(pairs),
    )


def _load(recording: Recording) -> str:
    return f"{recording.contact_force:.0f} N"


def _part(recording: Recording) -> tuple[Array, NDArray[np.bool_]]:
    """Return the time from the start of a recording, s, and a mask of the samples of whole
    cycles.
    """
    time = np.asarray(recording.time - recording.time[0])
    return time, (time >= _SPAN[0]) & (time < _SPAN[1])


def _panel(before: Recording, after: Recording) -> tuple[str, Array, dict[str, Array]]:
    time, part = _part(before)
    errors = {
        "without feed-forward": tracking_error(before)[part],
        "with it": tracking_error(after)[part],
    }
    return _load(before), time[part], errors


def _sine_data(pairs: Sequence[tuple[Recording, Recording]]) -> Rows:
    few = slice(None, None, _THIN)
    named: dict[str, Array] = {}
    for before, after in pairs:
        time, part = _part(before)
        named["time_s"] = time[part][few]
        both = ((before, before.stage), (after, f"{before.stage}_fed"))
        for recording, name in both:
            named[f"error_{name}_rad"] = tracking_error(recording)[part][few]
        for recording, name in both:
            power = recording.channels["voltage"] * recording.channels["current"]
            named[f"power_{name}_W"] = power[part][few]
    return columns(**named)


def _table(pairs: Sequence[tuple[Recording, Recording]]) -> Table:
    header = (
        "contact force",
        "error before (mrad rms)",
        "after",
        "ratio",
        "largest (mrad)",
        "after",
        "energy per cycle (J)",
        "after",
    )
    rows = []
    for before, after in pairs:
        one, other = track(before, *_SPAN), track(after, *_SPAN)
        rows.append(
            (
                _load(before),
                *(number(1e3 * t.rms, 3) for t in (one, other)),
                number(one.rms / other.rms, 3),
                *(number(1e3 * t.largest, 3) for t in (one, other)),
                *(number(t.energy / CYCLES, 4) for t in (one, other)),
            )
        )
    return Table(header, tuple(rows), tuple(range(1, 8)))
