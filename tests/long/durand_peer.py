"""The commands of a real bench against a drive and an encoder on an independent CANopen stack.

python -m tests.long.durand_peer [--only WORD] [--wire udp|slcan] [--quick]

The drive (CiA 402) and the encoder (CiA 406) use the package durand, which shares no code with the
library canopen. They are reached by the interface udp_multicast of python-can in a network
namespace of their own, which no packet leaves, or over a pseudo-terminal with the LAWICEL protocol,
whose bytes arrive late on a busy computer. `rig check`, `rig commission` and `rig run` are started
as at a real bench, and their questions are answered at a terminal. A case passes if every command
succeeds, the drive ends without power, and it was in fault only in the step of the commissioning
that provokes a fault.
"""

import argparse
import json
import math
import os
import pty
import re
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can

ROOT = Path(__file__).parents[2]
COUNTS, GEAR, TURN = 4096, 100, 262144
RATED_A, RATED_N_M, KT = 15.0, 0.45, 0.03
CYCLE_S = 0.02
STEP_S = 2e-4
TICK_S, LATE_S = 0.005, 0.02
BUSY = "late by"
REPEATS = 4

BENCH = """\
bench: 1
name: durand_{name}
machine: {{torque_constant_N_m_A: 0.03, back_emf_constant_V_s_rad: 0.02588, resistance_ohm: 1.56,
  inductance_H: 0.00132, gear_ratio: 100, moment_arm_m: 0.095, lever_ratio: 10}}
bus: {{interface: {interface}, channel: {channel}, bitrate: 1000000}}
servo: {{node: 1, counts_per_motor_turn: 4096, rated_current_A: 15, rated_torque_N_m: 0.45,
  eds: drive.eds{keys}}}
encoder: {{node: 2, counts_per_turn: 262144, eds: encoder.eds}}
cycle_Hz: 50
limits: {{angle_min_deg: -30, angle_max_deg: 30, speed_deg_s: 120, torque_N_m: 75, current_A: 25,
  following_error_deg: 5, encoder_disagreement_deg: 1, weight_kg: 40, contact_force_N: 4000,
  sample_age_ms: 400, lateness_ms: 50, supply_min_V: 48, supply_max_V: 72}}
weights_hung_by: hoist
"""
SEQUENCE = """\
sequence: 1
name: short
stages:
  - {name: empty, stage: unloaded, tones: [{amplitude_deg: 4, frequency_Hz: 0.5}], duration_s: 2,
     ramp_in_s: 0.5, ramp_out_s: 0.5, settle_s: 0.1}
"""


@dataclass(frozen=True)
class Case:
    """Attributes: objects that drive and EDS lack, objects that only the drive lacks, 1029h:01h,
    the time that an SDO answer takes, s, whether remote frames are answered, keys of the bench
    file.
    """

    name: str
    lacks: frozenset[int] = frozenset()
    hides: frozenset[int] = frozenset()
    behaviour: int = 1
    sdo_s: float = 0.0
    remote_frames: bool = True
    keys: str = ""


OPTIONAL = (
    *(0x1009, 0x100A, 0x1014, 0x1016, 0x1017, 0x1029, 0x6007, 0x603F, 0x605A, 0x6065, 0x606C),
    *(0x6072, 0x6073, 0x6075, 0x6076, 0x6077, 0x6078, 0x6079, 0x607D, 0x607F, 0x6085, 0x60C2),
    0x6502,
)


def cases() -> Iterator[Case]:
    for behaviour in (0, 1, 2):
        for lag_ms in (0, 20, 50, 100):
            name = f"1029h:01h = {behaviour}, SDO {lag_ms} ms"
            yield Case(name, behaviour=behaviour, sdo_s=lag_ms * 1e-3)
    for index in OPTIONAL:
        behaviour = 0 if index == 0x1029 else 1
        yield Case(f"without {index:04X}h", frozenset({index}), behaviour=behaviour)
    guarded = frozenset({0x1016})
    yield Case("life guarding, 1029h:01h = 0, SDO 50 ms", guarded, behaviour=0, sdo_s=0.05)
    yield Case("life guarding, 1029h:01h = 2", guarded, behaviour=2)
    unwatched = frozenset({0x1016, 0x100C, 0x100D})
    yield Case("no watchdog, SDO 100 ms", unwatched, sdo_s=0.1)
    told = ", stops_alone: false"
    yield Case("no remote frames, told", guarded, remote_frames=False, keys=told)
    # These must be refused by the check and by the run alike.
    for index in (0x1016, 0x6007, 0x605A, 0x60C2):
        yield Case(f"EDS of another firmware, {index:04X}h", hides=frozenset({index}))
    yield Case("no remote frames", guarded, remote_frames=False)


# The drive and the encoder, in a process of their own.


Hear = Callable[[int, bytes, bool], None]
"""Takes a frame: identifier, data, and whether it is a remote frame."""


class UdpWire:
    """The bus in the network namespace."""

    interface = "udp_multicast"

    def __init__(self) -> None:
        self.channel = f"239.74.{os.getpid() >> 8 & 0xFF}.{os.getpid() & 0xFF}"
        self._bus = can.Bus(interface=self.interface, channel=self.channel, hop_limit=0)

    def put(self, identifier: int, data: bytes) -> None:
        self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def listen(self, hear: Hear) -> None:
        while True:
            if (message := self._bus.recv(1.0)) is not None:
                hear(message.arbitration_id, bytes(message.data), message.is_remote_frame)


class SlcanWire:
    """The near end of a LAWICEL adapter: lines on a pseudo-terminal."""

    interface = "slcan"

    def __init__(self) -> None:
        self._descriptor, theirs = pty.openpty()
        tty.setraw(theirs)
        self.channel = os.ttyname(theirs)
        self._lock = threading.Lock()

    def put(self, identifier: int, data: bytes) -> None:
        line = f"t{identifier:03X}{len(data)}{bytes(data).hex().upper()}\r".encode()
        with self._lock, suppress(OSError):
            os.write(self._descriptor, line)

    def listen(self, hear: Hear) -> None:
        rest = b""
        while True:
            try:
                rest += os.read(self._descriptor, 4096)
            except OSError:
                time.sleep(0.01)  # nobody has the other end open
                continue
            *lines, rest = rest.split(b"\r")
            for line in lines:
                if line[:1] not in (b"t", b"r"):
                    continue
                data = bytes.fromhex(line[5:].decode()) if line[:1] == b"t" else b""
                hear(int(line[1:4], 16), data, line[:1] == b"r")


WIRES: Mapping[str, type[UdpWire] | type[SlcanWire]] = {"udp": UdpWire, "slcan": SlcanWire}
ALONE = "DURAND_PEER_ALONE"


def stay_alone() -> None:
    """Start this program again in a network namespace in which only the loopback interface is."""
    route = 'ip link set lo up && ip route add 224.0.0.0/4 dev lo && exec "$@"'
    command = [sys.executable, "-m", "tests.long.durand_peer", *sys.argv[1:]]
    os.environ[ALONE] = "1"
    os.execvp("unshare", ["unshare", "-rn", "sh", "-c", route, "sh", *command])


class Plant:
    """A joint with Coulomb and viscous friction, and the drive's own cascade of loops."""

    def __init__(self) -> None:
        self.angle = self.speed = self.integral = self.current = 0.0

    def advance(
        self, powered: bool, start: float, end: float, most_A: float, passed_s: float
    ) -> None:
        """Let ``passed_s`` pass, in which the demand moves from start to end, rad."""
        steps = max(1, round(passed_s / STEP_S))
        rate, mean, most = (end - start) / (steps * STEP_S), 0.0, most_A * KT * GEAR
        for step in range(1, steps + 1):
            torque = 0.0
            if powered:
                error = rate + 40.0 * (start + rate * step * STEP_S - self.angle) - self.speed
                torque = 100.0 * error + self.integral
                if abs(torque) < most:
                    self.integral += 4000.0 * error * STEP_S
                torque = min(max(torque, -most), most)
            else:
                self.integral = 0.0
            free = self.speed + STEP_S / 0.204 * (torque - 5.3 * self.speed)
            brake = STEP_S / 0.204 * 6.8
            self.speed = 0.0 if abs(free) <= brake else free - math.copysign(brake, free)
            self.angle += STEP_S * self.speed
            mean += torque / (KT * GEAR) / steps
        self.current = mean


STATUS = {"off": 0x40, "ready": 0x31, "on": 0x33, "run": 0x37, "quick stop": 0x17, "fault": 0x08}
POWERED = ("on", "run", "quick stop")


def next_state(state: str, word: int, rising: int) -> str:
    """Return the state that follows a controlword, by CiA 402-2."""
    if state == "fault":
        return "off" if rising & 0x80 else state
    if not word & 0x02:
        return "off"
    if not word & 0x04:
        return "quick stop" if state in ("run", "quick stop") else "off"
    if state == "quick stop":
        return state
    if not word & 0x01:
        return "ready"
    if state == "off":
        return state
    if state == "ready":
        return "on"
    return "run" if word & 0x08 else "on"


def hurry(priority: int) -> None:
    """Run this process before all others, where this is allowed, because both sides are in real
    time; the drive, as a device of its own, runs before the commands.
    """
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))


def serve(case: Case, folder: Path, wire: UdpWire | SlcanWire) -> None:
    """Be drive and encoder until the process is ended; write EDS files and what happens."""
    import durand
    from durand import DatatypeEnum as Type
    from durand.network import NetworkABC
    from durand.object_dictionary import ObjectDictionary
    from durand.scheduler import AbstractScheduler
    from durand.services.nmt import StateEnum

    lock = threading.RLock()
    log = (folder / "drive.log").open("a", buffering=1)

    class Timers(AbstractScheduler[threading.Timer]):
        def add(
            self, delay: float, callback: Any, args: Any = (), kwargs: Any = None
        ) -> threading.Timer:
            def run() -> None:
                with lock:
                    callback(*args, **(kwargs or {}))

            timer = threading.Timer(delay, run)
            timer.daemon = True
            timer.start()
            return timer

        def cancel(self, entry: threading.Timer) -> None:
            entry.cancel()

        @property
        def lock(self) -> Any:
            return lock

    def tick() -> None:
        """Note when the computer does not run this process in time."""
        while True:
            due = time.monotonic() + TICK_S
            time.sleep(TICK_S)
            if (late := time.monotonic() - due) > LATE_S:
                log.write(json.dumps([time.time(), f"{BUSY} {late:.3f} s"]) + "\n")

    threading.Thread(target=tick, daemon=True).start()
    timers = Timers()
    durand.set_scheduler(timers)

    class Lacking(ObjectDictionary):  # type: ignore[misc]
        """A dictionary without some of the objects that durand always adds."""

        def __init__(self, lacks: Collection[int]) -> None:
            super().__init__()
            self.lacks = lacks

        def __setitem__(self, index: int, item: Any) -> None:
            if index not in self.lacks:
                super().__setitem__(index, item)

        def write(self, index: int, subindex: int, value: Any, downloaded: bool = False) -> None:
            if index not in self.lacks:
                super().write(index, subindex, value, downloaded)

    class Net(NetworkABC):  # type: ignore[misc]
        def __init__(self, wire: UdpWire | SlcanWire | None) -> None:
            self.wire = wire
            self.calls: dict[int, Any] = {}

        def add_subscription(self, cob_id: int, callback: Any) -> None:
            self.calls[cob_id] = callback

        def remove_subscription(self, cob_id: int) -> None:
            self.calls.pop(cob_id, None)

        def send(self, cob_id: int, msg: bytes) -> None:
            wire = self.wire
            if wire is None:
                return
            if case.sdo_s and cob_id & 0x780 == 0x580:
                timers.add(case.sdo_s, wire.put, (cob_id, bytes(msg)))
            else:
                wire.put(cob_id, bytes(msg))

        def hear(self, identifier: int, data: bytes) -> None:
            if (call := self.calls.get(identifier)) is not None:
                call(identifier, data)

    def node(net: Net, number: int, lacks: Collection[int], name: str) -> Any:
        made = durand.MinimalNode(net, number, Lacking(lacks))
        objects = made.object_dictionary
        objects[0x1008].value = name.encode()
        for index in (0x1009, 0x100A):
            if index in objects:
                objects[index].value = b"1"
        for sub, value in enumerate((0x1234 + number, 0x42, 1, number), 1):
            objects[0x1018][sub].value = value
        return made

    def put(objects: Any, rows: Mapping[int, tuple[Any, str, int]]) -> None:
        for index, (kind, access, value) in rows.items():
            objects[index] = durand.Variable(kind, access, value, name=f"Object {index:04X}")

    def record(objects: Any, index: int, *members: tuple[Any, str, int]) -> None:
        item = durand.Record(name=f"Record {index:04X}")
        for sub, (kind, access, value) in enumerate(members, 1):
            item[sub] = durand.Variable(kind, access, value, name=f"{index:04X} {sub}")
        objects[index] = item

    u8, u16, u32 = Type.UNSIGNED8, Type.UNSIGNED16, Type.UNSIGNED32
    i8, i16, i32 = Type.INTEGER8, Type.INTEGER16, Type.INTEGER32
    limit = round(30 / 360 * GEAR * COUNTS)

    def drive(net: Net, lacks: Collection[int]) -> Any:
        made = node(net, 1, lacks, "durand drive")
        objects = made.object_dictionary
        objects[0x1000].value = 0x00020192
        put(
            objects,
            {
                0x100C: (u16, "rw", 0),
                0x100D: (u8, "rw", 0),
                0x6007: (i16, "rw", 0),
                0x603F: (u16, "ro", 0),
                0x6040: (u16, "rw", 0),
                0x6041: (u16, "ro", STATUS["off"]),
                0x605A: (i16, "rw", 2),
                0x6060: (i8, "rw", 0),
                0x6061: (i8, "ro", 0),
                0x6064: (i32, "ro", 0),
                0x6065: (u32, "rw", 40000),
                0x606C: (i32, "ro", 0),
                0x6072: (u16, "rw", 1670),
                0x6073: (u16, "rw", 1670),
                0x6075: (u32, "rw", 15000),
                0x6076: (u32, "rw", 450),
                0x6077: (i16, "ro", 0),
                0x6078: (i16, "ro", 0),
                0x6079: (u32, "ro", 60000),
                0x607A: (i32, "rw", 0),
                0x607F: (u32, "rw", 136534),
                0x6085: (u32, "rw", 2_000_000),
                0x6502: (u32, "ro", 0x80),
            },
        )
        record(objects, 0x1016, (u32, "rw", 0))
        record(objects, 0x1029, (u8, "rw", case.behaviour))
        record(objects, 0x607D, (i32, "rw", -limit), (i32, "rw", limit))
        record(objects, 0x60C2, (u8, "rw", 20), (i8, "rw", -3))
        return made

    def encoder(net: Net) -> Any:
        made = node(net, 2, (), "durand encoder")
        objects = made.object_dictionary
        objects[0x1000].value = 0x00010196
        rows = {0x6001: (u32, "rw", TURN), 0x6002: (u32, "rw", TURN), 0x6004: (u32, "ro", 0)}
        put(objects, rows)
        return made

    described = drive(Net(None), case.lacks)
    (folder / "drive.eds").write_text(described.eds.content)
    (folder / "encoder.eds").write_text(encoder(Net(None)).eds.content)

    servo_net, encoder_net = Net(wire), Net(wire)
    servo, joint = drive(servo_net, case.lacks | case.hides), encoder(encoder_net)
    objects, plant = servo.object_dictionary, Plant()
    state, word, demand, toggle = "off", 0, 0.0, 0
    synced_s = time.monotonic()
    alive: threading.Timer | None = None

    def read(index: int, subindex: int = 0, default: int = 0) -> int:
        return int(objects.read(index, subindex)) if index in objects else default

    def enter(following: str) -> None:
        nonlocal state
        if following != state:
            log.write(json.dumps([time.time(), following]) + "\n")
        state = following
        objects.write(0x6041, 0, STATUS[state] | 0x200)
        if state not in ("run", "quick stop"):
            # The power stage is off at once, also if no further SYNC comes.
            plant.current = plant.integral = 0.0
            for index in (0x6077, 0x6078):
                objects.write(index, 0, 0)

    def command(value: int) -> None:
        nonlocal word
        rising, word = value & ~word, value
        enter(next_state(state, value, rising))
        if state == "off":
            objects.write(0x603F, 0, 0)

    def master_lost() -> None:
        servo.emcy.set(0x8130, 0x11)
        log.write(json.dumps([time.time(), "master lost"]) + "\n")
        if read(0x6007) == 1:
            objects.write(0x603F, 0, 0x8130)
            enter("fault")
        behaviour = read(0x1029, 1)
        if behaviour != 1:
            servo.nmt.set_state(StateEnum.STOPPED if behaviour else StateEnum.PRE_OPERATIONAL)

    def watch(seconds: float) -> None:
        nonlocal alive
        if alive is not None:
            alive.cancel()
        alive = timers.add(seconds, master_lost) if seconds else None

    def guarded() -> None:
        nonlocal toggle
        if not case.remote_frames or read(0x1017):
            return
        servo_net.send(0x701, bytes([servo.nmt.state | toggle]))
        toggle ^= 0x80
        if life := read(0x100C) * read(0x100D):
            watch(life * 1e-3)

    def stop_watching(value: int) -> None:
        if not value & 0xFFFF:
            watch(0.0)

    def sync() -> None:
        nonlocal demand, synced_s
        # Not each SYNC is one cycle after the last: the first one of a braking is sent at once.
        now_s = time.monotonic()
        passed_s, synced_s = min(now_s - synced_s, 2.0 * CYCLE_S), now_s
        start = demand if state in ("run", "quick stop") else plant.angle
        target = read(0x607A) * math.tau / (GEAR * COUNTS)
        demand = target if state == "run" else start
        powered, most_A = state in ("run", "quick stop"), read(0x6073, 0, 1670) * 0.015
        plant.advance(powered, start, demand, most_A, passed_s)
        if state == "quick stop" and abs(plant.speed) < 1e-3:
            enter("off")
        counts = plant.angle / math.tau * GEAR * COUNTS
        values = {
            0x6064: counts,
            0x606C: plant.speed / math.tau * GEAR * COUNTS,
            0x6077: plant.current * KT / RATED_N_M * 1e3,
            0x6078: plant.current / RATED_A * 1e3,
        }
        for index, value in values.items():
            objects.write(index, 0, round(value))
        joint.object_dictionary.write(0x6004, 0, round(plant.angle / math.tau * TURN) % TURN)

    def hear(identifier: int, data: bytes, remote: bool) -> None:
        with lock:
            if remote:
                if identifier == 0x701:
                    guarded()
                return
            if identifier == 0x080:
                sync()
            if identifier == 0x77F and read(0x1016, 1) & 0xFFFF:
                watch((read(0x1016, 1) & 0xFFFF) * 1e-3)
            servo_net.hear(identifier, data)
            encoder_net.hear(identifier, data)

    objects.update_callbacks[0x6040, 0].add(command)
    objects.update_callbacks[0x6060, 0].add(lambda value: objects.write(0x6061, 0, value))
    objects.update_callbacks[0x1016, 1].add(stop_watching)
    objects.update_callbacks[0x100D, 0].add(stop_watching)
    print(wire.channel, flush=True)
    wire.listen(hear)


# The commands, and what must come of them.


@dataclass
class Result:
    case: Case
    problems: list[str] = field(default_factory=list)
    seconds: float = 0.0
    repeats: int = 0


@contextmanager
def peer(case: Case, folder: Path, wire: str) -> Iterator[str]:
    """Run drive and encoder; yield the channel of the bus."""
    command = [sys.executable, "-m", "tests.long.durand_peer", "--serve", case.name]
    command += ["--wire", wire]
    with (folder / "peer.err").open("w") as errors:
        process = subprocess.Popen(
            [*command, "--folder", str(folder)],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )
        try:
            path = process.stdout.readline().strip()
            if not path:
                raise RuntimeError((folder / "peer.err").read_text())
            yield path
        finally:
            process.kill()
            process.wait()
            process.stdout.close()


ANSWERS = ((r"yes, no or abort \[no\]: $", "yes"), (r"Mass on the lever, kg: $", "0"))


def at_terminal(words: list[str], folder: Path, limit_s: float = 900.0) -> tuple[int, str]:
    """Run a command at a terminal of its own, answer its questions; return status and output."""
    pid, terminal = pty.fork()
    if not pid:
        os.chdir(folder)
        hurry(1)
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "dumb", "COLUMNS": "200"}
        command = [sys.executable, "-c", "from rig.cli.entry import main; main()", *words]
        os.execve(sys.executable, command, environment)
    shown, answered, end = "", 0, time.monotonic() + limit_s
    try:
        while time.monotonic() < end:
            if select.select([terminal], [], [], 0.1)[0]:
                try:
                    piece = os.read(terminal, 4096)
                except OSError:
                    break
                if not piece:
                    break
                shown += piece.decode(errors="replace")
                continue
            for question, answer in ANSWERS:
                if re.search(question, shown[answered:].rstrip("\r\n")):
                    answered = len(shown)
                    os.write(terminal, f"{answer}\n".encode())
        else:
            os.kill(pid, signal.SIGKILL)
            shown += "\nno end"
    finally:
        os.close(terminal)
        _, status = os.waitpid(pid, 0)
    return os.waitstatus_to_exitcode(status), shown


def events(folder: Path) -> list[tuple[float, str]]:
    """What the drive has noted, with its time, s."""
    path = folder / "drive.log"
    lines = path.read_text().splitlines() if path.exists() else []
    return [(float(when), str(what)) for when, what in map(json.loads, lines)]


def states(folder: Path) -> list[str]:
    return [what for _, what in events(folder) if not what.startswith(BUSY)]


def tried(case: Case, wire: str, quick: bool, keep: Path | None) -> Result:
    """Try a case, again if it failed while the computer was too busy for real time."""
    begun = time.monotonic()
    for repeats in range(REPEATS):
        result, busy = once(case, wire, quick, keep)
        result.repeats = repeats
        if not result.problems or not busy:
            break
    result.seconds = time.monotonic() - begun
    return result


def once(case: Case, wire: str, quick: bool, keep: Path | None) -> tuple[Result, bool]:
    result = Result(case)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with peer(case, folder, wire) as channel:
            text = BENCH.format(
                interface=WIRES[wire].interface, channel=channel, keys=case.keys, name=os.getpid()
            )
            (folder / "bench.yaml").write_text(text)
            (folder / "short.yaml").write_text(SEQUENCE)
            refused = bool(case.hides) or (not case.remote_frames and not case.keys)
            for problem in (trial_refused if refused else trial)(folder, quick):
                result.problems.append(problem)
        if keep is not None and result.problems:
            target = keep / re.sub("[^A-Za-z0-9]+", "_", case.name)
            target.mkdir(parents=True, exist_ok=True)
            for path in folder.iterdir():
                if path.is_file():
                    (target / path.name).write_bytes(path.read_bytes())
        late = "lateness of the control cycle" in " ".join(result.problems)
        return result, late or any(what.startswith(BUSY) for _, what in events(folder))


def command(folder: Path, name: str, words: list[str], wanted: int = 0) -> Iterator[str]:
    status, shown = at_terminal(words, folder)
    (folder / f"{name}.txt").write_text(shown)
    if status != wanted:
        yield f"{name}: status {status}, {' '.join(shown.split())[-300:]}"


def trial(folder: Path, quick: bool) -> Iterator[str]:
    yield from command(folder, "check", ["check", "bench.yaml"])
    if not quick:
        words = ["commission", "bench.yaml", "--angle", "0", "--out", "commissioned"]
        yield from command(folder, "commission", words)
        seen = states(folder)
        if "fault" in seen and seen.count("fault") > 1:
            yield f"commission: the drive was in fault {seen.count('fault')} times"
    before = len(states(folder))
    yield from command(folder, "run", ["run", "short.yaml", "--bench", "bench.yaml", "--out", "r"])
    seen = states(folder)[before:]
    if "run" not in seen or "fault" in seen or seen[-1:] != ["off"]:
        yield f"run: the drive went through {seen}"
    record = folder / "r" / "run.json"
    found = json.loads(record.read_text()) if record.exists() else {}
    if (found.get("state"), found.get("de_energised")) != ("done", True):
        yield f"run: {found.get('state')}, de-energised {found.get('de_energised')}"


def trial_refused(folder: Path, quick: bool) -> Iterator[str]:
    """A case in which a run would fail: the check says so, and the run gives no power."""
    status, shown = at_terminal(["check", "bench.yaml"], folder)
    (folder / "check.txt").write_text(shown)
    if status == 0 or "a run would start" in shown:
        yield f"check: status {status}, though a run would be refused"
    status, shown = at_terminal(
        ["run", "short.yaml", "--bench", "bench.yaml", "--out", "r"], folder
    )
    (folder / "run.txt").write_text(shown)
    if status == 0:
        yield "run: not refused"
    if any(state in POWERED for state in states(folder)):
        yield f"run: the drive went through {states(folder)}"


def main() -> int:
    """Try all cases; print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="")
    parser.add_argument("--wire", choices=WIRES, default="udp")
    parser.add_argument("--quick", action="store_true", help="without commissioning")
    parser.add_argument("--keep", type=Path, help="folder for the files of failed cases")
    parser.add_argument("--serve")
    parser.add_argument("--folder", type=Path)
    chosen = parser.parse_args()
    hurry(2)
    if chosen.wire == "udp" and ALONE not in os.environ:
        stay_alone()
    if chosen.serve is not None:
        case = next(case for case in cases() if case.name == chosen.serve)
        serve(case, chosen.folder, WIRES[chosen.wire]())
    todo = [case for case in cases() if chosen.only in case.name]
    failed = 0
    for case in todo:
        result = tried(case, chosen.wire, chosen.quick, chosen.keep)
        failed += bool(result.problems)
        verdict = "; ".join(result.problems) or "passed"
        again = f", {result.repeats} repeated" if result.repeats else ""
        print(f"{case.name:45} {result.seconds:5.0f} s  {verdict}{again}", flush=True)
    print(f"{len(todo) - failed} of {len(todo)} cases passed")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
