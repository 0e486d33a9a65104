"""Accuracy on the literal bench: noise-free exact channels of the paper's parameter set and of
random ones.

Run: python benchmarks/literal_accuracy.py [random sets, default 20]
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from drivers.mock.plant.machine import simulate
from drivers.mock.plant.parts.constants import Joint, Machine
from identification.estimate.default import identify
from identification.recording import Array, Bench, Dataset, Recording
from rig.config.bench import load_bench
from rig.runs.recorded_inputs import JOINT_FIELDS

CONTACT_FORCE_N = 3000.0
RATE_HZ = 1000.0
DURATION_S = 5.0
SPREAD = 0.4


def literal_machine(joint: Joint) -> Machine:
    """Return the packaged literal bench (i = 1, no limits, exact channels) with these constants at
    the joint.
    """
    machine = load_bench("literal").value.mock
    if machine is None:
        raise ValueError("the packaged bench 'literal' has no simulated machine")
    return replace(machine, joint=joint)


def paper_joint() -> Joint:
    """Return the paper's own set, J as printed."""
    return Joint(inertia_kg_m2=0.000204)


def random_joint(rng: np.random.Generator) -> Joint:
    """Return a set with every one of the nine within 40 % of the paper's; static friction stays
    above Coulomb's.
    """
    paper = paper_joint()
    factors = {name: float(rng.uniform(1.0 - SPREAD, 1.0 + SPREAD)) for name in JOINT_FIELDS}
    values = {field: getattr(paper, field) * factors[name] for name, field in JOINT_FIELDS.items()}
    if values["Ms_N_m"] <= values["Mc_N_m"] or values["mu_s"] <= values["mu_c"]:
        return random_joint(rng)
    return replace(paper, **values)


def command(time: Array) -> Array:
    """Return 20 deg sin(0.4 pi t), rad."""
    return np.asarray(np.deg2rad(20.0) * np.sin(0.4 * np.pi * time))


def dataset(joint: Joint) -> Dataset:
    """Simulate both cases of Sec. 4.2."""
    bench = Bench(torque_constant=0.03, moment_arm=0.095)
    recordings = []
    for stage, force in (("unloaded", 0.0), ("loaded", CONTACT_FORCE_N)):
        out = simulate(literal_machine(joint), command, DURATION_S, RATE_HZ, contact_force_N=force)
        channels = {name: out[name] for name in ("time", "angle", "velocity", "current")}
        mass = force / (bench.lever_ratio * bench.gravity)
        recordings.append(
            Recording(name=stage, channels=channels, bench=bench, stage=stage, weight_mass=mass)
        )  # type: ignore[arg-type]
    return Dataset(tuple(recordings))


def errors_percent(joint: Joint) -> dict[str, float]:
    """Return the error of every parameter, percent of the truth; infinite where it was not
    identified.
    """
    result = identify(dataset(joint), bandwidth_Hz=0.5 * RATE_HZ)
    found = result.values
    true = {name: getattr(joint, field) for name, field in JOINT_FIELDS.items()}
    return {
        name: 100.0 * abs(found.get(name, np.inf) / value - 1.0) for name, value in true.items()
    }


def main() -> None:
    """Print the errors of every set and the worst of each parameter."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    rng = np.random.default_rng(2024)
    rows = [("paper", errors_percent(paper_joint()))]
    print("error, % of the truth")
    print("set".ljust(8), *(name.rjust(10) for name in JOINT_FIELDS))
    for k in range(count + 1):
        label, errors = rows[-1]
        print(label.ljust(8), *(f"{errors[name]:10.2e}" for name in JOINT_FIELDS), flush=True)
        if k < count:
            rows.append((f"{k + 1}", errors_percent(random_joint(rng))))
    print(
        "worst".ljust(8),
        *(f"{max(errors[name] for _, errors in rows):10.2e}" for name in JOINT_FIELDS),
    )


if __name__ == "__main__":
    main()
