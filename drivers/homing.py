"""Homing: a drive sets the zero of its position by itself (CiA 402, mode of operation 6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final

from drivers.errors import ConfigurationError

IN_PLACE: Final = frozenset({35, 37})
"""Methods without motion: the present position is the home position. 35 is the older number."""
_WORDS: Final[Mapping[int, str]] = {
    17: "to the limit switch on the negative side of the drive's position",
    18: "to the limit switch on the positive side of the drive's position",
    33: "to the next index pulse on the negative side",
    34: "to the next index pulse on the positive side",
    35: "the present position is the home position",
    37: "the present position is the home position",
}
STANDARD: Final = (*range(1, 15), *range(17, 31), 33, 34, 35, 37)
"""Methods of CiA 402; negative ones are the maker's own."""


class HomingState(Enum):
    """How a homing stands."""

    RUNNING = "running"
    ATTAINED = "attained"
    FAILED = "homing error"
    INTERRUPTED = "interrupted"


def method_words(method: int) -> str:
    """Return what a method does."""
    if method in _WORDS:
        return _WORDS[method]
    kind = "the maker's own" if method < 0 else "to a switch or index pulse, see 6098h"
    return f"{kind}, in the drive's manual"


@dataclass(frozen=True)
class HomingOffer:
    """Whether a drive can home, and how.

    Attributes:
        methods: Values of 6098h that it takes; none where it cannot home.
        why_not: Why it cannot home, or why only without motion; empty where nothing is missing.
        listed: Whether the drive lists these methods (60E3h); else they are all that its EDS allows
            in 6098h, and it may refuse one.
    """

    methods: tuple[int, ...] = ()
    why_not: str = ""
    listed: bool = True

    @property
    def words(self) -> str:
        """Return the offer for the operator."""
        if not self.methods:
            return f"no homing by the drive: {self.why_not}"
        shown = f"methods {', '.join(map(str, self.methods))}"
        if not self.listed:
            shown = "by the methods in its manual, as it does not list them (60E3h)"
        more = f" (only without motion: {self.why_not})" if self.why_not else ""
        return f"the drive can set its zero by homing, {shown}{more}"

    def refusal(self, method: int) -> str:
        """Return why a method cannot be used; empty if it can be used."""
        return "" if method in self.methods else f"method {method} is not offered; {self.words}"


@dataclass(frozen=True)
class HomingOrder:
    """One homing.

    Attributes:
        method: Value of 6098h.
        home_rad: Joint angle that the drive is to show at the home position.
        search_rad_s: Joint speed towards a switch.
        zero_rad_s: Joint speed in search of the home position itself.
        acceleration_rad_s2: Joint acceleration.
    """

    method: int
    home_rad: float
    search_rad_s: float
    zero_rad_s: float
    acceleration_rad_s2: float


class Homes:
    """Homing of a drive; the methods of this class are those of a drive that cannot home."""

    def homing_offer(self) -> HomingOffer:
        """Return whether the drive can home, from its description and from objects that it reads.
        Writes nothing.

        Raises:
            LinkError: The drive cannot be reached.
        """
        return HomingOffer(why_not="this program homes drives of CiA 402 only")

    def begin_homing(self, order: HomingOrder) -> Mapping[str, int]:
        """Write the settings of a homing, verify them, and energise in homing mode; the homing does
        not start. The drive must be prepared.

        Returns:
            Object to the value that it holds now.

        Raises:
            ConfigurationError: The drive cannot home, or does not take a setting.
            StateError: It is energised already, or does not show homing mode (6061h) in time; it is
                then de-energised.
        """
        raise ConfigurationError(
            f"{self.homing_offer().words}; homing method {order.method} is not carried out"
        )

    def start_homing(self) -> None:
        """Put the start of the homing (controlword bit 4) into the PDO of the next exchange."""

    def homing_state(self) -> HomingState:
        """Return the state of the homing at the last exchange."""
        return HomingState.FAILED

    def end_homing(self) -> tuple[int, int]:
        """Select the usual mode of operation again; the drive must be de-energised.

        Returns:
            The mode that the drive shows now (6061h), and the usual one (6060h).

        Raises:
            StateError: The drive is energised.
            LinkError: It cannot be reached.
        """
        return 0, 0
