"""Simulated benches with one mistake each end in their first pass, with the key to set; a right one
runs. ``make units`` tries three hundred.
"""

from pathlib import Path

import numpy as np
import pytest

from rig.runs.mcap.reader import read_run

from ..long.unit_benches import MISTAKES, TENFOLD, draw, judged, run


@pytest.mark.parametrize("mistake", [*MISTAKES, None])
def test_a_drawn_bench(tmp_path: Path, mistake: str | None) -> None:
    seed = 7
    drawn = draw(np.random.default_rng([seed, 0 if mistake is None else 1]), mistake)
    folder, outcome = run(drawn, seed, tmp_path / "bench")
    assert judged(drawn, outcome, folder) == ""
    if mistake is None:
        events = [e for e in read_run(folder.recording).events if e["event"] == "units"]
        factors = events[-1]["factors"]
        assert all(value == pytest.approx(1.0, abs=0.15) for value in factors.values()), factors


@pytest.mark.parametrize(
    ("mistake", "seed", "bus"),
    [
        ("unit of speed", 0, "epos_serial"),
        ("unit of speed", 505, "epos_serial"),
        ("unit of speed", 1003, "mock"),
        ("sign", 3000, "epos_serial"),
        (TENFOLD, 0, "epos_serial"),
        (TENFOLD, 6, "mock"),
        (TENFOLD, 808, "epos_serial"),
        (TENFOLD, 822, "epos_serial"),
    ],
)
def test_a_mistake_is_found_on_every_transport(tmp_path, mistake, seed, bus):
    drawn = draw(np.random.default_rng([seed, 1]), mistake)
    assert drawn.bench["bus"]["interface"] == bus
    folder, outcome = run(drawn, seed, tmp_path / "bench")
    assert judged(drawn, outcome, folder) == ""
