"""The sine of the paper's cases on stiff gains, before and after feed-forward: tracking and energy
per cycle.
"""

from __future__ import annotations

from pathlib import Path

from identification.plots import regulator
from identification.recording import Array, Dataset
from identification.tracking import track, tracking_error
from rig.common.tables import number
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.simulated_run import run_simulated
from rig.planning.feedforward import Feedforward
from rig.results.document import Picture, Table
from rig.results.paper.exhibit import Exhibit, columns

BENCH, SEQUENCE = "practical", "figure10"
PERIOD_S = 5.0
FIRST_S = 2.0
CYCLES = 2
_THIN = 10  # of the samples, in the data file


def run_sines(scratch: Path, model: Feedforward, seed: int) -> tuple[Dataset, Dataset]:
    """Run the paper's two cases without and with feed-forward, with other noise than the
    identification saw.
    """
    bench, sequence = load_bench(BENCH), load_sequence(SEQUENCE)
    plain = run_simulated(bench, sequence, seed + 1, scratch / "sine-plain")
    return plain, run_simulated(bench, sequence, seed + 1, scratch / "sine-fed", model)


def exhibit(plain: Dataset, fed: Dataset) -> Exhibit:
    """Return the tracking error of both cases over two whole cycles, and the energy of one."""
    span = (FIRST_S, FIRST_S + CYCLES * PERIOD_S)
    rows, panels = [], []
    named: dict[str, Array] = {}
    for before, after in zip(plain.recordings, fed.recordings, strict=True):
        one, other = track(before, *span), track(after, *span)
        load = f"{before.contact_force:.0f} N"
        rows.append(
            (
                load,
                *(number(1e3 * t.rms, 3) for t in (one, other)),
                number(one.rms / other.rms, 3),
                *(number(1e3 * t.largest, 3) for t in (one, other)),
                *(number(t.energy / CYCLES, 4) for t in (one, other)),
            )
        )
        time = before.time - before.time[0]
        part = (time >= span[0]) & (time < span[1])
        errors = {
            "without feed-forward": tracking_error(before)[part],
            "with it": tracking_error(after)[part],
        }
        panels.append((load, time[part], errors))
        few = slice(None, None, _THIN)
        named |= {
            "time_s": time[part][few],
            f"error_{before.stage}_rad": errors["without feed-forward"][few],
            f"error_{before.stage}_fed_rad": errors["with it"][few],
            f"power_{before.stage}_W": (before.channels["voltage"] * before.channels["current"])[
                part
            ][few],
            f"power_{before.stage}_fed_W": (after.channels["voltage"] * after.channels["current"])[
                part
            ][few],
        }
    header = (
        "contact force",
        "error before (mrad rms)",
        "after",
        "ratio",
        "largest (mrad)",
        "after",
    )
    return Exhibit(
        "compensation",
        "Compensation: the sine of Case 1 and 2 before and after feed-forward, and its energy",
        "Friction is said to raise control error and power consumption, and the model to be a "
        "starting point for "
        "compensation; none is shown.",
        (
            f"{SEQUENCE} on {BENCH}, stiff gains, identified from a log of its own: command less "
            f"joint encoder, and "
            f"electrical energy, over {CYCLES} cycles.",
        ),
        (
            Picture.of(
                "compensation",
                "Tracking error of the 0.2 Hz sine without and with feed-forward",
                regulator.errors(panels),
            ),
        ),
        {"compensation": columns(**named)},
        Table((*header, "energy per cycle (J)", "after"), tuple(rows), tuple(range(1, 8))),
    )
