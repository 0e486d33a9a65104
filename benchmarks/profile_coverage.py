"""How often profile ranges and intervals hold the truth, on data of the fitted model itself.

Two stages of 10 s at 1 kHz under a usual servo loop with set-valued friction; the torque is a noisy
mean over each period, half of the noise's power in the torque itself and half in its measurement,
the encoder is quantised. The constants are drawn within 20 % of the practical bench's. Beside the
scaled range stands that of the likelihood as it comes.

    python benchmarks/profile_coverage.py --benches 40
"""

from __future__ import annotations

import argparse
from collections import defaultdict

import numpy as np
from scipy import stats

from identification.estimate.default import identify
from identification.estimate.uncertainty import crossings
from identification.model.parameters import NOMINAL
from identification.recording import Array, Bench, Dataset, Recording
from identification.simulate.drive_loop import respond, usual_loop
from rig.common.tables import table

PERIOD_S, STAGE_S = 1e-3, 10.0
BENCH = Bench(moment_arm=0.095)
COUNT_RAD = 2.0 * np.pi / 409600.0
NOISE_N_M = 0.1
SPREAD = 0.2


def stage(
    truth: dict[str, float],
    weight_kg: float,
    rng: np.random.Generator,
    noise_N_m: float = NOISE_N_M,
) -> Recording:
    """Simulate and log one stage."""
    time = PERIOD_S * np.arange(round(STAGE_S / PERIOD_S))
    command = np.deg2rad(20.0) * np.sin(0.8 * np.pi * time) * np.clip(time, 0.0, 1.0)
    noise, read = noise_N_m * 0.5**0.5 * rng.standard_normal((2, len(time)))
    moment = BENCH.contact_force(weight_kg) * 0.095
    out = respond(command, PERIOD_S, truth, moment, 2.0, usual_loop(truth["J"], 75.0), noise)
    angle: Array = np.floor(out.angle / COUNT_RAD + rng.uniform()) * COUNT_RAD
    return Recording(
        name=f"{weight_kg:g} kg",
        channels={"time": time, "angle": angle, "torque": out.torque + read},
        bench=BENCH,
        stage="loaded" if weight_kg else "unloaded",
        weight_mass=weight_kg,
        averaged=frozenset({"torque"}),
    )


def main() -> None:
    """Print coverage by parameter."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--benches", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    held: dict[str, list[tuple[bool, bool, bool]]] = defaultdict(list)
    refused: list[int] = []
    for seed in range(arguments.first, arguments.first + arguments.benches):
        rng = np.random.default_rng(seed)
        truth = {n: v * rng.uniform(1.0 - SPREAD, 1.0 + SPREAD) for n, v in NOMINAL.items()}
        truth["Ms"], truth["mu_s"] = (
            max(truth["Ms"], 1.2 * truth["Mc"]),
            max(truth["mu_s"], 1.2 * truth["mu_c"]),
        )
        found = identify(Dataset((stage(truth, 0.0, rng), stage(truth, 30.6, rng))), profile=True)
        if not found.profiles:
            refused.append(seed)
            print(f"bench {seed}: {'; '.join(found.warnings)}", flush=True)
        for curve in found.profiles:
            p, true = found.parameters[curve.name], truth[curve.name]
            if p.low is None or p.high is None:
                continue
            ranges = (
                (curve.low, curve.high),
                crossings(curve.values, curve.deviance / curve.scale),
            )
            scaled, plain = (
                (low is None or low <= true) and (high is None or true <= high)
                for low, high in ranges
            )
            held[curve.name].append((p.low <= true <= p.high, scaled, plain))
    rows = []
    for name, each in (*held.items(), ("all", [h for some in held.values() for h in some])):
        counts = np.sum(each, axis=0)
        ends = [
            stats.beta.ppf(
                q, [counts[1], counts[1] + 1], [len(each) - counts[1] + 1, len(each) - counts[1]]
            )[k]
            for k, q in enumerate((0.05, 0.95))
        ]
        rows.append(
            [
                name,
                str(len(each)),
                *(f"{100.0 * c / len(each):.1f}" for c in counts),
                f"{100 * ends[0]:.0f} to {100 * ends[1]:.0f}",
            ]
        )
    print(
        table(
            [
                "parameter",
                "benches",
                "interval",
                "profile",
                "profile, unscaled",
                "90 % of the profile's",
            ],
            rows,
            range(1, 5),
        )
    )
    print(f"refused: {refused or 'none'}")


if __name__ == "__main__":
    main()
