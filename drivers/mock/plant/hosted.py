"""Anybody's machine behind the simulated drive: a class in Python, or an FMU (FMI 2 or 3).

The machine has winding, motor, gear, friction and load of its own. Around it stand the control
loops, limits, power stage, encoders and faults of the own simulated machine, by the same code.
"""

from __future__ import annotations

import math
import reprlib
import shutil
import tempfile
import traceback
import weakref
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import CodeType
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.errors import CORRECT_MACHINE, ConfigurationError, MachineError
from drivers.mock.plant.effects.own import user_module
from drivers.mock.plant.machine import DrivenMachine, Latches, Truth
from drivers.mock.plant.parts import constants, loops
from drivers.mock.plant.parts.compiled import Vector, compiled

OUTPUTS: Final = ("motor_angle_rad", "joint_angle_rad", "motor_speed_rad_s", "current_A")
_CAUSALITIES: Final = {
    "voltage_V": ("input",),
    "mass_kg": ("input", "parameter"),
    **dict.fromkeys(OUTPUTS, ("output", "local")),
}
"""Names of the variables of an FMU, and their possible causalities."""
_METHODS: Final = {
    "reset": "reset(seed: int) -> None",
    "hang": "hang(mass_kg: float) -> None",
    "step": f"step(dt_s: float, voltage_V: float) -> ({', '.join(OUTPUTS)})",
}
_FOUR: Final = f"four finite numbers ({', '.join(OUTPUTS)})"


class Plant(Protocol):
    """A machine that somebody else wrote; SI units."""

    def reset(self, seed: int) -> None:
        """Bring the machine to rest, without a weight; ``seed`` is for what is random in it."""
        ...

    def hang(self, mass_kg: float) -> None:
        """Hang a mass on the lever in place of the present one; 0 for none."""
        ...

    def step(self, dt_s: float, voltage_V: float) -> tuple[float, float, float, float]:
        """Move for one period of the current loop with this voltage at the winding.

        Returns:
            Angle of the motor, rad; angle of the joint after the gear, rad; speed of the motor,
            rad/s; current in the winding, A; at the end of the period.
        """
        ...


class PlantFile(NamedTuple):
    """A machine and the file that it is from, which error messages name."""

    plant: Plant
    path: Path


@compiled
def voltage_for(s: Vector, d: Vector, error: float) -> float:
    """Return the voltage of the drive for the next loop period, V; without power it is zero.

    ``error`` is that of the current sensor, A.
    """
    wanted = loops.current_command(s, d)
    if s[loops.MODE] == loops.OFF:
        s[loops.VELOCITY_INTEGRAL] = s[loops.VOLTAGE_INTEGRAL] = 0.0
        return 0.0
    return loops.voltage_command(s, d, wanted, error)


@compiled
def take_outputs(
    s: Vector, d: Vector, rotor: float, speed: float, current: float, voltage: float, error: float
) -> None:
    """Store angle and speed of the rotor over the gear ratio and the current after a period."""
    period = d[loops.LOOP_S]
    s[loops.SUM_CURRENT] += 0.5 * (s[loops.CURRENT] + current) * period
    s[loops.SUM_VOLTAGE] += voltage * period
    s[loops.SUM_NOISE] += error
    s[loops.SUM_LOOPS] += 1.0
    s[loops.THETA], s[loops.OMEGA], s[loops.CURRENT] = rotor, speed, current


class HostedMachine(DrivenMachine):
    """Another machine with the simulated drive around it.

    ``constants`` are those of the drive: its loops, sensors and supply, and what it assumes of
    motor and gear. Without power the winding gets 0 V, as in a stage that brakes by a short
    circuit: this damps any machine, while the voltage of an open winding depends on constants that
    the drive does not know. After an error in the machine, the power is off, and the machine is
    not called again: it stands still.
    """

    def __init__(
        self,
        machine: constants.Machine,
        rng: np.random.Generator,
        file: PlantFile,
        seed: int,
        tell: Callable[[MachineError], None] | None = None,
    ) -> None:
        """Reset the machine, and learn its angles from a first step without voltage.

        Args:
            machine: Constants of the drive.
            rng: Random generator of the noise of the drive's current sensor.
            file: The machine.
            seed: Seed of the machine itself.
            tell: Called with the error if the machine fails later; without it, the error is raised.

        Raises:
            MachineError: The machine fails in the reset or in the first step.
        """
        super().__init__(machine, rng)
        self.failure: MachineError | None = None  # the error in the machine, or None
        self._plant, self._path = file
        self._tell: Callable[[MachineError], None] | None = None
        self._joint = self._run_s = 0.0
        self._call("reset", seed)
        self._move(0.0, 0.0)
        s, count = self._s, self._d[loops.COUNT]
        s[loops.MEASURED] = s[loops.THETA]
        if count > 0.0:
            s[loops.MEASURED] = math.floor(s[loops.THETA] / count) * count
        self.latch()
        self._tell = tell

    def hang(self, mass_kg: float) -> None:
        """Hang ``mass_kg`` on the lever."""
        self._call("hang", mass_kg)

    def power(self, on: bool) -> None:
        """Switch the power stage; that of a machine with an error stays off."""
        if self.failure is None:
            super().power(on)

    def truth(self) -> Truth:
        """Return the state, NaN for what is unknown; the current is zero without power."""
        s = self._s
        current = float(s[loops.CURRENT]) if self.powered else 0.0
        pressure = self.constants.gas.back_pressure_Pa
        return Truth(self._joint, float(s[loops.OMEGA]), current, math.nan, pressure, math.nan)

    def record(self, target_counts: NDArray[np.float64], cycle_ns: int) -> Latches:
        """See :meth:`DrivenMachine.record`."""
        rows = np.zeros((len(target_counts), len(Latches._fields)))
        for row, target in zip(rows, target_counts.tolist(), strict=True):
            self.advance(cycle_ns)
            seen = self.latch()
            row[:] = (
                seen.motor_counts,
                seen.joint_counts,
                self._s[loops.VELOCITY_ESTIMATE],
                seen.current_A,
                seen.voltage_V,
                seen.supply_V,
                self._run_s,
                seen.pressure_Pa,
            )
            self.track(target, cycle_ns)
        return Latches(*rows.T)

    def _sensed(self) -> tuple[float, float, float, float, float]:
        own = self.constants
        rotor = float(self._s[loops.THETA])
        return rotor, self._joint, own.supply_V, self._run_s, own.gas.back_pressure_Pa

    def _advance(self, count: int) -> None:
        s, d = self._s, self._d
        for error in (self._take_noise(count) * d[loops.NOISE]).tolist():
            if self.failure is not None:
                break
            self._move(voltage_for(s, d, error), error)

    def _move(self, voltage_V: float, error_A: float) -> None:
        """Let the machine move for one loop period."""
        s, d = self._s, self._d
        # With two phases swapped, the winding gets each voltage with the other sign.
        sign = math.copysign(1.0, d[loops.TORQUE_PER_AMPERE])
        period = self.loop_ns * 1e-9
        outputs = self._call("step", period, sign * voltage_V)
        if self.failure is not None:
            return
        try:
            motor, joint, speed, current = outputs
            fine = math.isfinite(motor + joint + speed + current)
        except (TypeError, ValueError):
            fine = False
        if not fine:
            code = getattr(self._plant.step, "__code__", None)
            line = f":{code.co_firstlineno}" if isinstance(code, CodeType) else ""
            shown = f"step returned {reprlib.repr(outputs)}"
            self._fail(f"{self._path}{line}: {shown}; it must return {_FOUR}")
            return
        gear = self.constants.motor.gear_ratio
        self._joint = float(joint)
        self._run_s += period
        rotor, turning = float(motor) / gear, float(speed) / gear
        take_outputs(s, d, rotor, turning, sign * float(current), voltage_V, error_A)

    def _call(self, method: str, *given: float) -> Any:
        """Call the machine; after an error return None."""
        if self.failure is not None:
            return None
        try:
            return getattr(self._plant, method)(*given)
        except (Exception, SystemExit) as error:  # noqa: BLE001 - code of the user raises anything
            arguments = ", ".join(f"{value:g}" for value in given)
            place = _place(error, self._path)
            self._fail(f"{place}: {method}({arguments}) raised {_words(error)}", error)
            return None

    def _fail(self, words: str, cause: BaseException | None = None) -> None:
        """Switch the power off, and raise the error or tell it."""
        self.failure = MachineError(
            f"{words}, {self._run_s:.6g} s after the reset; {CORRECT_MACHINE}; the machine stands "
            "still without power from there on"
        )
        self.failure.__cause__ = cause
        s = self._s
        s[loops.MODE] = loops.OFF
        s[loops.OMEGA] = s[loops.CURRENT] = s[loops.VELOCITY_ESTIMATE] = 0.0
        if self._tell is None:
            raise self.failure
        self._tell(self.failure)


def _words(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def _place(error: BaseException, path: Path) -> str:
    """Return file and line of the last call in a file that led to an error."""
    if isinstance(error, SyntaxError) and error.filename == str(path):
        return f"{path}:{error.lineno}"
    calls = traceback.extract_tb(error.__traceback__)
    lines = [call.lineno for call in calls if call.filename == str(path)]
    return f"{path}:{lines[-1]}" if lines else str(path)


def python_plant(path: Path, name: str) -> PlantFile:
    """Run a Python file, and build the machine of this class in it.

    Raises:
        ConfigurationError: The file cannot be read or run, or has no such class, or the class lacks
            a method.
    """
    module = user_module(path)
    made = getattr(module, name, None)
    try:
        plant = made() if isinstance(made, type) else None
    except (Exception, SystemExit) as error:
        raise ConfigurationError(f"{_place(error, path)}: {_words(error)}") from error
    if plant is None:
        known = [n for n, found in vars(module).items() if isinstance(found, type)]
        has = f"it has {', '.join(known)}" if known else "it has no class"
        raise ConfigurationError(f"{path}: has no class {name}; {has}")
    lacking = [text for n, text in _METHODS.items() if not callable(getattr(plant, n, None))]
    if lacking:
        lines = path.read_text(encoding="utf-8").splitlines()
        line = next((n for n, t in enumerate(lines, 1) if t.startswith(f"class {name}")), 1)
        raise ConfigurationError(f"{path}:{line}: class {name} lacks {' and '.join(lacking)}")
    return PlantFile(plant, path)


class FmuPlant:
    """The machine in an FMU for co-simulation, FMI 2 or 3.

    The FMU has the real inputs ``voltage_V`` and ``mass_kg`` and the real outputs :data:`OUTPUTS`.
    A variable ``seed``, if there is one, gets the seed of the run before the initialisation.
    """

    def __init__(self, path: Path) -> None:
        """Unpack and load the FMU.

        Raises:
            ConfigurationError: The package fmpy is not installed, the file is no FMU for
                co-simulation on this computer, or lacks a variable.
        """
        try:
            import fmpy
            from fmpy.simulation import instantiate_fmu
        except ImportError as error:
            text = "an FMU needs the package fmpy; install it with: pip install 'loadrig[fmu]'"
            raise ConfigurationError(f"{path}: {text}") from error
        self._said = said = list[str]()
        folder = tempfile.mkdtemp(prefix="loadrig-fmu-")
        try:
            fmpy.extract(str(path), folder)
            model = fmpy.read_model_description(folder)
            variables = {v.name: v for v in model.modelVariables}
            if problem := _fmu_problem(model, variables):
                raise ConfigurationError(f"{path}: {problem}")
            self._slave = slave = instantiate_fmu(
                folder, model, "CoSimulation", logger=lambda *told: said.append(told[-1].decode())
            )
        except Exception as error:
            shutil.rmtree(folder, ignore_errors=True)
            if isinstance(error, ConfigurationError):
                raise
            text = f"cannot be used as an FMU on this computer: {_words(error)}"
            raise ConfigurationError(f"{path}: {text}") from error
        weakref.finalize(self, _release, slave, folder)
        self._two = model.fmiVersion == "2.0"
        self._set = slave.setReal if self._two else slave.setFloat64
        self._get = slave.getReal if self._two else slave.getFloat64
        at = [variables[name].valueReference for name in _CAUSALITIES]
        self._voltage, self._mass, self._outputs = at[:1], at[1:2], at[2:]
        self._seed = variables.get("seed")
        self._steps = -1

    def reset(self, seed: int) -> None:
        """Initialise the FMU."""
        slave = self._slave
        if self._steps >= 0:
            slave.reset()
        if self._two:
            slave.setupExperiment(startTime=0.0)
        if (seeded := self._seed) is not None:
            getattr(slave, f"set{seeded.type}")([seeded.valueReference], [seed])
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        self._steps = 0

    def hang(self, mass_kg: float) -> None:
        """Set the mass on the lever."""
        self._set(self._mass, [mass_kg])

    def step(self, dt_s: float, voltage_V: float) -> tuple[float, float, float, float]:
        """Let the FMU compute one communication step."""
        self._set(self._voltage, [voltage_V])
        try:
            ended = self._slave.doStep(self._steps * dt_s, dt_s)
        except Exception as error:
            raise RuntimeError("; ".join([str(error), *self._said[-1:]])) from error
        if isinstance(ended, tuple) and ended[1]:
            raise RuntimeError("the FMU ends the simulation")
        self._steps += 1
        motor, joint, speed, current = self._get(self._outputs)
        return motor, joint, speed, current


def _fmu_problem(model: Any, variables: dict[str, Any]) -> str:
    """Return what is missing in an FMU, and what is right; empty if nothing is."""
    if model.coSimulation is None or model.fmiVersion == "1.0":
        return f"is no FMU for co-simulation by FMI 2 or 3 (FMI {model.fmiVersion}); export it so"
    lacking = [
        f"{name} ({' or '.join(allowed)})"
        for name, allowed in _CAUSALITIES.items()
        if (found := variables.get(name)) is None
        or found.type not in ("Real", "Float64")
        or found.causality not in allowed
    ]
    return f"lacks the real variables {', '.join(lacking)}, in SI units" if lacking else ""


def _release(slave: Any, folder: str) -> None:
    """End an FMU, and delete its files."""
    with suppress(Exception):
        slave.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)
