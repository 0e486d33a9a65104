"""Trade-offs in words, on covariances whose pinned combination is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from identification.estimate.parameter_table import least_pinned, tradeoffs
from identification.model.parameters import UNITS_ROTARY
from identification.numerics.spread import Spread

from .synthetic import TRUTH


def spread(names: tuple[str, ...], pinned: list[float], tight: float, loose: float) -> Spread:
    """Two parameters of which ``pinned`` @ both has deviation ``tight``, and their other
    combination ``loose``.
    """
    basis = np.array([pinned, [-pinned[1], pinned[0]]])
    turn = np.linalg.inv(basis)
    return Spread(names, turn @ np.diag([tight**2, loose**2]) @ turn.T, math.inf)


@pytest.mark.parametrize(
    ("names", "weight", "told"),
    [
        (
            ("Mc", "sigma_2"),
            0.3,
            "sum at 0.3 rad/s is determined, Mc + 0.3 sigma_2 = 8.4289 +- 0.0016 N m",
        ),
        (
            ("mu_c", "mu_2"),
            0.3,
            "sum at 0.3 rad/s is determined, mu_c + 0.3 mu_2 = 0.0616 +- 0.0016",
        ),
        (("Ms", "mu_s"), 285.0, "sum at a contact moment of 285 N m is determined, Ms + 285 mu_s"),
    ],
)
def test_the_pinned_sum_is_found(names: tuple[str, str], weight: float, told: str) -> None:
    (pair,) = tradeoffs(spread(names, [1.0, weight], 0.001, 10.0 * weight), TRUTH, UNITS_ROTARY)
    assert pair.names == names
    assert pair.correlation < -0.99
    assert told in pair.statement


def test_other_pairs_are_told_as_products_and_ratios() -> None:
    relative = np.array([TRUTH["mu_s"], TRUTH["omega_sL"]])
    for sign, words in (
        (-1.0, "only the product mu_s omega_sL^0.5 is determined"),
        (1.0, "only the ratio mu_s / omega_sL^0.5 "),
    ):
        # mu_s moves by half a percent for each percent of omega_sL, and by 0.01 % on its own.
        moves = np.array([[0.005 * sign, 0.0001], [0.01, 0.0]]) * relative[:, None]
        (pair,) = tradeoffs(
            Spread(("mu_s", "omega_sL"), moves @ moves.T, math.inf), TRUTH, UNITS_ROTARY
        )
        assert words in pair.statement
        assert pair.statement.endswith("to 0.016 %")


def test_what_does_not_trade_off_is_not_told() -> None:
    independent = Spread(("Mc", "J"), np.diag([1e-6, 1e-4]), math.inf)
    assert tradeoffs(independent, TRUTH, UNITS_ROTARY) == ()
    line = least_pinned(independent, TRUTH)
    assert line.startswith("least determined is J alone: relative standard deviation 4.9 %")
