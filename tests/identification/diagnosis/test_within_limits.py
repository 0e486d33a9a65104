"""Fits within their limits: what is reported is what the reported constants leave."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from identification.diagnosis.joint import Joint, fit
from identification.diagnosis.rows import equations
from identification.diagnosis.within_limits import within_limits
from identification.effects import MOTION
from identification.recording import Array, Recording
from identification.views.nominal import Nominal
from identification.views.view import View, views

from .benches import campaign, nominal_fit

TERM = {t.name: t for t in MOTION}


@lru_cache
def recordings() -> tuple[Recording, ...]:
    return campaign({}, 11, 6.0)


def here(joint: Joint) -> tuple[View, ...]:
    return joint.equations[0].views


def left_by(joint: Joint) -> Array:
    """Return what the reported constants leave of the torque's rows, evaluated anew."""
    rows = next(e for e in equations(here(joint), joint.nominal, "N m") if e.name == "torque")
    left = rows.residual.copy()
    for effect in joint.effects:
        columns = joint.stack.columns(effect.term, effect.shape)["torque"]
        left -= columns @ np.array(effect.coefficients)
    return left


def rubbed_off(recording: Recording, share: float) -> Recording:
    """Return a recording whose torque falls with speed, as no viscous friction does."""
    speed = np.gradient(recording.channels["motor_angle"], recording.time)
    current = recording.channels["current"] - share * speed
    return replace(recording, channels={**recording.channels, "current": current})


@pytest.mark.parametrize("share", [0.0, 0.08])
def test_what_is_left_is_what_the_reported_constants_leave(share: float) -> None:
    """Also where the rows ask for viscous friction below zero."""
    fitted = [rubbed_off(r, share) for r in recordings()[:2]]
    joint = nominal_fit(fitted)
    bounded = within_limits(joint)
    torque = next(e for e in joint.equations if e.name == "torque")
    rows = bounded.stack.part("torque")
    np.testing.assert_allclose(torque.sigma * bounded.residual[rows], left_by(bounded), atol=1e-9)
    assert all(v >= 0.0 for v in bounded.nominal.values.values())
    assert (bounded.nominal.get("sigma_2") == 0.0) == (share > 0.0)
    # Never more than the values that the fit ended at leave.
    assert np.sum(left_by(bounded) ** 2) <= (1.0 + 1e-9) * np.sum(left_by(joint) ** 2)


def test_with_the_speeds_as_they_are_it_is_bounded_least_squares() -> None:
    joint = nominal_fit([rubbed_off(r, 0.08) for r in recordings()[:2]])
    bounded = within_limits(joint)
    torque = next(e for e in equations(here(joint), bounded.nominal, "N m") if e.name == "torque")
    free = bounded.nominal.free
    use = [k for k, name in enumerate(free) if name != "omega_sf"]
    values = np.array(
        [
            bounded.nominal.get(free[k]) - (bounded.nominal.get("Mc") if free[k] == "Ms" else 0.0)
            for k in use
        ]
    )
    columns = torque.tangent[:, use]
    best = lsq_linear(columns, torque.residual + columns @ values, (0.0, np.inf))
    assert np.sum(torque.residual**2) == pytest.approx(2.0 * best.cost, rel=1e-4)
    np.testing.assert_allclose(best.x, values, rtol=2e-2, atol=1e-3)


def test_of_constants_that_cannot_be_told_apart_the_least_are_taken() -> None:
    """One way of motion: Coulomb friction and an offset are one column."""
    recording = recordings()[0]
    start = nominal_fit(recordings()[:1]).nominal
    there = views([recording], 25.0)
    ahead = tuple(replace(v, moving=v.moving & (v.low_pass(v.velocity) > 0.0)) for v in there)

    values = {**start.values, "offset": -7.0e5, "Mc": start.get("Mc") + 7.0e5}
    values["Ms"] = values["Mc"] + 3.0
    joint = fit(ahead, "N m", Nominal(values, (*start.free, "offset"), 2.0))
    found = within_limits(joint).nominal
    assert found.get("Mc") < 20.0
    assert abs(found.get("offset")) < 20.0
    assert found.get("Mc") + found.get("offset") == pytest.approx(start.get("Mc"), rel=0.1)


@pytest.mark.parametrize("averaged", [False, True])
def test_a_voltage_that_is_held_for_an_unknown_part_of_a_sample_may_be_late(averaged: bool) -> None:
    """A sample of lateness is no mismatch, unless the channel is declared as an average."""
    late = tuple(
        replace(
            r,
            channels={**r.channels, "voltage": np.roll(r.channels["voltage"], 1)},
            averaged=r.averaged | {"voltage"} if averaged else r.averaged - {"voltage"},
        )
        for r in recordings()[:2]
    )
    rows = equations(views(late, 25.0), nominal_fit(recordings()[:2]).nominal, "N m")
    voltage = next(e for e in rows if e.name == "voltage")
    basis, _ = np.linalg.qr(voltage.tangent)
    left = voltage.residual - basis @ (basis.T @ voltage.residual)
    assert (float(np.mean(left**2)) < 2.0 * voltage.sigma**2) is not averaged, left
