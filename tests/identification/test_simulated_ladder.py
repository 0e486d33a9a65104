"""Friction fitted to the predicted angle: known constants recovered from noisy loops, and the rungs
ranked on another mass.
"""

import math
from dataclasses import replace

import pytest

from identification.estimate.simulated_ladder import (
    PER_VOLT,
    SimulatedRung,
    climb_simulated,
    open_horizon,
    pieces_of,
    predictable,
)
from identification.model.parameters import DIRECTIONAL, TRANSMITTED
from identification.prepare import prepare
from identification.recording import Dataset, Recording

from .synthetic import sine
from .voltage_lever import DECLARED, LATENESS, TRUE_KM, TRUE_R, TRUTH, lever

BANDWIDTH_HZ = 8.0


def fitted(closed: bool = True, times: int = 1) -> tuple[Recording, ...]:
    return tuple(
        lever(0.4, length, seed=10 * k + n, closed=closed)
        for k, length in enumerate((0.05, 0.08, 0.11))
        for n in range(times)
    )


def aside(closed: bool = True) -> tuple[Recording, ...]:
    return tuple(
        lever(0.8, length, role="validate", seed=50 + k, closed=closed)
        for k, length in enumerate((0.05, 0.11))
    )


def climbed(dataset: Dataset) -> dict[tuple[str, bool], SimulatedRung]:
    rungs = climb_simulated(dataset, bandwidth_Hz=BANDWIDTH_HZ)
    return {(r.friction, r.free): r for r in rungs}


@pytest.fixture(scope="module")
def loops() -> dict[tuple[str, bool], SimulatedRung]:
    return climbed(Dataset((*fitted(), *aside())))


@pytest.mark.proof
def test_constants_are_recovered_from_noisy_loops() -> None:
    found = climbed(Dataset((*fitted(times=2), *aside())))[TRANSMITTED, True]
    assert found.fitted["mu_gd"] == 1.0
    assert found.fitted["mu_gc"] == pytest.approx(TRUTH["mu_gc"], rel=0.1)
    assert found.fitted["mu_gs"] == pytest.approx(TRUTH["mu_gs"], rel=0.1)
    assert found.fitted["lateness"] == pytest.approx(LATENESS, abs=1.5e-3)
    # The noise alone has a mean absolute value of sqrt(2/pi) times its rms of 1 mrad.
    assert found.train < 1.5 * math.sqrt(2.0 / math.pi) * 1e-3
    assert found.scored < 2.0 * math.sqrt(2.0 / math.pi) * 1e-3


def test_a_motor_stronger_than_declared_is_reported_as_moved(loops):
    found = {c.name: c for c in loops[TRANSMITTED, True].constants}
    drive = found[PER_VOLT]
    assert DECLARED.resistance is not None
    assert drive.declared == DECLARED.torque_constant / DECLARED.resistance
    assert drive.value == pytest.approx(TRUE_KM / TRUE_R, rel=0.02)
    assert drive.change == pytest.approx(0.25, abs=0.03)
    assert drive.moved
    assert drive.low <= TRUE_KM / TRUE_R <= drive.high
    assert found["resistance"].prior == 0.3
    assert not loops[TRANSMITTED, False].constants


@pytest.mark.proof
def test_a_stated_deviation_holds_a_constant(loops):
    sure = {"bench.torque_constant": 5e-4, "bench.resistance": 4e-3}
    recordings = tuple(replace(r, uncertainties=sure) for r in fitted())
    found = climbed(Dataset(recordings))[TRANSMITTED, True]
    constants = {c.name: c for c in found.constants}
    assert constants["resistance"].prior == pytest.approx(1e-3)
    assert abs(constants["resistance"].change) < 0.02
    assert found.train > loops[TRANSMITTED, True].train
    assert found.scored is None


def test_the_rung_that_made_the_data_predicts_another_mass_best(loops):
    scored = {key: rung.scored for key, rung in loops.items() if rung.scored}
    assert scored[TRANSMITTED, True] < 0.7 * scored["stribeck_load_dependent", True]
    assert scored["stribeck_load_dependent", True] < 0.7 * scored["stribeck", True]
    assert scored[TRANSMITTED, True] < 0.5 * scored[TRANSMITTED, False]
    chosen = {key for key, rung in loops.items() if rung.chosen}
    assert {free for _, free in chosen} == {False, True}
    assert len(chosen) == 2
    assert next(rung for rung, free in chosen if free) in (TRANSMITTED, DIRECTIONAL)
    assert all(r.crossed > 0.0 for r in loops.values())


@pytest.mark.proof
def test_a_load_that_depends_on_direction_is_recovered() -> None:
    truth = {**TRUTH, "mu_gd": 2.0, "mu_gc": 0.08, "mu_gs": 0.14}
    recordings = tuple(
        lever(0.4, length, seed=10 * k + n, truth=truth)
        for k, length in enumerate((0.05, 0.08, 0.11))
        for n in range(2)
    )
    found = climbed(Dataset(recordings))
    assert found[DIRECTIONAL, True].fitted["mu_gd"] == pytest.approx(2.0, rel=0.15)
    assert found[DIRECTIONAL, True].crossed < 0.9 * found[TRANSMITTED, True].crossed


@pytest.mark.proof
def test_a_voltage_without_its_loop_is_predicted_from_reversal_to_reversal() -> None:
    recordings = fitted(closed=False, times=2)
    prepared = prepare(recordings[0], BANDWIDTH_HZ)
    pieces = pieces_of(prepared)
    assert 0.1 < open_horizon(prepared) < 1.0
    assert len(pieces) > 3
    assert sum(len(p.angle) for p in pieces) == len(recordings[0].time)
    assert pieces[1].velocity != 0.0
    found = climbed(Dataset(recordings))[TRANSMITTED, True]
    drive = next(c for c in found.constants if c.name == PER_VOLT)
    assert found.horizon_s < 1.0
    assert "lateness" in found.fitted
    assert found.fitted["lateness"] == 0.0
    assert drive.value == pytest.approx(TRUE_KM / TRUE_R, rel=0.1)


def test_measured_torque_needs_no_prediction() -> None:
    torque = sine(rate=200.0)
    assert not predictable(torque)
    assert not climbed(Dataset((torque,)))
