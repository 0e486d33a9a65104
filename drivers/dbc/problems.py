"""Collects the errors of a signal map, and looks up its names and values in a DBC file."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping

from drivers.dbc.codec import Signal
from drivers.dbc.file import Layout

Place = tuple[str | int, ...]
"""Keys that lead from the top of the map to a faulty value."""
Problem = tuple[Place, str]


class DbcMapError(Exception):
    """The map does not fit the DBC.

    Attributes:
        problems: Place in the map and description of each problem.
    """

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(problems)
        super().__init__(
            "; ".join(f"{'.'.join(map(str, place))}: {text}" for place, text in self.problems)
        )


class Names:
    """Looks up the names of a map in a DBC, and collects the problems, so that all problems are
    reported together.

    Attributes:
        problems: The problems found so far.
    """

    def __init__(self, layouts: Mapping[str, Layout]) -> None:
        self.layouts = layouts
        self.problems: list[Problem] = []

    def report(self, place: Place, text: str) -> None:
        """Add a problem."""
        self.problems.append((place, text))

    def layout(self, place: Place, message: str) -> Layout | None:
        """Return a message. If the message is unknown or cannot be used, a problem is reported and
        the result is None.
        """
        layout = self.layouts.get(message)
        if layout is None:
            self.report(
                place, f"the DBC has no message {message!r}; {nearest(message, self.layouts)}"
            )
        elif layout.obstacle:
            self.report(place, f"message {message!r} {layout.obstacle}")
            return None
        return layout

    def signal(self, place: Place, name: str) -> tuple[Layout, Signal] | None:
        """Return the message and signal of ``Message.Signal``; if the name is unknown, a problem is
        reported and the result is None.
        """
        message, dot, signal = name.partition(".")
        if not dot:
            self.report(place, f"{name!r} must have the form Message.Signal")
            return None
        layout = self.layout(place, message)
        found = None if layout is None else self.part(place, layout, signal)
        return None if layout is None or found is None else (layout, found)

    def part(self, place: Place, layout: Layout, name: str) -> Signal | None:
        """Return a signal of a message. If the message has no signal of this name, a problem is
        reported and the result is None.
        """
        signal = layout.signals.get(name)
        if signal is None:
            near = nearest(name, layout.signals)
            self.report(place, f"message {layout.name!r} has no signal {name!r}; {near}")
        return signal

    def require_whole(self, place: Place, signal: Signal) -> bool:
        """Report a problem if a signal that must be a whole number is floating-point."""
        if signal.real:
            self.report(
                place, f"signal {signal.name!r} is floating-point; use a signal with whole numbers"
            )
        return not signal.real

    def raw(self, place: Place, signal: Signal, value: str | int | float) -> int | None:
        """Return the raw value of a label or number; report a value that does not fit into the
        signal.
        """
        if isinstance(value, str):
            raw = next((raw for raw, label in signal.labels.items() if label == value), None)
            if raw is None:
                near = nearest(value, signal.labels.values())
                self.report(place, f"signal {signal.name!r} has no value {value!r}; {near}")
            return raw
        if not self.require_whole(place, signal):
            return None
        low, high = signal.range
        if isinstance(value, int) and low <= value <= high:
            return value
        what = f"is outside {low} to {high}, the range of {signal.name!r}"
        if not isinstance(value, int):
            what = f"is not a whole number, as signal {signal.name!r} requires"
        self.report(place, f"{value} {what}")
        return None

    def bits(self, place: Place, signal: Signal, value: str | int | float) -> int | None:
        """Return the bits of a value, also for a floating-point signal."""
        if signal.real and not isinstance(value, str):
            try:
                return signal.pack(float(value))
            except (ValueError, OverflowError) as error:
                self.report(place, str(error))
                return None
        raw = self.raw(place, signal, value)
        return None if raw is None else raw & signal.mask


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a text with the known names that are most similar to an unknown name, or with all
    known names.
    """
    names = sorted(known)
    close = [k for k in names if k.casefold() == name.casefold()] or difflib.get_close_matches(
        name, names, n=3
    )
    if close:
        return f"did you mean {' or '.join(repr(k) for k in close)}?"
    return f"known names are {', '.join(names)}" if names else "no name is known"
