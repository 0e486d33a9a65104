"""``rig commission --home``: the drive sets its zero by its own homing, or ends de-energised."""

import json
from pathlib import Path
from typing import Any

import pytest

from drivers.mock.drive import DRIVE_EDS, Homing
from drivers.mock.plant.machine import SimulatedMachine
from rig.cli.entry import status
from rig.common.sample import Sample
from rig.config.bench import load_bench
from rig.control.cycle import Cycle
from rig.planning.limits import Limits
from rig.runs.mcap.reader import read_run

from .benches import variant
from .test_commission import SLOW, answers, commissioned, fastest_deg_s, here

__all__ = ["here"]

FAILURES = {
    ("home_jammed", 17): "the drive reports a homing error (6041h bit 13)",
    ("home_endless", 37): "has not ended after 5 s, limit 5 s",
    ("home_switch", 18): "limit 0.5236 rad (30 deg); look for a switch that does not close",
}


def commissioned_record() -> dict[str, Any]:
    record: dict[str, Any] = json.loads(Path("out/commission.json").read_text())
    return record


def step_of(record: dict[str, Any], name: str = "homing") -> dict[str, Any]:
    return next(step for step in record["sessions"][-1] if step["name"] == name)


def measured(record: dict[str, Any]) -> dict[str, str]:
    """Return name and value of what the homing measured; of two passes, the second's."""
    return {item["name"]: item["value"] for item in step_of(record)["measured"]}


def ends_off(record: dict[str, Any]) -> bool:
    """Return whether the drive is verified off, and in the bench's mode."""
    drive, mode = record["drive"], measured(record)["mode of operation afterwards, 6061h"]
    return bool(drive["verified"]) and drive["state"] == "switch on disabled" and mode == "8"


@pytest.mark.parametrize("angle", ["0", "2.5"])
def test_the_present_position_is_the_zero(here: Path, angle: str) -> None:
    # The joint stands at 0: where it is said to stand at 2.5, the encoder's zero is corrected.
    ended, record = commissioned("--home", "37", "--angle", angle)
    assert (ended, record["state"], record["schema"]) == (0, "done", "loadrig.commission/1")
    names = [step["name"] for step in record["sessions"][-1]]
    assert names.index("homing") == names.index("limits") + 1
    step, found = step_of(record), measured(record)
    assert (step["verdict"], step["consent"]) == ("good", "--yes")
    assert (found["method, 6098h"], found["servo.offset_deg of the bench file"]) == ("37", "0")
    counts = round(float(angle) / 360 * 100 * 4096)
    assert int(found["written and read back, 607Ch"]) == counts
    assert float(found["angle by the drive afterwards"]) == pytest.approx(float(angle), abs=0.02)
    changes = {c["key"]: c["value"] for c in record["changes"]}
    assert set(changes) == ({"encoder.offset_deg"} if angle != "0" else set())
    assert ends_off(record)


def test_a_switch_is_homed_to_after_the_stop_is_proven(here: Path) -> None:
    ended, record = commissioned("--home", "17", "--home-angle", "-20")
    assert ended == 0
    names = [step["name"] for step in record["sessions"][-1]]
    assert names[names.index("homing") - 1] == "stop"
    assert names[-1] == "large move"
    found = measured(record)
    assert int(found["written and read back, 607Ch"]) == round(-20 / 360 * 100 * 4096)
    assert float(found["angle by the drive afterwards"]) == pytest.approx(-20, abs=0.1)
    assert fastest_deg_s(100.0) < 12.0
    assert ends_off(record)
    page = Path("out/report.html").read_text()
    assert "THE JOINT TURNS BY ITSELF" in page
    assert "607Ch" in page


def test_an_unknown_home_position_is_found_by_the_joint_encoder(here: Path) -> None:
    ended, record = commissioned("--home", "18")
    assert ended == 0
    offsets = [
        int(item["value"]) for item in step_of(record)["measured"] if "607Ch" in item["name"]
    ]
    assert offsets[0] == 0
    assert offsets[1] == pytest.approx(20 / 360 * 100 * 4096, abs=50)


@pytest.mark.parametrize(("mistake", "method"), FAILURES)
def test_a_homing_that_fails_ends_de_energised(here: Path, mistake: str, method: int) -> None:
    ended, record = commissioned("--home", str(method), "--mistake", mistake)
    assert (ended, record["state"]) == (1, "tripped")
    assert FAILURES[mistake, method] in record["message"]
    assert "look for" in record["message"]
    assert "The zero of the drive counts as not set" in record["message"]
    assert record["sessions"][-1][-1]["name"] == "homing"
    assert ends_off(record)


@pytest.mark.parametrize(
    ("error", "ended", "state"), [(None, 3, "stopped"), (RuntimeError("x"), 5, "crashed")]
)
def test_however_it_is_ended_the_drive_is_read_back_as_off(here, monkeypatch, error, ended, state):
    attend, calls = Cycle.attend, [0]

    def interrupted(self: Cycle, limits: Limits) -> Sample:
        calls[0] += 1
        if calls[0] == 200:
            if error is not None:
                raise error
            self._stop.press("Ctrl-C")
        return attend(self, limits)

    monkeypatch.setattr(Cycle, "attend", interrupted)
    assert commissioned("--home", "17")[0] == ended
    record = commissioned_record()
    assert (record["state"], record["sessions"][0][-1]["name"]) == (state, "homing")
    assert ends_off(record)
    if state != "crashed":
        assert "The zero of the drive counts as not set" in record["message"]
    angle = read_run(Path("out/recording.mcap")).samples["motor_angle"][-1] / 100.0
    assert -0.2 < angle < -0.01


def test_a_lost_bus_leaves_it_to_the_watchdog_and_says_so(here, monkeypatch, capsys):
    attend, calls, power = Cycle.attend, [0], SimulatedMachine.power
    powered: list[bool] = []

    def cut(self: Cycle, limits: Limits) -> Sample:
        calls[0] += 1
        if calls[0] == 200:
            bus = self._link._port  # type: ignore[attr-defined]
            bus.frame_filters.append(lambda *_: None)
        return attend(self, limits)

    def switched(self: SimulatedMachine, on: bool) -> None:
        powered.append(on)
        power(self, on)

    monkeypatch.setattr(Cycle, "attend", cut)
    monkeypatch.setattr(SimulatedMachine, "power", switched)
    ended, record = commissioned("--home", "17")
    assert ended == 4
    assert "The zero of the drive counts as not set" in record["message"]
    assert not record["drive"]["verified"]
    assert "not restored" in measured(record)["mode of operation afterwards, 6061h"]
    assert "could NOT be verified" in " ".join(capsys.readouterr().out.split())
    assert not powered[-1]


def test_a_joint_that_moves_where_it_must_not_ends_it(here, monkeypatch):
    obey = Homing.obey

    def wild(self: Homing) -> None:
        self._values[0x609800], method = 17, self._values[0x609800]
        obey(self)
        self._values[0x609800] = method

    monkeypatch.setattr(Homing, "obey", wild)
    monkeypatch.setattr(Homing, "_closed", lambda *_: False)
    ended, record = commissioned("--home", "37")
    assert ended == 1
    said = "in a homing without motion (method 37); it may move by at most 0.2 deg"
    assert said in record["message"]
    assert ends_off(record)


def test_a_drive_that_takes_the_offset_with_the_other_sign_is_found(here, monkeypatch):
    def other(self: Homing, counts: int) -> None:
        self.shift = -self._values[0x607C00] - counts

    monkeypatch.setattr(Homing, "_set_zero", other)
    ended, record = commissioned("--home", "17", "--home-angle", "-20")
    assert record["changes"][0]["key"] == "servo.offset_deg"
    assert record["changes"][0]["value"] == -20.0
    words = next(s["words"] for s in record["sessions"][0] if s["name"] == "homing")
    assert "the drive uses the home offset 607Ch with the opposite sign" in words
    assert ended in (0, 1)


def test_without_consent_it_is_not_energised(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    powered: list[bool] = []
    monkeypatch.setattr(SimulatedMachine, "power", lambda _self, on: powered.append(on))
    answers(monkeypatch, "yes", "0", "yes", "no")
    assert status(["commission", "bench.yaml", "--out", "out", "--home", "37"]) == 3
    assert commissioned_record()["sessions"][0][-1]["name"] == "homing"
    assert True not in powered


def test_a_drive_that_cannot_home_keeps_the_present_ways(here: Path) -> None:
    text, keep = [], True
    for line in DRIVE_EDS.read_text().splitlines():
        if line.startswith("["):
            keep = not line.startswith("[6098")
        text += [line] * keep
    Path("lean.eds").write_text("\n".join(text))
    variant(here, *SLOW, ("servo: {node: 1,", "servo: {node: 1, eds: lean.eds,"))
    ended, record = commissioned("--home", "37", "--angle", "1")
    assert ended == 1
    step = step_of(record)
    assert (step["verdict"], step["consent"]) == ("not tried", "")
    assert load_bench("bench.commissioned.yaml").value.servo.offset_deg == 1.0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--home-angle", "3"), "--home-angle: is an option of a homing"),
        (("--home-time", "3"), "--home-time: is an option of a homing"),
        (("--home", "17", "--home-angle", "50"), "is 50 deg; it must be from -30 to 30 deg"),
    ],
)
def test_options_that_do_not_fit_are_refused(here, capsys, options, words):
    assert status(["commission", "bench.yaml", "--yes", "--out", "out", *options]) == 2
    assert words in capsys.readouterr().err
