"""Simulates worlds with motulator: its converter, synchronous machine and one or two masses.

The package has no gear and no stiction: the machine drives the joint directly, and friction of the
paper's nominal model and the known loads act on its mechanics. Current and voltage of the log are
those of the q axis in power-invariant scaling, in which torque and back-EMF have one constant; the
drive holds the current of the d axis at zero.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import Any

from benchmarks.worlds.others.bench import Shaft, played, steps
from benchmarks.worlds.world import Signals, World
from rig.common.errors import InputError

try:
    from motulator.drive import model
    from motulator.drive.utils import SynchronousMachinePars, TwoMassMechanicalSystemPars
except ImportError as error:
    raise InputError(
        "the plant motulator needs the package motulator; install it with: "
        "pip install 'loadrig[plants]'"
    ) from error

PAIRS = 8
"""Number of pole pairs."""
PER_PEAK = math.sqrt(1.5)
"""Ratio of a power-invariant quantity to the peak value that the package has."""
DAMPING = 0.02
"""Damping ratio of the elastic shaft."""


class MotulatorPlant:
    """Plant of motulator; see :class:`benchmarks.worlds.seal.Plant`.

    ``compliance`` is the stiffness of the shaft between two masses, ``quadratic_drag`` a friction
    coefficient that grows with the speed, ``x_timed_torque`` a load torque over time. The friction
    of two masses acts on the load alone.
    """

    effects: Collection[str] = frozenset({"compliance", "quadratic_drag"})
    outside: Collection[str] = frozenset({"x_timed_torque"})
    not_scored: Collection[str] = frozenset()

    def play(self, world: World) -> Iterator[Signals]:
        """Yield the signals of the machine in each recording."""
        return played(world, _Machine)


class _Rigid(model.StiffMechanicalSystem):
    """One mass with the paper's dry friction and the known loads."""

    twist = 0.0

    def __init__(self, shaft: Shaft, step_s: float, **given: Any) -> None:
        super().__init__(J=shaft.inertia, **given)
        self.shaft, self.step_s, self.angle = shaft, step_s, 0.0

    def rhs(self) -> list[Any]:
        out, push = self.out, self.shaft.load(self.angle)
        free = self.inp.tau_M - out.tau_L_tot + push
        dry = self.shaft.friction(self.state.w_M, free, self.par.J, self.step_s)
        out.tau_L_tot += dry - push
        return list(super().rhs())


class _Elastic(model.TwoMassMechanicalSystem):
    """Two masses with an elastic shaft, of which the load has all friction."""

    def __init__(self, shaft: Shaft, step_s: float, **given: Any) -> None:
        super().__init__(**given)
        self.shaft, self.step_s, self.angle = shaft, step_s, 0.0
        self.state.theta_ML = -shaft.load(0.0) / self.par.K_S

    @property
    def twist(self) -> float:
        return float(self.state.theta_ML)

    def rhs(self) -> list[Any]:
        out, push = self.out, self.shaft.load(self.angle)
        free = out.tau_S - out.tau_L_tot + push
        dry = self.shaft.friction(self.state.w_L, free, self.par.J_L, self.step_s)
        out.tau_L_tot += dry - push
        motor, turn, load, _ = super().rhs()
        # The twist follows from the speeds after the step: no energy from explicit steps.
        speeds = self.state.w_M - self.state.w_L + self.step_s * (motor - load)
        return [motor, turn, load, speeds]


class _Machine:
    """One recording of a :class:`motulator.drive.model.Drive`, in explicit steps."""

    def __init__(self, world: World, k: int) -> None:
        motor, given = world.motor, world.effects
        shaft, self._steps = Shaft(world, k), steps(world)
        self._step_s = 1.0 / (world.drive.rate_Hz * self._steps)
        drag = given.get("quadratic_drag", {}).get("coefficient_Nms2_rad2", 0.0)
        timed = given.get("x_timed_torque", {"torque_Nm": 0.0, "frequency_Hz": 0, "phase_rad": 0})
        turn = 2.0 * math.pi * timed["frequency_Hz"]
        further = {"tau_L": lambda t: -timed["torque_Nm"] * math.sin(turn * t + timed["phase_rad"])}
        self._joint: Any
        if "compliance" in given:
            rotor = motor.rotor_share * world.constants.J
            stiffness, load = given["compliance"]["stiffness_Nm_rad"], shaft.inertia - rotor
            damping = 2.0 * DAMPING * math.sqrt(stiffness * rotor * load / (rotor + load))
            masses = TwoMassMechanicalSystemPars(
                rotor, load, stiffness, damping, lambda w: shaft.viscous + drag * w
            )
            self._joint = _Elastic(shaft, self._step_s, par=masses, **further)
        else:
            self._joint = _Rigid(
                shaft, self._step_s, B_L=lambda w: shaft.viscous + drag * w, **further
            )
        flux, inductance = motor.torque_per_A / (PER_PEAK * PAIRS), motor.inductance_H
        windings = SynchronousMachinePars(
            n_p=PAIRS, R_s=motor.resistance_ohm, L_d=inductance, L_q=inductance, psi_f=flux
        )
        held = -world.recordings[k].steady_N_m(world.gravity_m_s2) / motor.torque_per_A
        self._synchronous = model.SynchronousMachine(
            windings, psi_s0=complex(flux, inductance * held / PER_PEAK)
        )
        self._model = model.Drive(
            model.VoltageSourceConverter(motor.supply_V), self._synchronous, self._joint
        )
        self.current = self.mean_current = held
        self.shaft, self.angle = self._joint.twist, 0.0
        self.terminal, self.supply = 0.0, motor.supply_V

    def advance(self, voltage: float) -> None:
        drive, machine, h, sums = self._model, self._synchronous, self._step_s, 0.0
        for _ in range(self._steps):
            speed, current = self._joint.state.w_M, machine.i_s
            sums += current.imag
            # Without the coupling of the axes the d axis has no current.
            wanted = complex(-PAIRS * speed * machine.par.L_q * current.imag, voltage / PER_PEAK)
            turn = machine.state.exp_j_theta_m
            drive.converter.inp.q_cs = wanted * turn / (abs(turn) * self.supply)
            state = drive.get_initial_values()
            rates = drive.rhs(drive.t0, state)
            drive.t0 += h
            drive.set_states([y + h * rate for y, rate in zip(state, rates, strict=True)])
            machine.state.exp_j_theta_m /= abs(machine.state.exp_j_theta_m)
            self.shaft += h * self._joint.state.w_M
            self._joint.angle = self.shaft - self._joint.twist
        self.angle = self._joint.angle
        self.current = PER_PEAK * machine.i_s.imag
        self.mean_current = PER_PEAK * sums / self._steps
        self.terminal = voltage
