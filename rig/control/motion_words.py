"""Contradictions between the reports of devices and the bench file, as text for the operator and as
values to set in the bench file.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from drivers.interfaces import Servo
from rig.control.motion_factors import SENSE
from rig.wiring.devices import Nominal

SPEED, SHAFT, WORK, CONSTANT = (
    "speed against position",
    "joint encoder against motor encoder",
    "current against motion",
    "torque constant",
)
"""Names of the compared quantities."""
SPEED_BAND: Final = (0.25, 4.0)
"""Range of the ratio of reported to true speed in which the unit of the speed counts as right.
Filters, and samples that miss the peaks of stick-slip, change the ratio less (to 0.33 at one count
per cycle); a wrong unit changes the ratio more, for example rpm for degrees per second by a factor
of 6.
"""
RATIO_TOLERANCE: Final = 0.1
"""Relative difference of the encoders' travels that play and twist may cause."""
TORQUE_BAND: Final = (1.0 / 1.5, 1.5)
"""Range of the ratio of found to stated torque constant within which the stated constant counts as
right. Data sheets, magnets and temperature cause differences of 20 %; wrong definitions (peak or
root mean square, motor or joint) cause larger differences.
"""
STANDS_STILL: Final = 0.005
"""Share of the motor encoder's travel below which the joint encoder counts as standing still."""
SHAFT_SPREAD: Final = 1.3
"""Greatest ratio of the encoders' travels, of the larger to the smaller, at which the encoders
count as turning 1:1. This ratio is large, because before a trip the motor encoder moves only a few
counts.
"""
NO_TORQUE: Final = (
    "the torque constant cannot be compared with a measurement: the drive reports neither a "
    "torque beside its current nor a usable motor voltage, and the bench file states no rated "
    "torque and current. Set servo.voltage_object, or state the rated values; an "
    "identification of this bench shows a change of the torque constant"
)


@dataclass(frozen=True)
class Change:
    """Value that the operator should set in the bench file.

    Attributes:
        section: Section of the file.
        key: Key in this section.
        value: Value to set; None removes the key.
    """

    section: str
    key: str
    value: str | float | None

    def __str__(self) -> str:
        if self.value is None:
            return f"no {self.section}.{self.key}"
        shown = f"{self.value:.4g}" if isinstance(self.value, float) else self.value
        return f"{self.section}.{self.key}: {shown}"


@dataclass(frozen=True)
class Contradiction:
    """Two reports, or a report and the bench file, that contradict each other.

    Attributes:
        what: Compared quantity.
        factor: Found value over the expected value.
        words: Finding and remedy, for the operator.
        changes: Values to set in the bench file; empty if the bench or the drive must be changed.
        rough: Whether the factor is computed from few counts.
        open: Whether two factors are possible, both of which ``words`` states.
    """

    what: str
    factor: float
    words: str
    changes: tuple[Change, ...] = ()
    rough: bool = False
    open: bool = False

    @property
    def above(self) -> bool:
        """Whether the found value is above the expected value."""
        return self.factor > 1.0


def wrong_speed(
    factor: float, servo: Servo, rough: bool = False, other: float | None = None
) -> Contradiction:
    """Return the contradiction for a reported speed of ``factor`` times the true speed; ``rough``
    is true if the factor is computed from few counts, and ``other`` is a second possible factor.
    """
    words = (
        f"the speed that the drive reports is {factor:.4g} times the change of its position; it "
        f"must be {SPEED_BAND[0]:g} to {SPEED_BAND[1]:g} times: {servo.speed_remedy(factor)}"
    )
    if other is not None:
        words += f"; or the factor is {other:.4g}: {servo.speed_remedy(other)}"
    if rough:
        words += "; few counts show this factor, so compare the unit with the manual of the drive"
    changes = tuple(Change("servo", key, value) for key, value in servo.speed_settings(factor))
    return Contradiction(SPEED, factor, words, changes, rough, other is not None)


def wrong_shaft(factor: float, nominal: Nominal) -> Contradiction:
    """Return the contradiction, with its cause, for encoders with different travels."""
    gear = nominal.gear_ratio
    found = (
        f"the joint encoder travels {factor:.4g} times as far as the motor encoder over the gear "
        f"ratio of {gear:g}"
    )
    size, sign = abs(factor), Change("encoder", "sign", -nominal.encoder_sign)
    changes = (sign,) if factor < 0.0 else ()
    if size < STANDS_STILL:
        changes = ()
        remedy = (
            "the joint encoder stands still: check its coupling, and whether it is the "
            "encoder of this joint"
        )
    elif abs(size - 1.0) <= 2.0 * RATIO_TOLERANCE and changes:
        remedy = f"set {sign}, or reverse servo.sign if the drive counts in the opposite direction"
    elif 1.0 / SHAFT_SPREAD <= size / gear <= SHAFT_SPREAD:
        changes = ()
        remedy = (
            "both encoders turn 1:1, so that both are on the same side of the gear: mount the "
            "joint encoder on the joint, or set machine.gear_ratio: 1 if there is no gear"
        )
    else:
        ratio = Change("machine", "gear_ratio", float(f"{gear / size:.4g}"))
        changes = (*changes, ratio)
        remedy = (
            f"set {' and '.join(map(str, changes))}, if the counts per turn of both encoders "
            "are right"
        )
    return Contradiction(SHAFT, factor, f"{found}: {remedy}", changes)


def wrong_sense(sense: float) -> Contradiction:
    """Return the contradiction if the current works against the motion."""
    words = (
        f"the current works against the motion in both directions (relative work {sense:.2f}, "
        f"must be above {-SENSE:g}), but friction consumes work, so that the sign of the current "
        "is wrong: set servo.current_sign: -1, or correct the sign with the maker's tool"
    )
    return Contradiction(WORK, sense, words, (Change("servo", "current_sign", -1),))


def wrong_torque(constant: float, source: str, nominal: Nominal) -> Contradiction:
    """Return the contradiction between the found and the stated torque constant."""
    stated = nominal.torque_constant_N_m_A
    factor = constant / stated
    if factor < 0.0:
        words = (
            "torque 6077h and current 6078h of the drive have opposite signs; correct the drive "
            "with its maker's tool"
        )
        return Contradiction(CONSTANT, factor, words)
    change = Change("machine", "torque_constant_N_m_A", float(f"{constant:.4g}"))
    words = (
        f"by {source} the motor gives {constant:.4g} N m/A, the bench file says {stated:.4g} "
        f"N m/A: the ratio {factor:.3g} must be {TORQUE_BAND[0]:.2g} to {TORQUE_BAND[1]:g}: set "
        f"{change}, or correct the rated values"
    )
    return Contradiction(CONSTANT, factor, words, (change,))
