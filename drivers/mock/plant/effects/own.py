"""Torques of a user's own file that are injected into the simulated machine.

For the effect NAME of a bench file, the file has a function ``inject_NAME(angle, speed,
motor_torque, load, state, dt, p)`` of angle, rad, speed, rad/s, torque of the motor, N m, and
moment of the load on the lever, N m, all at the joint. It is called at the start of each period
``dt``, s, of the drive's loops with the parameters ``p`` of the bench file and an array ``state``
of :data:`STATES` numbers, first zero, and returns the torque that resists the motion during this
period, N m; positive resists motion in the positive direction.
"""

from __future__ import annotations

import ast
import importlib.util
import logging
import math
import sys
import traceback
from collections import namedtuple
from collections.abc import Callable, Sequence
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from drivers.errors import ConfigurationError
from drivers.mock.plant.effects import table
from drivers.mock.plant.effects.kernel import CONSTANTS_AT, Histories
from drivers.mock.plant.parts import constants, friction, loops
from drivers.mock.plant.parts.compiled import Vector

_LOG = logging.getLogger(__name__)
STATES = 16
_PREFIX = "inject_"
_STEADY_LOAD = CONSTANTS_AT + table.STEADY_LOAD
Kernel = Callable[..., Any]


class OwnTorque(NamedTuple):
    """Function of a user's file for an effect, its parameters, and its place, ``file:line``."""

    name: str
    function: Callable[..., float]
    parameters: Any
    place: str


def injected(path: Path) -> list[str]:
    """Return the names of the effects that a file injects; the file is not run.

    Raises:
        ConfigurationError: The file cannot be read, or is not Python.
    """
    try:
        tree = ast.parse(path.read_bytes(), str(path))
    except (OSError, SyntaxError, ValueError) as error:
        raise ConfigurationError(_words(error, path)) from error
    names = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    return [name.removeprefix(_PREFIX) for name in names if name.startswith(_PREFIX)]


class _Loader(SourceFileLoader):
    """Compiles the file itself, not a stored copy from before the last change."""

    def get_code(self, fullname: str) -> CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


def user_module(path: Path) -> ModuleType:
    """Run a Python file of the user, which can import modules beside it; nothing stays registered.

    Raises:
        ConfigurationError: The file cannot be read or fails; the message has file and line.
    """
    name = f"own_{path.stem}"
    spec = importlib.util.spec_from_loader(name, _Loader(name, str(path)))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up by name
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise ConfigurationError(_words(error, path)) from error
    finally:
        sys.path.remove(str(path.parent))
        del sys.modules[name]
    return module


def own_torques(machine: constants.Machine) -> list[OwnTorque]:
    """Return the functions of the user's file for the effects of a machine, each tried once.

    Raises:
        ConfigurationError: The file cannot be used, or a function fails.
    """
    if not machine.effects_file:
        return []
    path = Path(machine.effects_file)
    names = [name for name in machine.effects if name in injected(path)]
    module = user_module(path) if names else None
    found = []
    for name in names:
        function = getattr(module, f"{_PREFIX}{name}")
        place = f"{path}:{function.__code__.co_firstlineno}"
        given = machine.effects[name]
        record: Any = namedtuple("Parameters", given)  # type: ignore[misc]
        p = record(*map(float, given.values()))
        try:
            first = float(function(0.0, 0.0, 0.0, 0.0, np.zeros(STATES), 1e-4, p))
        except Exception as error:
            line = function.__code__.co_firstlineno
            raise ConfigurationError(_words(error, path, line)) from error
        if not math.isfinite(first):
            raise ConfigurationError(f"{place}: {_PREFIX}{name} returns {first} at rest")
        found.append(OwnTorque(name, function, p, place))
    return found


def with_own_torques(
    own: Sequence[OwnTorque], period_s: float, advance: Kernel, cycles: Kernel
) -> tuple[Kernel, Kernel]:
    """Return the two kernels that move a machine, with torques of the user's file: compiled, or a
    hundred times slower if the functions of the file cannot be compiled.

    Args:
        own: The torques; their states follow those of the effects in the extra state ``x``.
        period_s: Period of the drive's loops, s.
        advance: Kernel that advances a number of loop periods.
        cycles: Kernel that records cycles by ``advance``.
    """

    def built(compile_: Callable[[Any], Any]) -> tuple[Kernel, Kernel]:
        moved = compile_(_with_torque(_sum_of(own, compile_), period_s, advance))
        plain: Any = cycles.py_func  # type: ignore[attr-defined]
        code = FunctionType(plain.__code__, {**plain.__globals__, advance.__name__: moved})
        return moved, compile_(code)

    try:
        total = _sum_of(own, njit(error_model="numpy"))
        total(0.1, 0.2, 3.0, 4.0, np.zeros(STATES * len(own)), period_s)
        made = built(njit(error_model="numpy"))
    except Exception as error:  # noqa: BLE001 - numba fails in many ways; Python is the remedy
        first = str(error).partition("\n")[0]
        _LOG.warning("%s: is not compiled, and is slow: %s", own[0].place, first)
        made = built(lambda function: function)

    def guarded(kernel: Kernel) -> Kernel:
        def move(*given: Any) -> None:
            try:
                kernel(*given)
            except Exception as error:
                places = ", ".join(torque.place for torque in own)
                raise ConfigurationError(f"{places}: {error}") from error

        return move

    return guarded(made[0]), guarded(made[1])


def _sum_of(own: Sequence[OwnTorque], compile_: Callable[[Any], Any]) -> Any:
    """Return a function of motion, states and period that returns the sum of the torques."""

    def none(
        angle: float, speed: float, motor: float, load: float, states: Any, dt: float
    ) -> float:
        return 0.0

    def joined(rest: Any, torque: Any, p: Any, at: int) -> Any:
        def total(
            angle: float, speed: float, motor: float, load: float, states: Any, dt: float
        ) -> float:
            mine = states[at : at + STATES]
            here = torque(angle, speed, motor, load, mine, dt, p)
            return float(rest(angle, speed, motor, load, states, dt) + here)

        return compile_(total)

    found = compile_(none)
    for k, torque in enumerate(own):
        found = joined(found, compile_(torque.function), torque.parameters, k * STATES)
    return found


def _with_torque(total: Any, period_s: float, advance: Kernel) -> Kernel:
    """Return ``advance`` with a torque on the joint that is constant over each loop period."""

    def moved(
        count: int,
        s: Vector,
        x: Vector,
        histories: Histories,
        d: Vector,
        p: Vector,
        e: Vector,
        y: Vector,
        g: Vector,
        noise: Vector,
        path: Vector,
    ) -> None:
        states = x[table.EXTRA_SIZE :]
        for k in range(count):
            motion = x[table.JOINT], s[loops.OMEGA], x[table.TRANSMITTED], p[friction.MOMENT]
            torque = total(*motion, states, period_s)
            if not math.isfinite(torque):
                raise ValueError("the sum of the injected torques is not finite")
            e[_STEADY_LOAD] = -torque
            part = path[k : k + 1] if len(path) > 0 else path
            advance(1, s, x, histories, d, p, e, y, g, noise[k : k + 1], part)

    return moved


def _words(error: BaseException, path: Path, line: int | None = None) -> str:
    """Return place and text of an error in a user's file, by default of its line."""
    if isinstance(error, OSError):
        return f"{path}: cannot be read: {error.strerror}"
    calls = traceback.extract_tb(error.__traceback__)
    lines = [line, *(call.lineno for call in calls if call.filename == str(path))]
    line = error.lineno if isinstance(error, SyntaxError) else lines[-1]
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    if text.startswith(f"{path}:"):  # the error knows its place
        return text
    if names := getattr(getattr(error, "obj", None), "_fields", ()):
        text += f"; the parameters are {', '.join(names)}"
    return f"{path}{'' if line is None else f':{line}'}: {type(error).__name__}: {text}"
