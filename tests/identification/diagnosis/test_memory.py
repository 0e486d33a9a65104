"""Regressors with a state against their closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from identification.numerics.series import (
    dahl,
    delayed_series,
    falling_play,
    first_order_lag,
    first_swing,
    play,
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


def test_a_driven_side_that_its_friction_holds_stands_in_the_gap_under_a_weight_as_well() -> None:
    angle = 0.5 * np.sin(2.0 * np.pi * TIME)
    pull, hold = np.full(2000, 5.0), np.full(2000, 60.0)
    lead = falling_play(angle, np.gradient(angle, 1e-3), 1e-3, 0.1, pull, hold, 0.0)
    assert lead == pytest.approx(play(angle, 0.1), abs=0.01), (
        "it coasts on for less than a tenth of the gap"
    )


def test_a_driven_side_falls_through_the_gap_as_its_weight_says() -> None:
    still, pull, hold = np.zeros(2000), np.full(2000, 9.0), np.full(2000, 5.0)
    lead = falling_play(still, still, 1e-3, 0.2, pull, hold, 0.1)
    falls = 0.1 - 0.5 * (9.0 - 5.0) * TIME**2
    assert lead == pytest.approx(np.maximum(falls, -0.1), abs=1e-3)
    assert lead[-1] == -0.1


def test_a_play_that_has_been_crossed_no_longer_knows_where_it_began() -> None:
    angle = 0.5 * np.sin(2.0 * np.pi * TIME)
    crossed = first_swing(angle, 0.3)
    assert play(angle, 0.3, 0.15)[crossed:] == pytest.approx(
        play(angle, 0.3, -0.15)[crossed:], abs=1e-12
    )
    assert play(angle, 0.3, 0.15)[crossed - 1] != pytest.approx(
        play(angle, 0.3, -0.15)[crossed - 1], abs=1e-6
    )
    assert first_swing(angle, 1.1) == len(angle)


def test_dahl_friction_starts_at_its_stiffness_and_ends_at_its_level() -> None:
    angle = np.linspace(0.0, 0.05, 2001)
    force = dahl(angle, np.full(2001, 7.0), 2000.0)
    assert force == pytest.approx(7.0 * (1.0 - np.exp(-2000.0 * angle / 7.0)), abs=1e-9)


def test_dahl_friction_forgets_what_it_began_with() -> None:
    angle = np.linspace(0.0, 0.05, 2001)
    level = np.full(2001, 7.0)
    loaded, free = dahl(angle, level, 2000.0, -5.0), dahl(angle, level, 2000.0)
    assert loaded[0] == -5.0
    assert loaded == pytest.approx(7.0 - 12.0 * np.exp(-2000.0 * angle / 7.0), abs=1e-9)
    assert loaded[-1] == pytest.approx(free[-1], abs=1e-4)
    assert dahl(angle, level, 2000.0, -50.0)[0] == -7.0, "no more than it bears"


def test_dahl_friction_dissipates() -> None:
    angle = 0.01 * np.sin(2.0 * np.pi * TIME)
    force = dahl(angle, np.full(len(angle), 7.0), 3000.0)
    assert float(np.sum(force[1001:] * np.diff(angle[1000:]))) > 0.0


def test_a_maxwell_slip_element_closes_its_loop_within_its_force() -> None:
    force = play(10.0 * np.sin(2.0 * np.pi * TIME), 4.0)
    assert np.max(np.abs(force)) == 2.0
    assert force[1250] == 2.0
    assert force[1260] < 2.0, "it gives as soon as the torque turns"
    assert force[999] == pytest.approx(force[1999], abs=1e-9)


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
