"""Builds the CAN frames of each order (disable, stop, enable, ...) from a signal map and its DBC.

The module also finds the messages that are sent only with an order.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from drivers.dbc.codec import Signal
from drivers.dbc.file import Layout
from drivers.dbc.map import STATES, Assignments, DbcMap
from drivers.dbc.problems import Names, Place
from drivers.dbc.wiring import Order
from drivers.interfaces import ServoState

_KEEPS_RUNNING: Final[Place] = ("orders", "enable", "running")


@dataclass(frozen=True)
class BoundOrders:
    """The orders of a map.

    Attributes:
        orders: Orders that do not lead toward power, by their name in the map.
        enable: Orders that lead toward power, by state of the drive.
        cyclic: Messages that are sent periodically.
        once: Messages that are sent only with an order that contains them.
    """

    orders: Mapping[str, Order]
    enable: Mapping[ServoState, Order]
    cyclic: frozenset[str]
    once: frozenset[str]


def bind_orders(spec: DbcMap, names: Names, written: Iterable[str]) -> BoundOrders:
    """Build all orders; ``names`` collects the problems.

    Args:
        spec: The map.
        names: The DBC.
        written: Signals ``Message.Signal`` that the program writes in every cycle, the target
            first.
    """
    places = order_places(spec)
    named = {
        found[0].name
        for place, values in places
        for name in values
        if (found := names.signal((*place, name), name)) is not None
    }
    filled = [found for name in written if (found := _quiet(names.layouts, name)) is not None]
    cyclic = frozenset(layout.name for layout, _ in filled) | {
        name
        for name in named
        if name in spec.messages and spec.messages[name].period_ms is not None
    }
    bound = [_order(spec, names, place, values, cyclic, filled) for place, values in places]
    return BoundOrders(
        dict(zip(("disable", "stop", "reset"), bound, strict=False)),
        {STATES[name]: order for name, order in zip(spec.orders.enable, bound[3:], strict=True)},
        cyclic,
        frozenset(named - cyclic),
    )


def order_places(spec: DbcMap) -> list[tuple[Place, Assignments]]:
    """Return the place in the map and the values of each order: disable, stop, reset, then the
    orders that lead toward power.
    """
    orders = spec.orders
    return [
        (("orders", "disable"), orders.disable),
        (("orders", "stop"), orders.stop),
        (("orders", "reset"), orders.reset),
        *((("orders", "enable", state), values) for state, values in orders.enable.items()),
    ]


def _order(
    spec: DbcMap,
    names: Names,
    place: Place,
    values: Assignments,
    cyclic: frozenset[str],
    filled: list[tuple[Layout, Signal]],
) -> Order:
    """Return the frames of an order with its values, and whether the order replaces the target of
    the program.
    """
    images = _Images(names)
    for name in cyclic:
        images.begin(names.layouts[name])
    for name, value in values.items():
        found = _quiet(names.layouts, name)
        if found is None:
            continue
        layout, signal = found
        _require_free(spec, names, (*place, name), layout, signal)
        images.put((*place, name), layout, signal, value)
    for message, selector, reason in images.wrong_pages():
        names.report((*place, f"{message}.{selector}"), reason)
    own_target = False
    for number, (layout, signal) in enumerate(filled):
        shared = images.covered(layout) & signal.covers
        if number == 0 and (shared or images.other_page(layout, signal)):
            own_target = True
            if place == _KEEPS_RUNNING:
                names.report(
                    place,
                    f"sets the target {layout.name}.{signal.name} or another page of its message, "
                    "so that a running drive would never receive a target: remove this value",
                )
        elif number and shared and not own_target:
            names.report(
                place,
                f"sets {layout.name}.{signal.name}, which the program writes in every cycle: "
                "remove this value",
            )
    return Order(images.frames, own_target)


def _require_free(spec: DbcMap, names: Names, place: Place, layout: Layout, signal: Signal) -> None:
    """Report an order that sets a counter or a checksum, because the program computes both."""
    guard = spec.messages.get(layout.name)
    for role in ("counter", "checksum"):
        if guard is None or (filled := getattr(guard, role)) is None:
            continue
        other = layout.signals.get(filled)
        if other is not None and other.covers & signal.covers:
            names.report(
                place,
                f"overlaps the {role} of message {layout.name!r}, which the program computes: "
                "remove this value",
            )


class _Images:
    """Frames under construction, with the bits that have been set.

    Attributes:
        frames: Frame of each message.
    """

    def __init__(self, names: Names) -> None:
        self.frames: dict[str, bytes] = {}
        self._names = names
        self._covered: dict[str, int] = {}
        self._page: dict[str, Signal] = {}

    def begin(self, layout: Layout) -> None:
        """Start a frame in which all bits are zero."""
        self.frames.setdefault(layout.name, bytes(layout.size))

    def covered(self, layout: Layout) -> int:
        """Return the bits of a message that have been set, read as one big-endian number."""
        return self._covered.get(layout.name, 0)

    def other_page(self, layout: Layout, signal: Signal) -> bool:
        """Return whether the order has selected a page that does not contain this signal."""
        selector = signal.selector
        if selector is None or not self.covered(layout) & selector.covers:
            return False
        return selector.bits(self.frames[layout.name]) not in signal.pages

    def put(self, place: Place, layout: Layout, signal: Signal, value: str | int | float) -> None:
        """Set a signal and the selector of its page."""
        bits = self._names.bits(place, signal, value)
        if bits is None:
            return
        self.begin(layout)
        if self.other_page(layout, signal):
            self._names.report(
                place, f"is on another page of {layout.name!r} than other signals of this order"
            )
        frame = signal.insert(self.frames[layout.name], bits)
        covers = signal.covers
        selector = signal.selector
        if selector is not None and layout.name not in self._page:
            self._page[layout.name] = signal
            if not self.covered(layout) & selector.covers:
                frame = selector.insert(frame, signal.pages[0])
                covers |= selector.covers
        self.frames[layout.name] = frame
        self._covered[layout.name] = self.covered(layout) | covers

    def wrong_pages(self) -> Iterator[tuple[str, str, str]]:
        """Yield message, selector and reason where an order sets a selector to a page other than
        that of its signals.
        """
        for message, signal in self._page.items():
            selector = signal.selector
            if selector is None:
                continue
            shown = selector.bits(self.frames[message])
            if shown not in signal.pages:
                yield (
                    message,
                    selector.name,
                    f"is {shown}, but signal {signal.name!r} is on page "
                    f"{' or '.join(map(str, signal.pages))}",
                )


def _quiet(layouts: Mapping[str, Layout], name: str) -> tuple[Layout, Signal] | None:
    """Look up ``Message.Signal`` without a report, because an unknown name has been reported
    before.
    """
    message, _, part = name.partition(".")
    layout = layouts.get(message)
    if layout is None or layout.obstacle or part not in layout.signals:
        return None
    return layout, layout.signals[part]


def stop_image(spec: DbcMap, names: Names) -> tuple[Layout, bytes] | None:
    """Return message and data of the stop frame; ``names`` collects the problems."""
    stop = spec.stop_frame
    layout = names.layout(("stop_frame", "message"), stop.message)
    if layout is None:
        return None
    images = _Images(names)
    images.begin(layout)
    for name, value in stop.signals.items():
        place: Place = ("stop_frame", "signals", name)
        signal = names.part(place, layout, name)
        if signal is not None:
            _require_free(spec, names, place, layout, signal)
            images.put(place, layout, signal, value)
    for _, selector, reason in images.wrong_pages():
        names.report(("stop_frame", "signals", selector), reason)
    return layout, images.frames[layout.name]
