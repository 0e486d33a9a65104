"""Provides data of the packaged benches for the figures: the true machine, and an identification
from a run.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from drivers.mock.plant.parts.constants import Machine
from rig.common.places import write_json
from rig.config.bench import load_bench
from rig.config.sequence import load_sequence
from rig.control.simulated_run import run_simulated
from rig.planning.feedforward import Feedforward, load_feedforward
from rig.results.identify.identify import Request, identify_source
from rig.results.identify.record import identification_record
from rig.runs.run import bench_constants


def true_machine(name: str) -> Machine:
    """Return the simulated machine of a packaged bench.

    Raises:
        ValueError: The bench has no simulated machine.
    """
    machine = load_bench(name).value.mock
    if machine is None:
        raise ValueError(f"the packaged bench {name!r} has no simulated machine")
    return machine


def identified(
    name: str, scratch: Path, seed: int, progress: Callable[[str, float], None]
) -> Feedforward:
    """Run ``figure10`` on a packaged bench and identify that run.

    Args:
        name: Name of the bench.
        scratch: Empty folder for the run and its result.
        seed: Seed of the bench's noise and of the method.
        progress: Called with the current step and the completed share.
    """
    bench = load_bench(name)
    progress(f"running figure10 on {name}", 0.0)
    run_simulated(bench, load_sequence("figure10"), seed, scratch / f"{name}-run")
    outcome = identify_source(scratch / f"{name}-run", Request(seed=seed), progress)
    result = scratch / f"{name}.json"
    write_json(result, identification_record(outcome.results[0], outcome.provenance))
    return load_feedforward(result, bench_constants(bench.value))
