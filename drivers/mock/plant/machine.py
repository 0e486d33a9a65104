"""The simulated machine with its control loops: integrates its motion and samples its sensors."""

from __future__ import annotations

import cmath
import dataclasses
import math
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError
from drivers.mock.plant import gas
from drivers.mock.plant.burning import advance_loaded, felt_force
from drivers.mock.plant.effects import state as extra
from drivers.mock.plant.effects import table
from drivers.mock.plant.effects.pack import bare_vector, effect_vector
from drivers.mock.plant.gas_pack import gas_vector, lit, unlit
from drivers.mock.plant.loop_modes import close_loops, spin, take_over
from drivers.mock.plant.machine_pack import drive_vector, friction_vector
from drivers.mock.plant.parts import constants, friction, loops
from drivers.mock.plant.record import (
    CHAMBER_PRESSURE,
    FOLLOWING,
    JOINT_SEEN,
    LATCHED,
    LINK_VOLTAGE,
    MEAN_CURRENT,
    MEAN_VOLTAGE,
    ROTOR,
    RUN_TIME,
    SPEED,
    Latches,
    record_cycles,
)

Loop = Literal["position", "velocity", "phases"]
LOOPS: Final[tuple[Loop, ...]] = get_args(Loop)
"""The parts of a drive that may have the wrong sign, see :meth:`SimulatedMachine.reverse`."""
_NOISE_BLOCK = 1 << 16
_REFERENCE_MASS_KG = 30.6
_NO_PATH = np.zeros(0)


class Reading(NamedTuple):
    """Sensor values of drive and joint encoder at one instant.

    ``current_A`` and ``voltage_V`` are means since the previous sampling; all other values are
    those at the instant.
    """

    motor_counts: int
    joint_counts: int
    motor_velocity_rad_s: float
    current_A: float
    voltage_V: float
    supply_V: float
    temperature_C: float
    following_error_counts: float
    pressure_Pa: float


class Truth(NamedTuple):
    """The exact state of the machine, for tests and for benches with exact channels; this state is
    not sent over the bus.
    """

    angle_rad: float
    velocity_rad_s: float
    current_A: float
    friction_work_J: float
    pressure_Pa: float
    contact_force_N: float


@dataclasses.dataclass
class Extremes:
    """Greatest joint speed, rad/s, and least and greatest joint angle, rad."""

    speed_rad_s: float
    low_rad: float
    high_rad: float

    def take(self, truth: Truth) -> None:
        """Take a state of the machine."""
        self.speed_rad_s = max(self.speed_rad_s, abs(truth.velocity_rad_s))
        self.low_rad = min(self.low_rad, truth.angle_rad)
        self.high_rad = max(self.high_rad, truth.angle_rad)


class SimulatedMachine:
    """Motor, gear, friction, lever with weights and the control loops of the drive, integrated with
    a constant step.

    The machine starts at rest at angle 0, with the power off and no weight on the lever. With exact
    sensors (zero counts) the loops use the exact angle, and the interface states it in counts of 1
    microradian of the joint.

    Attributes:
        motor_count_rad: Joint angle of one count of the motor encoder, rad.
        joint_count_rad: Joint angle of one count of the joint encoder, rad.
        stuck: Whether the power stage is defective and stays on, whatever it is told.
    """

    stuck = False

    def __init__(
        self, machine: constants.Machine, rng: np.random.Generator, any_size: bool = False
    ) -> None:
        """Build a machine at rest.

        Args:
            machine: Constants of the machine.
            rng: Random generator of the noise of the current sensor.
            any_size: Whether effects may have sizes outside the ranges of the catalogue.
        """
        self.constants = machine
        self._cascade = machine.loops
        self._marked: Extremes | None = None
        self.loop_ns = round(1e9 / machine.loops.rate_Hz)
        self._rng = rng
        self._noise = rng.standard_normal(_NOISE_BLOCK)
        self._noise_at = 0
        self._s = np.zeros(loops.STATE_SIZE)
        self._d = drive_vector(machine)
        self._e = effect_vector(machine, any_size)
        self._x = np.zeros(extra.EXTRA_SIZE)
        self._x[extra.SUPPLY] = machine.supply_V
        self._histories = np.zeros((2, extra.HISTORY))
        self._g = gas_vector(machine)
        self._y = unlit(machine)
        self._label_kg = 0.0
        self._force_N: float | None = None
        self._fixed_inertia = 0.0
        self._load()
        self.motor_count_rad = float(self._d[loops.COUNT]) or 1e-6
        self.joint_count_rad = 2.0 * math.pi / (machine.sensing.joint_counts_per_turn or 1 << 22)

    def hang(self, mass_kg: float) -> None:
        """Hang a weight with the label ``mass_kg`` in total on the lever: contact force (L3/L4) m_w
        g (eq. 17).
        """
        self._label_kg, self._force_N = mass_kg, None
        self._y = unlit(self.constants)
        self._load()

    def press(self, contact_force_N: float) -> None:
        """Load the valve with the contact force F_P (eq. 13)."""
        self._force_N = contact_force_N
        self._y = unlit(self.constants)
        self._load()

    def ignite(self) -> None:
        """Load the valve with the gas generator in place of a weight; the gas generator burns
        steadily from the start until another load is set.
        """
        self._label_kg, self._force_N = 0.0, None
        self._y = lit(self.constants, self._g, self._angle())
        self._load()

    def _angle(self) -> float:
        return float(self._x[extra.JOINT] if self._e.size else self._s[loops.THETA])

    def fix_weight(self, mass_kg: float, length_m: float, zero_rad: float) -> None:
        """Fix a weight to the joint that turns with it: torque -m g l sin(theta - zero), inertia m
        l^2.
        """
        if not self._e.size:
            self._e = bare_vector(self.constants)
            self._x[extra.JOINT] = self._x[extra.SEEN] = self._s[loops.THETA]
        # The torques of the weight and of an injected imbalance are both sines of the angle; their
        # sum is one sine.
        hidden = self.constants.effects.get(
            "gravity_imbalance", {"torque_Nm": 0.0, "zero_rad": 0.0}
        )
        weight_N_m = mass_kg * self.constants.joint.gravity_m_s2 * length_m
        both = cmath.rect(weight_N_m, zero_rad) + cmath.rect(
            hidden["torque_Nm"], hidden["zero_rad"]
        )
        self._e[table.GRAVITY_TORQUE], self._e[table.GRAVITY_ZERO] = cmath.polar(both)
        self._fixed_inertia = mass_kg * length_m**2
        self._load()

    def _load(self) -> None:
        """Pack the friction vector for the load of the present or next recording."""
        joint, e = self.constants.joint, self._e
        per_kg = joint.lever_ratio * joint.gravity_m_s2
        force = (
            joint.lever_ratio * self._label_kg * joint.gravity_m_s2
            if self._force_N is None
            else self._force_N
        )
        force += float(self._y[gas.FORCE])
        if not e.size:
            self._p = friction_vector(joint, force)
            return
        coming = self._x[extra.RECORDING] + (self._s[loops.MODE] == loops.OFF)
        if e[table.WEIGHT_RECORDING] == coming and self._force_N is None and not self._y[gas.MASS]:
            force = per_kg * e[table.WEIGHT_MASS]
        self._p = friction_vector(joint, felt_force(force, e))
        hanging = 0.0 if self._y[gas.MASS] > 0.0 else force / per_kg
        self._p[friction.INERTIA] += (
            e[table.LOAD_INERTIA] * hanging / _REFERENCE_MASS_KG + self._fixed_inertia
        )
        if e[table.STRIBECK_ALPHA] > 0.0:
            self._p[friction.ALPHA] = e[table.STRIBECK_ALPHA]
        if self._s[loops.OMEGA] == 0.0:
            p = self._p
            of_speed = e[table.MEMORY_OF_SPEED] > 0.0
            at_rest = p[friction.DM] + p[friction.MOMENT] * p[friction.DMU]
            self._x[extra.FALLING] = 0.0 if of_speed else at_rest

    def limit_current(self, current_A: float) -> None:
        """Set the current limit of the drive, which is at most that of the control loops."""
        self._d[loops.CURRENT_LIMIT] = min(self.constants.loops.current_limit_A, current_A)

    def power(self, on: bool) -> None:
        """Switch the power stage.

        When the power is off, the motor is open-circuit and coasts. When the power is switched on,
        the motor holds its position.
        """
        s = self._s
        if on and s[loops.MODE] == loops.OFF:
            s[loops.MODE] = loops.TRACK
            s[loops.TARGET] = s[loops.MEASURED]
            s[loops.TARGET_LEFT] = 0.0
            s[loops.TARGET_STEP] = 0.0
            self._x[extra.TIME] = 0.0
            self._x[extra.RECORDING] += 1.0
            self._load()
        elif not on and not self.stuck:
            s[loops.MODE] = loops.OFF
            s[loops.OFFSET] = 0.0

    @property
    def powered(self) -> bool:
        """Whether the power stage is on."""
        return bool(self._s[loops.MODE] != loops.OFF)

    def control(self, position: bool, speed: bool) -> None:
        """Close or open the drive's position and speed loops before the joint moves."""
        close_loops(self._d, self._cascade, position, speed)

    def reverse(self, loop: Loop) -> None:
        """Give one loop of the drive the wrong sign, or the right sign again.

        The loop ``phases`` is the winding: with two phases swapped, each current gives the opposite
        torque, while the loop of the current itself still works.
        """
        d, cascade = self._d, self._cascade
        gain = cascade.velocity_gain_N_m_s_rad
        if loop == "phases":
            d[loops.TORQUE_PER_AMPERE] *= -1.0
            d[loops.EMF_PER_SPEED] *= -1.0
        # The current command is a torque over the torque constant, whose sign the drive does not
        # know; one gain has to change its sign with it.
        if loop == "position" or gain is None:
            d[loops.POSITION_GAIN] *= -1.0
            self._cascade = dataclasses.replace(cascade, position_gain=-cascade.position_gain)
        else:
            d[loops.VELOCITY_GAIN] *= -1.0
            self._cascade = dataclasses.replace(cascade, velocity_gain_N_m_s_rad=-gain)

    def spin(self, speed_rad_s: float) -> None:
        """Command a joint speed until the next command, without the position loop."""
        spin(self._s, self._d, speed_rad_s)

    def rest(self, seconds: float) -> None:
        """Advance the time with the power off and the joint at rest, so that the motor cools."""
        self._x[extra.RUN] += seconds
        e = self._e
        if e.size and e[table.HEATING_RISE] > 0.0:
            self._x[extra.HEAT] *= math.exp(-seconds / e[table.HEATING_TIME])

    def track(self, target_counts: float, over_ns: int) -> None:
        """Follow ``target_counts`` (motor encoder), which is reached by linear interpolation within
        ``over_ns``.
        """
        s = self._s
        if s[loops.MODE] == loops.OFF:
            return
        s[loops.MODE] = loops.TRACK
        left = max(1, round(over_ns / self.loop_ns))
        s[loops.TARGET_LEFT] = left
        s[loops.TARGET_STEP] = (target_counts * self.motor_count_rad - s[loops.TARGET]) / left

    def feed(self, current_A: float) -> None:
        """Add a current to the current command of the control loops, until the next call, while the
        machine follows targets.
        """
        if self._s[loops.MODE] == loops.TRACK:
            self._s[loops.OFFSET] = current_A

    def brake(self, deceleration_rad_s2: float) -> None:
        """Reduce the commanded joint speed to zero with this deceleration, then hold the position
        (quick stop).
        """
        s = self._s
        if s[loops.MODE] == loops.OFF:
            return
        opened = take_over(s, self._d, self._cascade)
        if not opened and s[loops.MODE] == loops.TRACK and s[loops.TARGET_LEFT] <= 0.0:
            # The last target is reached, and the ramp starts at the measured speed.
            s[loops.TARGET_STEP] = s[loops.VELOCITY_ESTIMATE] * self._d[loops.LOOP_S]
        s[loops.MODE] = loops.BRAKE
        s[loops.OFFSET] = 0.0
        s[loops.BRAKE_STEP] = deceleration_rad_s2 * self._d[loops.LOOP_S]

    def advance(self, duration_ns: int) -> None:
        """Integrate for a whole number of loop periods.

        Raises:
            ValueError: ``duration_ns`` is not a whole number of loop periods.
        """
        self._advance(self._loops_in(duration_ns), _NO_PATH)
        if self._marked is not None:
            self._marked.take(self.truth())

    def mark(self) -> Extremes:
        """Return the extremes of the motion from now on, which further steps update."""
        truth = self.truth()
        self._marked = Extremes(abs(truth.velocity_rad_s), truth.angle_rad, truth.angle_rad)
        return self._marked

    def _loops_in(self, duration_ns: int) -> int:
        count, rest = divmod(duration_ns, self.loop_ns)
        if rest or count < 0:
            raise ValueError(
                f"{duration_ns} ns is not a whole number of loop periods of {self.loop_ns} ns"
            )
        return count

    def follow(self, path_rad: NDArray[np.float64]) -> None:
        """Integrate one loop period for each commanded joint angle of ``path_rad``."""
        self._advance(len(path_rad), path_rad)

    def _advance(self, count: int, path: NDArray[np.float64]) -> None:
        done = 0
        while count > 0:
            if self._noise_at == _NOISE_BLOCK:
                self._noise = self._rng.standard_normal(_NOISE_BLOCK)
                self._noise_at = 0
            n = min(count, _NOISE_BLOCK - self._noise_at)
            noise = self._noise[self._noise_at : self._noise_at + n]
            part = path[done : done + n]
            x, histories, d, p, e = self._x, self._histories, self._d, self._p, self._e
            advance_loaded(n, self._s, x, histories, d, p, e, self._y, self._g, noise, part)
            self._noise_at += n
            done += n
            count -= n

    def record(self, target_counts: NDArray[np.float64], cycle_ns: int) -> Latches:
        """For each target of ``target_counts`` (motor encoder counts): advance one cycle, sample
        the sensors and set the target.

        Raises:
            ValueError: The cycle is not a whole number of loop periods.
        """
        per_cycle = self._loops_in(cycle_ns)
        out = np.zeros((len(target_counts), LATCHED))
        targets = target_counts * self.motor_count_rad
        x, histories, d, p, e = self._x, self._histories, self._d, self._p, self._e
        noise = self._take_noise(per_cycle * len(targets))
        s, y, g = self._s, self._y, self._g
        record_cycles(per_cycle, s, x, histories, d, p, e, y, g, noise, targets, _NO_PATH, out)
        return Latches(
            np.floor(out[:, ROTOR] / self.motor_count_rad),
            np.floor(out[:, JOINT_SEEN] / self.joint_count_rad),
            out[:, SPEED],
            out[:, MEAN_CURRENT],
            out[:, MEAN_VOLTAGE],
            out[:, LINK_VOLTAGE],
            out[:, FOLLOWING],
            out[:, RUN_TIME],
            out[:, CHAMBER_PRESSURE],
        )

    def _take_noise(self, count: int) -> NDArray[np.float64]:
        """Return the next ``count`` noise samples, equal to those that ``count`` single loop
        periods draw.
        """
        left = self._noise[self._noise_at :]
        if count <= len(left):
            self._noise_at += count
            return left[:count]
        more = -(-(count - len(left)) // _NOISE_BLOCK) * _NOISE_BLOCK
        drawn = np.concatenate((left, self._rng.standard_normal(more)))
        self._noise = drawn[-_NOISE_BLOCK:]
        self._noise_at = _NOISE_BLOCK - (len(drawn) - count)
        return drawn[:count]

    def latch(self) -> Reading:
        """Return the present sensor values, and start new means of current and voltage.

        Raises:
            ConfigurationError: With these constants the equations diverge, so that the angles are
                NaN.
        """
        s = self._s
        theta = float(s[loops.THETA])
        seen = float(self._x[extra.SEEN]) if self._e.size else theta
        n = float(s[loops.SUM_LOOPS])
        if n:
            seconds = n * float(self._d[loops.LOOP_S])
            noise = float(s[loops.SUM_NOISE]) / n if s[loops.MODE] != loops.OFF else 0.0
            current = float(s[loops.SUM_CURRENT]) / seconds + noise
            voltage = float(s[loops.SUM_VOLTAGE]) / seconds
        else:
            current = voltage = 0.0
        s[loops.SUM_CURRENT] = s[loops.SUM_VOLTAGE] = s[loops.SUM_NOISE] = s[loops.SUM_LOOPS] = 0.0
        following = 0.0
        if s[loops.MODE] != loops.OFF:
            following = (float(s[loops.TARGET]) - float(s[loops.MEASURED])) / self.motor_count_rad
        try:
            motor, joint = (
                math.floor(theta / self.motor_count_rad),
                math.floor(seen / self.joint_count_rad),
            )
        except (ValueError, OverflowError) as error:
            raise ConfigurationError(
                f"the equations of the simulated machine diverge (angle {theta:g} rad); look for a "
                "value with a wrong exponent or unit in the section `mock` of the bench file"
            ) from error
        return Reading(
            motor,
            joint,
            float(s[loops.VELOCITY_ESTIMATE]) * self.constants.motor.gear_ratio,
            current,
            voltage,
            float(self._x[extra.SUPPLY]),
            float(self.temperature(float(self._x[extra.RUN]))),
            following,
            float(self._y[gas.PRESSURE]),
        )

    def temperature(self, run_s: float | NDArray[np.float64]) -> Any:
        """Return the temperature that the drive reports after this running time, deg C."""
        machine = self.constants
        return machine.temperature_C - machine.warming_K * np.expm1(-run_s / machine.warming_s)

    def truth(self) -> Truth:
        """Return the exact state."""
        s, y = self._s, self._y
        motion = (
            self._angle(),
            float(s[loops.OMEGA]),
            float(s[loops.CURRENT]),
            float(s[loops.FRICTION_WORK]),
        )
        return Truth(
            *motion, float(y[gas.PRESSURE]), float(self._p[friction.MOMENT] / self._g[gas.ARM])
        )
