"""Checks a signal map against a DBC file and resolves its names to bit positions in CAN frames.

All problems of a map are reported together.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
_NOT_SAMPLED: Final = frozenset({"fault_code", "serial_number", "revision"})
_Find = Callable[[Place, str], tuple[str, Signal] | None]
_Value = tuple[Place, Layout, Signal, str | int | float]
"""Value of an order: its place in the map, message, signal, and label or number."""


def bind(spec: DbcMap, layouts: Mapping[str, Layout]) -> Wiring:
    """Bind a map to the messages of a DBC.

    Raises:
        DbcMapError: The map has unknown names (the message states the most similar known names),
            values that do not fit into their signals, or missing entries.
    """
    return _Binder(spec, layouts).bind()


class _Binder:
    """Binds a map part by part; ``names`` collects the problems."""

    def __init__(self, spec: DbcMap, layouts: Mapping[str, Layout]) -> None:
        self._spec = spec
        self._layouts = layouts
        self._names = Names(layouts)
        self._received: set[str] = set()
        self._pages: dict[str, BoundPage] = {}
        self._settings: set[str] = set()
        self._filled: list[tuple[Layout, Signal]] = []  # signals written in every cycle

    def bind(self) -> Wiring:
        spec, names = self._spec, self._names
        inputs = self._inputs()
        status = self._heard(("status", "signal"), spec.status.signal)
        states = self._states(status[1]) if status else {}
        written = {"target": spec.target, "torque_offset": spec.torque_offset}
        targets = {
            key: None if quantity is None else self._quantity((key,), quantity, self._written)
            for key, quantity in written.items()
        }
        target, offset = targets["target"], targets["torque_offset"]
        self._check_offset(target, offset)
        values = {place: list(self._values(place, found)) for place, found in self._order_places()}
        named = {layout.name for found in values.values() for _, layout, _, _ in found}
        cyclic = {layout.name for layout, _ in self._filled} | {
            name
            for name in named
            if name in spec.messages and spec.messages[name].period_ms is not None
        }
        orders = {place: self._order(place, found, cyclic) for place, found in values.items()}
        stop = names.layout(("stop_frame", "message"), spec.stop_frame.message)
        stop_image = b"" if stop is None else self._stop_image(stop)
        limits = self._limits()
        once, stops = named - cyclic, {stop.name} if stop else set()
        received, sent, alone, settings, stop_messages = (
            {name: self._message(self._layouts[name]) for name in sorted(some)}
            for some in (self._received, cyclic, once, self._settings, stops)
        )
        self._check_whole(named | cyclic, stops)
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
            torque_offset=offset,
            disable=orders["orders", "disable"],
            stop=orders["orders", "stop"],
            reset=orders["orders", "reset"],
            enable={STATES[n]: orders["orders", "enable", n] for n in spec.orders.enable},
            stop_message=stop_messages[stop.name],
            stop_image=stop_image,
        )

    def _order_places(self) -> list[tuple[Place, Assignments]]:
        """Return the place in the map and the values of each order."""
        orders = self._spec.orders
        return [
            (("orders", "disable"), orders.disable),
            (("orders", "stop"), orders.stop),
            (("orders", "reset"), orders.reset),
            *((("orders", "enable", state), values) for state, values in orders.enable.items()),
        ]

    def _values(self, place: Place, values: Assignments) -> Iterator[_Value]:
        for name, value in values.items():
            if (found := self._names.signal((*place, name), name)) is not None:
                yield (*place, name), *found, value

    def _order(self, place: Place, values: Sequence[_Value], cyclic: Iterable[str]) -> Order:
        """Return the frames of an order, and whether it replaces the program's target."""
        report = self._names.report
        frames = {name: bytes(self._layouts[name].size) for name in cyclic}
        covered = self._fill(place, values, frames)
        own_target = False
        for number, (layout, signal) in enumerate(self._filled):
            set_bits = covered.get(layout.name, 0)
            shared = set_bits & signal.covers
            if number == 0 and (shared or _other_page(signal, frames[layout.name], set_bits)):
                own_target = True
                if place == _KEEPS_RUNNING:
                    report(
                        place,
                        f"sets the target {layout.name}.{signal.name} or another page of its "
                        "message, so that a running drive would never receive a target: remove "
                        "this value",
                    )
            elif number and shared and not own_target:
                report(
                    place,
                    f"sets {layout.name}.{signal.name}, which the program writes in every cycle: "
                    "remove this value",
                )
        return Order(frames, own_target)

    def _stop_image(self, layout: Layout) -> bytes:
        """Return the data of the stop frame."""
        place: Place = ("stop_frame", "signals")
        values: list[_Value] = [
            ((*place, name), layout, signal, value)
            for name, value in self._spec.stop_frame.signals.items()
            if (signal := self._names.part((*place, name), layout, name)) is not None
        ]
        frames = {layout.name: bytes(layout.size)}
        self._fill(place, values, frames)
        return frames[layout.name]

    def _fill(
        self, place: Place, values: Sequence[_Value], frames: dict[str, bytes]
    ) -> Mapping[str, int]:
        """Put values and page selectors into frames; return the set bits of each message."""
        names, covered, paged = self._names, dict.fromkeys(frames, 0), dict[str, Signal]()
        for at, layout, signal, value in values:
            self._require_free(at, layout, signal)
            bits = names.bits(at, signal, value)
            if bits is None:
                continue
            name, selector = layout.name, signal.selector
            frame, before = frames.setdefault(name, bytes(layout.size)), covered.get(name, 0)
            if _other_page(signal, frame, before):
                names.report(at, f"is on another page of {name!r} than other signals of this order")
            frame, covers = signal.insert(frame, bits), signal.covers
            if selector is not None and name not in paged:
                paged[name] = signal
                if not before & selector.covers:
                    frame = selector.insert(frame, signal.pages[0])
                    covers |= selector.covers
            frames[name], covered[name] = frame, before | covers
        for name, signal in paged.items():
            selector = signal.selector
            assert selector is not None
            shown = selector.bits(frames[name])
            if shown not in signal.pages:
                names.report(
                    (*place, f"{name}.{selector.name}"),
                    f"is {shown}, but signal {signal.name!r} is on page "
                    f"{' or '.join(map(str, signal.pages))}",
                )
        return covered

    def _require_free(self, place: Place, layout: Layout, signal: Signal) -> None:
        """Report an order that sets a counter or a checksum, because the program computes both."""
        guard = self._spec.messages.get(layout.name, Protection())
        for role, filled in (("counter", guard.counter), ("checksum", guard.checksum)):
            other = layout.signals.get(filled or "")
            if other is not None and other.covers & signal.covers:
                self._names.report(
                    place,
                    f"overlaps the {role} of message {layout.name!r}, which the program computes: "
                    "remove this value",
                )

    def _check_offset(self, target: BoundQuantity | None, offset: BoundQuantity | None) -> None:
        """Report a torque offset that cannot be zero or cannot be sent with the target."""
        if offset is None:
            return
        try:
            offset.bits(0.0)
        except ValueError as error:
            self._names.report(("torque_offset",), f"cannot be zero: {error}")
        if target is None or target.message != offset.message:
            return
        one, other = target.signal, offset.signal
        apart = one.pages and other.pages and not set(one.pages) & set(other.pages)
        if one.covers & other.covers or apart:
            self._names.report(
                ("torque_offset", "signal"),
                "its signal has bits in common with the target, or is on another page than the "
                "target; use another signal",
            )

    def _inputs(self) -> dict[str, BoundQuantity]:
        bound: dict[str, BoundQuantity] = {}
        for item in dataclasses.fields(self._spec.inputs):
            quantity: Quantity | None = getattr(self._spec.inputs, item.name)
            place: Place = ("inputs", item.name)
            if quantity is None or (found := self._quantity(place, quantity, self._heard)) is None:
                continue
            bound[item.name] = found
            if item.name in _NOT_SAMPLED:
                self._names.require_whole((*place, "signal"), found.signal)
        return bound

    def _limits(self) -> dict[str, BoundLimit]:
        bound: dict[str, BoundLimit] = {}
        for item in dataclasses.fields(self._spec.limits):
            signals: LimitSignals | None = getattr(self._spec.limits, item.name)
            if signals is None:
                continue
            place: Place = ("limits", item.name)
            written = self._quantity((*place, "set"), signals.set, self._set)
            held = None
            if signals.held is not None:
                held = self._quantity((*place, "held"), signals.held, self._heard)
            if written is not None and (held is not None or signals.held is None):
                bound[item.name] = BoundLimit(written, held)
        return bound

    def _quantity(self, place: Place, quantity: Quantity, find: _Find) -> BoundQuantity | None:
        found = find((*place, "signal"), quantity.signal)
        if found is None:
            return None
        key, signal = found
        if quantity.wraps_after is not None and place not in (("inputs", "position"), ("target",)):
            self._names.report(
                (*place, "wraps_after"), "is allowed for position and target only; remove it"
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
        if found is None:
            return None
        self._filled.append(found)
        return found[0].name, found[1]

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
        needed = [ServoState.SWITCH_ON_DISABLED, ServoState.OPERATION_ENABLED]
        if not self._spec.inputs.fault_code:  # a fault may be reported by the fault code alone
            needed.append(ServoState.FAULT)
        for word, state in STATES.items():
            if state in needed and state not in states.values():
                names.report(("status", "states"), f"no value is stated for {word!r}; state one")
        return states

    def _message(self, layout: Layout) -> BoundMessage:
        name = layout.name
        guard = self._spec.messages.get(name, Protection())
        counter = self._guard(layout, "counter", guard.counter)
        checksum = self._guard(layout, "checksum", guard.checksum)
        period_ms, last, place = guard.period_ms, guard.counter_last, ("messages", name)
        if last is not None and counter is None:
            self._names.report(
                (*place, "counter_last"),
                "states the last value of a counter, but the message has no counter",
            )
        elif last is not None and counter is not None and not 1 <= last <= counter.mask:
            self._names.report(
                (*place, "counter_last"),
                f"{last} is outside 1 to {counter.mask}, the range of {counter.name!r}",
            )
        left_out = guard.own_byte == "left out"
        if checksum is None and (guard.prefix or left_out):
            self._names.report(
                place, "states how a checksum is computed, but the message has no checksum"
            )
        if checksum is not None and left_out:
            whole = {0xFF << 8 * at for at in range(checksum.size)}
            if checksum.covers not in whole:
                self._names.report(
                    (*place, "own_byte"), f"signal {checksum.name!r} is not a whole byte"
                )
        return BoundMessage(
            name=name,
            identifier=layout.identifier,
            size=layout.size,
            counter=counter,
            turn=0 if counter is None else (counter.mask if last is None else last) + 1,
            checksum=checksum,
            algorithm=sum
            if checksum is None
            else checksum_of(guard.algorithm, checksum, bytes(guard.prefix), left_out=left_out),
            period_s=(layout.period_s or 0.0) if period_ms is None else period_ms * 1e-3,
            remote=guard.remote,
        )

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

    def _check_whole(self, sent: set[str], stop: set[str]) -> None:
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


def _other_page(signal: Signal, frame: bytes, set_bits: int) -> bool:
    """Return whether an order has selected a page of its message that does not contain a signal."""
    selector = signal.selector
    if selector is None or not set_bits & selector.covers:
        return False
    return selector.bits(frame) not in signal.pages
