"""Random signal maps, refused with their places or held against file and map bit by bit."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from random import Random

from drivers.dbc.bind import bind
from drivers.dbc.channel import DbcChannel
from drivers.dbc.codec import Order, Wiring
from drivers.dbc.file import DbcMapError, read_dbc
from drivers.dbc.map import (
    STATES,
    Assignments,
    DbcMap,
    Inputs,
    LimitMap,
    LimitSignals,
    Orders,
    Quantity,
    Status,
    StopFrame,
)
from drivers.interfaces import ServoState

from .dbc_shapes import Field, Frame, drawn_frame, drawn_frames, write


@dataclass(frozen=True)
class Place:
    """A signal of a message, with the name that maps give it."""

    frame: Frame
    part: Field

    def __str__(self) -> str:
        return f"{self.frame.name}.{self.part.name}"


def drawn_quantity(rng: Random, places: Mapping[str, Place]) -> Quantity:
    """Draw a quantity in one of the signals; some have a name that the file lacks."""
    name = rng.choice(sorted(places)) if rng.random() < 0.97 else "Reply.Nothing"
    return Quantity(
        name,
        scale=rng.choice((1.0, 0.1, 2 * math.pi, 1e-3)),
        sign=rng.choice((1, 1, -1)),
        offset=rng.choice((0.0, 0.0, 1.5)),
    )


def drawn_order(rng: Random, places: Mapping[str, Place]) -> Assignments:
    """Draw the values of an order: labels and numbers, some of which do not fit."""
    found: dict[str, str | int | float] = {}
    for name in rng.sample(sorted(places), min(len(places), rng.randint(1, 3))):
        part = places[name].part
        if part.real:
            found[name] = rng.choice((0.5, -3.25, 0.0))
        elif part.labels and rng.random() < 0.5:
            found[name] = rng.choice(list(part.labels.values()))
        else:
            low, high = part.ends()
            found[name] = rng.choice((low, high, rng.randint(low, high)))
            if rng.random() < 0.02:
                found[name] = rng.choice((high + 1, 0.5, "NOTHING"))
    return found


def drawn_map(rng: Random, heard: Mapping[str, Place], told: Mapping[str, Place]) -> DbcMap:
    """Draw a map whose inputs are in some messages and whose orders are in others."""
    whole = [name for name, at in heard.items() if not at.part.real and at.part.width > 1]
    state = rng.choice(whole or sorted(heard))
    low, high = heard[state].part.ends()
    values = rng.sample(range(max(low, -8), min(high, 15) + 1), min(3, high - low + 1))
    frame = rng.choice([at.frame for at in told.values()])
    inside = {str(at): at for at in told.values() if at.frame is frame}
    stop = {name.partition(".")[2]: value for name, value in drawn_order(rng, inside).items()}
    limit = LimitSignals(drawn_quantity(rng, told)) if rng.random() < 0.1 else None
    target = drawn_quantity(rng, told)
    apart = {name: at for name, at in told.items() if name != target.signal}
    running = drawn_order(rng, apart) if apart and rng.random() < 0.5 else {}
    return DbcMap(
        inputs=Inputs(
            position=drawn_quantity(rng, heard),
            velocity=drawn_quantity(rng, heard),
            current=drawn_quantity(rng, heard),
        ),
        status=Status(
            state, dict(zip(("disabled", "running", "fault"), ((v,) for v in values), strict=False))
        ),
        target=target,
        orders=Orders(
            disable=drawn_order(rng, told),
            stop=drawn_order(rng, told),
            reset=drawn_order(rng, told),
            enable={"disabled": drawn_order(rng, told), "running": running},
        ),
        stop_frame=StopFrame(frame.name, stop),
        limits=LimitMap(speed=limit),
    )


def require_frames(
    images: Mapping[str, bytes], values: Assignments, places: Mapping[str, Place]
) -> None:
    """Hold the frames of an order against the values that the map orders."""
    allowed: dict[str, set[int]] = {}
    for name, value in values.items():
        frame, part = places[name].frame, places[name].part
        if isinstance(value, str):
            value = next(raw for raw, label in part.labels.items() if label == value)
        found = part.raw(images[frame.name])
        assert found == value, f"{name} is ordered as {found} instead of {value}"
        allowed.setdefault(frame.name, set()).update(part.bits())
        if part.page is not None:
            selector = frame.selector()
            assert selector.raw(images[frame.name]) == part.page, f"{name} is on another page"
            allowed[frame.name].update(selector.bits())
    for message, data in images.items():
        bits = {n for n in range(8 * len(data)) if data[n // 8] >> n % 8 & 1}
        assert bits <= allowed.get(message, set()), f"{message}: {data.hex()} of {values}"


def require_inputs(rng: Random, spec: DbcMap, wiring: Wiring, places: Mapping[str, Place]) -> None:
    """Hold the inputs of a random frame against the file's and the map's units."""
    for name, bound in wiring.inputs.items():
        quantity: Quantity = getattr(spec.inputs, name)
        at = places[quantity.signal]
        data = rng.randbytes(at.frame.size)
        stated = at.part.raw(data) * float(at.part.factor) + float(at.part.offset)
        true = quantity.sign * (quantity.scale * stated + quantity.offset)
        size = abs(at.part.raw(data) * float(at.part.factor)) + abs(float(at.part.offset)) + 2
        found = bound.read(data)
        same = math.isclose(found, true, rel_tol=1e-12, abs_tol=1e-12 * size * quantity.scale)
        assert same or not math.isfinite(true), f"{name}: {found} is not {true}"
    for values, state in spec.status.states.items():
        for value in state:
            assert wiring.states[value] is STATES[values], f"{value} is not {values}"


def require_target(rng: Random, spec: DbcMap, wiring: Wiring, at: Place) -> None:
    """Hold the target in a frame to a running drive against the target that was asked for."""
    part, quantity = at.part, spec.target
    asked = rng.uniform(-8.0, 8.0) if part.real else float(rng.randint(*part.ends()))
    stated = asked * float(part.factor) + float(part.offset)
    channel = DbcChannel(wiring, "the drive")
    channel.order(wiring.enable[ServoState.OPERATION_ENABLED], hold=True)
    channel.aim(wiring.target.bits(quantity.sign * (quantity.scale * stated + quantity.offset)))
    frame = dict(channel.frames(all_now=True))[at.frame.identifier]
    found, selector = part.raw(frame), at.frame.selector()
    # Offsets in SI take digits of a raw value that is beyond them by a factor of 1e10.
    assert math.isclose(found, asked, rel_tol=1e-6, abs_tol=1e-3), f"{found} is not {asked}"
    if part.page is not None:
        assert selector.raw(frame) == part.page, "the target is on another page"


def any_map(rng: Random, path: Path) -> bool:
    """Bind a random map to a file of known messages; whether they fit."""
    frames = [frame for frame in drawn_frames(rng) if frame.fields]
    if len(frames) < 2:
        frames += [drawn_frame(rng, f"Other{n}", n) for n in (0x7FE, 0x7FF)]
    write(rng, path, frames)
    half = rng.randint(1, len(frames) - 1)
    heard, told = (
        {f"{frame.name}.{part.name}": Place(frame, part) for frame in some for part in frame.fields}
        for some in (frames[:half], frames[half:])
    )
    spec = drawn_map(rng, heard, told)
    try:
        wiring = bind(spec, read_dbc(path))
    except DbcMapError as refused:
        if all(place and text for place, text in refused.problems):
            return False
        raise
    require_inputs(rng, spec, wiring, heard)
    orders: list[tuple[Order, Assignments]] = [
        (wiring.disable, spec.orders.disable),
        (wiring.stop, spec.orders.stop),
        (wiring.reset, spec.orders.reset),
        *((wiring.enable[STATES[name]], spec.orders.enable[name]) for name in spec.orders.enable),
    ]
    for order, values in orders:
        require_frames(order.frames, values, told)
    stop = {f"{spec.stop_frame.message}.{name}": v for name, v in spec.stop_frame.signals.items()}
    require_frames({spec.stop_frame.message: wiring.stop_image}, stop, told)
    target = told[spec.target.signal]
    if target.part.width <= 32:
        require_target(rng, spec, wiring, target)
    return True


TEXTS: Mapping[str, Callable[[Random, Path], bool]] = {"DBC map": any_map}
"""Kind of text to its property: draws a file and a map, and binds them; whether they fit."""
