"""The default identification of 40 s at 1 kHz against differential evolution on the same residual.

Differential evolution (SciPy's defaults, seeded) searches all parameters of a stage at once on the equation error that
variable projection minimises, stage by stage, between the same bounds; where those are infinite, between 0 and the
value at which the term alone would make the greatest torque seen. The last row adds the prediction errors.

    python benchmarks/identification_speed.py
"""

from __future__ import annotations

from collections.abc import Mapping
from statistics import median
from time import perf_counter

import numpy as np
from scipy import optimize

from drivers.mock.plant.constants import Machine
from drivers.mock.plant.direct import simulate
from identification.estimate.default import identify, solve_stages
from identification.estimate.regression import Stage, loaded_stage, unloaded_stage
from identification.estimate.result import LOAD_PARAMETERS, SYSTEM_PARAMETERS
from identification.prepare import prepare
from identification.recording import Array, Bench, Dataset, Model, Recording
from rig.tables import table
from rig.truth import true_parameters

STAGE_S = 20.0
RATE_HZ = 1000.0
REPEATS = 5
SEED = 0


def command(time: Array) -> Array:
    """Return 20 deg at 0.2 Hz, eased in over the first and out over the last second, rad."""
    ease = np.clip(np.minimum(time, STAGE_S - time), 0.0, 1.0)
    return np.asarray(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time) * (0.5 - 0.5 * np.cos(np.pi * ease)))


def recording(weight_kg: float) -> Recording:
    """Simulate one stage and log it as the practical bench does: counts, quanta, mean current."""
    machine = Machine()
    out = simulate(machine, command, STAGE_S, RATE_HZ, weight_kg, rng=np.random.default_rng(round(weight_kg)))
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


def evolve(stage: Stage) -> tuple[dict[str, float], int]:
    """Minimise a stage's squared equation error by differential evolution; return its values and the evaluations."""
    first = stage.design(stage.speed_range()[1])
    greatest = np.max(np.abs(first.target)) / np.max(np.abs(first.columns), axis=0)
    high = np.where(np.isfinite(first.high), first.high, greatest)
    least, most = np.log(stage.speed_range())
    bounds = optimize.Bounds(np.append(least, first.low), np.append(most, high))

    def cost(x: Array) -> float:
        design = stage.design(float(np.exp(x[0])))
        error = design.target - design.columns @ x[1:]
        return float(error @ error)

    found = optimize.differential_evolution(cost, bounds, rng=np.random.default_rng(SEED), polish=False)
    return stage.named(float(np.exp(found.x[0])), found.x[1:]), int(found.nfev)


def worst(values: Mapping[str, float], truth: Mapping[str, float], names: tuple[str, ...]) -> str:
    """Return the parameter that is farthest off and by how much, percent."""
    errors = {name: 100.0 * abs(values.get(name, np.inf) / truth[name] - 1.0) for name in names}
    name = max(errors, key=lambda n: errors[n])
    return f"{errors[name]:.2f} ({name})"


def main() -> None:
    """Print seconds, evaluations and worst errors of each."""
    dataset, truth, model = Dataset((recording(0.0), recording(30.6))), true_parameters(Machine()), Model()
    result = identify(dataset)
    prepared = [prepare(r, result.fit.bandwidth_Hz) for r in dataset.recordings]

    began = perf_counter()
    system, spent = evolve(unloaded_stage(prepared[:1], model))
    load, more = evolve(loaded_stage(prepared[1:], model, system))
    rows = {"differential evolution": (perf_counter() - began, spent + more, {**system, **load})}

    stage_s, whole_s = [], []
    for _ in range(REPEATS):
        began = perf_counter()
        values, stages = solve_stages(prepared[:1], prepared[1:], model, lambda _stage, _share: None)
        stage_s.append(perf_counter() - began)
        began = perf_counter()
        result = identify(dataset)
        whole_s.append(perf_counter() - began)
    rows["variable projection"] = (median(stage_s), sum(s.evaluations for s in stages), values)
    rows["whole default method"] = (median(whole_s), result.evaluations, result.values())

    base = rows["differential evolution"][0]
    body = [
        [
            name,
            f"{base / seconds:.1f}",
            f"{seconds:.2f}",
            str(evaluations),
            worst(found, truth, SYSTEM_PARAMETERS),
            worst(found, truth, LOAD_PARAMETERS),
        ]
        for name, (seconds, evaluations, found) in rows.items()
    ]
    print(f"equation error at {result.fit.bandwidth_Hz:.3g} Hz; errors are percent of the truth")
    print(table(["method", "times faster", "s", "evaluations", "worst, unloaded", "worst, loaded"], body))


if __name__ == "__main__":
    main()
