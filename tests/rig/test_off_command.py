"""`rig off`: who is ended and how, and what comes of a drive that answers or does not."""

import dataclasses
import json
import os
import pty
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

import drivers.mock
from benchmarks.adapters import RealTimeBench
from drivers.clock import NS, SimulatedClock
from drivers.errors import LinkError
from drivers.mock.bench import simulated_bench
from drivers.mock.drive import SimulatedEposPort
from drivers.mock.plant.parts.constants import Machine
from drivers.mock.power_state import State
from rig.cli.commands.bench import GOES_ON
from rig.cli.entry import DEVICE_FAILED, DONE, status
from rig.common import locks
from rig.common.errors import InUseError
from rig.common.locks import hold_bench
from rig.config.bench import Bench, load_bench
from rig.config.configuration import Document
from rig.control import off
from rig.control.off import HANDOVER_S, PATIENCE_S, RELEASE_S, Processes, make_off
from rig.wiring.connect import BareBench, bare_bench, bus_resources
from rig.wiring.guardian import HAND_OVER, MODULE, Deed, Ward, drive_on, stop

from ..drivers.host import DRIVE_EDS, DRIVE_NODE, SCALES
from .benches import variant
from .drives import FakeDrive
from .pty_bench import PtyBench, pty_bench
from .test_one_owner import ANGLE, rig

RUN, GUARDIAN = 101, 102


class Servo(FakeDrive):
    def __init__(self) -> None:
        self.reachable = True
        self.told: list[str] = []

    def do(self, verb: str) -> None:
        self.told.append(verb)
        if not self.reachable and verb != "glance":
            raise LinkError("no answer")


class Encoder:
    def reading(self) -> float:
        return 0.0

    def step_rad(self) -> float:
        return 1e-5


class Link:
    has_watchdog = False

    def __init__(self) -> None:
        self.clock = SimulatedClock()
        self.broken = False
        self.opened = self.closed = 0

    def open(self) -> None:
        if self.broken:
            raise LinkError("EPOS4 at /dev/some cannot be opened: no such file")
        self.opened += 1

    def close(self) -> None:
        self.closed += 1


class Fakes(Processes):
    """Processes on a bench, and what each does with a signal."""

    def __init__(self) -> None:
        self.here: dict[int, str] = {}
        self.suspended: set[int] = set()
        self.obeys: dict[int, set[signal.Signals]] = {}
        self.sent: list[tuple[int, signal.Signals]] = []
        self.after: Callable[[int], None] = lambda number: None

    def add(self, number: int, command: str, *obeys: signal.Signals) -> None:
        self.here[number], self.obeys[number] = command, {signal.SIGKILL, *obeys}

    def using(self, files: Iterable[Path]) -> list[int]:
        return sorted(self.here)

    def command(self, number: int) -> str:
        return self.here[number]

    def frozen(self, number: int) -> bool:
        return number in self.suspended

    def send(self, number: int, what: signal.Signals) -> None:
        self.sent.append((number, what))
        if what in self.obeys[number]:
            self.here.pop(number, None)
            self.after(number)


@dataclasses.dataclass
class Desk:
    """A real bench with fake devices, and what was said."""

    document: Document[Bench]
    servo: Servo
    link: Link
    processes: Fakes
    said: list[str]

    def off(self) -> off.Off:
        return make_off(self.document, self.said.append, self.link.clock, self.processes)


@pytest.fixture
def desk(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Desk:
    monkeypatch.setattr(locks, "LOCK_FOLDER", tmp_path / "locks")
    document = load_bench("practical_serial")
    bus = document.value.bus.model_copy(update={"port": "/dev/some"})  # type: ignore[union-attr]
    value = document.value.model_copy(update={"bus": bus})
    link = Link()
    made = Desk(dataclasses.replace(document, value=value), Servo(), link, Fakes(), [])
    bare: Any = BareBench
    monkeypatch.setattr(off, "bare_bench", lambda document: bare(link, made.servo, Encoder()))
    return made


def test_a_bench_that_nobody_uses_is_switched_off(desk: Desk) -> None:
    done = desk.off()
    assert (done.proved, done.users, done.attempts, desk.link.closed) == (True, (), 1, 1)
    assert desk.servo.told[0] == "quick_stop"
    record = done.record()
    assert (record["schema"], record["real"], record["proved"]) == ("loadrig.off/1", True, True)
    assert record["safe"]["state"] == "switch on disabled"
    assert record["safe"]["joint_read"] is True
    assert done.message.endswith("joint at rest")


@pytest.mark.parametrize("eds", ["encoder.eds", "gone.eds"])
def test_an_encoder_without_its_file_does_not_prevent_the_stop(eds: str) -> None:
    document = load_bench("practical")
    value = document.value
    bus = value.bus.model_copy(update={"interface": "virtual"})  # type: ignore[union-attr]
    folder = Path(drivers.mock.__file__).parent
    parts = {
        "bus": bus,
        "servo": value.servo.model_copy(update={"eds": str(folder / "drive.eds")}),
        "encoder": value.encoder.model_copy(update={"eds": str(folder / eds)}),
    }
    bare = bare_bench(dataclasses.replace(document, value=value.model_copy(update=parts)))
    assert (bare.encoder is not None) is (eds == "encoder.eds")


def test_a_program_that_does_not_leave_is_killed_before_anything_is_sent(desk: Desk) -> None:
    desk.processes.add(RUN, "rig run")
    desk.processes.after = lambda number: desk.servo.told.append("alone")
    done = desk.off()
    assert desk.processes.sent == [(RUN, signal.SIGTERM), (RUN, signal.SIGKILL)]
    assert [user.ended for user in done.users] == ["killed"]
    assert desk.servo.told[:2] == ["alone", "quick_stop"]
    assert RELEASE_S <= done.seconds < RELEASE_S + 1.0


def test_a_suspended_program_and_its_guardian_are_not_waited_for(desk: Desk) -> None:
    desk.processes.add(RUN, "rig run", signal.SIGTERM)
    desk.processes.add(GUARDIAN, f"python -m {MODULE} 3", HAND_OVER)
    desk.processes.suspended = {RUN, GUARDIAN}
    done = desk.off()
    assert desk.processes.sent == [(RUN, signal.SIGKILL), (GUARDIAN, signal.SIGKILL)]
    assert [user.ended for user in done.users] == ["killed", "killed"]
    assert done.proved
    assert done.seconds < 0.5


@pytest.mark.parametrize("obeys", [True, False])
def test_a_guardian_hands_over_or_is_killed(desk: Desk, obeys: bool) -> None:
    desk.processes.add(GUARDIAN, f"python -m {MODULE} 3", *([HAND_OVER] if obeys else []))
    done = desk.off()
    sent = [(GUARDIAN, HAND_OVER), *([] if obeys else [(GUARDIAN, signal.SIGKILL)])]
    assert desk.processes.sent == sent
    assert [user.ended for user in done.users] == ["handed over" if obeys else "killed"]
    assert done.seconds < (0.5 if obeys else HANDOVER_S + 0.5)


def test_who_cannot_be_ended_does_not_keep_the_bench_from_being_made_safe(desk: Desk) -> None:
    desk.processes.add(RUN, "rig run")
    desk.processes.obeys[RUN] = set()
    with hold_bench("other", bus_resources(desk.document.value), "rig run"):
        done = desk.off()
    assert [user.ended for user in done.users] == ["stays"]
    assert done.proved
    assert any("acts all the same" in words for words in desk.said)


def test_the_lock_of_a_killed_program_is_waited_for(desk, monkeypatch):
    desk.processes.add(RUN, "rig run")
    held = hold_bench("other", bus_resources(desk.document.value), "rig run")
    refused = 0

    def hold(*words: Any) -> locks.Lock:
        nonlocal refused
        try:
            return hold_bench(*words)
        except InUseError:
            refused += 1
            if refused == 3:
                held.release()
            raise

    monkeypatch.setattr(off, "hold_bench", hold)
    assert desk.off().proved
    assert refused == 3
    assert not any("acts all the same" in words for words in desk.said)


def test_a_drive_that_does_not_answer_is_tried_and_then_said_what_to_do(desk: Desk) -> None:
    desk.servo.reachable = False
    done = desk.off()
    assert not done.proved
    assert done.attempts > 10
    assert PATIENCE_S < done.seconds < PATIENCE_S + 2.0
    assert "main supply" in done.message
    assert sum("trying" in words for words in desk.said) == 1


@pytest.mark.parametrize("moves", [False, True])
def test_current_or_motion_of_a_drive_that_says_off_ends_with_4(desk, tmp_path, monkeypatch, moves):
    desk.servo.current = 0.0 if moves else 3.98
    clock, speed_rad_s = desk.link.clock, 0.1 if moves else 0.0
    monkeypatch.setattr(Encoder, "reading", lambda _self: speed_rad_s * clock.now_ns() / NS)
    bench = variant(tmp_path, ("port: mock", "port: /dev/some"), source="practical_serial")
    file = tmp_path / "off.json"
    assert status(["off", str(bench), "--json", str(file)]) == DEVICE_FAILED
    record = json.loads(file.read_text())
    assert (record["proved"], record["safe"]["verified"]) == (False, False)
    assert record["safe"]["state"] == "switch on disabled"
    assert record["safe"]["current_A"] == pytest.approx(desk.servo.current)
    assert record["safe"]["motion_rad_s"] == pytest.approx(speed_rad_s, rel=0.1)
    assert ("the joint moves" if moves else "3.98 A") in record["message"]
    assert record["attempts"] > 1


def test_a_port_that_is_back_while_it_is_tried_is_used(desk: Desk) -> None:
    desk.link.broken = True

    def say(words: str) -> None:
        desk.link.broken = desk.link.broken and "trying" not in words

    done = make_off(desk.document, say, desk.link.clock, desk.processes)
    assert (done.proved, done.attempts, desk.link.opened) == (True, 2, 1)


@pytest.fixture
def wired(tmp_path: Path) -> Iterator[PtyBench]:
    with pty_bench("serial", tmp_path) as bench:
        yield bench


def test_a_program_that_uses_the_bench_ends_as_if_it_were_stopped(wired, tmp_path):
    file = tmp_path / "off.json"
    with rig("jog", str(wired.path)) as first:
        first.wait_for(ANGLE)
        assert status(["off", str(wired.path), "--json", str(file)]) == DONE
        assert first.end() == 3
    record = json.loads(file.read_text())
    assert [(user["command"], user["ended"]) for user in record["users"]] == [
        ("rig jog", "stopped")
    ]
    assert (record["safe"]["verified"], record["safe"]["joint_read"]) == (True, True)


def test_a_suspended_program_that_uses_the_bench_is_killed(wired: PtyBench, tmp_path: Path) -> None:
    file = tmp_path / "off.json"
    with rig("jog", str(wired.path)) as first:
        first.wait_for(ANGLE)
        first.process.send_signal(signal.SIGSTOP)
        processes = Processes()
        while not processes.frozen(first.process.pid):
            time.sleep(0.001)
        assert "jog" in processes.command(first.process.pid)
        assert status(["off", str(wired.path), "--json", str(file)]) == DONE
        assert first.end() == -signal.SIGKILL
    assert json.loads(file.read_text())["users"][0]["ended"] == "killed"


def test_ctrl_c_is_answered_at_once_and_a_second_one_ends_it(wired, tmp_path):
    ours, theirs = pty.openpty()
    wired.path.write_text(wired.path.read_text().replace(wired.port, os.ttyname(theirs)))
    file = tmp_path / "off.json"
    with rig("off", str(wired.path), "--json", str(file)) as command:
        command.wait_for("proof that the drive is off")
        command.process.send_signal(signal.SIGINT)
        began = time.monotonic()
        command.wait_for(GOES_ON)
        assert time.monotonic() - began < 0.5
        began = time.monotonic()
        command.process.send_signal(signal.SIGINT)
        _, err = command.process.communicate(timeout=60)
        assert time.monotonic() - began < 1.5
        assert command.process.returncode == DEVICE_FAILED
    os.close(ours)
    os.close(theirs)
    assert b"it could NOT be verified that the drive is de-energised" in err
    record = json.loads(file.read_text())
    assert record["proved"] is False
    assert "switch the main supply off" in record["message"]


def dead_terminal() -> int:
    ours, theirs = pty.openpty()
    os.close(ours)
    return theirs


def test_a_guardian_reaches_the_drive_again_when_the_adapter_is_back(tmp_path: Path) -> None:
    bench = simulated_bench(Machine(), 0)
    ports = RealTimeBench(bench.clock)
    path = ports.open_pty(SimulatedEposPort(bench.bus, bench.clock, bench.drive))
    name = tmp_path / "by-id"
    drive = {"name": "EPOS4", "port": str(name), "baud": 1_000_000, "node": DRIVE_NODE}
    scales = {"eds": str(DRIVE_EDS), "scales": dataclasses.asdict(SCALES)}
    servo, clock = drive_on(dead_terminal(), Ward({**drive, **scales}))
    failed: list[Deed] = []

    def plugged(deed: Deed) -> None:
        failed.append(deed)
        if len(failed) == 2:
            name.symlink_to(path)

    with ports:
        deed = stop(servo, clock, failed=plugged)
    assert (deed.safe.verified, deed.attempts) == (True, 3)
    assert bench.drive.power_state is State.SWITCH_ON_DISABLED
    # The time of a teardown, not that of a person who looks for the plug.
    assert deed.seconds - failed[1].seconds < 1.0
    bench.bus.shutdown()
