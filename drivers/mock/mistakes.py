"""Injects mistakes of a first set-up into the simulated machine and its devices, to test that
commissioning finds them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from drivers.mock import faults
from drivers.mock.bench import SimulatedBench, SimulatedDbcBench
from drivers.mock.canopen.dictionary import key
from drivers.mock.plant.machine import Loop
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.power_state import Command

_PRODUCT: Final = key(0x1018, 2)
_LIMITS: Final = frozenset({0x607D, 0x607F, 0x6072, 0x6073, 0x6065})


@dataclass(frozen=True)
class Mistake:
    """One mistake.

    Attributes:
        words: Description of the mistake.
        spoil: Function that injects the mistake into the devices of a bench, of which the used
            joint encoder is an argument.
        change: Function that injects the mistake into the machine.
        signs: Parts of the drive that have the wrong sign.
    """

    words: str
    spoil: Callable[[SimulatedBench, faults.Sensor], None] | None = None
    change: Callable[[Machine], Machine] | None = None
    signs: tuple[Loop, ...] = ()

    @property
    def any_drive(self) -> bool:
        """Whether the mistake is possible with drives of every kind."""
        return self.spoil is None and self.change is None

    def build_into(self, bench: SimulatedBench | SimulatedDbcBench, encoder: faults.Sensor) -> None:
        """Inject the mistake into the devices of a bench, of which ``encoder`` is the used joint
        encoder.
        """
        for loop in self.signs:
            bench.machine.reverse(loop)
        if self.spoil is not None and isinstance(bench, SimulatedBench):
            self.spoil(bench, encoder)


def _in_rpm(bench: SimulatedBench, _: faults.Sensor) -> None:
    increments = bench.machine.constants.sensing.motor_counts_per_turn or 60
    bench.drive.use_speed_unit(increments / 60.0)


def _motor(**factors: float) -> Callable[[Machine], Machine]:
    def change(machine: Machine) -> Machine:
        values = {name: getattr(machine.motor, name) * f for name, f in factors.items()}
        return dataclasses.replace(machine, motor=dataclasses.replace(machine.motor, **values))

    return change


def _never_lost(_: int) -> None:
    """Do nothing when the master is lost."""


MISTAKES: Final[Mapping[str, Mistake]] = {
    "another_device": Mistake(
        "the drive on the node is of another product than its EDS file",
        lambda bench, _: bench.drive.objects.values.__setitem__(_PRODUCT, 0x0999),
    ),
    "position_sign": Mistake("the drive's position loop has the wrong sign", signs=("position",)),
    "velocity_sign": Mistake("the drive's speed loop has the wrong sign", signs=("velocity",)),
    "phases_swapped": Mistake("two phases of the motor are swapped", signs=("phases",)),
    # The joint encoder shows the true direction; the machine is the mirror image.
    "motor_encoder": Mistake(
        "the motor encoder counts the other way",
        lambda _, encoder: faults.reverse(encoder),
        signs=("phases",),
    ),
    "zero_off": Mistake(
        "the joint encoder reads 5 deg at zero",
        lambda _, encoder: faults.jump(encoder, round(encoder.counts_per_turn / 72.0)),
    ),
    "limits_ignored": Mistake(
        "the drive acknowledges limits and keeps its own",
        lambda bench, _: setattr(bench.drive.objects, "deaf", _LIMITS),
    ),
    "watchdog_dead": Mistake(
        "the drive goes on when the program is silent",
        lambda bench, _: setattr(bench.drive, "connection_lost", _never_lost),
    ),
    "stop_ignored": Mistake(
        "the drive ignores the quick stop",
        lambda bench, _: setattr(bench.drive, "deaf_to", frozenset({Command.QUICK_STOP})),
    ),
    "rpm": Mistake("the drive's speeds are in rpm", _in_rpm),
    "current_sign": Mistake(
        "the drive's current has the wrong sign",
        lambda bench, _: setattr(bench.drive, "current_sign", -1),
    ),
    "encoder_sign": Mistake(
        "the joint encoder counts the other way", lambda _, encoder: faults.reverse(encoder)
    ),
    "motor_shaft": Mistake(
        "the joint encoder is on the motor's shaft",
        lambda bench, encoder: faults.on_motor_shaft(encoder, bench.machine),
    ),
    "ratio": Mistake("the gear has 2/3 of the stated ratio", change=_motor(gear_ratio=2.0 / 3.0)),
    "torque_constant": Mistake(
        "the motor has twice the stated torque constant",
        change=_motor(torque_constant_N_m_A=2.0, back_emf_constant_V_s_rad=2.0),
    ),
    "home_jammed": Mistake(
        "the joint is jammed while the drive homes (--home)",
        lambda bench, _: setattr(bench.drive.homing, "jammed", True),
    ),
    "home_endless": Mistake(
        "the drive never ends a homing (--home)",
        lambda bench, _: setattr(bench.drive.homing, "endless", True),
    ),
    "home_switch": Mistake(
        "the limit switches never close (--home 17 or 18)",
        lambda bench, _: setattr(bench.drive.homing, "switches_deg", None),
    ),
}
"""Name to mistake."""
