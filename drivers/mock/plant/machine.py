"""The simulated machine with its control loops: integrates its motion and samples its sensors."""

from __future__ import annotations

import cmath
import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError
from drivers.mock.plant import gas
from drivers.mock.plant.effects import table
from drivers.mock.plant.effects.kernel import Histories, read_rotor
from drivers.mock.plant.effects.own import STATES, own_torques, with_own_torques
from drivers.mock.plant.effects.pack import effect_vector
from drivers.mock.plant.gas import PRESSURE, advance_loaded, felt_force, gas_vector, lit, unlit
from drivers.mock.plant.parts import constants, friction, loops
from drivers.mock.plant.parts.compiled import Vector, compiled


def friction_vector(joint: constants.Joint, contact_force_N: float) -> NDArray[np.float64]:
    """Pack the joint's constants for compiled code; ``contact_force_N`` is F_P of eq. 13."""
    p = np.zeros(friction.FRICTION_SIZE)
    p[friction.MC] = joint.Mc_N_m
    p[friction.DM] = joint.Ms_N_m - joint.Mc_N_m
    p[friction.OMEGA_SF] = joint.omega_sf_rad_s
    p[friction.SIGMA_2] = joint.sigma_2_N_m_s_rad
    p[friction.MU_C] = joint.mu_c
    p[friction.DMU] = joint.mu_s - joint.mu_c
    p[friction.OMEGA_SL] = joint.omega_sL_rad_s
    p[friction.MU_2] = joint.mu_2_s_rad
    p[friction.ALPHA] = joint.alpha
    p[friction.MOMENT] = contact_force_N * joint.moment_arm_m
    p[friction.INERTIA] = joint.inertia_kg_m2
    return p


def drive_vector(machine: constants.Machine) -> NDArray[np.float64]:
    """Pack motor and loop constants for compiled code, all referred to the joint."""
    motor, cascade, sensing = machine.motor, machine.loops, machine.sensing
    loop_s = 1.0 / cascade.rate_Hz
    counts = sensing.motor_counts_per_turn * motor.gear_ratio
    d = np.zeros(loops.DRIVE_SIZE)
    d[loops.RESISTANCE] = motor.resistance_ohm
    d[loops.INDUCTANCE] = motor.inductance_H
    d[loops.TORQUE_PER_AMPERE] = motor.torque_constant_N_m_A * motor.gear_ratio
    d[loops.EMF_PER_SPEED] = motor.back_emf_constant_V_s_rad * motor.gear_ratio
    d[loops.LOOP_S] = loop_s
    d[loops.STEPS] = machine.steps_per_loop
    d[loops.POSITION_GAIN] = cascade.position_gain
    d[loops.VELOCITY_GAIN] = cascade.velocity_gain_N_m_s_rad or 0.0
    d[loops.VELOCITY_INTEGRAL_GAIN] = cascade.velocity_integral_1_s
    d[loops.VELOCITY_FILTER] = 1.0 - math.exp(-2.0 * math.pi * cascade.velocity_filter_Hz * loop_s)
    d[loops.FEEDFORWARD] = cascade.velocity_feedforward
    d[loops.CURRENT_GAIN] = cascade.current_gain_V_A
    d[loops.CURRENT_INTEGRAL_GAIN] = cascade.current_integral_1_s
    d[loops.VOLTAGE_LIMIT] = min(cascade.voltage_limit_V, machine.supply_V)
    d[loops.CURRENT_LIMIT] = cascade.current_limit_A
    d[loops.COUNT] = 2.0 * math.pi / counts if counts else 0.0
    d[loops.NOISE] = sensing.current_noise_A * math.sqrt(sensing.cycle_s * cascade.rate_Hz)
    return d


# Columns of the latched values.
(
    ROTOR,
    JOINT_SEEN,
    SPEED,
    MEAN_CURRENT,
    MEAN_VOLTAGE,
    LINK_VOLTAGE,
    RUN_TIME,
    CHAMBER_PRESSURE,
    LATCHED,
) = range(9)


class Latches(NamedTuple):
    """Values of drive and joint encoder at each SYNC before conversion to device units; arrays of
    shape (n,).

    ``current_A`` and ``voltage_V`` are means over the cycle that ends at the SYNC; ``run_s`` is the
    running time of the machine. ``pressure_Pa`` is exact; while no gas generator burns, it is the
    pressure downstream of the valve.
    """

    motor_counts: NDArray[np.float64]
    joint_counts: NDArray[np.float64]
    joint_velocity_rad_s: NDArray[np.float64]
    current_A: NDArray[np.float64]
    voltage_V: NDArray[np.float64]
    supply_V: NDArray[np.float64]
    run_s: NDArray[np.float64]
    pressure_Pa: NDArray[np.float64]


@compiled
def record_cycles(
    loops_per_cycle: int,
    s: Vector,
    x: Vector,
    histories: Histories,
    d: Vector,
    p: Vector,
    e: Vector,
    y: Vector,
    g: Vector,
    noise: Vector,
    targets: Vector,
    no_path: Vector,
    out: Histories,
) -> None:
    """Run one cycle for each joint angle of ``targets``: advance, sample, set the target.

    As with a bus, the target that is sent with a SYNC is reached by interpolation one cycle later.
    """
    for k in range(len(targets)):
        part = noise[k * loops_per_cycle : (k + 1) * loops_per_cycle]
        advance_loaded(loops_per_cycle, s, x, histories, d, p, e, y, g, part, no_path)
        n = s[loops.SUM_LOOPS]
        seconds = n * d[loops.LOOP_S]
        row = out[k]
        row[ROTOR] = read_rotor(s[loops.THETA], e)
        row[JOINT_SEEN] = x[table.SEEN]
        row[SPEED] = s[loops.VELOCITY_ESTIMATE]
        row[MEAN_CURRENT] = s[loops.SUM_CURRENT] / seconds + s[loops.SUM_NOISE] / n
        row[MEAN_VOLTAGE] = s[loops.SUM_VOLTAGE] / seconds
        row[LINK_VOLTAGE] = x[table.SUPPLY]
        row[RUN_TIME] = x[table.RUN]
        row[CHAMBER_PRESSURE] = y[PRESSURE]
        s[loops.SUM_CURRENT] = s[loops.SUM_VOLTAGE] = s[loops.SUM_NOISE] = s[loops.SUM_LOOPS] = 0.0
        s[loops.TARGET_LEFT] = loops_per_cycle
        s[loops.TARGET_STEP] = (targets[k] - s[loops.TARGET]) / loops_per_cycle


Loop = Literal["position", "velocity", "phases"]
LOOPS: Final[tuple[Loop, ...]] = get_args(Loop)
"""The parts of a drive that may have the wrong sign, see :meth:`DrivenMachine.reverse`."""
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
    """The exact state of the machine, which no bus carries."""

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


class DrivenMachine(ABC):
    """A machine with the drive around it: control loops, limits, power stage, and the sensors of
    drive and joint.

    A subclass moves the machine. The loops of :mod:`drivers.mock.plant.parts.loops` run on the
    state vector ``_s`` and the drive vector ``_d``, whatever moves. The machine starts at rest with
    the power off and no weight on the lever. With exact sensors (zero counts) the loops use the
    exact angle, and the interface states it in counts of 1 microradian of the joint.

    Attributes:
        constants: Constants of the drive and its sensors; those of motor and joint are the true
            ones, or those that the drive assumes of another machine.
        loop_ns: Period of the control loops, ns.
        motor_count_rad: Joint angle of one count of the motor encoder, rad.
        joint_count_rad: Joint angle of one count of the joint encoder, rad.
        stuck: Whether the power stage is defective and stays on, whatever it is told.
    """

    stuck = False

    def __init__(self, machine: constants.Machine, rng: np.random.Generator) -> None:
        self.constants = machine
        self._cascade = machine.loops
        self._marked: Extremes | None = None
        self.loop_ns = round(1e9 / machine.loops.rate_Hz)
        self._rng = rng
        self._noise = rng.standard_normal(_NOISE_BLOCK)
        self._noise_at = 0
        self._s = np.zeros(loops.STATE_SIZE)
        self._d = drive_vector(machine)
        self.motor_count_rad = float(self._d[loops.COUNT]) or 1e-6
        self.joint_count_rad = 2.0 * math.pi / (machine.sensing.joint_counts_per_turn or 1 << 22)

    @abstractmethod
    def hang(self, mass_kg: float) -> None:
        """Hang ``mass_kg`` on the lever."""

    @abstractmethod
    def truth(self) -> Truth:
        """Return the exact state."""

    @abstractmethod
    def record(self, target_counts: NDArray[np.float64], cycle_ns: int) -> Latches:
        """For each target (motor encoder counts): advance a cycle, sample, and set the target."""

    @abstractmethod
    def _advance(self, count: int) -> None:
        """Move the machine for ``count`` loop periods."""

    @abstractmethod
    def _sensed(self) -> tuple[float, float, float, float, float]:
        """Return what the sensors measure: angles of the motor over the gear ratio and of the
        joint, rad; supply voltage, V; running time, s; pressure, Pa.
        """

    def limit_current(self, current_A: float) -> None:
        """Set the current limit of the drive, which is at most that of the control loops."""
        self._d[loops.CURRENT_LIMIT] = min(self.constants.loops.current_limit_A, current_A)

    def power(self, on: bool) -> None:
        """Switch the power stage; when it is switched on, the motor holds its position."""
        s = self._s
        if on and s[loops.MODE] == loops.OFF:
            s[loops.MODE] = loops.TRACK
            s[loops.TARGET] = s[loops.MEASURED]
            s[loops.TARGET_LEFT] = 0.0
            s[loops.TARGET_STEP] = 0.0
        elif not on and not self.stuck:
            s[loops.MODE] = loops.OFF
            s[loops.OFFSET] = 0.0

    @property
    def powered(self) -> bool:
        """Whether the power stage is on."""
        return bool(self._s[loops.MODE] != loops.OFF)

    def control(self, position: bool, speed: bool) -> None:
        """Close or open the drive's position and speed loops before the joint moves."""
        d, cascade = self._d, self._cascade
        d[loops.POSITION_GAIN] = cascade.position_gain if position else 0.0
        d[loops.VELOCITY_GAIN] = (cascade.velocity_gain_N_m_s_rad or 0.0) if speed else 0.0
        d[loops.FEEDFORWARD] = cascade.velocity_feedforward if position else 1.0

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
        s = self._s
        if s[loops.MODE] != loops.OFF:
            s[loops.MODE] = loops.TRACK
            s[loops.TARGET_LEFT] = math.inf
            s[loops.TARGET_STEP] = speed_rad_s * self._d[loops.LOOP_S]

    def track(self, target_counts: float, over_ns: int) -> None:
        """Follow ``target_counts`` (motor encoder), reached linearly within ``over_ns``."""
        s = self._s
        if s[loops.MODE] == loops.OFF:
            return
        s[loops.MODE] = loops.TRACK
        left = max(1, round(over_ns / self.loop_ns))
        s[loops.TARGET_LEFT] = left
        s[loops.TARGET_STEP] = (target_counts * self.motor_count_rad - s[loops.TARGET]) / left

    def feed(self, current_A: float) -> None:
        """Add a current to the command of the loops while the machine follows targets."""
        if self._s[loops.MODE] == loops.TRACK:
            self._s[loops.OFFSET] = current_A

    def brake(self, deceleration_rad_s2: float) -> None:
        """Reduce the commanded joint speed to zero, then hold the position (quick stop)."""
        s, d = self._s, self._d
        if s[loops.MODE] == loops.OFF:
            return
        measured_step = s[loops.VELOCITY_ESTIMATE] * d[loops.LOOP_S]
        if d[loops.POSITION_GAIN] != self._cascade.position_gain:
            # A loop is open; the ramp needs all of them.
            s[loops.TARGET] = s[loops.MEASURED]
            if d[loops.VELOCITY_GAIN] == 0.0:
                s[loops.TARGET_STEP] = measured_step
                s[loops.VELOCITY_INTEGRAL] = 0.0
            self.control(position=True, speed=True)
        elif s[loops.MODE] == loops.TRACK and s[loops.TARGET_LEFT] <= 0.0:
            # The last target is reached, and the ramp starts at the measured speed.
            s[loops.TARGET_STEP] = measured_step
        s[loops.MODE] = loops.BRAKE
        s[loops.OFFSET] = 0.0
        s[loops.BRAKE_STEP] = deceleration_rad_s2 * d[loops.LOOP_S]

    def advance(self, duration_ns: int) -> None:
        """Integrate for a whole number of loop periods.

        Raises:
            ValueError: ``duration_ns`` is not a whole number of loop periods.
        """
        self._advance(self._loops_in(duration_ns))
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

    def _take_noise(self, count: int) -> NDArray[np.float64]:
        """Return the next noise samples, as single loop periods would draw them."""
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
        theta, seen, supply_V, run_s, pressure_Pa = self._sensed()
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
            supply_V,
            float(self.temperature(run_s)),
            following,
            pressure_Pa,
        )

    def temperature(self, run_s: float | NDArray[np.float64]) -> Any:
        """Return the temperature that the drive reports after this running time, deg C."""
        machine = self.constants
        return machine.temperature_C - machine.warming_K * np.expm1(-run_s / machine.warming_s)


class SimulatedMachine(DrivenMachine):
    """The simulated machine: motor, gear, friction and lever with weights, integrated with a
    constant step. It starts at angle 0; without power the motor is open-circuit and coasts.
    """

    def __init__(
        self, machine: constants.Machine, rng: np.random.Generator, any_size: bool = False
    ) -> None:
        """Build a machine at rest.

        Args:
            machine: Constants of the machine.
            rng: Random generator of the noise of the current sensor.
            any_size: Whether effects may have sizes outside the ranges of the catalogue.
        """
        super().__init__(machine, rng)
        own = own_torques(machine)
        self._e = effect_vector(machine, any_size, [torque.name for torque in own])
        self._x = np.zeros(table.EXTRA_SIZE + STATES * len(own))
        self._kernels = advance_loaded, record_cycles
        if own:
            period_s = 1.0 / machine.loops.rate_Hz
            self._kernels = with_own_torques(own, period_s, advance_loaded, record_cycles)
        self._x[table.SUPPLY] = machine.supply_V
        self._histories = np.zeros((2, table.HISTORY))
        self._g = gas_vector(machine)
        self._y = unlit(machine)
        self._label_kg = 0.0
        self._force_N: float | None = None
        self._fixed_inertia = 0.0
        self._load()

    def hang(self, mass_kg: float) -> None:
        """Hang ``mass_kg`` on the lever: contact force (L3/L4) m_w g (eq. 17)."""
        self._label_kg, self._force_N = mass_kg, None
        self._y = unlit(self.constants)
        self._load()

    def press(self, contact_force_N: float) -> None:
        """Load the valve with the contact force F_P (eq. 13)."""
        self._force_N = contact_force_N
        self._y = unlit(self.constants)
        self._load()

    def ignite(self) -> None:
        """Load the valve with the gas generator, which burns until another load is set."""
        self._label_kg, self._force_N = 0.0, None
        self._y = lit(self.constants, self._g, self._angle())
        self._load()

    def _angle(self) -> float:
        return float(self._x[table.JOINT])

    def fix_weight(self, mass_kg: float, length_m: float, zero_rad: float) -> None:
        """Fix a weight to the joint: torque -m g l sin(theta - zero), inertia m l^2."""
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
        coming = self._x[table.RECORDING] + (self._s[loops.MODE] == loops.OFF)
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
            self._x[table.FALLING] = 0.0 if of_speed else at_rest

    def power(self, on: bool) -> None:
        """Switch the power stage; a recording starts when it is switched on."""
        starts = on and not self.powered
        super().power(on)
        if starts:
            self._x[table.TIME] = 0.0
            self._x[table.RECORDING] += 1.0
            self._load()

    def rest(self, seconds: float) -> None:
        """Advance the time with the power off and the joint at rest, so that the motor cools."""
        self._x[table.RUN] += seconds
        e = self._e
        if e[table.HEATING_RISE] > 0.0:
            self._x[table.HEAT] *= math.exp(-seconds / e[table.HEATING_TIME])

    def follow(self, path_rad: NDArray[np.float64]) -> None:
        """Integrate one loop period for each commanded joint angle of ``path_rad``."""
        self._advance(len(path_rad), path_rad)

    def _advance(self, count: int, path: NDArray[np.float64] = _NO_PATH) -> None:
        noise = self._take_noise(count)
        x, histories, d, p, e = self._x, self._histories, self._d, self._p, self._e
        self._kernels[0](count, self._s, x, histories, d, p, e, self._y, self._g, noise, path)

    def record(self, target_counts: NDArray[np.float64], cycle_ns: int) -> Latches:
        """See :meth:`DrivenMachine.record`."""
        per_cycle = self._loops_in(cycle_ns)
        out = np.zeros((len(target_counts), LATCHED))
        targets = target_counts * self.motor_count_rad
        x, histories, d, p, e = self._x, self._histories, self._d, self._p, self._e
        noise = self._take_noise(per_cycle * len(targets))
        s, y, g = self._s, self._y, self._g
        run = self._kernels[1]
        run(per_cycle, s, x, histories, d, p, e, y, g, noise, targets, _NO_PATH, out)
        rotor, joint, *others = out.T
        motor_counts = np.floor(rotor / self.motor_count_rad)
        return Latches(motor_counts, np.floor(joint / self.joint_count_rad), *others)

    def _sensed(self) -> tuple[float, float, float, float, float]:
        x = self._x
        return (
            float(read_rotor(float(self._s[loops.THETA]), self._e)),
            float(x[table.SEEN]),
            float(x[table.SUPPLY]),
            float(x[table.RUN]),
            float(self._y[gas.PRESSURE]),
        )

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


def simulate(
    machine: constants.Machine,
    command: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    duration_s: float,
    rate_Hz: float,
    weight_kg: float = 0.0,
    contact_force_N: float | None = None,
    burning: bool = False,
    rng: np.random.Generator | None = None,
) -> dict[str, NDArray[np.float64]]:
    """Follow ``command`` (joint angle in rad of time in s) from rest and sample the exact state.

    Args:
        machine: The simulated machine.
        command: Vectorised function of time that returns the joint angle; 0 at time 0.
        duration_s: Length of the simulation, s.
        rate_Hz: Sample rate; the drive's loop rate must be a multiple of it.
        weight_kg: Mass on the lever.
        contact_force_N: Contact force F_P in place of that of a weight, N.
        burning: Whether the load is a gas generator, steady at the first angle, not a weight.
        rng: Random generator; needed only if the machine has current noise.

    Returns:
        ``time``, ``command``, ``angle``, ``velocity`` (of the joint), ``current`` (at the sample),
        ``mean_current`` (over the period that ends at the sample), ``voltage``, ``pressure`` and
        ``contact_force``; each of shape (n,), SI units.

    Raises:
        ValueError: The loop rate is not a multiple of the sample rate.
    """
    plant = SimulatedMachine(machine, rng or np.random.default_rng(0))
    if burning:
        plant.ignite()
    elif contact_force_N is None:
        plant.hang(weight_kg)
    else:
        plant.press(contact_force_N)
    loops_per_sample = round(machine.loops.rate_Hz / rate_Hz)
    if abs(loops_per_sample * rate_Hz - machine.loops.rate_Hz) > 1e-9 * rate_Hz:
        raise ValueError(
            f"loop rate {machine.loops.rate_Hz:g} Hz: not a multiple of sample rate {rate_Hz:g} Hz"
        )
    n = round(duration_s * rate_Hz) + 1
    time = np.arange(n) / rate_Hz
    path = command(np.arange(1, (n - 1) * loops_per_sample + 1) / machine.loops.rate_Hz)
    plant.power(True)
    out = np.zeros((7, n))
    out[5, 0], out[6, 0] = plant.truth().pressure_Pa, plant.truth().contact_force_N
    for k in range(1, n):
        plant.follow(path[(k - 1) * loops_per_sample : k * loops_per_sample])
        state, reading = plant.truth(), plant.latch()
        out[:3, k] = state.angle_rad, state.velocity_rad_s, state.current_A
        out[3:5, k] = reading.current_A, reading.voltage_V
        out[5:, k] = state.pressure_Pa, state.contact_force_N
    return {
        "time": time,
        "command": command(time),
        "angle": out[0],
        "velocity": out[1],
        "current": out[2],
        "mean_current": out[3],
        "voltage": out[4],
        "pressure": out[5],
        "contact_force": out[6],
    }
