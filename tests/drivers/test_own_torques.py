"""Torques of a user's file in the simulated machine."""

import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.mock.plant.effects.own import injected, own_torques
from drivers.mock.plant.machine import SimulatedMachine, simulate
from drivers.mock.plant.parts.constants import Machine, Sensing
from drivers.mock.without_bus import record

QUADRATIC = """
def helper(x):
    return x

def inject_drag(angle, speed, motor_torque, load, state, dt, p):
    {}
    return p.c * speed * abs(speed)
"""
PLAIN = Machine(sensing=Sensing(current_noise_A=0.0))


def command(time: np.ndarray) -> np.ndarray:
    return 0.3 * np.sin(4.0 * time) * np.minimum(time, 1.0)


def machine(tmp_path: Path, text: str, **effects: dict[str, float]) -> Machine:
    path = tmp_path / "mine.py"
    path.write_text(text)
    return dataclasses.replace(PLAIN, effects=effects, effects_file=str(path))


@pytest.mark.parametrize("line", ["state[0] += dt", "speed = helper(speed)"])
def test_a_torque_of_ones_own_is_that_of_the_catalogue(line, tmp_path, caplog):
    own = machine(tmp_path, QUADRATIC.format(line), drag={"c": 5.0})
    known = dataclasses.replace(PLAIN, effects={"quadratic_drag": {"coefficient_Nms2_rad2": 5.0}})
    found, wanted, plain = (simulate(m, command, 1.0, 500.0) for m in (own, known, PLAIN))
    effect = wanted["mean_current"] - plain["mean_current"]
    # Single samples differ by the current of one step of an encoder.
    error = found["mean_current"] - wanted["mean_current"]
    assert np.std(error) < 0.02 * np.std(effect)
    assert ("is not compiled" in caplog.text) is ("helper" in line)


def test_cycles_in_one_call_are_those_one_by_one(tmp_path: Path) -> None:
    text = """
def inject_lag(angle, speed, motor_torque, load, state, dt, p):
    state[0] += (speed - state[0]) * dt / p.lag
    return p.c * state[0] + p.share * load + 0.0 * motor_torque * angle

def inject_push(angle, speed, motor_torque, load, state, dt, p):
    state[0] += dt
    return p.torque * state[0]
"""
    hidden = machine(
        tmp_path, text, lag={"c": 4.0, "lag": 0.1, "share": 0.01}, push={"torque": 0.5}
    )
    found = []
    for length in (300, 1):
        plant = SimulatedMachine(hidden, np.random.default_rng(0))
        plant.hang(10.0)
        plant.power(True)
        path = command(np.arange(300) * 1e-3)
        parts = [record(plant, path[k : k + length]) for k in range(0, 300, length)]
        found.append(np.concatenate([p.motor_angle for p in parts]))
    assert np.array_equal(*found)
    assert np.ptp(found[0]) > 1.0


def test_a_torque_that_is_not_finite_ends_the_simulation(tmp_path: Path) -> None:
    text = """
def inject_drag(angle, speed, motor_torque, load, state, dt, p):
    return p.c / (abs(angle) - 0.05) if angle > 0.0 else 0.0 / max(0.05 - abs(angle), 0.0)
"""
    own = machine(tmp_path, text, drag={"c": 0.01})
    with pytest.raises(ConfigurationError, match=r"mine.py:2: .*not finite"):
        simulate(own, command, 2.0, 500.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def inject_drag(\n", r"mine.py:1: SyntaxError: '\(' was never closed"),
        ("def inject_drag(angle):\n    return 0.0\n", "mine.py:1: TypeError"),
        ("def inject_drag(*given):\n    return given[-1].d\n", "mine.py:2: AttributeError"),
        (
            "def inject_drag(*given):\n    return 0.0 * 1e400\n",
            "mine.py:1: inject_drag returns nan",
        ),
        ("def inject_drag(*given):\n    return None\n", "mine.py:1: TypeError"),
        ("x = 1 / 0\ndef inject_drag(*given): ...\n", "mine.py:1: ZeroDivisionError"),
    ],
)
def test_a_wrong_file_is_refused_with_its_place(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=words):
        own_torques(machine(tmp_path, text, drag={"c": 1.0}))


def test_names_are_read_without_running_the_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text("raise SystemExit\ndef inject_a(): ...\ndef other(): ...\n")
    assert injected(path) == ["a"]


def test_nothing_stays_registered(tmp_path: Path) -> None:
    modules, paths = set(sys.modules), list(sys.path)
    own_torques(machine(tmp_path, QUADRATIC.format("pass"), drag={"c": 1.0}))
    assert set(sys.modules) == modules
    assert sys.path == paths
