"""Writes the simulated model as a bench file."""

from __future__ import annotations

from pathlib import Path

from rig.common.errors import InputError
from rig.results.diagnose.model_bench import BENCH_FILE, base_bench, bench_text, model_bench
from rig.results.simulate.simulate import Simulation


def as_bench(source: Path, found: Simulation) -> tuple[dict[str, str], list[str]]:
    """Return the first model as a simulated bench (file name to text), and remarks on this bench.

    If the model cannot be a simulated bench, there is no file, and the remarks state why.
    """
    try:
        constants = found.dataset.recordings[0].bench
        bench, left_out = model_bench(base_bench(source), found.models[0].corrected, constants)
        said = f"{BENCH_FILE} beside this page is the model as a simulated bench."
        return {BENCH_FILE: bench_text(bench, left_out)}, [said, *left_out]
    except InputError as error:
        return {}, list(error.problems)
