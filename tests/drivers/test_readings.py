"""Devices asked for what they are and show, unprepared."""

import dataclasses
import math
import re

import pytest

from drivers.canopen.motion import ProfilePosition
from drivers.canopen.sensors import Cia404Transmitter
from drivers.epos.frames import FrameDecoder, Opcode
from drivers.errors import ConfigurationError, DeviceError, LimitError, LinkError, ObjectAccessError
from drivers.interfaces import Link, RawFrame, Servo, ServoLimits
from drivers.mock.bench import SimulatedBench, simulated_bench
from drivers.mock.canopen import dictionary as od
from drivers.mock.canopen.dictionary import key
from drivers.mock.encoder import TRANSMITTER_EDS
from drivers.mock.plant.parts.constants import Machine
from drivers.servo_limits import OBJECTS, decode, encode
from drivers.units import ServoScales

from .dbc_host import DRIVE, make_dbc_host
from .host import SCALES, Host, make_host
from .serial_host import SerialHost

LIMITS = ServoLimits(-0.5, 0.5, 2.0, 75.0, 25.0, 0.03, 2, 35.0)
READS = {Opcode.READ_OBJECT, Opcode.INITIATE_SEGMENTED_READ, Opcode.SEGMENT_READ}
DOWNLOADS = {0, 1}
"""Command specifiers of SDO requests that write: a segment and the start of one (CiA 301,
7.2.4.3).
"""


def ask_everything(servo: Servo, *others: object) -> list[DeviceError]:
    """Ask for all that `rig check` asks for."""
    found = list(servo.problems(0.001)) + list(servo.limit_problems(LIMITS))
    servo.identity(), servo.state(), servo.read_limits(), servo.readings(), servo.limit_steps()
    for other in others:
        other.identity(), other.reading()  # type: ignore[attr-defined]
        found += other.problems(0.001)  # type: ignore[attr-defined]
    return found


def sent(link: Link) -> list[RawFrame]:
    return [frame for frame in link.take_frames() if frame.sent]


@pytest.fixture
def can(host: Host) -> Host:
    return host


def test_a_canopen_bench_is_only_read(can: Host) -> None:
    assert ask_everything(can.servo, can.encoder) == []
    frames = sent(can.link)
    assert {frame.identifier for frame in frames} == {0x601, 0x602}
    assert not [frame for frame in frames if frame.data[0] >> 5 in DOWNLOADS]
    assert can.powered == []


def test_a_bench_on_serial_lines_is_only_read(serial: SerialHost) -> None:
    assert ask_everything(serial.servo, serial.encoder) == []
    by_line: dict[int, bytes] = {}
    for frame in sent(serial.link):
        line = frame.identifier & 0xFF
        by_line[line] = by_line.get(line, b"") + frame.data
    assert set(by_line.pop(serial.encoder.line.address)) == {serial.encoder.line.address}
    opcodes = {frame.opcode for data in by_line.values() for frame in FrameDecoder().feed(data)}
    assert opcodes <= READS
    assert Opcode.READ_OBJECT in opcodes


def test_a_drive_with_frames_of_its_own_is_only_heard() -> None:
    host = make_dbc_host()
    assert ask_everything(host.servo) == []
    assert sent(host.link) == []


@pytest.mark.parametrize("kind", ["can", "serial"])
def test_readings_are_what_a_sample_shows(kind: str, request: pytest.FixtureRequest) -> None:
    host = request.getfixturevalue(kind)
    readings, angle = host.servo.readings(), host.encoder.reading()
    assert readings.supply_voltage_V == 60.0
    assert readings.temperature_C == 25.0
    host.servo.prepare(host.cycle_s)
    host.encoder.prepare(host.cycle_s)
    host.cycles(20)
    sample = host.servo.sample()
    assert readings.motor_angle_rad == sample.motor_angle_rad
    assert readings.velocity_rad_s == sample.velocity_rad_s == 0.0
    assert readings.current_A == pytest.approx(sample.current_A, abs=1e-9)
    assert angle == host.encoder.sample().angle_rad


def test_readings_carry_sign_and_zero_of_the_bench_file() -> None:
    scales = dataclasses.replace(SCALES, sign=-1, offset_rad=0.25)
    host = make_host(scales=scales)
    host.bench.drive.objects.values[key(0x6064)] = 4096
    assert host.servo.readings().motor_angle_rad / scales.gear_ratio == pytest.approx(0.25)


def test_a_drive_with_frames_of_its_own_shows_what_comes_by_itself() -> None:
    host = make_dbc_host(drive=dataclasses.replace(DRIVE, offset_rad=0.5))
    readings = host.servo.readings()
    assert readings.motor_angle_rad == pytest.approx(50.0, abs=1e-6)
    assert (readings.supply_voltage_V, readings.temperature_C, readings.current_A) == (
        60.0,
        25.0,
        0.0,
    )
    assert math.isnan(readings.velocity_rad_s)  # it only comes as an answer to a command


@pytest.mark.parametrize(
    ("address", "field"), [(0x2101, "temperature_C"), (0x6079, "supply_voltage_V")]
)
def test_a_value_that_the_drive_refuses_is_nan(can: Host, address: int, field: str) -> None:
    refuse(can.bench, address)
    readings = can.servo.readings()
    assert [name for name, value in readings._asdict().items() if math.isnan(value)] == [field]
    (error,) = can.servo.problems(0.001)
    assert isinstance(error, ObjectAccessError)
    with pytest.raises(ObjectAccessError, match=f"{address:04X}h") as caught:
        can.servo.prepare(0.001)
    assert str(caught.value) == str(error)


def refuse(bench: SimulatedBench, index: int) -> None:
    """Have the drive refuse to be asked for an object."""
    read = bench.drive.objects.read

    def refusing(asked: int, subindex: int) -> bytes:
        if asked == index:
            raise od.SdoAbortError(0x08000020)
        return read(asked, subindex)

    bench.drive.objects.read = refusing  # type: ignore[method-assign]


def test_a_silent_drive_is_no_reading(can: Host) -> None:
    can.bench.bus.frame_filters.append(lambda time, identifier, data, host: None)
    with pytest.raises(LinkError):
        can.servo.readings()
    with pytest.raises(LinkError):
        list(can.servo.problems(0.001))
    with pytest.raises(LinkError):
        can.encoder.reading()


def test_all_refusals_of_a_drive_are_yielded() -> None:
    scales = ServoScales(4000, 100.0, 14.0, 0.5)
    host = make_host(scales=scales)
    words = [str(error) for error in host.servo.problems(0.0015)]
    assert [word.split(":")[0] for word in words] == [
        "rated current, 6075h",
        "rated torque, 6076h",
        "encoder resolution, 608Fh",
        "the cycle time is 1.5 ms; it must be a whole number of milliseconds (60C2h)",
    ]
    with pytest.raises(ConfigurationError) as caught:
        host.servo.prepare(0.001)
    assert str(caught.value) == words[0]


@pytest.mark.parametrize(
    ("torque", "accepted"), [(0.4510, True), (0.4511, False), (0.4490, True), (0.4489, False)]
)
def test_a_rated_torque_is_the_same_within_one_unit_of_its_object(torque, accepted):
    host = make_host(scales=dataclasses.replace(SCALES, rated_torque_N_m=torque))
    assert (not list(host.servo.problems(0.001))) is accepted


def test_an_encoder_says_what_preparing_it_would_refuse(can: Host) -> None:
    values = can.bench.encoder.objects.values
    values[key(0x6001)], values[key(0x6503)] = 1000, 0x1
    resolution, alarm = can.encoder.problems(0.001)
    assert "6001h reads 1000 counts per turn, but the bench file states 262144" in str(resolution)
    assert "reports the alarms 0001h" in str(alarm)
    with pytest.raises(ConfigurationError) as caught:
        can.encoder.prepare(0.001)
    assert str(caught.value) == str(resolution)


def test_a_bad_answer_of_an_amt21_is_nan(serial: SerialHost) -> None:
    serial.encoder._ask = lambda: None  # type: ignore[method-assign]
    assert math.isnan(serial.encoder.reading())


@pytest.mark.parametrize(("status", "pressure"), [(0, 1.0e6), (1, math.nan)])
def test_a_transmitter_is_read(status: int, pressure: float) -> None:
    bench = simulated_bench(Machine(), 0, transmitter_node=4)
    host = make_host()
    link = type(host.link)(bench.clock, lambda: bench.bus, "simulated bus")
    device = Cia404Transmitter(link.add_node(4, TRANSMITTER_EDS), 100.0)
    link.open()
    bench.transmitter._sdo._refresh = lambda: None
    values = bench.transmitter.objects.values
    values[key(0x9130, 1)], values[key(0x6150, 1)] = 10_000, status
    assert device.reading() == pytest.approx(pressure, nan_ok=True)
    assert len(list(device.problems(0.001))) == status
    assert not [frame for frame in sent(link) if frame.data[0] >> 5 in DOWNLOADS]
    link.close()


@pytest.mark.parametrize(("current", "count"), [(0xFFFF * 0.015, 0), (0x10000 * 0.015, 1)])
def test_a_limit_must_fit_its_object(can: Host, current: float, count: int) -> None:
    limits = dataclasses.replace(LIMITS, current_A=current)
    found = list(can.servo.limit_problems(limits))
    assert len(found) == count
    if found:
        with pytest.raises(ConfigurationError) as caught:
            can.servo.write_limits(limits)
        assert str(caught.value) == str(found[0])


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("field", "value", "key"),
    [
        ("angle_min_rad", -4e4, "limits.angle_min_deg"),
        ("angle_max_rad", 4e4, "limits.angle_max_deg"),
        ("speed_rad_s", 1e7, "limits.speed_deg_s"),
        ("torque_N_m", 3e3, "limits.torque_N_m"),
        ("current_A", 1e3, "limits.current_A"),
        ("following_error_rad", 1e7, "limits.following_error_deg"),
        ("quick_stop_option", 1 << 15, "servo.quick_stop_option"),
        ("quick_stop_deceleration_rad_s2", 1e7, "servo.quick_stop_deceleration_deg_s2"),
    ],
)
def test_a_limit_that_does_not_fit_names_its_key(field, value, key, sign):
    """A wrong ratio or unit shows up as such a limit: the message states limit, range, keys."""
    host = make_host(scales=dataclasses.replace(SCALES, sign=sign))
    limits = dataclasses.replace(LIMITS, **{field: value})
    (found,) = host.servo.limit_problems(limits)
    assert isinstance(found, LimitError)
    assert found.keys[0] == key
    assert all(key in str(found) for key in found.keys)
    held = re.search(r"can hold (\S+) to ([^ :]+)", str(found))
    shown = math.degrees(value) if "_rad" in field else value
    assert not float(held[1]) <= shown <= float(held[2])
    with pytest.raises(LimitError) as caught:
        host.servo.write_limits(limits)
    assert caught.value.keys == found.keys


def test_a_profile_that_does_not_fit_names_its_key() -> None:
    host = make_host(motion=ProfilePosition(SCALES, 1e7))
    found = list(host.servo.limit_problems(LIMITS))
    assert [type(error) for error in found] == [LimitError, LimitError]
    assert {error.keys[0] for error in found if isinstance(error, LimitError)} == {
        "servo.profile_acceleration_deg_s2"
    }


def test_a_limit_must_fit_its_signal() -> None:
    host = make_dbc_host()
    wide = dataclasses.replace(LIMITS, speed_rad_s=409.6)
    (error,) = host.servo.limit_problems(wide)
    assert isinstance(error, LimitError)
    assert error.keys == ("limits.speed_deg_s", "machine.gear_ratio")
    assert all(key in str(error) for key in error.keys)
    assert not list(host.servo.limit_problems(LIMITS))


@pytest.mark.parametrize("address", OBJECTS)
def test_the_step_of_a_limit_is_one_unit_of_its_object(address: tuple[int, int]) -> None:
    values = encode(LIMITS, SCALES)
    before, after = (decode({**values, address: values[address] + k}, SCALES) for k in (0, 1))
    host = make_host()
    steps = host.servo.limit_steps()
    assert steps is not None
    changed = [
        (field.name, abs(getattr(after, field.name) - getattr(before, field.name)))
        for field in dataclasses.fields(ServoLimits)
        if getattr(after, field.name) != getattr(before, field.name)
    ]
    ((name, change),) = changed
    if name == "quick_stop_option":
        return
    held = "angle_rad" if name.startswith("angle") else name
    assert change == pytest.approx(getattr(steps, held), rel=1e-6)
