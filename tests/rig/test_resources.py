"""Which parts of a bench one program at a time may use."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.common.locks import Resource
from rig.config.bench import Bench, load_bench
from rig.config.canopen import Bus, EncoderSection
from rig.config.serial_bus import Amt21Section, SerialBus
from rig.wiring.connect import resources


def can_bench(interface: str, channel: str | None) -> Bench:
    return load_bench("practical").value.model_copy(
        update={"bus": Bus(interface=interface, channel=channel)}
    )


def serial_bench(drive: str, encoder: str) -> Bench:
    bus = SerialBus(interface="epos_serial", port=drive)
    update = {"bus": bus, "encoder": Amt21Section(kind="amt21", port=encoder)}
    return load_bench("practical_serial").value.model_copy(update=update)


@pytest.mark.parametrize(
    "name",
    [
        "practical",
        "practical_serial",
        "practical_dbc",
        "practical_hot",
        "literal",
        "odrive_can",
        "mit_mini",
    ],
)
def test_a_simulated_bench_uses_nothing_that_others_could(name: str) -> None:
    assert resources(load_bench(name).value) == ()


@pytest.mark.parametrize(
    ("interface", "channel", "expected"),
    [
        ("socketcan", "can0", Resource("socketcan:can0", "socketcan channel can0")),
        ("socketcan", "vcan0@500", Resource("socketcan:vcan0@500", "socketcan channel vcan0@500")),
        ("pcan", "PCAN_USBBUS1", Resource("pcan:PCAN_USBBUS1", "pcan channel PCAN_USBBUS1")),
        ("kvaser", None, Resource("kvaser:", "kvaser channel by default")),
        ("slcan", "/dev/none0", Resource("/dev/none0", "port /dev/none0")),
        ("slcan", "/dev/none0@115200", Resource("/dev/none0", "port /dev/none0")),
        ("robotell", "/dev/none0@115200", Resource("/dev/none0", "port /dev/none0")),
        ("seeedstudio", "/dev/../dev/none0", Resource("/dev/none0", "port /dev/../dev/none0")),
        ("unheard_of", "/dev/none0", Resource("/dev/none0", "port /dev/none0")),
        (
            "slcan",
            "socket://10.0.0.1:23",
            Resource("slcan:socket://10.0.0.1:23", "slcan channel socket://10.0.0.1:23"),
        ),
        ("slcan", "/dev/no\0ne", Resource("/dev/no\0ne", "port /dev/no\0ne")),
    ],
)
def test_a_channel_is_a_device_or_a_name(
    interface: str, channel: str | None, expected: Resource
) -> None:
    assert resources(can_bench(interface, channel)) == (expected,)


def test_a_port_is_the_same_under_all_its_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_id = tmp_path / "usb-FTDI-port0"
    by_id.symlink_to(tmp_path / "ttyUSB0")
    monkeypatch.chdir(tmp_path)
    keys = [
        {part.key for part in resources(bench)}
        for bench in (
            serial_bench(str(tmp_path / "ttyUSB0"), str(tmp_path / "ttyUSB0")),
            serial_bench(str(by_id), str(by_id)),
            can_bench("slcan", f"{by_id}@921600"),
            can_bench("slcan", "ttyUSB0"),
            can_bench("slcan", "./usb-FTDI-port0@1"),
        )
    ]
    real = tmp_path.resolve()
    assert set.intersection(*keys) == {str(real / "ttyUSB0")}
    assert set.union(*keys) == {str(real / "ttyUSB0"), str(real / "usb-FTDI-port0")}


def test_a_port_is_the_same_after_its_adapter_was_unplugged_and_plugged_in(tmp_path: Path) -> None:
    by_id = tmp_path / "usb-FTDI-port0"
    by_id.symlink_to(tmp_path / "ttyUSB0")
    bench = can_bench("slcan", str(by_id))
    before = set(resources(bench))
    by_id.unlink()
    assert before & set(resources(bench))
    by_id.symlink_to(tmp_path / "ttyUSB1")
    assert before & set(resources(bench))


def test_drive_and_encoder_each_have_a_port() -> None:
    found = resources(serial_bench("/dev/none1", "/dev/none0"))
    assert found == (
        Resource("/dev/none0", "port /dev/none0"),
        Resource("/dev/none1", "port /dev/none1"),
    )


def test_an_encoder_line_beside_a_can_bus() -> None:
    bench = can_bench("socketcan", "can0")
    assert isinstance(bench.encoder, EncoderSection)
    assert len(resources(bench)) == 1
    bench = bench.model_copy(update={"encoder": Amt21Section(kind="amt21", port="/dev/none0")})
    assert [part.key for part in resources(bench)] == ["/dev/none0", "socketcan:can0"]
