"""Simulates worlds with gym-electric-motor: its DC machine, bridge, supply and load polynomial.

The package has no stiction and no angle: friction of the paper's nominal model and the known loads
act on its shaft. Its bridge of four transistors gives both halves the same current, so that their
interlocking times cancel; here the second half has the current that returns.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from benchmarks.worlds.others.bench import Shaft, played, steps
from benchmarks.worlds.world import Signals, World
from rig.common.errors import InputError
from rig.results.prove.draw import log

try:
    from gym_electric_motor import physical_systems as gem
    from gym_electric_motor.physical_systems.solvers import EulerSolver
except ImportError as error:
    raise InputError(
        "the plant electric-motor needs the package gym-electric-motor; install it with: "
        "pip install 'loadrig[plants]'"
    ) from error

FIELD_SHARE = 0.1
"""Ratio of the field current to the current limit of the drive."""
CHARGE_S = (2e-3, 1e-2)
"""Range of the time constant of the supply's resistance and capacitance, s."""
STREAM = 11


class ElectricMotorPlant:
    """Plant of gym-electric-motor; see :class:`benchmarks.worlds.seal.Plant`.

    ``inverter_dead_time`` is the interlocking time of the bridge, ``supply_sag`` the resistance of
    a supply with a capacitor, ``quadratic_drag`` the coefficient c of the load polynomial;
    ``x_field_sag`` is a wound field that hangs on the same supply.
    """

    effects: Collection[str] = frozenset({"inverter_dead_time", "supply_sag", "quadratic_drag"})
    outside: Collection[str] = frozenset({"x_field_sag"})
    not_scored: Collection[str] = frozenset()

    def play(self, world: World) -> Iterator[Signals]:
        """Yield the signals of the machine in each recording."""
        return played(world, _Machine)


class _Bridge(gem.ContFourQuadrantConverter):
    def convert(self, i_out: Any, t: float) -> list[float]:
        out, back = self._subconverters
        return [out.convert(i_out, t)[0] - back.convert([-i_out[0]], t)[0]]


class _Load(gem.PolynomialStaticLoad):
    """The package's polynomial with the paper's dry friction and the known loads, at the motor.

    The solver calls the differential equation once in each step, so that the angle can follow here.
    """

    def __init__(self, shaft: Shaft, gear: float, drag: float, step_s: float) -> None:
        per = 1.0 / gear**2
        terms = {"a": 0.0, "b": shaft.viscous * per, "c": drag * per / gear}
        terms["j_load"] = shaft.inertia * per
        super().__init__(terms, load_initializer={"states": {"omega": 0.0}})
        self._shaft, self._gear, self._step_s = shaft, gear, step_s
        self.angle = 0.0

    def mechanical_ode(self, t: float, mechanical_state: Any, torque: Any) -> Any:
        gear, joint = self._gear, float(mechanical_state[0]) / self._gear
        push = self._shaft.load(self.angle)
        free = (float(torque) - self._static_load(joint * gear)) * gear + push
        dry = self._shaft.friction(joint, free, self._shaft.inertia, self._step_s)
        rates = super().mechanical_ode(t, mechanical_state, float(torque) + (push - dry) / gear)
        self.angle += self._step_s * (joint + 0.5 * self._step_s * float(rates[0]) / gear)
        return rates


class _Machine:
    """One recording of a :class:`gym_electric_motor.physical_systems.DcMotorSystem`."""

    def __init__(self, world: World, k: int) -> None:
        motor, given, tau = world.motor, world.effects, 1.0 / world.drive.rate_Hz
        shaft, self._steps = Shaft(world, k), steps(world)
        drag = given.get("quadratic_drag", {}).get("coefficient_Nms2_rad2", 0.0)
        self._load = _Load(shaft, motor.gear_ratio, drag, tau / self._steps)
        dead_V = given.get("inverter_dead_time", {}).get("voltage_V", 0.0)
        # Both halves of the bridge lose the interlocking time once in each period.
        bridge = _Bridge(tau=tau, interlocking_time=0.5 * tau * dead_V / motor.supply_V)
        held = -world.recordings[k].steady_N_m(world.gravity_m_s2) / motor.torque_per_A
        field = given.get("x_field_sag", {})
        sag = field or given.get("supply_sag", {})
        supply = gem.IdealVoltageSupply(motor.supply_V)
        if sag:
            charge_s = log(*CHARGE_S)(np.random.default_rng([*world.seed, STREAM]))
            ohm = sag["resistance_ohm"]
            supply = gem.RCVoltageSupply(motor.supply_V, {"R": ohm, "C": charge_s / ohm})
        # The load has the inertia of all parts.
        armature = {"r_a": motor.resistance_ohm, "l_a": motor.inductance_H, "j_rotor": 0.0}
        most = {"u": motor.supply_V, "i": 2.0 * motor.limit_A, "omega": 1e6}
        if field:
            i_e = FIELD_SHARE * motor.limit_A
            r_e = motor.supply_V / i_e
            wound = {"r_e": r_e, "l_e": r_e * field["time_s"], "l_e_prime": motor.constant / i_e}
            states, kind = {"i_a": held, "i_e": i_e}, gem.DcExternallyExcitedMotor
            most |= {f"{name}_{part}": most[name] for name in "ui" for part in "ae"}
            # Without interlocking, so that the field has the whole voltage of the supply.
            one = gem.ContOneQuadrantConverter(tau=tau)
            bridge, further = gem.ContMultiConverter([bridge, one], tau=tau), wound
        else:
            states, kind = {"i": held}, gem.DcPermanentlyExcitedMotor
            further = {"psi_e": motor.constant}
        self._system = gem.DcMotorSystem(
            bridge,
            kind(armature | further, dict(most), dict(most), {"states": states}),
            self._load,
            supply,
            EulerSolver(self._steps),
            tau,
            calc_jacobian=False,
        )
        self._system.reset()
        self._field, self._nominal_V = bool(field), motor.supply_V
        self.current = self.mean_current = held
        self.shaft = self.angle = 0.0
        self.terminal, self.supply = 0.0, motor.supply_V

    def advance(self, voltage: float) -> None:
        duty = voltage / self._nominal_V
        before = self.current
        self._system.simulate(np.array([duty, 1.0] if self._field else [duty]))
        state = self._system.system_state
        self.current = float(state[self._system.CURRENTS_IDX[0]])
        self.shaft = self.angle = self._load.angle
        self.terminal = float(state[self._system.VOLTAGES_IDX[0]])
        self.supply = float(state[self._system.U_SUP_IDX[0]])
        self.mean_current = 0.5 * (before + self.current)
