"""Reproduction of the paper's verification (Sec. 4.2): literal bench, both methods, Tables 1 and
2, Fig. 12 and 13.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.mock.plant.parts.constants import Machine
from drivers.mock.plant.true_motion import simulate
from identification.recording import Array, Bench, Dataset, Recording
from identification.result import Identification
from rig.config.bench import load_bench
from rig.results.identify.identify import METHODS
from rig.runs.run import bench_constants
from rig.runs.truth import true_parameters

CONTACT_FORCE_N = 3000.0
"""Contact force F_P of Case 2 (Sec. 4.2.2), N."""
DURATION_S = 5.0
RATE_HZ = 1000.0
"""Duration, s (one period of the command), and sample rate, Hz, which the paper does not state. The
fitness sqrt(sum e^2) is the sum over all samples of this duration.
"""
WRONG_BASIN_PERCENT = 20.0
"""Largest error of a parameter other than J above which a seed counts as converged to a wrong
basin, %.
"""


@dataclass(frozen=True)
class Printed:
    """One column of Table 1 or 2 with the printed values.

    Attributes:
        original: "Original value".
        identified: "Identified value".
        error_percent: "Error".
    """

    original: float
    identified: float
    error_percent: float


TABLE_1: Mapping[str, Printed] = {
    "Mc": Printed(6.8250, 6.7478, 1.13),
    "Ms": Printed(12.025, 11.935, 0.74),
    "omega_sf": Printed(0.0577, 0.0577, 0.0),  # 0.0557 in the text, which is what is simulated
    "sigma_2": Printed(5.3462, 5.5400, 3.62),
    "J": Printed(0.000204, 0.0002048, 0.39),
}
TABLE_2: Mapping[str, Printed] = {
    "mu_c": Printed(0.0520, 0.0524, 0.77),
    "mu_s": Printed(0.0860, 0.0869, 1.05),
    "omega_sL": Printed(0.0326, 0.0318, 2.45),
    "mu_2": Printed(0.032, 0.031, 3.12),
}


@dataclass(frozen=True)
class Reproduction:
    """Result of ``rig paper``.

    Attributes:
        dataset: The two simulated cases.
        truth: True values of the simulated parameters, by name.
        runs: Results by method and seed.
    """

    dataset: Dataset
    truth: Mapping[str, float]
    runs: Mapping[str, Mapping[int, Identification]]

    def found(self, method: str, name: str) -> dict[int, float | None]:
        """Return the estimates of one parameter by one method, one for each seed.

        A genetic search always ends with some value of J, which the result withholds if the data do
        not determine J; for the comparison with Table 1, the value is read from the search history.
        """
        return {seed: _value(result, name) for seed, result in self.runs[method].items()}

    def errors(self, method: str, name: str) -> dict[int, float]:
        """Return the error for each seed, percent of the true value; infinite without an
        estimate.
        """
        return {
            seed: math.inf if value is None else 100.0 * abs(value / self.truth[name] - 1.0)
            for seed, value in self.found(method, name).items()
        }

    def worst_seed(self, method: str, name: str) -> int:
        """Return the seed with the largest error in one parameter."""
        errors = self.errors(method, name)
        return max(errors, key=lambda seed: errors[seed])

    def wrong_basins(self, method: str) -> list[int]:
        """Return the seeds that ended far from the true value of a parameter other than J."""
        worst = {seed: 0.0 for seed in self.runs[method]}
        for name in (*TABLE_1, *TABLE_2):
            if name != "J":
                worst = {
                    seed: max(worst[seed], error)
                    for seed, error in self.errors(method, name).items()
                }
        return [seed for seed, error in worst.items() if error > WRONG_BASIN_PERCENT]


def reproduce(seeds: Sequence[int], progress: Callable[[str, float], None]) -> Reproduction:
    """Simulate the literal bench without noise, and identify it by the paper's and by the default
    method from every seed.

    Args:
        seeds: Seeds of the methods; the simulation is deterministic.
        progress: Called with the current step and the completed share.
    """
    progress("simulating the literal bench", 0.0)
    dataset, truth = simulate_cases()
    runs: dict[str, dict[int, Identification]] = {method: {} for method in METHODS}
    jobs = [(method, seed) for method in METHODS for seed in seeds]
    for done, (method, seed) in enumerate(jobs):
        progress(f"{method} method, seed {seed}", done / len(jobs))
        rng = np.random.default_rng(seed)
        runs[method][seed] = METHODS[method](dataset, bandwidth_Hz=0.5 * RATE_HZ, rng=rng)
    progress("done", 1.0)
    return Reproduction(dataset, truth, runs)


def simulate_cases() -> tuple[Dataset, dict[str, float]]:
    """Simulate Case 1 and Case 2 on the literal bench; return the recordings and the true
    parameters.
    """
    bench = load_bench("literal").value
    machine = bench.mock
    if machine is None:
        raise ValueError("the packaged bench 'literal' has no simulated machine")
    constants = bench_constants(bench)
    cases = (
        _case(machine, constants, "Case 1", 0.0),
        _case(machine, constants, "Case 2", CONTACT_FORCE_N),
    )
    return Dataset(cases), true_parameters(machine)


def command(time: Array) -> Array:
    """Return theta_c = 20 deg sin(0.4 pi t), rad (Sec. 4.2.1; "0.4 pi r t" there is a misprint)."""
    return np.asarray(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time))


def _case(machine: Machine, bench: Bench, name: str, force_N: float) -> Recording:
    """Simulate one case; the current is sampled instantaneously, and no channel is quantised."""
    out = simulate(machine, command, DURATION_S, RATE_HZ, contact_force_N=force_N)
    return Recording(
        name=name,
        channels={
            channel: out[channel] for channel in ("time", "command", "angle", "velocity", "current")
        },
        bench=bench,
        stage="loaded" if force_N else "unloaded",
        weight_mass=force_N / (bench.lever_ratio * bench.gravity),
        notes=("simulated, literal bench, no noise",),
    )


def _value(result: Identification, name: str) -> float | None:
    parameter = result.parameters[name]
    if parameter.value is not None:
        return parameter.value
    for stage in result.stages:
        if name in stage.parameter_history:
            return float(stage.parameter_history[name][-1])
    return None
