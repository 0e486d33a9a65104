"""Checks a signal map against a DBC file and resolves its names to bit positions in CAN frames.

All problems of a map are reported together.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from typing import Final

from drivers.dbc.codec import Signal, checksum_of
from drivers.dbc.file import Layout
from drivers.dbc.map import STATES, DbcMap, LimitSignals, Protection, Quantity
from drivers.dbc.orders import bind_orders, stop_image
from drivers.dbc.problems import DbcMapError, Names, Place
from drivers.dbc.wiring import BoundLimit, BoundMessage, BoundPage, BoundQuantity, Wiring
from drivers.interfaces import ServoState

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
