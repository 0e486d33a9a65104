"""Late angles where the voltage was computed from them, and where it was sampled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from identification.diagnosis.diagnose import diagnose
from identification.recording import Bench, Controller, Dataset, Model, Recording
from identification.views.view import command_delay_error, views, voltage_is_computed

from .benches import campaign

TIME = np.arange(3000) / 140.0
LATE_S, GAIN, SUPPLY_V = 0.007, 2.0, 6.0
BENCH = Bench(torque_constant=0.5, back_emf_constant=0.5, resistance=4.0)


def _law(command_time: np.ndarray, angle_time: np.ndarray) -> np.ndarray:
    return SUPPLY_V * GAIN * (np.sin(2.0 * command_time) - 0.9 * np.sin(2.0 * angle_time - 0.2))


def _recording() -> Recording:
    seen = TIME - LATE_S
    channels = {
        "angle": 0.9 * np.sin(2.0 * seen - 0.2),
        "command": np.sin(2.0 * TIME),
        "voltage": _law(TIME, seen),
        "supply_voltage": np.full(len(TIME), SUPPLY_V),
    }
    return Recording(
        "r", {"time": TIME, **channels}, BENCH, "unloaded", 0.0, controller=Controller("duty", GAIN)
    )


def test_only_the_command_in_a_computed_voltage_is_early() -> None:
    (view,) = views([_recording()], 10.0)
    seen = view.time - LATE_S
    expected = 0.5 / 4.0 * (_law(view.time, seen) - _law(seen, seen))
    off = command_delay_error(view, LATE_S) - expected
    assert np.max(np.abs(off[2:])) < 2e-3 * np.max(np.abs(expected))


def test_a_voltage_is_computed_only_if_the_declared_law_makes_it() -> None:
    recording = _recording()
    assert voltage_is_computed(recording)
    assert not voltage_is_computed(replace(recording, controller=None))
    assert not voltage_is_computed(replace(recording, controller=Controller("duty", 1.01 * GAIN)))
    assert not voltage_is_computed(
        replace(recording, channels={**recording.channels, "current": np.zeros(len(TIME))})
    )
    noisy = recording.channels["voltage"] + np.random.default_rng(0).normal(0.0, 0.05, len(TIME))
    assert not voltage_is_computed(
        replace(recording, channels={**recording.channels, "voltage": noisy})
    )


@pytest.mark.parametrize("name", ["command", "supply_voltage"])
def test_without_a_channel_of_the_law_nothing_is_computed(name: str) -> None:
    recording = _recording()
    channels = {n: c for n, c in recording.channels.items() if n != name}
    assert not voltage_is_computed(replace(recording, channels=channels))


@pytest.mark.parametrize(
    ("late", "early"), [("angles", 0.004), pytest.param("current", 0.004, marks=pytest.mark.proof)]
)
def test_a_skew_is_found_whichever_channel_is_late(late: str, early: float) -> None:
    """Angles that are late against current and voltage are no lag of the current loop."""
    moved = ("motor_angle", "angle") if late == "angles" else ("current",)

    def skewed(recording: Recording) -> Recording:
        time = recording.time
        channels = {
            name: np.interp(time - early, time, values) if name in moved else values
            for name, values in recording.channels.items()
        }
        return replace(recording, channels=channels)

    found = diagnose(
        Dataset(tuple(skewed(r) for r in campaign({}, 21, 8.0)), Model()),
        rng=np.random.default_rng(0),
    )
    assert [e.name for e in found.effects] == ["time_skew"]
    expected = -early if late == "angles" else early
    assert found.effects[0].parameters["time_s"].value == pytest.approx(expected, rel=0.05)
