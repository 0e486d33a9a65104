"""Checks whether the constants of a bench file are physically plausible.

An example is a moment arm of 95 mm that was entered as 95 m.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from rig.common.findings import Cause, Finding
from rig.config.bench import Bench, Constants
from rig.config.canopen import ServoSection
from rig.config.configuration import Document, Loc


@dataclass(frozen=True)
class Range:
    """Plausible range of a quantity.

    Attributes:
        usual: Range for benches of this kind; a value outside gives a warning.
        possible: Range for any bench; a run refuses a value outside.
        unit: Unit of both ranges; empty for a ratio.
        hint: What the user should check.
    """

    usual: tuple[float, float]
    possible: tuple[float, float]
    unit: str
    hint: str


_NONE = ", which is impossible on a bench of this kind"
_FEW = ", which is unusual on a bench of this kind"
CONSTANTS = {
    "torque_constant_N_m_A": Range(
        (1e-3, 20.0), (1e-5, 1e3), "N m/A", "data sheets often give mN m/A"
    ),
    "back_emf_constant_V_s_rad": Range(
        (1e-3, 20.0),
        (1e-5, 1e3),
        "V s/rad",
        "data sheets often give the inverse in rpm/V; convert it as 9.549 divided by that value",
    ),
    "resistance_ohm": Range((0.01, 500.0), (1e-4, 1e5), "ohm", "check value and unit"),
    "inductance_H": Range((1e-6, 0.5), (0.0, 10.0), "H", "data sheets often give mH"),
    "gear_ratio": Range((1.0, 1e3), (0.01, 1e5), "", "state motor turns per joint turn"),
    "moment_arm_m": Range((0.01, 1.0), (1e-3, 5.0), "m", "state it in metres, not in millimetres"),
    "lever_ratio": Range((0.5, 50.0), (0.01, 1e3), "", "state contact force over weight force"),
    "gravity_m_s2": Range((9.76, 9.84), (9.7, 9.9), "m/s^2", "state the local gravity"),
}
"""Ranges of the keys of the section ``machine``."""
_EMF = Range((0.4, 2.5), (0.2, 5.0), "", "in SI units both constants of an ideal motor are equal")
_TIME = Range((1e-5, 0.1), (1e-7, 10.0), "s", "check the units of inductance and resistance")
_RATED = Range(
    (0.4, 2.5), (0.05, 20.0), "", "6076h has the torque of the motor before the gear, in mN m"
)
_MOTOR_SPEED = Range((0.0, 20e3), (0.0, 200e3), "rpm", "check speed_deg_s and gear_ratio")


def implausible(document: Document[Bench]) -> list[Finding]:
    """Return the constants of a bench that are impossible, and the constants that are unusual."""
    return [
        Finding(Cause.CONSTANTS, document.problem(place, text), refused)
        for place, text, refused in _unlikely(document.value)
    ]


def _unlikely(bench: Bench) -> Iterator[tuple[Loc, str, bool]]:
    machine = bench.machine
    for name, bounds in CONSTANTS.items():
        yield from _judge(("machine", name), "", getattr(machine, name), bounds)
    for place, words, value, bounds in (*_motor(machine), *_drive(bench)):
        yield from _judge(place, words, value, bounds)


_Derived = tuple[Loc, str, float, Range]


def _motor(machine: Constants) -> Iterator[_Derived]:
    place = "machine"
    ratio = machine.back_emf_constant_V_s_rad / machine.torque_constant_N_m_A
    yield (
        (place, "back_emf_constant_V_s_rad"),
        "its ratio to torque_constant_N_m_A of ",
        ratio,
        _EMF,
    )
    if machine.inductance_H > 0.0:
        time_s = machine.inductance_H / machine.resistance_ohm
        yield (
            (place, "inductance_H"),
            "with resistance_ohm a time constant of the current of ",
            time_s,
            _TIME,
        )


def _drive(bench: Bench) -> Iterator[_Derived]:
    rpm = bench.limits.speed_deg_s * bench.machine.gear_ratio / 6.0
    yield ("limits", "speed_deg_s"), "at the motor ", rpm, _MOTOR_SPEED
    if isinstance(bench.servo, ServoSection):
        torque = bench.machine.torque_constant_N_m_A * bench.servo.rated_current_A
        ratio = bench.servo.rated_torque_N_m / torque
        words = f"its ratio to rated_current_A times torque_constant_N_m_A ({torque:.4g} N m) of "
        yield ("servo", "rated_torque_N_m"), words, ratio, _RATED


def _judge(place: Loc, what: str, value: float, bounds: Range) -> Iterator[tuple[Loc, str, bool]]:
    unit = f" {bounds.unit}" if bounds.unit else ""
    found = f"{what}{value:g}{unit} is outside"
    for (low, high), words, refused in (
        (bounds.possible, _NONE, True),
        (bounds.usual, _FEW, False),
    ):
        if not low <= value <= high:
            yield place, f"{found} {low:g} to {high:g}{unit}{words}; {bounds.hint}", refused
            return
