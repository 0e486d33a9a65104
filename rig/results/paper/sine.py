"""The sine of the paper's cases with stiff gains, without and with feed-forward: tracking error and
energy per cycle.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from identification.plots import regulator
from identification.recording import Array, Dataset, Recording
from identification.signals import track, tracking_error
from rig.common.tables import number
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.session import run_simulated
from rig.planning.feedforward import Feedforward
from rig.results.document import Picture, Table
from rig.results.paper.exhibit import Exhibit, Rows, columns

SINE_BENCH, SINE_SEQUENCE = "practical", "figure10"
PERIOD_S = 5.0
FIRST_S = 2.0
CYCLES = 2
_SPAN = (FIRST_S, FIRST_S + CYCLES * PERIOD_S)
_THIN = 10  # the data file contains every tenth sample


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
            f"{SINE_SEQUENCE} on {SINE_BENCH} with stiff gains, identified from a separate run: command less "
            f"joint encoder, and electrical energy, over {CYCLES} cycles.",
        ),
        (
            Picture.of(
                "compensation",
                "Tracking error of the 0.2 Hz sine without and with feed-forward",
                regulator.errors([_panel(*pair) for pair in pairs]),
            ),
        ),
        {"compensation": _data(pairs)},
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


def _data(pairs: Sequence[tuple[Recording, Recording]]) -> Rows:
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
