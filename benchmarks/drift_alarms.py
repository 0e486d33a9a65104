"""How often `rig runs trend` reports a change: over simulated histories of ten runs without a
change, with a drift of one constant, and with a step after half of the runs, as after a change of
one unit to another.

    python benchmarks/drift_alarms.py --histories 100
"""

from __future__ import annotations

import argparse

import numpy as np

from rig.results.catalogue.compare import courses
from rig.runs.catalogue.entry import Constant, Details

NAMES = ("Mc", "Ms", "omega_sf", "sigma_2", "J", "mu_c", "mu_s", "omega_sL", "mu_2")
RUNS = 10
HALF_WIDTH = 0.01
"""Half of the 90 % interval of each constant, whose true value is 1."""
PER_SIGMA = 1.645
WIDTHS = 3.0
"""Size of drift and step, in widths of the interval."""


def history(rng: np.random.Generator, course: np.ndarray) -> list[Details]:
    """Return runs whose first constant follows ``course``, shape (RUNS,), in widths of its
    interval.
    """
    values = 1.0 + rng.normal(0.0, HALF_WIDTH / PER_SIGMA, (RUNS, len(NAMES)))
    values[:, 0] += 2.0 * HALF_WIDTH * course
    return [
        Details(
            {
                name: Constant(value, value - HALF_WIDTH, value + HALF_WIDTH, "1")
                for name, value in zip(NAMES, row.tolist(), strict=True)
            },
            0.02,
            "N m",
            "rotary",
            {},
        )
        for row in values
    ]


def main() -> None:
    """Print the numbers of histories in which something, and the right constant, was reported."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--histories", type=int, default=100)
    count = parser.parse_args().histories
    rng = np.random.default_rng(0)
    cases = {
        "no change": np.zeros(RUNS),
        f"drift of {WIDTHS:g} widths": np.linspace(0.0, WIDTHS, RUNS),
        f"step of {WIDTHS:g} widths": np.where(np.arange(RUNS) < RUNS // 2, 0.0, WIDTHS),
    }
    for name, course in cases.items():
        found = [courses(history(rng, course)) for _ in range(count)]
        alarms = [{each.name for each in one if each.alarm} for one in found]
        first = sum(NAMES[0] in each for each in alarms)
        print(f"{name}: {sum(map(bool, alarms))} of {count} with an alarm, {first} on {NAMES[0]}")


if __name__ == "__main__":
    main()
