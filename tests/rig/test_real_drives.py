"""Benches whose drive has only the objects of a maker's EDS file, from check to a finished run."""

import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

from drivers.units import ServoScales
from rig.cli.entry import status
from rig.common.errors import InputError
from rig.config.bench import load_bench
from rig.config.canopen import ServoSection
from rig.config.configuration import resolve
from rig.config.serial_bus import NO_WATCHDOG
from rig.control.check import describe, examine
from rig.runs.mcap.reader import read_run
from rig.wiring.connect import connect, servo_data
from rig.wiring.devices import watcher, watcher_of
from rig.wiring.scales import servo_scales
from tests.drivers.makes import LACKS, description

from .benches import stages, swing

SHORT = stages(swing("empty", 4, 0.5, duration_s=2))


WATCHED = {"Elmo": (False, True), "Nanotec": (True, True), "Copley": (True, True)}
"""Whether supply and temperature of a make are watched over CAN; those of the others are not."""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(SHORT)
    return tmp_path


def bench(make: str, keys: str = "", packaged: str = "practical", eds: str = "") -> str:
    Path("drive.eds").write_text(eds or description(make))
    text = resolve(packaged, "benches").read_text()
    assert "servo: {" in text
    Path("bench.yaml").write_text(text.replace("servo: {", f"servo: {{eds: drive.eds, {keys}", 1))
    return "bench.yaml"


@pytest.mark.parametrize(
    ("make", "packaged"),
    [
        *((make, "practical") for make in LACKS),
        *(
            pytest.param(
                make, "practical_serial", marks=() if make == "EPOS4" else pytest.mark.proof
            )
            for make in LACKS
            if make != "EPOS2"
        ),
    ],
)
def test_a_drive_of_this_make_runs_and_what_is_not_watched_is_told(here, make, packaged, capsys):
    name = bench(make, packaged=packaged)
    assert status(["check", name]) == 0
    shown = capsys.readouterr().out
    supply, temperature = WATCHED.get(make, (False, False))
    if make == "EPOS4":
        # Its own objects can be read singly, and on a serial line in the cycle.
        supply = temperature = packaged == "practical_serial"
    assert ("not monitored: supply voltage" in shown) is not supply
    assert ("not monitored: temperature" in shown) is not temperature
    assert ("no such limit in the drive: motor current (6073h)" in shown) is (0x6073 in LACKS[make])
    assert ("has none" in shown) is bool({0x6072, 0x6073, 0x607F} & LACKS[make])
    assert status(["run", "short.yaml", "--bench", name, "--yes", "--out", "o"]) == 0
    shown = capsys.readouterr()
    assert ("not monitored: supply voltage" in shown.out + shown.err) is not supply
    record = json.loads(Path("o/run.json").read_text())
    assert (record["state"], record["de_energised"]) == ("done", True)
    samples = read_run(here / "o/recording.mcap").samples
    assert all(math.isnan(value) is not temperature for value in samples["temperature"])
    if supply:
        assert samples["supply_voltage"][-1] == pytest.approx(60, abs=0.5)
    if temperature:
        assert samples["temperature"][-1] == pytest.approx(25)
    assert all(math.isfinite(value) for value in samples["current"])


def test_the_limits_are_those_of_a_drive_without_watchdog_unless_the_bench_says_more(here):
    cut = load_bench(bench("Trinamic")).value
    assert (cut.watched, cut.limits.torque_N_m) == (False, pytest.approx(0.6 * 75))
    assert watcher_of(cut).kind == "nobody"
    told = load_bench(bench("Trinamic", "stops_alone: true, "))
    assert (told.value.watched, told.value.limits.torque_N_m) == (True, 75)
    with connect(told, 0, realtime=False) as devices:
        assert devices.link.has_watchdog
    assert load_bench(bench("EPOS4")).value.limits.torque_N_m == 75
    assert not load_bench(bench("EPOS4", "stops_alone: false, ")).value.watched


def scales(name: str) -> ServoScales:
    document = load_bench(name)
    assert isinstance(document.value.servo, ServoSection)
    return servo_scales(document.value.servo, document.value.machine, servo_data(document))


def test_the_maker_s_units_are_used_until_the_bench_says_otherwise(here: Path) -> None:
    rpm = 2 * math.pi / 60
    known = scales(bench("EPOS4"))
    assert (known.current_object, known.named_current_unit_A) == ((0x30D1, 2), 1e-3)
    assert (known.supply_object, known.supply_unit_V) == ((0x2200, 1), 0.1)
    assert known.rated_torque_object_unit_N_m == 1e-6
    assert known.motor_speed_unit_rad_s == pytest.approx(rpm)
    assert known.named_objects == ()
    keys = "velocity_unit: counts_per_s, supply_object: [0x6064, 0], supply_unit_V: 2, "
    stated = scales(bench("EPOS4", keys))
    assert stated.motor_speed_unit_rad_s == pytest.approx(2 * math.pi / 4096)
    assert (stated.supply_object, stated.supply_unit_V) == ((0x6064, 0), 2)
    assert stated.named_objects == ((0x6064, 0),)
    other = scales(bench("EPOS4", "supply_object: [0x6064, 0], "))
    assert other.supply_unit_V == 1e-3
    none = scales(bench("EPOS4", "device: none, "))
    assert (none.current_object, none.supply_object) == (None, (0x6079, 0))
    chosen = scales(bench("Elmo", "device: copley, "))
    assert chosen.motor_speed_unit_rad_s == pytest.approx(0.1 * 2 * math.pi / 4096)


def shortened(make: str, *indices: str) -> str:
    return re.sub(rf"(?ms)^\[({'|'.join(indices)})(sub\d+)?\].*?(?=^\[)", "", description(make))


@pytest.mark.parametrize(
    ("lacks", "watched"), [(("1016",), True), (("1016", "100D"), False), (("100C", "100D"), True)]
)
def test_a_drive_without_a_heartbeat_consumer_is_guarded_or_has_reduced_limits(
    here: Path, lacks: tuple[str, ...], watched: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    name = bench("Technosoft", eds=shortened("Technosoft", *lacks))
    loaded = load_bench(name).value
    assert (loaded.watched, loaded.limits.torque_N_m) == (watched, 75 if watched else 45)
    assert status(["check", name, "--json", "check.json"]) == 0
    told = json.loads(Path("check.json").read_text())
    assert (told["good"], told["has_watchdog"]) == (True, watched)
    assert told["watched_by"] == ("drive" if watched else "nobody")
    assert (NO_WATCHDOG in capsys.readouterr().out) is not watched
    assert status(["run", "short.yaml", "--bench", name, "--yes", "--out", "o"]) == 0
    record = json.loads(Path("o/run.json").read_text())
    assert (record["state"], record["de_energised"]) == ("done", True)
    shown = capsys.readouterr()
    assert (NO_WATCHDOG in shown.out + shown.err) is not watched


@pytest.mark.parametrize("behaviour", [0, pytest.param(2, marks=pytest.mark.proof)])
def test_a_drive_that_leaves_operational_without_its_master_is_commissioned(here, behaviour):
    eds, count = re.subn(
        r"(?s)(\[1029sub1\].*?DefaultValue=)[^\n]*",
        rf"\g<1>{behaviour}",
        description("Elmo"),
        count=1,
    )
    words = ["commission", bench("Elmo", eds=eds), "--yes", "--angle", "0", "--out", "o"]
    assert (count, status(words)) == (1, 0)
    record = json.loads(Path("o/commission.json").read_text())
    assert record["drive"]["verified"] is True


@pytest.mark.parametrize("address", [(0x60C2, 1), (0x1016, 1)])
def test_an_object_that_only_the_eds_has_is_a_problem_of_the_check(here, address):
    document = load_bench(bench("Elmo"))

    def attach(made: Any) -> Any:
        del made.drive.objects.entries[address[0] << 8 | address[1]]
        return made.clock

    with connect(document, 0, realtime=False, attach=attach) as devices:
        found, readings = examine(document, devices, 0, [])
    assert not found["good"]
    assert any(f"{address[0]:04X}h:{address[1]:02X}h" in text for text in found["problems"])
    assert "NOT good" in describe(found, readings, watcher(devices))


def of_axis(offset: int) -> str:
    """Return the EDS of a make for another axis of a device with several."""
    return re.sub(
        r"(?m)^\[6([0-7])",
        lambda head: f"[{0x60 + offset // 0x100 + int(head[1]):02X}",
        description("Elmo"),
    )


def test_the_second_axis_of_a_node_runs(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = bench("Elmo", "object_offset: 0x800, ", eds=of_axis(0x800))
    assert load_bench(name).value.watched
    assert status(["check", name]) == 0
    assert status(["run", "short.yaml", "--bench", name, "--yes", "--out", "o"]) == 0
    capsys.readouterr()
    assert status(["check", bench("Elmo", eds=of_axis(0x800))]) == 2
    assert "6040h:00h is not in the device's EDS" in capsys.readouterr().err


@pytest.mark.parametrize("keys", ["object_offset: 0x400, ", "sub_index: 9, "])
def test_an_axis_that_cannot_be_is_refused(here: Path, keys: str) -> None:
    with pytest.raises(InputError):
        load_bench(bench("Elmo", keys))
