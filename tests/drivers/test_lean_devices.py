"""Drives and encoders that have, keep or refuse what CiA leaves to their makers."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.canopen import motion
from drivers.canopen.cia402_objects import cyclic, inputs
from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.cia402_servo import homing_settings as settings
from drivers.canopen.motion import RPM, ProfilePosition
from drivers.canopen.sensors import Cia406Encoder
from drivers.clock import NS
from drivers.errors import ConfigurationError, LinkError, ObjectAccessError
from drivers.homing import HomingOrder
from drivers.interfaces import ServoState
from drivers.mock.canopen.dictionary import SdoAbortError, key
from drivers.mock.canopen.node import SimulatedNode
from drivers.mock.traits import MAKES
from drivers.objects import optional
from drivers.servo_limits import NO_OPTION, encode
from drivers.units import EncoderScales, ServoScales
from tests.drivers.makes import LACKS, description

from .host import SCALES, Host, enabled, make_eds, make_host
from .test_servo import LIMITS

TURN = 262144
NO_REMOTE = 1 << 30


def remove(node: SimulatedNode, *addresses: tuple[int, int]) -> None:
    """Take objects from a simulated device, though its EDS has them."""
    for address in addresses:
        del node.objects.entries[key(*address)]


def lock(node: SimulatedNode, *addresses: tuple[int, int]) -> None:
    """Make objects of a simulated device read only."""
    entries = node.objects.entries
    for address in addresses:
        entries[key(*address)] = dataclasses.replace(entries[key(*address)], writable=False)


def test_what_an_identity_lacks_is_empty(host: Host) -> None:
    remove(host.bench.drive, (0x1009, 0), (0x100A, 0), (0x1018, 4), (0x1018, 3))
    found = host.servo.identity()
    assert (found.vendor_id, found.product_code) == (0x7FF, 0x402)
    assert (found.revision, found.serial_number) == (0, 0)
    assert (found.hardware_version, found.software_version) == ("", "")


def test_only_absence_makes_an_object_optional() -> None:
    def refuse(index: int, subindex: int) -> int:
        raise ObjectAccessError(index, subindex, 0x08000022, "device state")

    with pytest.raises(ObjectAccessError):
        optional(refuse, 0x1018, 4)

    def wrong(index: int, subindex: int) -> int:
        raise ConfigurationError("another length")

    with pytest.raises(ConfigurationError):
        optional(wrong, 0x1018, 4)


def test_a_device_without_remote_frames_keeps_that_flag(host: Host) -> None:
    drive = host.bench.drive

    def guarded(check: Callable[[int, int], None]) -> Callable[[int, int], None]:
        def guard(subindex: int, value: int) -> None:
            if subindex == 1 and not value & NO_REMOTE:
                raise SdoAbortError(0x06090030)
            check(subindex, value)

        return guard

    for index in range(0x1800, 0x1804):
        drive.objects.checks[index] = guarded(drive.objects.checks[index])
    enabled(host)
    host.cycles(5)
    assert host.servo.sample().fresh
    assert drive.objects.integer(0x1800, 1) == NO_REMOTE | 0x181


def fix_identifiers(node: SimulatedNode, identifiers: tuple[int, ...]) -> None:
    """Have a device with TPDOs whose identifiers are fixed and whose mapping is not."""
    for number, identifier in enumerate(identifiers):
        node.objects.values[key(0x1800 + number, 1)] = identifier
        node.objects.checks[0x1A00 + number] = lambda _sub, _value: None
    lock(node, *((0x1800 + number, 1) for number in range(len(identifiers))))


def test_pdos_with_fixed_identifiers_are_used_where_the_device_has_them(host: Host) -> None:
    fix_identifiers(host.bench.drive, (0x281, 0x181, 0x481, 0x381))
    enabled(host)
    host.cycles(25)
    assert host.servo.sample().fresh
    assert [*host.drive.inputs] == [0x281, 0x181, 0x481, 0x381]
    host.servo.disable()
    assert not host.powered[-1]


def test_a_fixed_identifier_of_another_node_is_refused(host: Host) -> None:
    fix_identifiers(host.bench.drive, (0x1A1, 0x281, 0x381, 0x481))
    with pytest.raises(
        ConfigurationError,
        match="identifier 1A1h, which belongs to another node, and object 1800h:01h",
    ):
        host.servo.prepare(host.cycle_s)


def test_the_object_that_cannot_be_mapped_is_named(host: Host) -> None:
    remove(host.bench.drive, (0x1013, 0))
    with pytest.raises(ObjectAccessError, match="refuses to map object 1013h:00h") as caught:
        host.servo.prepare(host.cycle_s)
    assert (caught.value.index, caught.value.subindex) == (0x1A01, 2)


def test_a_limit_that_is_held_already_is_not_written(host: Host) -> None:
    host.servo.write_limits(LIMITS)
    lock(host.bench.drive, (0x605A, 0), (0x607D, 1), (0x6072, 0))
    host.servo.write_limits(LIMITS)
    other = 8 - LIMITS.quick_stop_option
    with pytest.raises(ObjectAccessError, match="605Ah"):
        host.servo.write_limits(dataclasses.replace(LIMITS, quick_stop_option=other))


@pytest.mark.parametrize(("wanted_ms", "silence_s"), [(250, 1.0), (50, 0.2)])
def test_a_heartbeat_is_timed_by_the_period_that_the_device_holds(host, wanted_ms, silence_s):
    drive = host.bench.drive
    start = drive.objects.written[0x1017]

    def rounded(subindex: int, value: int) -> None:
        drive.objects.values[key(0x1017)] = wanted_ms
        start(subindex, value)

    drive.objects.written[0x1017] = rounded
    enabled(host)
    host.cycles(600)
    drive._producer.stop()
    with pytest.raises(LinkError, match=rf"\(limit {silence_s:g} s\)"):
        host.cycles(round(silence_s / host.cycle_s) + 300)


def test_a_device_that_sends_no_heartbeat_is_refused(host: Host) -> None:
    drive = host.bench.drive
    drive.objects.written[0x1017] = lambda _sub, _value: drive.objects.values.update(
        {key(0x1017): 0}
    )
    with pytest.raises(ConfigurationError, match="1017h reads 0 after 50 ms was written"):
        host.servo.prepare(host.cycle_s)


def test_a_drive_that_waits_for_its_master_hears_it_before_its_start(host: Host) -> None:
    drive = host.bench.drive
    drive.objects.values[key(0x1016, 1)] = 0x7F << 16 | 100
    drive._start_consumer()
    heard: list[bytes] = []
    listen, start = drive._on_heartbeat, drive._on_nmt

    def hear(data: bytes) -> None:
        heard.append(data)
        listen(data)

    def begin(data: bytes) -> None:
        if data[0] != 1 or heard:
            start(data)

    drive._port.listen(0x77F, hear)
    drive._port.listen(0x000, begin)
    enabled(host)
    host.cycles(200)
    assert host.servo.state() is ServoState.OPERATION_ENABLED


def scales_of(make: str) -> ServoScales:
    """Return the units of a make's drive, from the maker's documents."""
    rpm, counts_per_s = 2 * math.pi / 60, 2 * math.pi / 4096
    if make == "EPOS4":
        return dataclasses.replace(
            SCALES,
            velocity_unit_rad_s=rpm,
            current_object=(0x30D1, 2),
            rated_torque_object_unit_N_m=1e-6,
        )
    acceleration = {
        "Copley": 10 * counts_per_s,
        "Technosoft": counts_per_s * 1e6 / 65536,
        "Faulhaber": 2 * math.pi,
    }.get(make)
    scales = dataclasses.replace(SCALES, acceleration_unit_rad_s2=acceleration)
    if make == "Copley":
        own = (0x2201, 0)
        unit = 0.1 * counts_per_s
        return dataclasses.replace(
            scales, velocity_unit_rad_s=unit, supply_object=own, supply_unit_V=0.1
        )
    unit = {"Technosoft": counts_per_s * 1000 / 65536, "Faulhaber": rpm, "Nanotec": rpm}.get(make)
    return dataclasses.replace(scales, velocity_unit_rad_s=unit)


@pytest.mark.parametrize("make", [make for make in LACKS if make != "EPOS2"])
def test_a_drive_of_this_make_runs_and_is_left_without_power(make: str, tmp_path: Path) -> None:
    eds = make_eds(tmp_path, make)
    host = make_host(eds=eds, scales=scales_of(make))
    for index in LACKS[make]:
        with pytest.raises((ObjectAccessError, ConfigurationError)):
            host.drive.read(index, 1 if index in (0x60C2, 0x607D) else 0)
    assert list(host.servo.description_problems()) == []
    assert list(host.servo.problems(host.cycle_s)) == []
    lacks = host.servo.lacks(host.cycle_s)
    assert lacks.supply is (make != "Copley")
    assert lacks.temperature
    host.servo.write_limits(LIMITS)
    held = dataclasses.asdict(host.servo.read_limits())
    for field in lacks.limits:
        assert held[field] == NO_OPTION if field == "quick_stop_option" else math.isnan(held[field])
    enabled(host)
    host.cycles(600, lambda t: 0.1 * math.sin(math.pi / 1.2 * t))
    sample = host.servo.sample()
    assert sample.fresh
    reading = host.bench.sampler.peek(host.clock.now_ns())
    assert sample.motor_angle_rad == pytest.approx(100.0 * 0.1, abs=0.2)
    assert sample.current_A == pytest.approx(reading.current_A, abs=0.5)
    assert math.isnan(sample.supply_voltage_V) is lacks.supply
    assert math.isnan(sample.temperature_C)
    if 0x1013 in LACKS[make]:
        assert sample.device_time_s == pytest.approx(host.clock.now_ns() * 1e-9, abs=2e-3)
    host.servo.disable()
    assert host.servo.state() is ServoState.SWITCH_ON_DISABLED
    assert host.powered[-1] is False


def test_without_606c_the_speed_follows_from_the_position(tmp_path: Path) -> None:
    eds = tmp_path / "drive.eds"
    eds.write_text(description("Elmo").replace("[606C]", "[506C]"))
    host = enabled(make_host(eds=eds))
    speeds = []
    for step in range(30):
        host.cycles(20, lambda t, begun=0.02 * step: 0.2 * (t + begun))
        speeds.append(host.servo.sample().velocity_rad_s)
    assert sum(speeds[15:]) / 15 == pytest.approx(0.2, rel=0.15)


@pytest.mark.parametrize(("makes", "alone"), [("EPOS4", True), ("Trinamic", False)])
def test_a_drive_without_a_reaction_to_a_lost_master_has_no_watchdog(tmp_path, makes, alone):
    eds = make_eds(tmp_path, makes)
    host = make_host(eds=eds)
    assert host.link.has_watchdog is alone
    assert host.servo.watch_s == (0.1 if alone else None)
    told = Cia402Servo(host.drive, host.link, SCALES, stops_alone=True)
    assert told.watch_s == 0.1


def test_values_that_do_not_fit_beside_each_other_travel_in_the_next_frame(host: Host) -> None:
    wide = dataclasses.replace(SCALES, current_object=(0x60F4, 0), voltage_object=(0x6064, 0))
    layouts = inputs(cyclic(host.drive, wide), host.drive)
    assert [layout.objects for layout in layouts] == [
        ((0x6041, 0), (0x6064, 0)),
        ((0x60F4, 0), (0x606C, 0)),
        ((0x1013, 0), (0x6064, 0)),
        ((0x6079, 0), (0x2101, 0), (0x6077, 0)),
    ]
    assert [layout.mean for layout in layouts] == [None, (0x60F4, 0), None, None]


@pytest.mark.parametrize("span", [0, 0xFFFFFFFF])
def test_a_range_that_an_unsigned32_cannot_hold(host: Host, span: int) -> None:
    encoder = host.bench.encoder
    encoder.objects.values[key(0x6002)] = span
    encoder._range = 1 << 32
    enabled(host)
    host.cycles(400, lambda t: -0.05 * math.sin(math.pi / 0.8 * t))
    assert host.encoder.sample().angle_rad == pytest.approx(-0.05, abs=2e-3)


def test_coarser_units_per_turn(host: Host) -> None:
    node = host.encoder._channel
    node.write(0x6001, 0, 3600)
    encoder = Cia406Encoder(node, EncoderScales(3600, sign=-1, offset_rad=0.5))
    host.servo.prepare(host.cycle_s)
    encoder.prepare(host.cycle_s)
    host.servo.enable()
    host.cycles(400, lambda t: 0.05 * math.sin(math.pi / 0.8 * t))
    assert encoder.sample().angle_rad == pytest.approx(0.45, abs=3e-3)


def lacking(host: Host) -> list[str]:
    """Return the objects that the encoder is said to lack."""
    return [words.split("(")[1][:5] for words in host.encoder.lacks(host.cycle_s).words]


def test_an_encoder_of_class_1(host: Host) -> None:
    assert list(host.encoder.lacks(host.cycle_s).words) == []
    remove(host.bench.encoder, (0x6001, 0), (0x6002, 0), (0x6503, 0), (0x1013, 0))
    assert list(host.encoder.problems(host.cycle_s)) == []
    assert lacking(host) == ["6503h", "1013h"]
    enabled(host)
    host.cycles(400, lambda t: -0.05 * math.sin(math.pi / 0.8 * t))
    sample = host.encoder.sample()
    assert sample.angle_rad == pytest.approx(-0.05, abs=2e-3)
    assert sample.device_time_s == pytest.approx(host.clock.now_ns() * 1e-9, abs=2e-3)
    wrong = Cia406Encoder(host.encoder._channel, EncoderScales(4096))
    with pytest.raises(ConfigurationError, match="6501h reads 262144 counts per turn"):
        wrong.prepare(host.cycle_s)
    remove(host.bench.encoder, (0x6501, 0), (0x6502, 0))
    assert lacking(host) == ["6001h", "6002h", "6503h", "1013h"]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("start_deg", [-0.5, 0.5])
def test_the_first_angle_is_the_one_nearest_to_the_middle_of_the_travel(host, start_deg, sign):
    encoder = host.bench.encoder
    encoder.objects.values[key(0x6002)] = encoder._range = TURN
    zero = round((180.0 + sign * start_deg) / 360.0 * TURN)
    encoder.distort = lambda counts: counts + zero
    scales = EncoderScales(TURN, sign, offset_rad=-sign * math.pi, middle_rad=0.0)
    mounted = Cia406Encoder(host.encoder._channel, scales)
    assert mounted.reading() == pytest.approx(math.radians(start_deg), abs=1e-4)
    host.servo.prepare(host.cycle_s)
    mounted.prepare(host.cycle_s)
    host.cycles(3)
    assert mounted.sample().angle_rad == pytest.approx(math.radians(start_deg), abs=1e-4)


class Stating:
    """A drive that states one unit."""

    label = "node 1"

    def __init__(self, index: int, word: int) -> None:
        self._index, self._word = index, word

    def describes(self, index: int, _: int) -> bool:
        return index == self._index

    def read(self, *_: int) -> int:
        return self._word


@pytest.mark.parametrize(
    ("index", "word", "unit", "setting"),
    [
        (0x60A9, 0x00B44700, RPM, "velocity_unit: rpm"),
        (0x60A9, 0xFFB44700, 0.1 * RPM, "velocity_unit_rad_s: 0.01047"),
        (0x60A9, 0x00410300, math.pi / 180, "velocity_unit_rad_s: 0.01745"),
        (0x60A9, 0x00B50300, None, ""),
        (0x60AA, 0x00C00300, RPM, "acceleration_unit_rad_s2: 0.10472"),
        (0x60AA, 0x01105700, 10.0, "acceleration_unit_rad_s2: 10"),
        (0x60AA, 0x00B44700, None, ""),
    ],
)
def test_a_unit_that_a_drive_states_is_that_of_the_bench_file(index, word, unit, setting):
    drive: Any = Stating(index, word)
    found = list(motion.stated_unit_problems(drive, SCALES))
    if unit is None:
        assert found == []
        return
    (error,) = found
    assert str(error).endswith(f"set servo.{setting}")
    key = "velocity_unit_rad_s" if index == 0x60A9 else "acceleration_unit_rad_s2"
    right = dataclasses.replace(SCALES, **{key: unit})
    assert list(motion.stated_unit_problems(drive, right)) == []


@pytest.mark.parametrize(
    ("factor", "key", "value"),
    [
        (0.0146, "velocity_unit", "rpm"),
        (0.1, "velocity_unit_rad_s", 0.01534),
        (9.3, "velocity_unit_rad_s", 0.0001534),
        (-1.0, None, None),
    ],
)
def test_the_unit_of_a_speed_is_found_from_its_factor(host, factor, key, value):
    keys = dict(host.servo.speed_settings(factor))
    assert keys.get(key) == value
    assert bool(keys) is (factor > 0.0)
    assert key is None or f"servo.{key}: {value}" in host.servo.speed_remedy(factor)


RAMPED = [make for make in MAKES if make != "EPOS2" and 0x6085 not in LACKS[make]]
DECELERATION = 20.0
"""Of the quick stop, rad/s^2 at the joint."""
SPEED = 1.0


@pytest.mark.parametrize("make", RAMPED)
def test_a_quick_stop_brakes_as_the_bench_file_says(make: str, tmp_path: Path) -> None:
    eds = make_eds(tmp_path, make)
    host = make_host(eds=eds, scales=scales_of(make))
    limits = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=DECELERATION)
    host.servo.write_limits(limits)
    held = host.servo.read_limits().quick_stop_deceleration_rad_s2
    assert held == pytest.approx(DECELERATION, rel=0.01)
    enabled(host)
    host.cycles(300, lambda t: SPEED * t - 0.01)
    machine = host.bench.machine
    began, speed = host.clock.now_ns(), machine.truth().velocity_rad_s
    assert speed == pytest.approx(SPEED, rel=0.1)
    host.servo.quick_stop()
    while abs(machine.truth().velocity_rad_s) > 0.1 * SPEED:
        assert host.clock.now_ns() - began < NS
        host.cycles(1)
    took_s = (host.clock.now_ns() - began) / NS
    assert took_s == pytest.approx(0.9 * speed / DECELERATION, abs=0.012)


def test_a_deceleration_between_two_units_is_never_weaker() -> None:
    coarse = dataclasses.replace(SCALES, acceleration_unit_rad_s2=2 * math.pi * SCALES.gear_ratio)
    address = (0x6085, 0)
    # A drive with 0 in 6085h does not brake, or refuses it.
    weak = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=1.0)
    assert encode(weak, coarse)[address] == 1
    weakest = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=1e-9)
    assert encode(weakest, coarse)[address] == 1
    strong = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=20.0)
    assert encode(strong, coarse)[address] == 4
    whole = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=6 * math.pi)
    assert encode(whole, coarse)[address] == 3
    # The drive's own value goes back as it was.
    own = dataclasses.replace(LIMITS, quick_stop_deceleration_rad_s2=0.0)
    assert encode(own, coarse)[address] == 0


def test_homing_and_profiles_use_the_unit_of_the_acceleration() -> None:
    host = make_host(scales=dataclasses.replace(SCALES, acceleration_unit_rad_s2=2.0))
    order = HomingOrder(17, 0.0, 0.2, 0.1, 1.0)
    held = dict(settings(host.drive, host.servo._scales, order))
    assert held[0x609A, 0] == round(1.0 * 100 / 2.0)
    assert held[0x6099, 1] == math.floor(0.2 * 100 / SCALES.count_rad + 1e-6)
    profile = dict(ProfilePosition(host.servo._scales, 3.0).settings(LIMITS))
    assert (profile[0x6083, 0], profile[0x6084, 0]) == (150, 150)
    assert profile[0x6081, 0] > 1000
