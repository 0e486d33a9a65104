"""Checks node identifiers and device files of a bench without opening the link."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal, NoReturn, Protocol

from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.cia406 import Cia406Encoder
from drivers.canopen.link import MASTER_ID, CanopenLink
from drivers.clock import SimulatedClock
from drivers.dbc.link import DbcLink
from drivers.epos.link import EposSerialLink
from drivers.errors import ConfigurationError, DeviceError
from drivers.interfaces import Link
from drivers.objects import ProcessChannel
from rig.common.errors import InputError
from rig.common.findings import Cause, Finding
from rig.config.bench import Bench
from rig.config.canopen import EncoderSection, ServoSection
from rig.config.configuration import Document
from rig.config.dbc import DbcServoSection, wire
from rig.config.serial_bus import SerialBus
from rig.wiring.connect import eds_path, servo_data
from rig.wiring.scales import encoder_scales, servo_axis, servo_motion, servo_scales

Role = Literal["servo", "encoder", "pressure"]
_WORDS: dict[Role, str] = {
    "servo": "servo",
    "encoder": "encoder",
    "pressure": "pressure transmitter",
}


class _Described(Protocol):
    """Device profile that can check whether a device's description contains the objects that the
    profile needs.
    """

    def description_refusals(self) -> Iterator[DeviceError]:
        """Yield errors for the objects that the description lacks."""
        ...


def device_file_findings(document: Document[Bench]) -> list[Finding]:
    """Return the faults in node identifiers, CAN identifiers and EDS files of a bench.

    A fault of this kind prevents a connection to the bench. DBC files are checked with the bench
    file.
    """
    return list(_conflicts(document)) or list(_declared(document))


def _nodes(bench: Bench) -> Iterator[tuple[Role, int]]:
    """Yield the devices that have a node identifier."""
    if isinstance(bench.servo, ServoSection):
        yield "servo", bench.servo.node
    if isinstance(bench.encoder, EncoderSection):
        yield "encoder", bench.encoder.node
    if bench.pressure is not None:
        yield "pressure", bench.pressure.node


def _conflicts(document: Document[Bench]) -> Iterator[Finding]:
    bench = document.value
    owners: dict[int, str] = (
        {} if isinstance(bench.bus, SerialBus) else {MASTER_ID: "this program's own heartbeat"}
    )
    for role, node in _nodes(bench):
        if node in owners:
            text = (
                f"{node} is also the node identifier of {owners[node]}; give each device another "
                f"node identifier from 1 to {MASTER_ID - 1}"
            )
            yield Finding(Cause.NODES, document.problem((role, "node"), text), connectable=False)
        owners.setdefault(node, f"the {_WORDS[role]}")


def _declared(document: Document[Bench]) -> Iterator[Finding]:
    """Declare every device on the link as :func:`rig.wiring.connect.connect` does; yield each
    error.
    """
    bench = document.value
    link: CanopenLink | EposSerialLink
    if isinstance(bench.bus, SerialBus):
        link = EposSerialLink(SimulatedClock(), _never_opened)
    elif isinstance(bench.servo, DbcServoSection):
        link = DbcLink(SimulatedClock(), _never_opened)
        link.add_channel(
            wire(bench.servo, document.path, bench.simulated, document.problem), bench.servo.name
        )
    else:
        link = CanopenLink(SimulatedClock(), _never_opened)
    for role, number in _nodes(bench):
        try:
            eds = eds_path(document, role)
        except InputError as missing:
            yield from (Finding(Cause.FILES, text, connectable=False) for text in missing.problems)
            continue
        refused: list[DeviceError]
        told: tuple[str, ...] = ()
        try:
            if role == "servo" and isinstance(link, CanopenLink):
                assert isinstance(bench.servo, ServoSection)
                axis = servo_axis(bench.servo, servo_data(document))
                node: ProcessChannel = link.add_node(number, eds, axis)
            else:
                node = link.add_node(number, eds)
            profile = _profile(document, role, link, node)
            refused = list(profile.description_refusals())
            if not refused and isinstance(profile, Cia402Servo):
                told = (*_maker(document), *profile.lacks(bench.cycle_s).words)
        except ConfigurationError as error:
            refused = [error]
        yield from (Finding(Cause.FILES, f"servo: {text}", refused=False) for text in told)
        for lacking in refused:
            yield Finding(
                Cause.FILES, document.problem((role, "eds"), str(lacking)), connectable=False
            )
    if isinstance(link, DbcLink):
        for text in link.conflicts():
            yield Finding(Cause.NODES, document.problem(("servo",), text), connectable=False)


def _maker(document: Document[Bench]) -> Iterator[str]:
    """Yield the known deviations of the drive's maker from CiA 402."""
    servo, data = document.value.servo, servo_data(document)
    if isinstance(servo, ServoSection) and servo.eds is None and servo.device is None:
        return  # the simulated drive
    if data is not None:
        yield f"known of {data.name}, unless the bench file states another value: {data.words}"
        yield from data.remarks


def _profile(document: Document[Bench], role: Role, link: Link, node: ProcessChannel) -> _Described:
    bench = document.value
    if role == "servo":
        assert isinstance(bench.servo, ServoSection)
        data = servo_data(document)
        scales = servo_scales(bench.servo, bench.machine, data)
        motion = servo_motion(bench.servo, scales, data)
        return Cia402Servo(node, link, scales, motion=motion, stops_alone=bench.servo.stops_alone)
    if role == "encoder":
        assert isinstance(bench.encoder, EncoderSection)
        return Cia406Encoder(node, encoder_scales(bench.encoder, bench.limits))
    assert bench.pressure is not None
    return bench.pressure.transmitter(node)


def _never_opened() -> NoReturn:
    raise AssertionError("this bench is only checked, and its bus must not be opened")
