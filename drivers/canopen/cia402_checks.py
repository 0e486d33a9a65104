"""Checks a CiA 402 drive before the first motion: objects in its EDS, units and cycle time."""

from __future__ import annotations

from collections.abc import Iterator

from drivers import servo_limits
from drivers.canopen import cia402_mode, velocity_unit
from drivers.canopen import cia402_objects as objects
from drivers.canopen.cia402_objects import Cyclic
from drivers.canopen.motion import TORQUE_OFFSET, Motion, ProfilePosition
from drivers.errors import ConfigurationError, DeviceError
from drivers.lacks import Lacks
from drivers.objects import VENDOR, ObjectAddress, ProcessChannel, access_refusals, refusal
from drivers.units import ServoScales

_ONLY_HOST = "only this program, and not the drive, checks this limit in every cycle"


def description_refusals(
    channel: ProcessChannel, scales: ServoScales, sent: Cyclic, motion: Motion
) -> Iterator[DeviceError]:
    """Yield an error for each object that the servo needs and the EDS lacks, without sending
    anything.
    """
    yield from refusal(channel.require_fit, *VENDOR, 0)
    lacking = False
    for address, purpose in {**objects.NEEDED, **motion.needed}.items():
        for error in refusal(channel.require_fit, *address, 0):
            lacking = True
            yield ConfigurationError(f"{error}; every run needs this object, because {purpose}")
    for address in scales.named_objects:
        for error in refusal(channel.require_fit, *address, 0):
            lacking = True
            yield ConfigurationError(
                f"{error}, although the bench file names this object: correct the bench file"
            )
    if sent.current is None:
        lacking = True
        yield ConfigurationError(
            "the device's EDS has neither the current 6078h nor the torque 6077h as process data; "
            "one of the two is needed to check the limits of current and torque: state the "
            "maker's own object of the current in servo.current_object and its unit in "
            "servo.current_unit_A"
        )
    if not lacking:
        settings = (address for address, _ in objects.settings(channel, 0.0))
        for address in (*held_limits(channel, motion), *settings):
            yield from refusal(channel.require_fit, *address, 0)
        yield from refusal(
            channel.require_mappable, objects.outputs(motion), objects.inputs(sent, channel)
        )


def held_limits(channel: ProcessChannel, motion: Motion) -> tuple[ObjectAddress, ...]:
    """Return the objects of limits that the EDS of the drive has and that the drive obeys in this
    mode, without sending anything.
    """
    return tuple(
        address
        for address in servo_limits.OBJECTS
        if address not in motion.unheld and channel.describes(*address)
    )


def lacks(
    channel: ProcessChannel, scales: ServoScales, sent: Cyclic, motion: Motion, cycle_s: float
) -> Lacks:
    """Return the limits and values that the drive, by its EDS, does not have, without sending
    anything.

    Args:
        channel: The drive.
        scales: Units of the drive.
        sent: The objects that the drive sends in every cycle.
        motion: The mode of operation.
        cycle_s: Control cycle, s.
    """
    held = held_limits(channel, motion)
    missing = {
        field: f"{what} ({_name(address)})"
        for address, (field, what) in servo_limits.FIELDS.items()
        if address not in held
    }
    words = [f"mode {motion.mode}, {motion.words}: {text}" for text in motion.remarks]
    words += [f"no such limit in the drive: {text}; {_ONLY_HOST}" for text in missing.values()]
    words += _replaced(channel, scales, sent, cycle_s)
    if motion.mode == ProfilePosition.mode and not channel.describes(
        *servo_limits.PROFILE_ACCELERATION
    ):
        words.append("no ramps of the profile (6083h, 6084h): set them with the maker's tool")
    return Lacks(frozenset(missing), sent.temperature is None, sent.supply is None, tuple(words))


def _replaced(
    channel: ProcessChannel, scales: ServoScales, sent: Cyclic, cycle_s: float
) -> Iterator[str]:
    """Yield texts on the values that are not monitored, and on the value that replaces each missing
    object.
    """

    def place(address: ObjectAddress | None) -> str:
        if address is None:
            return ""
        single = ", which cannot be process data" if channel.describes(*address) else ""
        return f" ({_name(address)}{single})"

    supply, temperature, voltage = map(
        place, (scales.supply_object, scales.temperature_object, scales.voltage_object)
    )
    for there, text in (
        (sent.supply, f"not monitored: supply voltage{supply}; servo.supply_object names it"),
        (
            sent.temperature,
            f"not monitored: temperature{temperature}; servo.temperature_object names it",
        ),
        (sent.voltage, f"not recorded: motor voltage{voltage}; servo.voltage_object names it"),
        (sent.time, "no time stamp (1013h): samples have the time of the SYNC on this computer"),
        (sent.speed, "no motor speed (606Ch): the speed is computed from the position"),
        (
            sent.current if sent.current in (scales.current_object, objects.CURRENT) else None,
            "no motor current (6078h): the current is computed from the torque (6077h)",
        ),
        *(
            (
                channel.describes(*rated) or None,
                f"not checked: {what} ({_name(rated)}): the drive's values are in thousandths of "
                "this value; read it with the maker's tool",
            )
            for what, rated in (
                ("rated current", scales.rated_current_object),
                ("rated torque", scales.rated_torque_object),
            )
        ),
        (
            channel.describes(*objects.CYCLE) or None,
            f"no interpolation period (60C2h): set the period to {cycle_s * 1e3:g} ms with the "
            f"maker's tool",
        ),
        (
            objects.stops_alone(channel.describes) or None,
            f"{_watchless(channel)}, so that the drive counts as a drive without a watchdog; if "
            "its manual states that the drive takes the power off when it receives nothing from "
            "this program, set servo.stops_alone: true",
        ),
    ):
        if there is None:
            yield text


def _watchless(channel: ProcessChannel) -> str:
    """Return what a drive lacks that does not take the power off by itself."""
    if not channel.describes(*objects.ON_ABORT):
        return "no object for the reaction to a lost master (6007h)"
    return "neither heartbeat consumer (1016h) nor life guarding (100Ch, 100Dh)"


def _name(address: ObjectAddress) -> str:
    index, subindex = address
    return f"{index:04X}h:{subindex:02X}h" if subindex else f"{index:04X}h"


def refusals(
    channel: ProcessChannel,
    scales: ServoScales,
    sent: Cyclic,
    motion: Motion,
    cycle_s: float,
    watched: bool,
) -> Iterator[DeviceError]:
    """Yield an error for each unit that differs from the bench file, a cycle time that cannot be
    set, and each object that a run reads or writes and the drive refuses to read.
    """
    if (error := cia402_mode.not_offered(channel, motion)) is not None:
        yield error
    yield from unit_refusals(channel, scales, motion, cycle_s)
    needed = (*objects.NEEDED, *motion.needed, *held_limits(channel, motion))
    settings = (address for address, _ in objects.settings(channel, cycle_s))
    outputs, inputs = objects.outputs(motion), objects.inputs(sent, channel)
    yield from access_refusals(channel, outputs, inputs, watched, (*needed, *settings))


def unit_refusals(
    channel: ProcessChannel, scales: ServoScales, motion: Motion, cycle_s: float
) -> Iterator[DeviceError]:
    """Yield those errors of units, vendor and cycle time that the mapping of process data does not
    detect.
    """
    if scales.vendor_id is not None and channel.read(*VENDOR) != scales.vendor_id:
        yield ConfigurationError(
            f"vendor 1018h:01h: the drive reports {channel.read(*VENDOR):X}h, but the units are "
            f"those of the vendor {scales.vendor_id:X}h in its EDS file: use the EDS file of this "
            "drive"
        )
    yield from scales.mismatches(channel)
    yield from velocity_unit.refusals(channel, scales)
    milliseconds = round(cycle_s * 1e3)
    if milliseconds < 1 or abs(milliseconds * 1e-3 - cycle_s) > 1e-9:
        yield ConfigurationError(
            f"the cycle time is {cycle_s * 1e3:g} ms; it must be a whole number of milliseconds "
            "(60C2h)"
        )
    if motion.takes_offset:
        yield from _offset_refusals(channel)


def _offset_refusals(channel: ProcessChannel) -> Iterator[ConfigurationError]:
    for error in refusal(channel.read, *TORQUE_OFFSET):
        words = f"{channel.label}: no torque offset 60B2h ({error}): run without feed-forward"
        offset_error = ConfigurationError(words)
        offset_error.__cause__ = error
        yield offset_error
