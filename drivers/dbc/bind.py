"""Checks a signal map against a DBC file and resolves its names to bit positions in CAN frames.

All problems of a map are reported together.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Final

from drivers.dbc.codec import (
    BoundLimit,
    BoundMessage,
    BoundPage,
    BoundQuantity,
    Order,
    Signal,
    Wiring,
    checksum_of,
)
from drivers.dbc.file import DbcMapError, Layout, Names, Place
from drivers.dbc.map import STATES, Assignments, DbcMap, LimitSignals, Protection, Quantity
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


_Find = Callable[[Place, str], tuple[str, Signal] | None]
_NOT_SAMPLED: Final = frozenset({"fault_code", "serial_number", "revision"})


def bind(spec: DbcMap, layouts: Mapping[str, Layout]) -> Wiring:
    """Bind a map to the messages of a DBC.

    Raises:
        DbcMapError: The map has unknown names (the message states the most similar known names),
            values that do not fit into their signals, or missing entries.
    """
    return _Binder(spec, layouts).bind()


class _Binder:
    """Binds a map part by part, and collects the problems, so that all problems are reported
    together.
    """

    def __init__(self, spec: DbcMap, layouts: Mapping[str, Layout]) -> None:
        self._spec = spec
        self._layouts = layouts
        self._names = Names(layouts)
        self._received: set[str] = set()
        self._pages: dict[str, BoundPage] = {}
        self._settings: set[str] = set()

    def bind(self) -> Wiring:
        spec, names = self._spec, self._names
        inputs = self._inputs()
        status = self._heard(("status", "signal"), spec.status.signal)
        states = self._states(status[1]) if status else {}
        written = [quantity for quantity in (spec.target, spec.torque_offset) if quantity]
        targets = [
            self._quantity((key,), quantity, self._written)
            for key, quantity in zip(("target", "torque_offset"), written, strict=False)
        ]
        self._check_offset(targets)
        orders = bind_orders(spec, names, [quantity.signal for quantity in written])
        stop = stop_image(spec, names)
        limits = self._limits()
        cyclic, once = orders.cyclic, orders.once
        received, sent, alone, settings, stops = (
            self._messages(some)
            for some in (
                self._received, cyclic, once, self._settings, {stop[0].name} if stop else ()
            )
        )  # fmt: skip
        self._check_whole(cyclic | once, {stop[0].name} if stop else set())
        target = targets[0]
        if names.problems or target is None or status is None or stop is None:
            raise DbcMapError(dict.fromkeys(names.problems))
        return Wiring(
            received=received,
            pages=self._pages,
            sampled=frozenset(q.message for name, q in inputs.items() if name not in _NOT_SAMPLED)
            | {status[0]},
            sent=sent,
            once=alone,
            settings=settings,
            inputs=inputs,
            limits=limits,
            status_message=status[0],
            status=status[1],
            states=states,
            asked=spec.status.asked,
            target=target,
            torque_offset=targets[1] if len(targets) > 1 else None,
            **orders.orders,
            enable=orders.enable,
            stop_message=stops[stop[0].name],
            stop_image=stop[1],
        )

    def _check_offset(self, targets: Sequence[BoundQuantity | None]) -> None:
        """Report a torque offset whose signal cannot be zero, overlaps the target, or is on another
        page.
        """
        target, offset, *_ = (*targets, None)
        if offset is None:
            return
        try:
            offset.bits(0.0)
        except ValueError as error:
            self._names.report(("torque_offset",), f"cannot be zero: {error}")
        if target is None or target.message != offset.message:
            return
        pages = set(target.signal.pages) & set(offset.signal.pages)
        if target.signal.covers & offset.signal.covers or (
            target.signal.pages and offset.signal.pages and not pages
        ):
            self._names.report(
                ("torque_offset", "signal"),
                "its signal has bits in common with the target, or is on another page than the "
                "target; use another signal",
            )

    def _inputs(self) -> dict[str, BoundQuantity]:
        bound: dict[str, BoundQuantity] = {}
        for item in dataclasses.fields(self._spec.inputs):
            quantity: Quantity | None = getattr(self._spec.inputs, item.name)
            if quantity is None:
                continue
            found = self._quantity(("inputs", item.name), quantity, self._heard)
            if found is not None:
                bound[item.name] = found
                if item.name in _NOT_SAMPLED:
                    self._names.require_whole(("inputs", item.name, "signal"), found.signal)
        return bound

    def _limits(self) -> dict[str, BoundLimit]:
        bound: dict[str, BoundLimit] = {}
        for item in dataclasses.fields(self._spec.limits):
            signals: LimitSignals | None = getattr(self._spec.limits, item.name)
            if signals is None:
                continue
            written = self._quantity(("limits", item.name, "set"), signals.set, self._set)
            held = None
            if signals.held is not None:
                held = self._quantity(("limits", item.name, "held"), signals.held, self._heard)
            if written is not None and (held is not None or signals.held is None):
                bound[item.name] = BoundLimit(written, held)
        return bound

    def _quantity(self, place: Place, quantity: Quantity, find: _Find) -> BoundQuantity | None:
        if not (math.isfinite(quantity.scale) and quantity.scale > 0):
            self._names.report(
                (*place, "scale"),
                f"is {quantity.scale:g}, but must be more than zero; to reverse the direction, "
                "set sign: -1",
            )
            return None
        found = find((*place, "signal"), quantity.signal)
        if found is None:
            return None
        key, signal = found
        if (after := quantity.wraps_after) is not None:
            if place not in (("inputs", "position"), ("target",)):
                self._names.report(
                    (*place, "wraps_after"), "is allowed for position and target only; remove it"
                )
            elif not (math.isfinite(after) and after > 0):
                self._names.report(
                    (*place, "wraps_after"), f"is {after:g}, but must be more than zero"
                )
        gain = quantity.sign * quantity.scale * signal.factor
        bias = quantity.sign * (quantity.scale * signal.offset + quantity.offset)
        if not (gain and math.isfinite(gain) and math.isfinite(1.0 / gain) and math.isfinite(bias)):
            self._names.report(
                (*place, "scale"),
                f"with the factor {signal.factor:g} and offset {signal.offset:g} of signal "
                f"{signal.name!r} in the DBC, one raw unit would be {gain:g} SI units; correct "
                "the scale",
            )
            return None
        return BoundQuantity(key, signal, gain, bias, quantity.wraps_after)

    def _heard(self, place: Place, name: str) -> tuple[str, Signal] | None:
        """Find a signal that the drive sends; return the signal with its message or page."""
        found = self._names.signal(place, name)
        if found is None:
            return None
        layout, signal = found
        self._received.add(layout.name)
        if signal.selector is None:
            return layout.name, signal
        number = signal.pages[0]
        key = f"{layout.name} page {number}"
        pages = {page for other in layout.signals.values() for page in other.pages}
        self._pages[key] = BoundPage(layout.name, signal.selector, number, len(pages))
        return key, signal

    def _written(self, place: Place, name: str) -> tuple[str, Signal] | None:
        """Find a signal that the program writes in every cycle."""
        found = self._names.signal(place, name)
        return None if found is None else (found[0].name, found[1])

    def _set(self, place: Place, name: str) -> tuple[str, Signal] | None:
        """Find a signal with which a limit is written."""
        found = self._names.signal(place, name)
        if found is None:
            return None
        if found[1].selector is not None:
            self._names.report(
                place,
                f"signal {name!r} is on a page of a multiplexed message; use a signal that is in "
                "every frame",
            )
        self._settings.add(found[0].name)
        return found[0].name, found[1]

    def _states(self, signal: Signal) -> dict[float, ServoState]:
        names = self._names
        names.require_whole(("status", "signal"), signal)
        states: dict[float, ServoState] = {}
        for name, values in self._spec.status.states.items():
            for number, value in enumerate(values):
                place = ("status", "states", name, number)
                raw = names.raw(place, signal, value)
                if raw is not None and states.setdefault(raw, STATES[name]) is not STATES[name]:
                    names.report(
                        place, f"value {value!r} is stated for two states; remove it from one state"
                    )
        for needed in self._needed_states():
            if needed not in states.values():
                word = next(word for word, state in STATES.items() if state is needed)
                names.report(("status", "states"), f"no value is stated for {word!r}; state one")
        return states

    def _needed_states(self) -> list[ServoState]:
        """Return the states for which the status signal must have a value; a fault may be reported
        by the fault code alone.
        """
        needed = [ServoState.SWITCH_ON_DISABLED, ServoState.OPERATION_ENABLED]
        return needed if self._spec.inputs.fault_code else [*needed, ServoState.FAULT]

    def _messages(self, names: Iterable[str]) -> dict[str, BoundMessage]:
        bound: dict[str, BoundMessage] = {}
        for name in sorted(names):
            layout = self._layouts[name]
            guard = self._spec.messages.get(name, Protection())
            period_ms = guard.period_ms
            bound[name] = BoundMessage(
                name=name,
                identifier=layout.identifier,
                size=layout.size,
                counter=(counter := self._guard(layout, "counter", guard.counter)),
                turn=self._turn(name, guard, counter),
                checksum=(checksum := self._guard(layout, "checksum", guard.checksum)),
                algorithm=self._algorithm(name, guard, checksum),
                period_s=(layout.period_s or 0.0) if period_ms is None else period_ms * 1e-3,
                remote=guard.remote,
            )
        return bound

    def _turn(self, name: str, guard: Protection, signal: Signal | None) -> int:
        """Return the number of values of a life counter, from 0 to its last value; report a last
        value that is without a counter or out of range.
        """
        last = guard.counter_last
        if signal is None:
            if last is not None:
                self._names.report(
                    ("messages", name, "counter_last"),
                    "states the last value of a counter, but the message has no counter",
                )
            return 0
        if last is None:
            return signal.mask + 1
        if not 1 <= last <= signal.mask:
            self._names.report(
                ("messages", name, "counter_last"),
                f"{last} is outside 1 to {signal.mask}, the range of {signal.name!r}",
            )
        return last + 1

    def _algorithm(
        self, name: str, guard: Protection, signal: Signal | None
    ) -> Callable[[bytes], int]:
        """Return how the checksum of a message is computed."""
        place: Place = ("messages", name, "prefix")
        if signal is None:
            if guard.prefix or guard.own_byte != "zero":
                self._names.report(
                    place[:2], "states how a checksum is computed, but the message has no checksum"
                )
            return sum
        if not all(0 <= byte <= 0xFF for byte in guard.prefix):
            self._names.report(place, f"{list(guard.prefix)} must be numbers from 0 to 255")
            return sum
        left_out = guard.own_byte == "left out"
        if left_out and signal.covers not in {0xFF << 8 * at for at in range(signal.size)}:
            self._names.report(
                (*place[:2], "own_byte"), f"signal {signal.name!r} is not a whole byte"
            )
        return checksum_of(guard.algorithm, signal, bytes(guard.prefix), left_out=left_out)

    def _guard(self, layout: Layout, role: str, name: str | None) -> Signal | None:
        if name is None:
            return None
        place = ("messages", layout.name, role)
        signal = self._names.part(place, layout, name)
        if signal is None:
            return None
        if role == "checksum" and signal.width != 8:
            self._names.report(
                place, f"signal {name!r} has {signal.width} bits; a checksum must have 8"
            )
        for key in ("target", "torque_offset"):
            quantity: Quantity | None = getattr(self._spec, key)
            if quantity is not None and quantity.signal == f"{layout.name}.{name}":
                self._names.report(place, f"signal {name!r} is the {key} of this map")
        return signal

    def _check_whole(self, sent: Set[str], stop: Set[str]) -> None:
        spec, report = self._spec, self._names.report
        if (spec.inputs.current is None) == (spec.inputs.torque is None):
            report(("inputs",), "state either current or torque")
        for state, does in (
            ("disabled", "for the state 'disabled'"),
            ("running", "for the state 'running', with which the drive continues to run"),
        ):
            if state not in spec.orders.enable:
                report(("orders", "enable"), f"has no order {does}; add this order")
        used = self._received | sent | self._settings | stop
        for name, guard in spec.messages.items():
            place: Place = ("messages", name)
            if self._names.layout(place, name) is not None and name not in used:
                report(place, f"message {name!r} contains no signal of this map; remove it")
            if guard.period_ms is not None and guard.period_ms < 0:
                report((*place, "period_ms"), "must be zero or more")
            if guard.remote and name not in self._received:
                report(
                    (*place, "remote"),
                    "is allowed for messages that the drive sends only; remove it",
                )
        numbers: dict[int, str] = {}
        for name in sorted(used):
            first = numbers.setdefault(self._layouts[name].identifier, name)
            if first != name:
                report(
                    ("inputs",), f"messages {first!r} and {name!r} have one identifier in the DBC"
                )
        both = self._received & (sent | self._settings | stop) | (sent | stop) & self._settings
        if both:
            report(
                ("inputs",),
                f"message {min(both)!r} has two uses (input, command or setting), but may have one "
                "only",
            )
