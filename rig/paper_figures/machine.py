"""The packaged benches as the figures need them: their true machine, and the practical one identified from its log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from drivers.mock.plant.constants import Machine
from rig.bench import load_bench
from rig.feedforward import Feedforward, load_feedforward
from rig.identify import identify_source
from rig.places import write_json
from rig.results import identification_record
from rig.run import bench_constants
from rig.sequence import load_sequence
from rig.simulated_run import run_simulated


def true_machine(name: str) -> Machine:
    """Return the simulated machine of a packaged bench.

    Raises:
        ValueError: It has none.
    """
    machine = load_bench(name).value.mock
    if machine is None:
        raise ValueError(f"the packaged bench {name!r} has no simulated machine")
    return machine


def identified(scratch: Path, seed: int, progress: Callable[[str, float], None]) -> Feedforward:
    """Run ``figure10`` on the practical bench and identify that run.

    Args:
        scratch: Empty folder for the run and its result.
        seed: Of the bench's noise and of the method.
        progress: Called with what is being done and the share that is done.
    """
    bench = load_bench("practical")
    progress("running figure10 on the practical bench", 0.0)
    run_simulated(bench, load_sequence("figure10"), seed, scratch / "run")
    outcome = identify_source(scratch / "run", ["default"], None, seed, progress)
    write_json(scratch / "identify.json", identification_record(outcome.results[0], outcome.provenance))
    return load_feedforward(scratch / "identify.json", bench_constants(bench.value))
