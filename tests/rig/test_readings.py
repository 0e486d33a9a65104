"""Live readings of `rig check`: what is shown, and which end a run as soon as it begins."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import pytest

import rig.wiring.connect
from drivers.mock.bench import SimulatedBench, simulated_bench
from rig.cli.entry import status
from rig.common.errors import Cause
from rig.config.bench import load_bench
from rig.config.serial_bus import UNWATCHED_SHARE
from rig.control.readings import NOT_AVAILABLE, Readings, reading_findings
from rig.planning.limits import Limits
from rig.planning.plan import bench_limits
from rig.wiring.devices import Watcher, bench_line, watcher_of

from .benches import variant

LIMITS = bench_limits(load_bench("practical").value)
CALM = Readings("switch on disabled", 0.1, 0.1, 0.0, 0.0, 60.0, 25.0, None)
HOT = bench_limits(load_bench("practical_hot").value)


def found(limits: Limits = LIMITS, **changes: float) -> list[str]:
    findings = list(reading_findings(dataclasses.replace(CALM, **changes), limits))
    assert all(finding.cause is Cause.READINGS and finding.refused for finding in findings)
    return [finding.text for finding in findings]


@pytest.mark.parametrize(
    ("name", "inside", "words"),
    [
        ("supply_V", LIMITS.supply_min, "DC link voltage"),
        ("supply_V", LIMITS.supply_max, "DC link voltage"),
        ("temperature_C", LIMITS.temperature, "motor temperature"),
        ("speed_rad_s", LIMITS.speed, "joint speed"),
        ("current_A", LIMITS.current, "motor current"),
        ("motor_encoder_at_joint_rad", 0.1 + 0.999 * LIMITS.encoder_disagreement, "encoder "),
        ("motor_encoder_at_joint_rad", 0.1 - 0.999 * LIMITS.encoder_disagreement, "encoder "),
    ],
)
def test_both_sides_of_each_reading(name: str, inside: float, words: str) -> None:
    outward = -1 if inside in (LIMITS.supply_min, 0.1 - 0.999 * LIMITS.encoder_disagreement) else 1
    assert found(**{name: inside}) == []
    (text,) = found(**{name: inside + outward * 2e-3 * abs(inside)})
    assert text.startswith(words)


@pytest.mark.parametrize("end", ["angle_min", "angle_max"])
def test_both_ends_of_the_angle(end: str) -> None:
    for share, count in ((0.999, 0), (1.001, 1)):
        at = share * getattr(LIMITS, end)
        texts = found(joint_encoder_rad=at, motor_encoder_at_joint_rad=at)
        assert [text.startswith("joint angle ") for text in texts] == [True] * count


def test_both_sides_of_the_pressure() -> None:
    gas = HOT.gas
    anywhere = dataclasses.replace(HOT, gas=dataclasses.replace(gas, contact_force=math.inf))
    for share, count in ((1.0, 0), (1.001, 1)):
        readings = dataclasses.replace(CALM, pressure_Pa=share * gas.pressure)
        assert len(list(reading_findings(readings, anywhere))) == count


@pytest.mark.parametrize("angle", [-0.1, 0.1, math.nan])
def test_both_sides_of_the_force_that_the_pressure_makes_where_the_valve_is(angle: float) -> None:
    gas = HOT.gas
    force = 2e6 * gas.area(0.0 if math.isnan(angle) else angle)
    readings = dataclasses.replace(
        CALM,
        pressure_Pa=gas.back_pressure + 2e6,
        joint_encoder_rad=angle,
        motor_encoder_at_joint_rad=angle,
    )
    for limit, count in ((force * 1.0001, 0), (force * 0.9999, 1)):
        limits = dataclasses.replace(HOT, gas=dataclasses.replace(gas, contact_force=limit))
        assert [
            f.text.startswith("contact force ") for f in reading_findings(readings, limits)
        ] == [True] * count


@pytest.mark.parametrize("name", ["joint_encoder_rad", "speed_rad_s", "current_A", "temperature_C"])
def test_what_is_not_available_is_shown_so_and_not_judged(name: str) -> None:
    readings = dataclasses.replace(CALM, **{name: math.nan})
    assert list(reading_findings(readings, LIMITS)) == []
    record = readings.record()
    assert record[name] is None
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert [NOT_AVAILABLE, ""] in [row[1:] for row in readings.rows()]
    assert NOT_AVAILABLE not in [cell for row in CALM.rows() for cell in row]


def moved(*arguments: Any) -> SimulatedBench:
    """Return a simulated bench whose joint stands elsewhere, by a coupling that slipped."""
    bench = simulated_bench(*arguments)
    bench.encoder.distort = lambda counts: counts + 728  # one degree
    return bench


def test_check_shows_what_the_bench_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(rig.wiring.connect, "simulated_bench", moved)
    path = variant(tmp_path, ("supply_V: 60", "supply_V: 40"))
    assert status(["check", str(path), "--json", str(tmp_path / "c.json")]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"simulated bench practical ({path})"
    rows = {line.split("  ")[0]: line.split()[-2:] for line in lines}
    assert rows["difference of the two"] == ["-1.000", "deg"]
    assert rows["supply voltage"] == ["40.0", "V"]
    record = json.loads((tmp_path / "c.json").read_text())
    readings = record["readings"]
    assert readings["joint_encoder_rad"] == pytest.approx(math.radians(1), abs=1e-4)
    assert [readings[key] for key in ("supply_V", "speed_rad_s", "current_A")] == [40.0, 0.0, 0.0]
    assert (record["real"], record["good"], record["causes"]) == (False, False, ["readings"])
    assert (record["watched_by"], record["watch_s"]) == ("drive", 0.1)


REAL = ("interface: mock", "interface: virtual, channel: nobody")
SERIAL = (
    ("port: mock, baud: 1000000", "port: /dev/none, baud: 1000000"),
    ("port: mock, baud: 2", "port: /dev/no, baud: 2"),
)
UNWATCHED = ("watchdog_ms: 100", "watchdog_ms: null")


@pytest.mark.parametrize(
    ("source", "changes", "real", "watch"),
    [
        ("practical", (), False, Watcher("drive", 0.1)),
        ("practical_serial", (), False, Watcher("nobody")),
        ("practical_serial", SERIAL, True, Watcher("guardian", 0.2)),
        ("practical_dbc", (UNWATCHED,), False, Watcher("nobody")),
    ],
)
def test_the_first_line_says_real_in_capitals_and_the_file_says_who_watches(
    tmp_path: Path, source: str, changes: tuple[tuple[str, str], ...], real: bool, watch: Watcher
) -> None:
    path = variant(tmp_path, *changes, source=source)
    document = load_bench(path)
    assert bench_line(document) == f"{'REAL' if real else 'simulated'} bench {source} ({path})"
    assert watcher_of(document.value) == watch
    assert ("NOBODY" in watch.words) is (watch.kind == "nobody")
    assert ("100 ms" in watch.words) is (watch.kind == "drive")
    assert ("200 ms" in watch.words) is (watch.kind == "guardian")
    share = 1.0 if watch.kind == "drive" else UNWATCHED_SHARE
    assert document.value.limits.torque_N_m == pytest.approx(share * 75.0)
