"""Runs that reproduce the paper's figures: low-speed ramps, sines, uniform motion, the opening
valve and the closed loop, each through the whole simulated chain.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from rig.results.paper import exhibit, loop, ramp, uniform
from rig.results.paper import loop as sweep
from rig.results.paper import loop as valve
from rig.results.paper import ramp as sine
from rig.results.paper.exhibit import Exhibit


def study(seed: int, progress: Callable[[str, float], None]) -> list[Exhibit]:
    """Make the runs and draw all figures except those of the tables, in the order of the paper.

    Args:
        seed: Seed of the simulated benches' noise.
        progress: Called with the current step and the completed share.
    """
    with tempfile.TemporaryDirectory(prefix="rig-paper-") as name:
        scratch = Path(name)
        progress("Fig. 2 and 9: identifying the bench from a separate run", 0.0)
        model = exhibit.identified(ramp.RAMP_BENCH, scratch, seed, _silent)
        progress("Fig. 2 and 9: slow ramps", 0.2)
        fig_2, fig_9 = ramp.ramp_exhibits(ramp.run_ramps(scratch, model, seed))
        progress("compensation: identifying the bench from a separate run", 0.25)
        model = exhibit.identified(sine.SINE_BENCH, scratch, seed, _silent)
        progress("compensation: the sine of both cases", 0.4)
        compensation = sine.compensation_exhibit(*sine.run_sines(scratch, model, seed))
        progress("eq. 14: uniform motion on two gain sets", 0.45)
        eq_14 = uniform.uniform_exhibit(uniform.measure(scratch, seed))
        progress("Fig. 4: the opening valve", 0.85)
        fig_4 = sweep.sweep_exhibit(seed)
        progress("Fig. 5 and 11: the closed loop", 0.9)
        fig_11 = loop.loop_exhibit(scratch, seed)
    return [fig_2, valve.valve_exhibit(), fig_4, fig_11, fig_9, eq_14, compensation]


def _silent(what: str, share: float) -> None:
    pass
