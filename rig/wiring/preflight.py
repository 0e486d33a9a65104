"""Checks before a run: of the bench file and of the devices.

``rig run``, ``resume`` and ``jog`` refuse to start if a check fails; ``rig check`` and ``rig run
--dry-run`` report failed checks. Checks that need a write to a device are made by the run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import date
from typing import Literal

from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.link import MASTER_ID, CanopenLink
from drivers.canopen.sensors import Cia404Transmitter, Cia406Encoder
from drivers.clock import SimulatedClock
from drivers.dbc.link import DbcLink
from drivers.epos.link import EposSerialLink
from drivers.errors import ConfigurationError, DeviceError
from drivers.interfaces import Link, ServoLimits, ServoState
from drivers.objects import ProcessChannel
from rig.common.errors import Cause, Finding, InputError, refusals, warnings
from rig.config.bench import Bench, calibration_records, overdue, overdue_problems
from rig.config.canopen import EncoderSection, ServoSection
from rig.config.configuration import Document, Loc
from rig.config.dbc import DbcServoSection, wire
from rig.config.serial_bus import SerialBus
from rig.config.simulated_machine import unstable_current_loop
from rig.wiring.connect import NO_BUS, eds_path, never_opened, servo_data
from rig.wiring.devices import Devices
from rig.wiring.drive_limits import require_within_own
from rig.wiring.off import BEFORE_PROMPT, energised_doubt
from rig.wiring.scales import encoder_scales, servo_axis, servo_motion, servo_scales


@dataclass(frozen=True)
class Range:
    """Plausible range; outside ``usual`` a bench gets a warning, outside ``possible`` no run."""

    usual: tuple[float, float]
    possible: tuple[float, float]
    unit: str
    hint: str


_NONE = ", which is impossible on a bench of this kind"
_FEW = ", which is unusual on a bench of this kind"
CONSTANTS = {
    "torque_constant_N_m_A": Range(
        (1e-3, 20.0), (1e-5, 1e3), "N m/A", "data sheets often give mN m/A"
    ),
    "back_emf_constant_V_s_rad": Range(
        (1e-3, 20.0),
        (1e-5, 1e3),
        "V s/rad",
        "data sheets often give the inverse in rpm/V; convert it as 9.549 divided by that value",
    ),
    "resistance_ohm": Range((0.01, 500.0), (1e-4, 1e5), "ohm", "check value and unit"),
    "inductance_H": Range((1e-6, 0.5), (0.0, 10.0), "H", "data sheets often give mH"),
    "gear_ratio": Range((1.0, 1e3), (0.01, 1e5), "", "state motor turns per joint turn"),
    "moment_arm_m": Range((0.01, 1.0), (1e-3, 5.0), "m", "state it in metres, not in millimetres"),
    "lever_ratio": Range((0.5, 50.0), (0.01, 1e3), "", "state contact force over weight force"),
    "gravity_m_s2": Range((9.76, 9.84), (9.7, 9.9), "m/s^2", "state the local gravity"),
}
_EMF = Range((0.4, 2.5), (0.2, 5.0), "", "in SI units both constants of an ideal motor are equal")
_TIME = Range((1e-5, 0.1), (1e-7, 10.0), "s", "check the units of inductance and resistance")
_RATED = Range(
    (0.4, 2.5), (0.05, 20.0), "", "6076h has the torque of the motor before the gear, in mN m"
)
_MOTOR_SPEED = Range((0.0, 20e3), (0.0, 200e3), "rpm", "check speed_deg_s and gear_ratio")


def implausible(document: Document[Bench]) -> list[Finding]:
    """Return the constants of a bench that are impossible, and the constants that are unusual."""
    found = []
    for place, what, value, bounds in _constants(document.value):
        unit = f" {bounds.unit}" if bounds.unit else ""
        for (low, high), words, refused in (
            (bounds.possible, _NONE, True),
            (bounds.usual, _FEW, False),
        ):
            if not low <= value <= high:
                text = f"{what}{value:g}{unit} is outside {low:g} to {high:g}{unit}{words}"
                text = document.problem(place, f"{text}; {bounds.hint}")
                found.append(Finding(Cause.CONSTANTS, text, refused))
                break
    return found


def _constants(bench: Bench) -> Iterator[tuple[Loc, str, float, Range]]:
    """Yield place, description, value and range of each constant and of what follows from it."""
    machine, servo = bench.machine, bench.servo
    for name, bounds in CONSTANTS.items():
        yield ("machine", name), "", getattr(machine, name), bounds
    place = ("machine", "back_emf_constant_V_s_rad")
    ratio = machine.back_emf_constant_V_s_rad / machine.torque_constant_N_m_A
    yield place, "its ratio to torque_constant_N_m_A of ", ratio, _EMF
    if machine.inductance_H > 0.0:
        time_s = machine.inductance_H / machine.resistance_ohm
        words = "with resistance_ohm a time constant of the current of "
        yield ("machine", "inductance_H"), words, time_s, _TIME
    rpm = bench.limits.speed_deg_s * machine.gear_ratio / 6.0
    yield ("limits", "speed_deg_s"), "at the motor ", rpm, _MOTOR_SPEED
    if isinstance(servo, ServoSection):
        torque = machine.torque_constant_N_m_A * servo.rated_current_A
        words = f"its ratio to rated_current_A times torque_constant_N_m_A ({torque:.4g} N m) of "
        yield ("servo", "rated_torque_N_m"), words, servo.rated_torque_N_m / torque, _RATED


Role = Literal["servo", "encoder", "pressure"]
_WORDS: dict[Role, str] = {
    "servo": "servo",
    "encoder": "encoder",
    "pressure": "pressure transmitter",
}


_Profile = Cia402Servo | Cia406Encoder | Cia404Transmitter


def _nodes(bench: Bench) -> Iterator[tuple[Role, int]]:
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
    bench = document.value
    data = servo_data(document)
    link: CanopenLink | EposSerialLink
    if isinstance(bench.bus, SerialBus):
        link = EposSerialLink(SimulatedClock(), never_opened)
    elif isinstance(bench.servo, DbcServoSection):
        link = DbcLink(SimulatedClock(), never_opened)
        link.add_channel(
            wire(bench.servo, document.path, bench.simulated, document.problem), bench.servo.name
        )
    else:
        link = CanopenLink(SimulatedClock(), never_opened)
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
                axis = servo_axis(bench.servo, data)
                node: ProcessChannel = link.add_node(number, eds, axis)
            else:
                node = link.add_node(number, eds)
            profile = _profile(document, role, link, node)
            refused = list(profile.description_problems())
            if not refused and isinstance(profile, Cia402Servo):
                told = profile.lacks(bench.cycle_s).words
                assert isinstance(bench.servo, ServoSection)
                if data is not None and (bench.servo.eds or bench.servo.device):
                    known = f"known of {data.name}, unless the bench file states another value"
                    told = (f"{known}: {data.words}", *data.remarks, *told)
        except ConfigurationError as error:
            refused = [error]
        yield from (Finding(Cause.FILES, f"servo: {text}", refused=False) for text in told)
        for lacking in refused:
            yield Finding(
                Cause.FILES, document.problem((role, "eds"), str(lacking)), connectable=False
            )
    if isinstance(link, DbcLink):
        for text in link.problems():
            yield Finding(Cause.NODES, document.problem(("servo",), text), connectable=False)


def _profile(document: Document[Bench], role: Role, link: Link, node: ProcessChannel) -> _Profile:
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


RESET_HINT = "; remove the cause of the fault, then clear the fault with --reset-fault"


def bench_findings(document: Document[Bench], today: date) -> list[Finding]:
    """Return the errors of a bench in its file and in the files that it names."""
    bench = document.value
    if bench.bus is None:
        return [Finding(Cause.BUS, document.problem(("bus",), NO_BUS), connectable=False)]
    found = (list(_conflicts(document)) or list(_declared(document))) + implausible(document)
    if bench.simulated and bench.mock is not None and (text := unstable_current_loop(bench.mock)):
        place = ("mock", "loops", "current_gain_V_A")
        found.append(Finding(Cause.SIMULATION, document.problem(place, text)))
    late = overdue_problems(document, today)
    found += [Finding(Cause.CALIBRATION, text) for text in late]
    if not late:
        records = calibration_records(bench, today)
        found += [Finding(Cause.CALIBRATION, text, refused=False) for text in overdue(records)]
    return found


def require_startable(
    document: Document[Bench], today: date, warn: Callable[[str], object]
) -> None:
    """Refuse (InputError, with places) a bench with errors in its files, before any connection."""
    found = bench_findings(document, today)
    for text in warnings(found):
        warn(f"warning: {text}")
    if problems := refusals(found):
        raise InputError(problems)


def device_findings(
    devices: Devices, wanted: ServoLimits, cycle_s: float, reset_fault: bool = False
) -> Iterator[Finding]:
    """Yield why a run with these limits would refuse the devices; writes nothing to them."""
    servo = devices.servo
    state = servo.state()
    if state.energised:
        yield Finding(Cause.STATE, f"{BEFORE_PROMPT}: {energised_doubt(state)}")
    elif state is ServoState.FAULT and not reset_fault:
        yield Finding(Cause.STATE, f"{servo.fault()}{RESET_HINT}")
    settings = list(_refused(Cause.DRIVE, servo.problems(cycle_s)))
    yield from settings
    unread = list(_refused(Cause.ENCODER, devices.encoder.problems(cycle_s)))
    yield from unread
    if not unread:
        for text in devices.encoder.lacks(cycle_s).words:
            yield Finding(Cause.ENCODER, text, refused=False)
    if devices.pressure is not None:
        yield from _refused(Cause.PRESSURE, devices.pressure.problems(cycle_s))
    if settings:
        return  # limits in other units than the drive's cannot be compared
    try:
        unheld = servo.lacks(cycle_s).limits
        steps, places = servo.limit_steps(), servo.limit_places
        require_within_own(wanted, servo.read_limits(), steps, places, unheld)
    except ConfigurationError as refused:
        yield Finding(Cause.LIMITS, str(refused))
    yield from _refused(Cause.LIMITS, servo.limit_problems(wanted))


def require_ready(
    devices: Devices, wanted: ServoLimits, cycle_s: float, reset_fault: bool = False
) -> list[str]:
    """Before a weight is hung, refuse the devices that the run would refuse; return warnings."""
    found = list(device_findings(devices, wanted, cycle_s, reset_fault))
    if problems := refusals(found):
        raise ConfigurationError("; ".join(problems))
    return warnings(found)


def _refused(cause: Cause, errors: Iterable[DeviceError]) -> Iterator[Finding]:
    return (Finding(cause, str(error)) for error in errors)
