"""Two programs on one bench and on one run folder, as users start them."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.canopen.link import CanopenLink
from drivers.clock import NS, SimulatedClock
from drivers.errors import LinkError
from rig.cli.entry import status
from rig.common import locks
from rig.common.errors import InputError, InUseError
from rig.common.locks import OWNER_FILE, Lock, Resource, hold_bench, lock_files
from rig.config.bench import Bench, load_bench
from rig.config.canopen import Bus, EncoderSection
from rig.config.serial_bus import Amt21Section, SerialBus
from rig.control import attendance
from rig.control.attendance import when_free
from rig.runs.run import create_folder
from rig.runs.run_file import read_record
from rig.terminal.stop_button import StopButton
from rig.wiring import connect as connect_module
from rig.wiring.connect import connect, resources

from .pty_bench import PtyBench, pty_bench

RIG = [sys.executable, "-c", "import sys; from rig.cli.entry import main; main()"]
MASS, ANGLE = "Mass on the lever", "Joint angle"
"""What the prompts begin with."""


@dataclass
class Rig:
    """A ``rig`` command in a process of its own, at a prompt."""

    process: subprocess.Popen[bytes]

    def wait_for(self, prompt: str) -> None:
        """Read what it says until it asks."""
        said = b""
        while not said.endswith(prompt.encode()):
            letter = self.process.stderr.read(1)
            assert letter, said.decode()
            said += letter

    def answer(self, words: str) -> None:
        self.process.stdin.write(f"{words}\n".encode())
        self.process.stdin.flush()

    def end(self) -> int:
        self.process.communicate(timeout=60)
        return self.process.returncode

    def kill(self) -> None:
        """Kill it as the system does when memory runs out."""
        self.process.kill()
        self.process.communicate()


@contextmanager
def rig(*arguments: str) -> Iterator[Rig]:
    pipe = subprocess.PIPE
    env = os.environ | {"CAN_CONFIG": '{"sleep_after_open": 0.0}'}
    with subprocess.Popen(
        [*RIG, *arguments], stdin=pipe, stdout=pipe, stderr=pipe, env=env
    ) as process:
        try:
            yield Rig(process)
        finally:
            process.kill()


def seconds(bench: PtyBench, sequence: Path, out: Path) -> list[list[str]]:
    file = str(bench.path)
    return [
        ["check", file],
        ["jog", file],
        ["jog", file, "--to", "1"],
        ["run", str(sequence), "--bench", file, "--out", str(out), "--wait", "0.1"],
    ]


def settled(bench: PtyBench) -> int:
    """Return how many bytes the bench has read, once that stands still."""
    before, now = -1, bench.bytes_sent()
    while now != before:
        time.sleep(0.1)
        before, now = now, bench.bytes_sent()
    return now


@pytest.mark.parametrize("kind", ["serial", pytest.param("slcan", marks=pytest.mark.proof)])
def test_the_second_program_on_a_bench_is_refused(kind, tmp_path, short_sequence, capsys):
    # The limits of a serial bench are cut.
    text = short_sequence.read_text().replace("amplitude_deg: 5", "amplitude_deg: 1")
    # With weights a run on a real bench would first be refused for want of a terminal.
    short_sequence.write_text(text.replace("stage: loaded, weight_kg: 10", "stage: unloaded"))
    with pty_bench(kind, tmp_path) as bench, rig("jog", str(bench.path)) as first:
        first.wait_for(ANGLE)
        before = settled(bench)
        for words in seconds(bench, short_sequence, tmp_path / "out"):
            assert status(words) == 4
            said = capsys.readouterr()
            refused = [line for line in said.err.splitlines() if line.startswith("in use: ")]
            assert refused[0].startswith(
                f"in use: bench practical{'_serial' * (kind == 'serial')} (port {bench.port}) is "
            )
            assert f"is in use by `rig jog` (process {first.process.pid}, user " in said.err
            assert len(said.out.splitlines()) <= 1
        assert bench.bytes_sent() == before
        assert not (tmp_path / "out").exists()
        first.answer("")
        assert first.end() == 0
        with hold_bench("free", resources(load_bench(bench.path).value), "test") as lock:
            assert lock.taken_over is None


def test_a_run_waits_for_a_bench_that_is_in_use(tmp_path):
    part, clock, said = Resource("simulated", "port simulated"), SimulatedClock(), []
    first = hold_bench("wired", [part], "rig jog", tmp_path)
    clock.call_at(20 * NS, first.release)

    def hold() -> Lock:
        return hold_bench("wired", [part], "rig run", tmp_path)

    with pytest.raises(InUseError):
        when_free(hold, 10.0, said.append, clock)
    assert clock.now_ns() == 10 * NS
    with when_free(hold, 30.0, said.append, clock) as lock:
        assert lock.descriptors
    assert clock.now_ns() == 20 * NS
    assert ["`rig jog`" in words for words in said] == [True, True]


@pytest.mark.parametrize("at", [1, 2, 4])
def test_a_stop_of_the_console_ends_the_wait_for_a_bench_as_ctrl_c_does(monkeypatch, at) -> None:
    stop, asked = StopButton(), []

    def listen() -> None:
        asked.append(None)
        if len(asked) == at:
            stop.press("STOP by the console")

    def busy(*_: object) -> None:
        raise InUseError("in use")

    stop.listen = listen
    monkeypatch.setattr(attendance, "connect", busy)
    monkeypatch.setattr(attendance, "RealClock", SimulatedClock)
    with (
        pytest.raises(KeyboardInterrupt),
        attendance.connected(stop, load_bench("practical"), 0, False, wait_s=60.0),
    ):
        pass
    assert (len(asked), stop.presses) == (at, 1)


def test_who_waits_for_a_bench_is_seen_by_rig_off_and_holds_nothing(tmp_path):
    part, clock = Resource("simulated", "port simulated"), SimulatedClock()
    files = lock_files([part], tmp_path)
    opened = []

    def seen(_words: str) -> None:
        clock.call_at(NS, lambda: opened.append(open_files()))

    def open_files() -> int:
        folder = Path("/proc/self/fd")
        return sum(os.path.realpath(f) == os.path.realpath(files[0]) for f in folder.iterdir())

    first = hold_bench("wired", [part], "rig jog", tmp_path)
    clock.call_at(2 * NS, first.release)
    with when_free(
        lambda: hold_bench("wired", [part], "rig run", tmp_path), 9.0, seen, clock, files
    ):
        assert opened == [2], "one of the holder, one of the program that waits"
    assert open_files() == 0


def test_a_bench_is_held_from_before_it_is_opened_until_after_it_is_closed(tmp_path, monkeypatch):
    part = Resource("simulated", "port simulated")
    monkeypatch.setattr(connect_module, "resources", lambda bench: (part,))
    monkeypatch.setattr(locks, "LOCK_FOLDER", tmp_path)

    def in_use() -> str:
        try:
            hold_bench("other", [part], "rig check").release()
        except InUseError as error:
            return "rig jog" if "by `rig jog` on bench practical" in str(error) else "another"
        return "free"

    seen: list[tuple[str, str]] = []
    link_open, link_close = CanopenLink.open, CanopenLink.close

    def watched_open(link: CanopenLink) -> None:
        seen.append(("open", in_use()))
        link_open(link)

    def watched_close(link: CanopenLink) -> None:
        link_close(link)
        seen.append(("close", in_use()))

    monkeypatch.setattr(CanopenLink, "open", watched_open)
    monkeypatch.setattr(CanopenLink, "close", watched_close)
    with connect(load_bench("practical"), 0, False, purpose="rig jog") as devices:
        assert in_use() == "rig jog"
        assert len(devices.lock.descriptors) == 1
    assert seen == [("open", "rig jog"), ("close", "rig jog")]
    assert in_use() == "free"

    def fail(link: CanopenLink) -> None:
        raise LinkError("no cable")

    monkeypatch.setattr(CanopenLink, "open", fail)
    with pytest.raises(LinkError), connect(load_bench("practical"), 0, False):
        pass
    assert in_use() == "free"


def content(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_run_that_is_still_going_is_neither_recovered_nor_resumed(
    tmp_path: Path, short_sequence: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    with rig("run", str(short_sequence), "--out", str(run)) as first:
        first.wait_for(MASS)
        before = content(run)
        assert {"run.json", "recording.mcap", OWNER_FILE} <= set(before)
        for words in (
            ["recover"],
            ["resume", "--yes"],
            ["run", str(short_sequence), "--yes", "--out"],
        ):
            assert status([*words, str(run)]) == 4
            said = capsys.readouterr()
            assert said.err.startswith(
                f"in use: run folder {run} is in use by `rig run` (process {first.process.pid}, "
            )
            assert len(said.out.splitlines()) <= 1
        assert content(run) == before
        first.answer("0")
        first.wait_for(MASS)
        first.answer("10")
        assert first.end() == 0
    assert not (run / OWNER_FILE).exists()
    assert status(["recover", str(run)]) == 0
    said = capsys.readouterr()
    assert "recording complete" in said.out
    assert not said.err
    assert read_record(run).state == "done"


def test_a_run_whose_program_was_killed_is_taken_over_and_said(tmp_path, short_sequence, capsys):
    run, moved = tmp_path / "run", tmp_path / "moved"
    with rig("run", str(short_sequence), "--out", str(run)) as first:
        first.wait_for(MASS)
        first.kill()
    run.rename(moved)
    assert status(["resume", str(moved), "--yes"]) == 0
    said = capsys.readouterr()
    assert (
        f"run folder {moved} was left locked by `rig run` on run folder {run} (process "
        f"{first.process.pid}" in said.err
    )
    assert not (moved / OWNER_FILE).exists()


def test_a_left_over_file_does_not_fill_a_folder(tmp_path: Path) -> None:
    (tmp_path / OWNER_FILE).write_text("left")
    with create_folder(tmp_path, "rig run") as lock:
        assert lock.taken_over is not None
    assert not list(tmp_path.iterdir())
    (tmp_path / OWNER_FILE).touch()
    with create_folder(tmp_path, "rig run") as lock:
        assert lock.taken_over is None


def test_two_runs_do_not_get_one_folder(tmp_path: Path) -> None:
    path = tmp_path / "runs" / "new"
    with create_folder(path, "rig run"):
        with pytest.raises(InUseError, match=f"run folder {path} is in use by `rig run`"):
            create_folder(path, "rig run")
        (path / "run.json").touch()
    with pytest.raises(InputError, match=r"not empty \(holds run.json\)"):
        create_folder(path, "rig run")
    assert [item.name for item in path.iterdir()] == ["run.json"]


def can_bench(interface: str, channel: str | None) -> Bench:
    return load_bench("practical").value.model_copy(
        update={"bus": Bus(interface=interface, channel=channel)}
    )


def serial_bench(drive: str, encoder: str) -> Bench:
    bus = SerialBus(interface="epos_serial", port=drive)
    update = {"bus": bus, "encoder": Amt21Section(kind="amt21", port=encoder)}
    return load_bench("practical_serial").value.model_copy(update=update)


@pytest.mark.parametrize("name", ["practical", "practical_serial", "practical_dbc", "odrive_can"])
def test_a_simulated_bench_uses_nothing_that_others_could(name: str) -> None:
    assert resources(load_bench(name).value) == ()


@pytest.mark.parametrize(
    ("interface", "channel", "expected"),
    [
        ("socketcan", "can0", Resource("socketcan:can0", "socketcan channel can0")),
        ("kvaser", None, Resource("kvaser:", "kvaser channel by default")),
        ("slcan", "/dev/none0", Resource("/dev/none0", "port /dev/none0")),
        ("seeedstudio", "/dev/../dev/none0", Resource("/dev/none0", "port /dev/../dev/none0")),
        ("slcan", "/dev/no\0ne", Resource("/dev/no\0ne", "port /dev/no\0ne")),
    ],
)
def test_a_channel_is_a_device_or_a_name(interface, channel, expected):
    assert resources(can_bench(interface, channel)) == (expected,)


def test_a_port_is_the_same_under_all_its_names(tmp_path, monkeypatch):
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


def test_an_encoder_line_beside_a_can_bus() -> None:
    bench = can_bench("socketcan", "can0")
    assert isinstance(bench.encoder, EncoderSection)
    assert len(resources(bench)) == 1
    bench = bench.model_copy(update={"encoder": Amt21Section(kind="amt21", port="/dev/none0")})
    assert [part.key for part in resources(bench)] == ["/dev/none0", "socketcan:can0"]
