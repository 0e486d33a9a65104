"""Homing: a drive sets the zero of its position by itself (CiA 402, mode of operation 6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Final, Protocol, runtime_checkable

IN_PLACE: Final = frozenset({35, 37})
"""Homing methods without motion; 35 is the older number of method 37."""
_WORDS: Final[Mapping[int, str]] = {
    17: "to the limit switch on the negative side of the drive's position",
    18: "to the limit switch on the positive side of the drive's position",
    33: "to the next index pulse on the negative side",
    34: "to the next index pulse on the positive side",
    35: "the present position is the home position",
    37: "the present position is the home position",
}
STANDARD: Final = (*range(1, 15), *range(17, 31), 33, 34, 35, 37)
"""Homing methods of CiA 402; methods with negative numbers are the maker's own."""


class HomingState(Enum):
    """State of a homing."""

    RUNNING = "running"
    ATTAINED = "attained"
    FAILED = "homing error"
    INTERRUPTED = "interrupted"


def method_words(method: int) -> str:
    """Return a text on what a homing method does."""
    if method in _WORDS:
        return _WORDS[method]
    kind = "the maker's own" if method < 0 else "to a switch or index pulse, see 6098h"
    return f"{kind}, in the drive's manual"


@dataclass(frozen=True)
class HomingOffer:
    """Whether a drive can home, and how."""

    # Homing methods that the drive accepts (values of 6098h); empty if it cannot home.
    methods: tuple[int, ...] = ()
    # Reason why the drive cannot home, or can home only without motion; else empty.
    why_not: str = ""
    # Whether the drive lists these methods (60E3h); otherwise the methods are all that its EDS
    # allows in 6098h, and the drive may refuse some of them.
    listed: bool = True

    @property
    def words(self) -> str:
        """Return a text for the operator that states whether and how the drive can home."""
        if not self.methods:
            return f"no homing by the drive: {self.why_not}"
        shown = f"methods {', '.join(map(str, self.methods))}"
        if not self.listed:
            shown = "by the methods in its manual (the drive does not list them in 60E3h)"
        more = f" (only without motion: {self.why_not})" if self.why_not else ""
        return f"the drive can set its zero by homing, {shown}{more}"

    def problem(self, method: int) -> str:
        """Return why a homing method cannot be used; empty if it can."""
        return "" if method in self.methods else f"method {method} is not offered; {self.words}"


@dataclass(frozen=True)
class HomingOrder:
    """One homing."""

    method: int  # homing method, the value of 6098h
    home_rad: float  # joint angle at the home position, which the drive shows after the homing
    search_rad_s: float  # joint speed toward a switch
    zero_rad_s: float  # joint speed of the search for the home position
    acceleration_rad_s2: float  # joint acceleration


@runtime_checkable
class Homes(Protocol):
    """A drive that can set its zero by itself; other drives lack these methods."""

    def homing_offer(self) -> HomingOffer:
        """Return whether the drive can home, by its EDS and by reading objects; writes nothing."""
        ...

    def begin_homing(self, order: HomingOrder) -> Mapping[str, int]:
        """Write the settings of a homing, verify them, and energise the drive in homing mode,
        without starting the homing. The drive must be prepared.

        Returns:
            Name of each written object to the value that was read back.

        Raises:
            ConfigurationError: The drive does not store a setting.
            StateError: The drive is already energised, or does not activate homing mode (6061h) in
                time; it is then de-energised.
        """
        ...

    def start_homing(self) -> None:
        """Put the start of the homing (controlword bit 4) into the PDO of the next exchange."""
        ...

    def homing_state(self) -> HomingState:
        """Return the state of the homing at the last exchange."""
        ...

    def end_homing(self) -> tuple[int, int]:
        """Select the usual mode of operation again; the drive must be de-energised.

        Returns:
            The mode that is active (6061h), and the usual mode that is selected (6060h).

        Raises:
            StateError: The drive is energised.
            LinkError: The drive cannot be reached.
        """
        ...


NO_HOMING: Final = HomingOffer(why_not="this program can home only drives with the profile CiA 402")
"""Offer of a drive that is not one of :class:`Homes`."""
