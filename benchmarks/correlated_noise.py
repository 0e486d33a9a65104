"""Intervals under correlated noise of the current sensor: how often they hold the truth, and what is refused.

Unloaded stages of the fitted model itself (``benchmarks/profile_coverage.py``), the measured torque with noise of one
rms and several poles of a first-order process; half of its power white in each case. The equation error's intervals
stand beside those of the default method, and beside both what they would be for white errors.

    python benchmarks/correlated_noise.py --benches 20
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from profile_coverage import stage
from scipy import signal

from identification.estimate.default import free_names, identify, solve_stages
from identification.estimate.regression import model_torque
from identification.estimate.uncertainty import block_sandwich
from identification.model.nominal import NOMINAL
from identification.prepare import Prepared, prepare
from identification.recording import Array, Dataset, Model
from rig.tables import table

POLES = (0.0, 0.5, 0.9, 0.98)
NOISE_N_M = 0.1
NORMAL_90 = 1.6449
BANDWIDTH_HZ = 40.0
SYSTEM = ("Mc", "Ms", "omega_sf", "sigma_2", "J")


def noise(rng: np.random.Generator, samples: int, pole: float) -> Array:
    """Return noise of :data:`NOISE_N_M`, half of its power white and half of a first-order process."""
    settle = 2000
    driven = signal.lfilter([(1.0 - pole**2) ** 0.5], [1.0, -pole], rng.standard_normal(samples + settle))[settle:]
    return np.asarray(NOISE_N_M * 0.5**0.5 * (driven + rng.standard_normal(samples)))


def white_half_widths(p: Prepared, values: Mapping[str, float]) -> dict[str, float]:
    """Return the equation error's half widths as if its errors were white."""
    here = model_torque(p, values, 2.0)
    columns = []
    for name in SYSTEM:
        step = 1e-5 * abs(values[name])
        columns.append((model_torque(p, {**values, name: values[name] + step}, 2.0) - here)[p.used] / step)
    jacobian, residual = np.column_stack(columns), (p.torque - here)[p.used]
    covariance = np.linalg.inv(jacobian.T @ jacobian) * np.mean(residual**2)
    return dict(zip(SYSTEM, NORMAL_90 * np.sqrt(np.diag(covariance)), strict=True))


def main() -> None:
    """Print coverage by pole."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--benches", type=int, default=20)
    arguments = parser.parse_args()
    rows = []
    for pole in POLES:
        equation, plain, final, refused = [], [], [], 0
        for seed in range(arguments.benches):
            rng = np.random.default_rng(seed)
            clean = stage(dict(NOMINAL), 0.0, rng, 0.0)
            torque = clean.channels["torque"] + noise(rng, len(clean.time), pole)
            recording = replace(clean, channels={**clean.channels, "torque": torque})
            p = prepare(recording, BANDWIDTH_HZ)
            values, _ = solve_stages([p], [], Model(), lambda _stage, _share: None)
            spread = block_sandwich([p], values, free_names(values, Model()), 2.0)
            white = white_half_widths(p, values)
            for name in SYSTEM:
                off = abs(values[name] - NOMINAL[name])
                equation.append(off <= spread.half_width(name))
                plain.append(off <= white[name])
            found = identify(Dataset((recording,)), bandwidth_Hz=BANDWIDTH_HZ)
            refused += bool(found.warnings)
            if not found.warnings:
                final += [q.low <= NOMINAL[n] <= q.high for n, q in found.parameters.items() if q.low and q.high]
        cells = [f"{100.0 * np.mean(held):.0f}" if held else "-" for held in (plain, equation, final)]
        rows.append([f"{pole:g}", *cells, f"{refused} of {arguments.benches}"])
        print("row:", *rows[-1], flush=True)
    header = ["pole", "equation error as if white", "equation error", "default where taken", "default refused"]
    print(table(header, rows, range(1, 5)))


if __name__ == "__main__":
    main()
