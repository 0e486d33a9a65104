"""Regressors with a state, waves, sums over blocks and least squares against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.diagnosis.rows import in_blocks
from identification.numerics.least_squares import least_squares
from identification.numerics.series import (
    dahl,
    delayed_series,
    falling_play,
    first_order_lag,
    play,
    sine_cosine,
    temperature_rise,
)
from identification.recording import Array

TIME = np.arange(2000) * 1e-3


def test_a_lag_answers_a_ramp_by_its_time_constant_late() -> None:
    ramp = np.maximum(TIME - 0.5, 0.0)
    answer = first_order_lag(ramp, 1e-3, 0.1)
    later = TIME >= 0.5
    since = TIME[later] - 0.5
    assert answer[later] == pytest.approx(since - 0.1 * (1.0 - np.exp(-since / 0.1)), abs=1e-9)
    assert np.all(answer[~later] == 0.0)


def test_play_follows_only_beyond_its_gap() -> None:
    angle = np.concatenate([np.linspace(0.0, 1.0, 101), np.linspace(1.0, 0.0, 101)])
    lead = play(angle, 0.2)
    driven = angle - lead
    assert lead[100] == pytest.approx(0.1)
    assert driven[100] == pytest.approx(0.9)
    assert driven[110] == pytest.approx(0.9), "the driven side stands within the gap"
    assert driven[-1] == pytest.approx(0.1)


def test_a_driven_side_falls_through_the_gap_as_its_weight_says() -> None:
    still, pull, hold = np.zeros(2000), np.full(2000, 9.0), np.full(2000, 5.0)
    lead = falling_play(still, still, 1e-3, 0.2, pull, hold, 0.1)
    falls = 0.1 - 0.5 * (9.0 - 5.0) * TIME**2
    assert lead == pytest.approx(np.maximum(falls, -0.1), abs=1e-3)
    assert lead[-1] == -0.1


def test_dahl_friction_starts_at_its_stiffness_and_ends_at_its_level() -> None:
    angle = np.linspace(0.0, 0.05, 2001)
    force = dahl(angle, np.full(2001, 7.0), 2000.0)
    assert force == pytest.approx(7.0 * (1.0 - np.exp(-2000.0 * angle / 7.0)), abs=1e-9)


def test_a_warming_body_ends_at_its_loss() -> None:
    run = np.linspace(0.0, 600.0, 6001)
    run[3000:] += 40.0
    rise, left = temperature_rise(np.full(6001, 3.0), run, 60.0)
    assert rise == pytest.approx(3.0 * (1.0 - np.exp(-run / 60.0)), abs=1e-9)
    assert left == pytest.approx(np.exp(-run / 60.0), abs=1e-9), (
        "a hole between samples counts as time"
    )


def test_a_play_forgets_where_it_began_once_it_was_crossed() -> None:
    angle = np.concatenate([np.linspace(0.0, 0.3, 50), np.linspace(0.3, 0.0, 50)])
    middle, ahead = play(angle, 0.2), play(angle, 0.2, 0.1)
    assert ahead[0] == pytest.approx(0.1)
    crossed = np.maximum.accumulate(angle) - np.minimum.accumulate(angle) >= 0.2
    assert ahead[crossed] == pytest.approx(middle[crossed])
    assert np.max(np.abs(ahead - middle)) == pytest.approx(0.1)
    assert play(angle, 0.2, 5.0)[0] == pytest.approx(0.1), "no further than a flank"


@pytest.mark.parametrize("time_s", [0.0, 0.003, 0.00137, -0.0217])
def test_a_delay_is_exact_for_a_cubic_away_from_the_ends(time_s: float) -> None:
    """A log of 100 Hz resolves a delay of one and a half samples only with the curvature."""

    def cubic(time: Array) -> Array:
        return 0.3 + 2.0 * time - 70.0 * time**2 + 900.0 * time**3

    time = 0.001 * np.arange(200)
    late = delayed_series(cubic(time), 0.001, time_s)
    assert late[25:175] == pytest.approx(cubic(time - time_s)[25:175], abs=1e-12)


@pytest.mark.parametrize("time_s", [9.0, -9.0, 0.0123])
def test_a_delay_holds_the_ends(time_s: float) -> None:
    series = np.sin(0.1 * np.arange(200))
    late = delayed_series(series, 0.001, time_s)
    held = np.arange(200) - time_s / 0.001
    assert late[held <= 0.0] == pytest.approx(series[0])
    assert late[held >= 199.0] == pytest.approx(series[-1])


@given(st.floats(-200.0, 200.0), st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40))
def test_a_wave_is_sine_and_cosine(frequency: float, angles: list[float]) -> None:
    angle = np.array(angles)
    expected = np.stack([np.sin(frequency * angle), np.cos(frequency * angle)])
    assert sine_cosine(frequency, angle) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("width", [1, 2, 5])
def test_sums_over_blocks_are_those_of_each_block_by_itself(width: int) -> None:
    rng = np.random.default_rng(width)
    columns, residual, block = (
        rng.standard_normal((200, width)),
        rng.standard_normal(200),
        rng.integers(0, 7, 200),
    )
    sums, weights = in_blocks(columns, residual, block, 8)
    for k in range(8):
        own = columns[block == k]
        assert sums[k] == pytest.approx(own.T @ residual[block == k], abs=1e-12)
        assert weights[k] == pytest.approx(own.T @ own, abs=1e-12)


ROWS = np.linspace(0.0, 1.0, 400)


@pytest.mark.parametrize("scale", [1.0, 1e8])
def test_columns_that_are_apart_come_out_as_by_singular_values(scale: float) -> None:
    columns = np.stack([np.ones(400), scale * ROWS, np.sin(9.0 * ROWS)], axis=1)
    target = np.cos(5.0 * ROWS)
    expected = np.linalg.lstsq(columns, target, rcond=None)[0]
    assert least_squares(columns, target) == pytest.approx(expected, rel=1e-12)


def test_of_columns_that_are_one_each_gets_its_half() -> None:
    columns = np.stack([ROWS, ROWS], axis=1)
    assert least_squares(columns, 3.0 * ROWS) == pytest.approx([1.5, 1.5])


@pytest.mark.parametrize("scale", [1e-170, 1e-120, 1e120])
def test_columns_of_any_size_are_solved_without_overflow(scale: float) -> None:
    """An effect at a hopeless trial shape has next to no column; below 1e-140 it counts as none."""
    rng = np.random.default_rng(2)
    columns = rng.standard_normal((50, 2)) * (1.0, scale)
    found = least_squares(columns, columns @ (2.0, 3.0 / scale))
    assert np.all(np.isfinite(found))
    if scale != 1e-170:
        assert found * (1.0, scale) == pytest.approx([2.0, 3.0], rel=1e-9)


def test_what_is_no_number_is_not_passed_over() -> None:
    columns = np.stack([ROWS, np.full(400, np.nan)], axis=1)
    with pytest.raises(np.linalg.LinAlgError):
        least_squares(columns, ROWS)
