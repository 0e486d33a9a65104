"""Seconds and evaluations to the same error: the default identification against differential
evolution and CMA-ES.

40 s at 1 kHz on the practical bench. Two races, each search from several seeds, all in one process,
processor time:

- on the paper's equation error, stage by stage in one box, until the cost is within 0.1 % of
  variable projection's;
- on the likelihood of the prediction errors (Huber's beyond four deviations), all nine parameters
  at once in the same boxes, until the worst error of any parameter against the truth is no greater
  than the whole default method's. The noise is taken from the torque's scatter, and each stretch
  breaks away where its torque reaches the static limit on trial.

The searches are SciPy's and those of ``cmaes`` with their own settings; CMA-ES begins again from
another point where it stalls. What ends at a cap prints ``>=``. That they stop by looking at the
truth is in their favour.

    python benchmarks/identification_speed.py --seeds 3 --cap 150
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from time import process_time

import numpy as np
from cmaes import CMA
from scipy import optimize

from drivers.mock.plant.machine import simulate
from drivers.mock.plant.parts.constants import Machine
from identification.estimate import equation_error as varpro
from identification.estimate.default import identify
from identification.estimate.paper_method import GENERATIONS, POPULATION, StageProblem
from identification.filter.experiment import Experiment, Filter
from identification.filter.likelihood import HUBER_THRESHOLD, static_crossings, torque_noise
from identification.filter.segments import Noise, motion
from identification.model.parameters import pack
from identification.numerics.least_squares import huber
from identification.prepare import prepare
from identification.recording import Array, Bench, Dataset, Recording
from rig.common.tables import table
from rig.runs.recorded_inputs import true_parameters

STAGE_S = 20.0
RATE_HZ = 1000.0
SAME_COST = 1.001
"""Equation error over variable projection's at which a search has reached it."""
CAP_EVALUATIONS = POPULATION * GENERATIONS
"""Of each search and stage: the paper's budget."""
FIRST_SIGMA = 0.3


def command(time: Array) -> Array:
    """Return 20 deg at 0.2 Hz, eased in over the first and out over the last second, rad."""
    ease = np.clip(np.minimum(time, STAGE_S - time), 0.0, 1.0)
    return np.asarray(
        np.deg2rad(20.0) * np.sin(0.4 * np.pi * time) * (0.5 - 0.5 * np.cos(np.pi * ease))
    )


def recording(weight_kg: float) -> Recording:
    """Simulate one stage and log it as the practical bench does: counts, quanta, mean current."""
    machine = Machine()
    out = simulate(
        machine, command, STAGE_S, RATE_HZ, weight_kg, rng=np.random.default_rng(round(weight_kg))
    )
    count = 2.0 * np.pi / machine.sensing.motor_counts_per_turn
    channels = {
        "time": out["time"],
        "motor_angle": np.floor(out["angle"] * machine.motor.gear_ratio / count) * count,
        "current": np.round(out["mean_current"] / 0.015) * 0.015,
    }
    bench = Bench(torque_constant=0.03, gear_ratio=machine.motor.gear_ratio, moment_arm=0.095)
    return Recording(
        name=f"{weight_kg:g} kg",
        channels=channels,
        bench=bench,
        stage="loaded" if weight_kg else "unloaded",
        weight_mass=weight_kg,
        averaged=frozenset({"current"}),
    )


class Race:
    """One search: costs of points of the unit cube, counted and timed until the goal or a cap is
    reached.

    Args:
        costs: Points, shape (p, d), to costs, shape (p,).
        size: Number of coordinates d.
        goal: Whether the best point so far, at this cost, is good enough.
        cap_s: Processor time at most.
    """

    def __init__(
        self,
        costs: Callable[[Array], Array],
        size: int,
        goal: Callable[[Array, float], bool],
        cap_s: float,
    ) -> None:
        self.size = size
        self.best, self.least, self.evaluations, self.won = np.full(size, 0.5), np.inf, 0, False
        self.seconds = 0.0
        self._costs, self._goal, self._cap_s = costs, goal, cap_s
        self._began = process_time()

    @property
    def over(self) -> bool:
        """Whether the goal or a cap is reached."""
        return self.won or self.evaluations >= CAP_EVALUATIONS or self.seconds >= self._cap_s

    def __call__(self, points: Array) -> Array:
        """Return the costs of points."""
        costs = self._costs(points)
        self.evaluations += len(points)
        k = int(np.argmin(costs))
        if costs[k] < self.least:
            self.best, self.least = points[k].copy(), float(costs[k])
            self.won = self.won or self._goal(self.best, self.least)
        self.seconds = process_time() - self._began
        return costs


def differential_evolution(race: Race, seed: int) -> None:
    """SciPy's settings, no polish and no end of its own."""
    optimize.differential_evolution(
        lambda x: race(x.T),
        optimize.Bounds(np.zeros(race.size), np.ones(race.size)),
        vectorized=True,
        updating="deferred",
        polish=False,
        maxiter=CAP_EVALUATIONS,
        tol=0.0,
        callback=lambda _best, convergence: race.over,
        rng=np.random.default_rng(seed),
    )


def cma_es(race: Race, seed: int) -> None:
    """The library's settings from the centre of the box; from a random point where it has
    stalled.
    """
    rng = np.random.default_rng(seed)
    bounds = np.column_stack([np.zeros(race.size), np.ones(race.size)])
    mean = np.full(race.size, 0.5)
    while not race.over:
        search = CMA(mean, FIRST_SIGMA, bounds=bounds, seed=int(rng.integers(1 << 31)))
        while not (search.should_stop() or race.over):
            points = np.array([search.ask() for _ in range(search.population_size)])
            search.tell([(x, float(c)) for x, c in zip(points, race(points), strict=True)])
        mean = rng.uniform(size=race.size)


SEARCHES = {"differential evolution": differential_evolution, "CMA-ES": cma_es}


def equation_race(problems: Sequence[StageProblem], seeds: int, cap_s: float) -> list[list[str]]:
    """Return the rows of the race to variable projection's equation error, both stages."""
    began = process_time()
    costs = []
    for problem in problems:
        found = varpro.solve(problem.design, problem.low[2], problem.high[2])
        costs.append(
            float(
                np.linalg.norm(
                    problem.residuals(problem.unlinear(found.omega_s, found.coefficients))
                )
            )
        )
    spent_s, spent = process_time() - began, sum(p.evaluations for p in problems)
    rows = [["variable projection", "1 of 1", str(spent), f"{spent_s:.2f}", "1", "1"]]
    for name, search in SEARCHES.items():
        runs = []
        for seed in range(seeds):
            races = []
            for problem, cost in zip(problems, costs, strict=True):
                races.append(
                    Race(
                        problem.costs,
                        problem.size,
                        lambda _x, c, most=SAME_COST * cost: c <= most,
                        cap_s,
                    )
                )
                search(races[-1], seed)
            runs.append(races)
        rows.append(_row(name, runs, spent, spent_s))
    return rows


def likelihood_race(
    pair: Sequence[Recording],
    problems: Sequence[StageProblem],
    truth: Mapping[str, float],
    seeds: int,
    cap_s: float,
) -> tuple[float, list[list[str]]]:
    """Return the default method's worst error and the rows of the race to it."""
    began = process_time()
    default = identify(Dataset(tuple(pair)))
    spent_s, spent = process_time() - began, default.evaluations
    target = _worst(default.values, truth)
    motions = [m for m in map(motion, pair) if m is not None]
    likelihood = Filter(Experiment(tuple(motions)))
    noise = Noise(torque_noise(motions))

    def named(x: Array) -> dict[str, float]:
        parts = zip(problems, np.split(x, [problems[0].size]), strict=True)
        return {n: v for problem, part in parts for n, v in problem.named(part).items()}

    def costs(points: Array) -> Array:
        out = np.empty(len(points))
        for k, x in enumerate(points):
            p = pack(named(x), 2.0)
            errors, deviations = likelihood.run(p, static_crossings(p, motions), noise)
            value = 2.0 * float(
                np.sum(np.log(deviations) + huber(errors / deviations, HUBER_THRESHOLD))
            )
            out[k] = value if np.isfinite(value) else 1e300
        return out

    def goal(x: Array, _cost: float) -> bool:
        return _worst(named(x), truth) <= target

    size = sum(p.size for p in problems)
    costs(np.full((1, size), 0.5))  # compiled before it is timed
    rows = [
        [
            "whole default method",
            "1 of 1",
            str(spent),
            f"{spent_s:.2f}",
            "1",
            "1",
            f"{100.0 * target:.2f}",
        ]
    ]
    for name, search in SEARCHES.items():
        races: list[Race] = []
        for seed in range(seeds):
            races.append(Race(costs, size, goal, cap_s))
            search(races[-1], seed)
        errors = median(_worst(named(r.best), truth) for r in races)
        rows.append([*_row(name, [[r] for r in races], spent, spent_s), f"{100.0 * errors:.2g}"])
    return target, rows


def _worst(values: Mapping[str, float], truth: Mapping[str, float]) -> float:
    """Return the greatest relative error; infinite where a parameter is missing."""
    return max(abs(values.get(name, np.inf) / true - 1.0) for name, true in truth.items())


def _row(name: str, runs: Sequence[Sequence[Race]], spent: int, spent_s: float) -> list[str]:
    """Return wins, median evaluations and seconds over the seeds, and their ratios to the
    reference's.
    """
    wins = sum(all(r.won for r in races) for races in runs)
    least = "" if 2 * wins > len(runs) else ">= "
    evaluations = median(sum(r.evaluations for r in races) for races in runs)
    seconds = median(sum(r.seconds for r in races) for races in runs)
    return [
        name,
        f"{wins} of {len(runs)}",
        f"{least}{evaluations:.0f}",
        f"{least}{seconds:.2f}",
        f"{least}{evaluations / spent:.0f}",
        f"{least}{seconds / spent_s:.0f}",
    ]


def main() -> None:
    """Run both races and print their tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--cap", type=float, default=150.0, help="processor seconds of each search")
    arguments = parser.parse_args()
    pair, truth = (recording(0.0), recording(30.6)), true_parameters(Machine())
    result = identify(Dataset(pair))  # compiles
    prepared = [prepare(r, result.fit.bandwidth_Hz) for r in pair]
    alpha = result.alpha
    first = StageProblem("unloaded", prepared[:1], {}, alpha)
    found = varpro.solve(first.design, first.low[2], first.high[2])
    known = first.named(first.unlinear(found.omega_s, found.coefficients))
    problems = [
        StageProblem("unloaded", prepared[:1], {}, alpha),
        StageProblem("loaded", prepared[1:], known, alpha),
    ]
    header = ["search", "reached", "evaluations", "s", "evaluations over", "s over"]
    print(
        f"to the equation error of variable projection at {result.fit.bandwidth_Hz:.3g} Hz",
        flush=True,
    )
    print(
        table(header, equation_race(problems, arguments.seeds, arguments.cap), range(2, 6)),
        flush=True,
    )
    target, rows = likelihood_race(pair, problems, truth, arguments.seeds, arguments.cap)
    print(f"to the default method's worst error of {100.0 * target:.2f} %")
    print(table([*header, "worst error, %"], rows, range(2, 7)))


if __name__ == "__main__":
    main()
