"""Checks of a CiA 402 drive before its servo is used: objects, units and cycle."""

from __future__ import annotations

from collections.abc import Iterator

from drivers import servo_limits
from drivers.canopen import cia402_objects as objects
from drivers.errors import ConfigurationError, DeviceError
from drivers.objects import VENDOR, ProcessChannel, refusal
from drivers.units import ServoScales


def description_refusals(
    channel: ProcessChannel, scales: ServoScales, torque_offset: bool
) -> Iterator[DeviceError]:
    """Yield the objects that the servo needs and the EDS lacks. Sends nothing."""
    for address in (VENDOR, *objects.SINGLE, *servo_limits.OBJECTS):
        yield from refusal(channel.require_fit, *address, 0)
    yield from refusal(channel.require_mappable, *objects.layouts(scales, torque_offset))


def refusals(
    channel: ProcessChannel, scales: ServoScales, torque_offset: bool, cycle_s: float
) -> Iterator[DeviceError]:
    """Yield units that differ from the bench file, a cycle that cannot be set, and missing
    objects.
    """
    yield from unit_refusals(channel, scales, torque_offset, cycle_s)
    outputs, inputs = objects.layouts(scales, torque_offset)
    unmappable = list(refusal(channel.require_mappable, outputs, inputs))
    yield from unmappable
    if not unmappable:
        for layout in inputs:
            for address in layout.objects:
                yield from refusal(channel.read, *address)


def unit_refusals(
    channel: ProcessChannel, scales: ServoScales, torque_offset: bool, cycle_s: float
) -> Iterator[DeviceError]:
    """Yield refusals that mapping the process data does not detect."""
    yield from scales.mismatches(channel)
    milliseconds = round(cycle_s * 1e3)
    if milliseconds < 1 or abs(milliseconds * 1e-3 - cycle_s) > 1e-9:
        yield ConfigurationError(
            f"cycle is {cycle_s * 1e3:g} ms, must be whole milliseconds (60C2h)"
        )
    if torque_offset:
        yield from _offset_refusals(channel)


def _offset_refusals(channel: ProcessChannel) -> Iterator[ConfigurationError]:
    for error in refusal(channel.read, *objects.TORQUE_OFFSET):
        words = f"{channel.label} has no torque offset 60B2h ({error}): run without feed-forward"
        offset_error = ConfigurationError(words)
        offset_error.__cause__ = error
        yield offset_error
