"""Correlated noise of the current sensor: how often intervals hold the truth, and what the
refinement is worth.

Unloaded and loaded stages of the fitted model itself (``benchmarks/profile_coverage.py``), the
measured torque with noise of one rms and several poles of a first-order process; half of its power
white in each case. The equation error's intervals stand beside those of the default method, and
beside both what they would be for white errors.

    python benchmarks/correlated_noise.py --benches 12 --first 100
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from profile_coverage import stage
from scipy import signal

from identification.estimate.default import free_names, identify, solve_stages
from identification.estimate.equation_error import block_sandwich, model_torque
from identification.model.parameters import NOMINAL
from identification.prepare import Prepared, prepare
from identification.recording import Array, Dataset, Model, Recording
from rig.common.tables import table

POLES = (0.0, 0.5, 0.9, 0.98)
NOISE_N_M = 0.1
NORMAL_90 = 1.6449
BANDWIDTH_HZ = 40.0
WEIGHT_KG = 30.6


def noise(rng: np.random.Generator, samples: int, pole: float) -> Array:
    """Return noise of :data:`NOISE_N_M`, half of its power white and half of a first-order
    process.
    """
    settle = 2000
    driven = signal.lfilter(
        [(1.0 - pole**2) ** 0.5], [1.0, -pole], rng.standard_normal(samples + settle)
    )[settle:]
    return np.asarray(NOISE_N_M * 0.5**0.5 * (driven + rng.standard_normal(samples)))


def white_half_widths(
    prepared: list[Prepared], values: Mapping[str, float], names: Sequence[str]
) -> dict[str, float]:
    """Return the equation error's half widths as if its errors were white."""
    columns = []
    here = [model_torque(p, values, 2.0) for p in prepared]
    for name in names:
        step = 1e-5 * abs(values[name])
        moved = {**values, name: values[name] + step}
        slopes = [
            (model_torque(p, moved, 2.0) - h)[p.used] / step
            for p, h in zip(prepared, here, strict=True)
        ]
        columns.append(np.concatenate(slopes))
    residuals = np.concatenate(
        [(p.torque - h)[p.used] for p, h in zip(prepared, here, strict=True)]
    )
    jacobian = np.column_stack(columns)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * np.mean(residuals**2)
    return dict(zip(names, NORMAL_90 * np.sqrt(np.diag(covariance)), strict=True))


def recorded(weight_kg: float, pole: float, rng: np.random.Generator) -> Recording:
    """Return a stage whose measured torque has the noise and nothing else has any."""
    clean = stage(dict(NOMINAL), weight_kg, rng, 0.0)
    torque = clean.channels["torque"] + noise(rng, len(clean.time), pole)
    return replace(clean, channels={**clean.channels, "torque": torque})


def main() -> None:
    """Print coverage, half widths and the noise found, by pole."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--benches", type=int, default=12)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    rows = []
    for pole in POLES:
        equation, plain, final, gains, found_noise, refused = [], [], [], [], [], 0
        for seed in range(arguments.first, arguments.first + arguments.benches):
            rng = np.random.default_rng(seed)
            recordings = tuple(recorded(weight, pole, rng) for weight in (0.0, WEIGHT_KG))
            unloaded, loaded = ([prepare(r, BANDWIDTH_HZ)] for r in recordings)
            values, _ = solve_stages(unloaded, loaded, Model(), lambda _stage, _share: None)
            names = free_names(values, Model())
            spread = block_sandwich([*unloaded, *loaded], values, names, 2.0)
            white = white_half_widths([*unloaded, *loaded], values, names)
            off = {name: abs(values[name] - NOMINAL[name]) for name in names}
            equation += [off[n] <= spread.half_width(n) for n in names]
            plain += [off[n] <= white[n] for n in names]
            found = identify(Dataset(recordings), bandwidth_Hz=BANDWIDTH_HZ)
            refused += bool(found.warnings)
            if found.warnings or found.noise is None:
                continue
            found_noise.append(
                (found.noise.torque, found.noise.correlated, found.noise.correlation_s)
            )
            for name, q in found.parameters.items():
                if q.low is not None and q.high is not None:
                    final.append(q.low <= NOMINAL[name] <= q.high)
                    if name in names:
                        gains.append(spread.half_width(name) / (0.5 * (q.high - q.low)))
        cells = [
            f"{100.0 * np.mean(held):.0f} of {len(held)}" if held else "-"
            for held in (plain, equation, final)
        ]
        levels = np.median(found_noise, axis=0) if found_noise else np.full(3, np.nan)
        rows.append(
            [
                f"{pole:g}",
                *cells,
                f"{np.median(gains):.1f}" if gains else "-",
                f"{levels[0]:.3f} + {levels[1]:.3f}",
                f"{1e3 * levels[2]:.1f}",
                f"{refused} of {arguments.benches}",
            ]
        )
        print("row:", *rows[-1], flush=True)
    header = [
        "pole",
        "equation error as if white, %",
        "equation error, %",
        "default where taken, %",
        "times narrower",
        "white + correlated, N m",
        "over, ms",
        "default refused",
    ]
    print(table(header, rows, range(1, 8)))


if __name__ == "__main__":
    main()
