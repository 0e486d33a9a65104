"""Binds a map to a DBC: resolves all names, reports all problems at once, prepares all layouts."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Iterable, Mapping
from typing import Final

from drivers.dbc.codec import CHECKSUMS, Signal
from drivers.dbc.file import Layout
from drivers.dbc.map import STATES, Assignments, DbcMap, LimitSignals, Protection, Quantity
from drivers.dbc.wiring import BoundLimit, BoundMessage, BoundQuantity, Wiring
from drivers.interfaces import ServoState

Place = tuple[str | int, ...]
"""Path of keys from the top of the map to the faulty value."""
Problem = tuple[Place, str]
_NOT_SAMPLED: Final = frozenset({"fault_code", "serial_number", "revision"})


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


def bind(spec: DbcMap, layouts: Mapping[str, Layout]) -> Wiring:
    """Bind a map to the messages of a DBC.

    Raises:
        DbcMapError: Unknown names, with the nearest known ones; values that do not fit; missing
            entries.
    """
    return _Binder(spec, layouts).bind()


class _Binder:
    """Collects problems, so that all are reported at once."""

    def __init__(self, spec: DbcMap, layouts: Mapping[str, Layout]) -> None:
        self._spec = spec
        self._layouts = layouts
        self._problems: list[Problem] = []
        self._received: set[str] = set()
        self._sent: set[str] = set()
        self._settings: set[str] = set()

    def bind(self) -> Wiring:
        spec = self._spec
        inputs = self._inputs()
        status = self._signal(("status", "signal"), spec.status.signal, self._received)
        states = self._states(status[1]) if status else {}
        target = self._quantity(("target",), spec.target, self._sent)
        orders = spec.orders
        enable = {STATES[name]: values for name, values in orders.enable.items()}
        wanted = {"disable": orders.disable, "stop": orders.stop, "reset": orders.reset}
        for place, values in self._order_places():
            for name in values:
                self._signal((*place, name), name, self._sent)
        images = {name: self._images(("orders", name), values) for name, values in wanted.items()}
        steps = {
            state: self._images(("orders", "enable", name), values)
            for (state, values), name in zip(enable.items(), orders.enable, strict=True)
        }
        stop_frame = self._stop_frame()
        limits = self._limits()
        received, sent, settings = map(self._messages, (self._received, self._sent, self._settings))
        self._check_whole()
        if self._problems or target is None or status is None or stop_frame is None:
            raise DbcMapError(dict.fromkeys(self._problems))
        return Wiring(
            received=received,
            sampled=frozenset(q.message for name, q in inputs.items() if name not in _NOT_SAMPLED)
            | {status[0].name},
            sent=sent,
            settings=settings,
            inputs=inputs,
            limits=limits,
            status_message=status[0].name,
            status=status[1],
            states=states,
            target=target,
            **images,
            enable=steps,
            stop_frame=stop_frame,
        )

    def _inputs(self) -> dict[str, BoundQuantity]:
        bound: dict[str, BoundQuantity] = {}
        for item in dataclasses.fields(self._spec.inputs):
            quantity: Quantity | None = getattr(self._spec.inputs, item.name)
            if quantity is None:
                continue
            found = self._quantity(("inputs", item.name), quantity, self._received)
            if found is not None:
                bound[item.name] = found
                if item.name in _NOT_SAMPLED:
                    self._require_whole(("inputs", item.name, "signal"), found.signal)
        return bound

    def _require_whole(self, place: Place, signal: Signal) -> None:
        if signal.real:
            self._problems.append(
                (place, f"signal {signal.name!r} is floating-point; use one of whole numbers")
            )

    def _limits(self) -> dict[str, BoundLimit]:
        bound: dict[str, BoundLimit] = {}
        for item in dataclasses.fields(self._spec.limits):
            signals: LimitSignals | None = getattr(self._spec.limits, item.name)
            if signals is None:
                continue
            written = self._quantity(("limits", item.name, "set"), signals.set, self._settings)
            held = self._quantity(("limits", item.name, "held"), signals.held, self._received)
            if written is not None and held is not None:
                bound[item.name] = BoundLimit(written, held)
        return bound

    def _order_places(self) -> list[tuple[Place, Assignments]]:
        orders = self._spec.orders
        return [
            (("orders", "disable"), orders.disable),
            (("orders", "stop"), orders.stop),
            (("orders", "reset"), orders.reset),
            *((("orders", "enable", state), values) for state, values in orders.enable.items()),
        ]

    def _quantity(self, place: Place, quantity: Quantity, used: set[str]) -> BoundQuantity | None:
        if not (math.isfinite(quantity.scale) and quantity.scale > 0):
            self._problems.append(
                ((*place, "scale"), f"must be more than zero, not {quantity.scale:g}; use sign")
            )
            return None
        found = self._signal((*place, "signal"), quantity.signal, used)
        if found is None:
            return None
        layout, signal = found
        gain = quantity.sign * quantity.scale * signal.factor
        bias = quantity.sign * (quantity.scale * signal.offset + quantity.offset)
        return BoundQuantity(layout.name, signal, gain, bias)

    def _signal(self, place: Place, name: str, used: set[str]) -> tuple[Layout, Signal] | None:
        message, dot, signal = name.partition(".")
        if not dot:
            self._problems.append((place, f"{name!r} must be written Message.Signal"))
            return None
        layout = self._layout(place, message)
        if layout is None:
            return None
        if signal not in layout.signals:
            text = (
                f"message {message!r} has no signal {signal!r}; {nearest(signal, layout.signals)}"
            )
            self._problems.append((place, text))
            return None
        used.add(message)
        return layout, layout.signals[signal]

    def _layout(self, place: Place, message: str) -> Layout | None:
        layout = self._layouts.get(message)
        if layout is None:
            self._problems.append(
                (place, f"the DBC has no message {message!r}; {nearest(message, self._layouts)}")
            )
        elif layout.obstacle:
            self._problems.append((place, f"message {message!r} {layout.obstacle}"))
            return None
        return layout

    def _states(self, signal: Signal) -> dict[float, ServoState]:
        self._require_whole(("status", "signal"), signal)
        states: dict[float, ServoState] = {}
        for name, values in self._spec.status.states.items():
            for number, value in enumerate(values):
                place = ("status", "states", name, number)
                raw = self._raw(place, signal, value)
                if raw is not None and states.setdefault(raw, STATES[name]) is not STATES[name]:
                    self._problems.append(
                        (place, f"value {value!r} already means another state; name it once")
                    )
        for needed in (
            ServoState.SWITCH_ON_DISABLED,
            ServoState.OPERATION_ENABLED,
            ServoState.FAULT,
        ):
            if needed not in states.values():
                word = next(word for word, state in STATES.items() if state is needed)
                self._problems.append((("status", "states"), f"no value means {word!r}; name one"))
        return states

    def _raw(self, place: Place, signal: Signal, value: str | int) -> int | None:
        """Return the raw value of a label, or the number itself if it fits."""
        if isinstance(value, str):
            raw = next((raw for raw, label in signal.labels.items() if label == value), None)
            if raw is None:
                known = signal.labels.values()
                self._problems.append(
                    (
                        place,
                        f"signal {signal.name!r} has no value {value!r}; {nearest(value, known)}",
                    )
                )
            return raw
        if signal.real:
            self._problems.append(
                (place, f"signal {signal.name!r} is floating-point; use one of whole numbers")
            )
            return None
        low, high = signal.range
        if low <= value <= high:
            return value
        self._problems.append(
            (place, f"{value} is outside {low} to {high}, what {signal.name!r} can hold")
        )
        return None

    def _images(self, place: Place, values: Assignments) -> dict[str, bytes]:
        """Return the frames of an order: all messages used by any order, with the given values."""
        images = {name: bytes(self._layouts[name].size) for name in self._sent}
        for name, value in values.items():
            message, _, signal_name = name.partition(".")
            layout = self._layouts.get(message)
            signal = layout.signals.get(signal_name) if layout is not None else None
            if signal is None or message not in images:
                continue
            raw = self._raw((*place, name), signal, value)
            if raw is not None:
                images[message] = signal.insert(images[message], raw & signal.mask)
        return images

    def _stop_frame(self) -> tuple[int, bytes] | None:
        stop = self._spec.stop_frame
        layout = self._layout(("stop_frame", "message"), stop.message)
        if layout is None:
            return None
        data = bytes(layout.size)
        for name, value in stop.signals.items():
            place = ("stop_frame", "signals", name)
            signal = layout.signals.get(name)
            if signal is None:
                text = (
                    f"message {stop.message!r} has no signal {name!r}; "
                    f"{nearest(name, layout.signals)}"
                )
                self._problems.append((place, text))
                continue
            raw = self._raw(place, signal, value)
            if raw is not None:
                data = signal.insert(data, raw & signal.mask)
        return layout.identifier, data

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
                counter=self._guard(layout, "counter", guard.counter),
                checksum=self._guard(layout, "checksum", guard.checksum),
                algorithm=CHECKSUMS[guard.algorithm],
                period_s=(layout.period_s or 0.0) if period_ms is None else period_ms * 1e-3,
            )
        return bound

    def _guard(self, layout: Layout, role: str, name: str | None) -> Signal | None:
        if name is None:
            return None
        place = ("messages", layout.name, role)
        signal = layout.signals.get(name)
        if signal is None:
            text = (
                f"message {layout.name!r} has no signal {name!r}; {nearest(name, layout.signals)}"
            )
            self._problems.append((place, text))
        elif role == "checksum" and signal.width != 8:
            self._problems.append(
                (place, f"signal {name!r} has {signal.width} bits; a checksum has 8")
            )
        return signal

    def _check_whole(self) -> None:
        spec = self._spec
        if (spec.inputs.current is None) == (spec.inputs.torque is None):
            self._problems.append((("inputs",), "give one of current and torque"))
        if "disabled" not in spec.orders.enable:
            self._problems.append(
                (("orders", "enable"), "has no order for a drive that is 'disabled'; add one")
            )
        if "running" not in spec.orders.enable:
            self._problems.append(
                (("orders", "enable"), "has no order that keeps a 'running' drive running; add one")
            )
        for name, guard in spec.messages.items():
            place: Place = ("messages", name)
            used = self._received | self._sent | self._settings
            if self._layout(place, name) is not None and name not in used:
                self._problems.append(
                    (place, f"message {name!r} carries nothing in this map; remove it")
                )
            if guard.period_ms is not None and guard.period_ms < 0:
                self._problems.append(((*place, "period_ms"), "must be zero or more"))
        both = self._received & (self._sent | self._settings) | self._sent & self._settings
        if both:
            self._problems.append(
                (
                    ("inputs",),
                    f"message {min(both)!r} has two uses (input, command or setting); it may have "
                    f"one",
                )
            )


def nearest(name: str, known: Iterable[str]) -> str:
    """Suggest the names closest to a mistyped one, or list them all."""
    names = sorted(known)
    close = [k for k in names if k.casefold() == name.casefold()] or difflib.get_close_matches(
        name, names, n=3
    )
    if close:
        return f"did you mean {' or '.join(repr(k) for k in close)}?"
    return f"known are {', '.join(names)}" if names else "none is known"
