"""Random and mutated input for everything that reads: no exception but the declared ones.

python -m tests.long.fuzz [--count N] [--logs N] [--seed N] [NAME ...]

Frames and bytes for every decoder, half random, half mutations of good ones, since random ones
alone seldom get past the first check; damaged recordings; EDS files, DBC files and maps, each read
as it states or refused in words; logs of every format, each read to the last bit or something is
said, and damaged ones. What ends the program is told with its number.
"""

import argparse
import gc
import logging
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from random import Random

import numpy as np

from drivers.amt21 import encoder as amt21
from drivers.can import slcan
from drivers.can.port import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FramePort
from drivers.canopen.cia402_servo import Cia402Servo
from drivers.canopen.link import CanopenLink
from drivers.canopen.sensors import Cia406Encoder
from drivers.clock import NS, SimulatedClock
from drivers.dbc.codec import crc8_j1850
from drivers.dbc.link import DbcLink
from drivers.dbc.servo import DbcServo
from drivers.epos import frames as epos_serial
from drivers.errors import DeviceError, DriveFault
from drivers.interfaces import RawFrame
from drivers.mock.bench import DRIVE_NODE, ENCODER_NODE, simulated_bench
from drivers.mock.drive import DRIVE_EDS
from drivers.mock.encoder import ENCODER_EDS
from drivers.mock.plant.parts.constants import Machine
from drivers.units import EncoderScales, ServoScales
from rig.common.errors import InputError
from rig.common.sample import Sample
from rig.config.bench import load_bench
from rig.config.campaign_sections import ReadSection
from rig.config.dbc import wire
from rig.runs.mcap.reader import NotARecordingError, read_run
from rig.runs.recorder import open_recorder
from rig.sources.formats import open_table

BATCH = 50
REPORT = 10_000
KEPT = 50
"""Logs of a format that are kept to be damaged."""
MEMORY = Path("/dev/shm")
CYCLE_S = 0.001
SCALES = ServoScales(
    counts_per_turn=4096, gear_ratio=100.0, rated_current_A=15.0, rated_torque_N_m=0.45
)
_FLAGS = (0, 0, 0, 0, 0, EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG)


class _Tap:
    """A port into which frames can be slipped, and whose own traffic can be cut off."""

    def __init__(self, inner: FramePort, clock: SimulatedClock) -> None:
        self._inner = inner
        self._clock = clock
        self.slipped_in: list[RawFrame] = []
        self.seen: list[RawFrame] = []
        self.cut = False

    def transmit(self, identifier: int, data: bytes) -> None:
        if not self.cut:
            self._inner.transmit(identifier, data)

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        if self.slipped_in:
            frames, self.slipped_in = self.slipped_in, []
            return frames
        if self.cut:
            self._clock.sleep_until_ns(self._clock.now_ns() + round(timeout_s * NS))
            return ()
        frames = list(self._inner.collect(timeout_s))
        self.seen += frames
        return frames

    def shutdown(self) -> None:
        self._inner.shutdown()


def mutated(frame: RawFrame, rng: np.random.Generator) -> RawFrame:
    """Return a frame with one thing wrong."""
    identifier, data = frame.identifier, bytearray(frame.data)
    match int(rng.integers(5)):
        case 0:
            identifier ^= 1 << int(rng.integers(11))
        case 1:
            data = data[: int(rng.integers(len(data) + 1))]
        case 2:
            data += rng.bytes(int(rng.integers(1, 5)))
        case 3 if data:
            data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        case _:
            identifier |= int(_FLAGS[rng.integers(5, 8)])
    return frame._replace(identifier=identifier, data=bytes(data[:64]))


def random_frame(rng: np.random.Generator) -> RawFrame:
    """Return a frame of anything."""
    identifier = int(rng.integers(0x800)) | int(_FLAGS[rng.integers(len(_FLAGS))])
    return RawFrame(0, identifier, rng.bytes(int(rng.integers(9))), False)


def fuzz_link(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed frames to the host's link while its devices are silent."""
    bench = simulated_bench(Machine(), 0)
    tap = _Tap(bench.bus, bench.clock)
    link = CanopenLink(bench.clock, lambda: tap)
    drive = link.add_node(DRIVE_NODE, DRIVE_EDS)
    nodes = (drive, link.add_node(ENCODER_NODE, ENCODER_EDS))
    servo = Cia402Servo(drive, link, SCALES)
    encoder = Cia406Encoder(
        nodes[1], EncoderScales(bench.machine.constants.sensing.joint_counts_per_turn)
    )
    link.open()
    servo.prepare(CYCLE_S)
    encoder.prepare(CYCLE_S)
    for _ in range(20):
        link.exchange()
    good, tap.cut = tap.seen, True
    lengths = {identifier: slot.size for node in nodes for identifier, slot in node.inputs.items()}
    counts: Counter[str] = Counter()
    for _ in range(-(-count // BATCH)):
        frames = [
            random_frame(rng) if rng.integers(2) else mutated(good[rng.integers(len(good))], rng)
            for _ in range(BATCH)
        ]
        bad = [f for f in frames if lengths.get(f.identifier) != len(f.data)]
        before = [slot.values for node in nodes for slot in node.inputs.values()]
        counts += _exchange(link, tap, bad)
        after = [slot.values for node in nodes for slot in node.inputs.values()]
        assert before == after, f"a bad frame changed a sample: {bad}"
        counts += _exchange(link, tap, [f for f in frames if f not in bad])
        servo.sample()
        encoder.sample()
        counts["frames"] += BATCH
        counts["bad"] += len(bad)
        link.take_frames()
    link.close()
    return counts


def _exchange(link: CanopenLink, tap: _Tap, frames: list[RawFrame]) -> Counter[str]:
    tap.slipped_in = frames
    try:
        link.exchange()
    except DeviceError as error:
        return Counter([type(error).__name__])
    return Counter()


class _Liar:
    """A port behind which every SDO request is answered with nonsense."""

    def __init__(self, clock: SimulatedClock, rng: np.random.Generator) -> None:
        self._clock = clock
        self._rng = rng
        self._answers: list[RawFrame] = []
        self.sent = 0

    def transmit(self, identifier: int, data: bytes) -> None:
        rng = self._rng
        self.sent += 1
        command = int(_SDO_COMMANDS[rng.integers(len(_SDO_COMMANDS))])
        answer = RawFrame(0, 0x581, bytes([command]) + data[1:4] + rng.bytes(4), False)
        match int(rng.integers(4)):
            case 0:
                answer = mutated(answer, rng)
            case 1:
                answer = answer._replace(data=rng.bytes(8))
        self._answers = [answer] * int(rng.integers(0, 3))

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        answers, self._answers = self._answers, []
        if not answers:
            self._clock.sleep_until_ns(self._clock.now_ns() + round(timeout_s * NS))
        return answers

    def shutdown(self) -> None:
        """Nothing to close."""


_SDO_COMMANDS = (0x43, 0x4B, 0x4F, 0x41, 0x40, 0x60, 0x80, 0x00, 0x10, 0x01, 0x11, 0x20, 0x30)


def fuzz_sdo_client(count: int, rng: np.random.Generator) -> Counter[str]:
    """Read and write objects of a device that answers nonsense, for ``count`` requests."""
    clock = SimulatedClock()
    liar = _Liar(clock, rng)
    link = CanopenLink(clock, lambda: liar)
    drive = link.add_node(DRIVE_NODE, DRIVE_EDS)
    link.open()
    counts: Counter[str] = Counter()
    actions = (
        lambda: drive.read(0x6041),
        lambda: drive.read_text(0x1008),
        lambda: drive.write(0x607A, 0, 1),
    )
    while liar.sent < count:
        try:
            actions[rng.integers(3)]()
            counts["taken for good"] += 1
        except DeviceError as error:
            counts[type(error).__name__] += 1
        link.take_frames()
    link.close()
    return counts + Counter(frames=liar.sent)


def fuzz_twins(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed frames to the simulated devices as a mad host would."""
    bench = simulated_bench(Machine(), 0)
    good = [
        RawFrame(0, 0x000, bytes([1, 1]), True),
        RawFrame(0, 0x080, b"", True),
        RawFrame(0, 0x201, bytes(6), True),
        RawFrame(0, 0x77F, b"\x05", True),
        RawFrame(0, 0x601, bytes.fromhex("2b4060000f000000"), True),
        RawFrame(0, 0x601, bytes.fromhex("4041600000000000"), True),
        RawFrame(0, 0x602, bytes.fromhex("4004600000000000"), True),
        RawFrame(0, 0x601, bytes.fromhex("2116100000000000"), True),
        RawFrame(0, 0x602, bytes.fromhex("6000000000000000"), True),
    ]
    counts: Counter[str] = Counter()
    for _ in range(-(-count // BATCH)):
        for _ in range(BATCH):
            frame = (
                random_frame(rng)
                if rng.integers(2)
                else mutated(good[rng.integers(len(good))], rng)
            )
            bench.bus.transmit(frame.identifier & 0x7FF, frame.data[:8])
        counts["frames"] += BATCH
        counts["answers"] += len(bench.bus.collect(0.01))
        bench.clock.sleep_until_ns(bench.clock.now_ns() + NS // 100)
    bench.bus.shutdown()
    return counts


def _spoiled(encoded: Callable[[], bytes], rng: np.random.Generator) -> bytes:
    """Return 20 frames in a row, three of four spoiled: noise, a wrong bit, a byte missing."""
    line = bytearray()
    for _ in range(20):
        good = bytearray(encoded())
        match int(rng.integers(4)):
            case 0:
                good = bytearray(rng.bytes(len(good)))
            case 1 if good:
                good[rng.integers(len(good))] ^= 1 << int(rng.integers(8))
            case 2 if good:
                del good[rng.integers(len(good))]
        line += good
    return bytes(line)


def _pieces(line: bytes, rng: np.random.Generator) -> Iterator[bytes]:
    at = 0
    while at < len(line):
        step = int(rng.integers(1, 40))
        yield line[at : at + step]
        at += step


def fuzz_epos_serial(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed ``count`` bytes of noise and of damaged frames to the EPOS decoder."""
    decoder = epos_serial.FrameDecoder()
    counts: Counter[str] = Counter()
    while counts["bytes"] < count:
        line = _spoiled(
            lambda: epos_serial.encode(int(rng.integers(256)), rng.bytes(2 * int(rng.integers(8)))),
            rng,
        )
        for piece in _pieces(line, rng):
            for found in decoder.feed(piece):
                counts["frames"] += 1
                assert epos_serial.encode(*found) in line, f"{found} was never on the line"
        counts["bytes"] += len(line)
        decoder.clear()
        whole = epos_serial.Frame(0x60, rng.bytes(4))
        assert decoder.feed(epos_serial.encode(*whole)) == [whole]
        decoder.clear()
    counts["dropped"] = decoder.bad
    return counts


def fuzz_slcan(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed ``count`` bytes of noise and of damaged lines to the decoder of CAN adapters."""
    decoder = slcan.LineDecoder()
    counts: Counter[str] = Counter()
    while counts["bytes"] < count:
        line = _spoiled(
            lambda: slcan.encode(int(rng.integers(0x800)), rng.bytes(int(rng.integers(9)))), rng
        )
        whole = int(rng.integers(0x800)), rng.bytes(8)
        line += b"\r" + slcan.encode(*whole)
        found = [frame for piece in _pieces(line, rng) for frame in decoder.feed(piece)]
        said = b"\r" + line.replace(b"\a", b"\r").upper()
        for identifier, data in found:
            if identifier <= 0x7FF:
                text = b"\r" + slcan.encode(identifier, data)[:-1].upper()
                assert text in said, f"{identifier:03X} {data.hex()} was never on the line"
        assert found[-1] == whole
        counts["frames"] += len(found)
        counts["bytes"] += len(line)
    counts["dropped"] = decoder.bad
    return counts


def fuzz_amt21(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed ``count`` answers of 0 to 4 bytes to the AMT21 decoder."""
    counts: Counter[str] = Counter()
    for _ in range(count):
        answer = rng.bytes(2 if rng.integers(4) else int(rng.integers(5)))
        value = amt21.decode(answer)
        counts["frames"] += 1
        if value is not None:
            assert amt21.encode(value) == answer
            counts["taken for good"] += 1
    return counts


class _Silence:
    """A port on which nobody answers and only what is slipped in arrives."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self.slipped_in: list[RawFrame] = []

    def transmit(self, identifier: int, data: bytes) -> None:
        """Nobody hears it."""

    def collect(self, timeout_s: float) -> Sequence[RawFrame]:
        self._clock.sleep_until_ns(self._clock.now_ns() + round(timeout_s * NS))
        frames, self.slipped_in = self.slipped_in, []
        return frames

    def shutdown(self) -> None:
        """Nothing to close."""


def fuzz_dbc(count: int, rng: np.random.Generator) -> Counter[str]:
    """Feed frames to a drive's own CAN frames; what is taken has its length and its checksum."""
    document = load_bench("practical_dbc")
    section = document.value.servo
    clock = SimulatedClock()
    bus = _Silence(clock)
    link = DbcLink(clock, lambda: bus)
    wiring = wire(section, Path(document.path), True, document.problem)
    channel = link.add_channel(wiring, "the drive")
    servo = DbcServo(link, channel, section.drive(100.0, 0.03))
    link.open()
    link.set_cycle(CYCLE_S, "the fuzzer")
    channel.set_cycle(CYCLE_S)
    known = sorted(channel.slots)
    enable = channel.wiring.enable[next(iter(channel.wiring.enable))]
    counts: Counter[str] = Counter()
    while counts["frames"] < count:
        for _ in range(20):
            identifier = int(rng.choice(known)) if rng.integers(4) else int(rng.integers(0x800))
            data = bytearray(rng.bytes(int(rng.integers(9)) if rng.integers(4) == 0 else 8))
            slot = channel.slots.get(identifier)
            if slot is not None and slot.message.checksum is not None and rng.integers(2):
                data = data[: slot.message.size - 1]
                data.append(crc8_j1850(bytes(data) + b"\0"))
                counts["made good"] += 1
            flag = (EXTENDED_FLAG, REMOTE_FLAG)[rng.integers(2)] if rng.integers(10) == 0 else 0
            frame = RawFrame(clock.now_ns(), identifier | flag, bytes(data), False)
            bus.slipped_in.append(frame)
        before = {identifier: (slot.data, slot.count) for identifier, slot in channel.slots.items()}
        channel.order(enable, hold=bool(rng.integers(2)))
        try:
            link.exchange()
        except DriveFault:
            counts["faults told"] += 1
        assert all(isinstance(value, bool | int | float) for value in servo.sample())
        for identifier, slot in channel.slots.items():
            data_before, count_before = before[identifier]
            if slot.count == count_before:
                assert slot.data is data_before
                continue
            counts["taken"] += slot.count - count_before
            assert len(slot.data) == slot.message.size
            if slot.message.checksum is not None:
                right = crc8_j1850(slot.data[:-1] + b"\0")
                assert slot.data[-1] == right, "a bad checksum got through"
        link.take_frames()
        counts["frames"] += 20
    link.close()
    return counts


def fuzz_recording(count: int, rng: np.random.Generator, folder: Path) -> Counter[str]:
    """Damage a recording of some 20 kB in ``count`` / 50 ways."""
    whole = folder / "whole.mcap"
    write_recording(whole, 200)
    content = whole.read_bytes()
    times = read_run(whole).samples["time"]
    path = folder / "damaged.mcap"
    counts: Counter[str] = Counter()
    for _ in range(-(-count // 50)):
        path.write_bytes(damaged(content, rng))
        counts["files"] += 1
        try:
            log = read_run(path)
        except NotARecordingError:
            counts["NotARecordingError"] += 1
            continue
        found = log.samples["time"]
        counts["damage reported"] += log.damage is not None
        assert np.isin(found, times).all(), (
            "a damaged recording gave a sample that was never written"
        )
    return counts


def write_recording(path: Path, samples: int) -> None:
    """Write a small recording with samples, frames, events and an attachment."""
    recorder = open_recorder(path)
    recorder.metadata("run", {"name": "fuzz"})
    recorder.attach("run.json", "application/json", b"{}")
    for number in range(samples):
        values = np.random.default_rng(number).standard_normal(len(Sample._fields) - 1)
        sample = Sample(number * 0.001, *values.tolist())
        recorder.sample(number * 1_000_000, sample, [RawFrame(number, 0x181, bytes(8), False)])
        if number % 50 == 0:
            recorder.event(number * 1_000_000, "note", number=number)
    recorder.close()


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with bits flipped, bytes zeroed, a piece missing or the end cut off, up to
    three times.
    """
    spoiled = bytearray(content)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(spoiled)))
        match int(rng.integers(5)):
            case 0:
                spoiled[at] ^= 1 << int(rng.integers(8))
            case 1:
                spoiled[at : at + 8] = rng.bytes(8)
            case 2:
                spoiled[at : at + int(rng.integers(1, 4096))] = bytes(int(rng.integers(1, 4096)))
            case 3:
                del spoiled[at : at + int(rng.integers(1, 512))]
            case _:
                del spoiled[max(at, 1) :]
    return bytes(spoiled)


DECODERS: Mapping[str, Callable[[int, np.random.Generator], Counter[str]]] = {
    "host's CAN link": fuzz_link,
    "host's SDO client": fuzz_sdo_client,
    "simulated devices": fuzz_twins,
    "EPOS serial": fuzz_epos_serial,
    "slcan": fuzz_slcan,
    "AMT21": fuzz_amt21,
    "DBC": fuzz_dbc,
}


def fuzz_drawn(name: str, count: int, seed: int, read: Callable[[Random], bool]) -> Counter[str]:
    """Draw texts or logs, read and judge each."""
    counts: Counter[str] = Counter()
    for number in range(count):
        try:
            counts["read" if read(Random(seed << 32 | number)) else "refused"] += 1
        except BaseException:
            print(f"{name}: number {number}, seed {seed}", file=sys.stderr, flush=True)
            raise
        if (number + 1) % REPORT == 0:
            print(f"{name}: {dict(counts)}", file=sys.stderr, flush=True)
    return counts


def fuzz_logs(name: str, count: int, seed: int, folder: Path) -> Counter[str]:
    """Draw logs of a format; then open some of them damaged, a fifteenth as often."""
    from tests.rig.formats.shapes import PROPERTIES

    logs, holds = PROPERTIES[name]
    kept: list[Path] = []

    def read(random: Random) -> bool:
        good = holds(logs(random), folder)
        if good and len(kept) < KEPT:
            place = folder / f"kept{len(kept)}"
            place.mkdir()
            kept.append(place)
            for path in folder.glob("a.*"):
                shutil.copy(path, place)
        return good

    counts = fuzz_drawn(name, count, seed, read)
    rng = np.random.default_rng(seed)
    whole = [path for place in kept for path in place.glob("a.*") if path.suffix != ".dbc"]
    for number in range(count // 15):
        source = whole[number % len(whole)]
        path, dbc = source.with_name(f"damaged{source.suffix}"), source.with_name("a.dbc")
        path.write_bytes(damaged(source.read_bytes() or b"\0", rng))
        try:
            table = open_table(
                path, ReadSection(dbc=(str(dbc),)) if dbc.exists() else ReadSection()
            )
            for column in range(len(table.names)):
                table.read([column])
        except InputError:
            counts["damaged, refused"] += 1
        else:
            counts["damaged, read"] += 1
        path.unlink()
    return counts


def main() -> int:
    """Fuzz what is named, or all, and print the counts."""
    from tests.drivers import dbc_shapes, eds_shapes, map_shapes
    from tests.rig.formats.shapes import PROPERTIES

    texts = {**eds_shapes.TEXTS, **dbc_shapes.TEXTS, **map_shapes.TEXTS}
    names = [*DECODERS, "recordings", *texts, *PROPERTIES]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=names, metavar="NAME", help=", ".join(names))
    parser.add_argument(
        "--count", type=int, default=1_000_000, help="frames or bytes; of all texts"
    )
    parser.add_argument("--logs", type=int, default=150_000, help="of each format")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    seed, rng = options.seed, np.random.default_rng(options.seed)
    logging.disable()
    # A refused file makes its reader collect garbage, which passes over all that is imported.
    gc.freeze()
    for name in options.names:
        began = time.monotonic()
        with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as place:
            folder = Path(place)
            if name in DECODERS:
                counts = DECODERS[name](options.count, rng)
            elif name == "recordings":
                counts = fuzz_recording(options.count, rng, folder)
            elif name in texts:
                path, read = folder / f"text.{name[:3].lower()}", texts[name]
                share = options.count // len(texts)
                counts = fuzz_drawn(name, share, seed, lambda random: read(random, path))  # noqa: B023
            else:
                counts = fuzz_logs(name, options.logs, seed, folder)
        print(f"{name}: {dict(counts)}, {time.monotonic() - began:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
