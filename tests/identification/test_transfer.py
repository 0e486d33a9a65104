"""A model carried over: what moved, and the noise floor against a noise that is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from identification.estimate.default import identify
from identification.estimate.equation_error import command_period, noise_floor
from identification.estimate.ladder import moved, transfer
from identification.prepare import prepare
from identification.recording import Array, Dataset, Recording, RecordingError
from identification.result import Parameter

from .synthetic import TRUTH, sine

NOISE_NM = 0.2
RATE = 200.0


def noise(seed: int) -> Callable[[int], Array]:
    return lambda count: NOISE_NM * np.random.default_rng(seed).standard_normal(count)


def day(seed: int, duration: float = 20.0, **change: float) -> Recording:
    made = sine(
        {**TRUTH, **change}, name=f"day {seed}", rate=RATE, duration=duration, noise=noise(seed)
    )
    return replace(
        made, channels={**made.channels, "command": made.channels["angle"]}, sha256=f"{seed}"
    )


def test_only_the_parameter_that_changed_has_moved() -> None:
    first, second = Dataset((day(1),)), Dataset((day(2, Mc=8.0, Ms=13.2),))
    found = transfer(identify(first, bandwidth_Hz=100.0), first, second)
    said = {m.name: m.moved for m in found.parameters}
    assert said["Mc"]
    assert said["Ms"]
    assert not said["sigma_2"]
    assert not said["omega_sf"]
    assert found.fit.train_rms == pytest.approx(8.0 - 6.825, rel=0.1)
    assert found.own.train_rms == pytest.approx(NOISE_NM, rel=0.1)


@pytest.mark.parametrize("missing", [{}, {"Mc": 4.0, "sigma_2": 20.0}])
def test_the_floor_is_the_noise_whatever_the_model(missing: dict[str, float]) -> None:
    p = prepare(day(3), 100.0)
    floor = noise_floor([p], {**TRUTH, **missing}, 2.0)
    assert floor.rms == pytest.approx(NOISE_NM, rel=0.05)
    assert (floor.periods, floor.repeats) == (1, 0)


@pytest.mark.parametrize("ramp_s", [0.0, 1.0])
def test_the_period_of_a_command_is_found_through_its_ramps(ramp_s: float) -> None:
    r = day(6)
    envelope = np.clip(np.minimum(r.time, 20.0 - r.time) / max(ramp_s, 1e-9), 0.0, 1.0)
    shaped = replace(r, channels={**r.channels, "command": envelope * r.channels["command"]})
    assert command_period(shaped) == pytest.approx(5.0, abs=0.006)
    line = replace(r, channels={**r.channels, "command": r.time})
    assert command_period(line) is None


def test_intervals_decide_and_what_is_unknown_has_not_moved() -> None:
    first = Parameter("Mc", "N m", 1.0, 0.9, 1.1)
    assert moved(first, Parameter("Mc", "N m", 1.13, 1.03, 1.23)).moved is False
    assert moved(first, Parameter("Mc", "N m", 1.15, 1.05, 1.25)).moved is True
    assert moved(first, Parameter("Mc", "N m", None, identifiable=False)).moved is None


def test_what_was_fitted_is_no_test() -> None:
    data = Dataset((day(7),))
    fitted = identify(data, bandwidth_Hz=100.0)
    with pytest.raises(RecordingError, match="was fitted to this recording"):
        transfer(fitted, data, data)
    with pytest.raises(RecordingError, match="unloaded recordings only"):
        transfer(fitted, data, Dataset((sine(weight=30.6),)))
